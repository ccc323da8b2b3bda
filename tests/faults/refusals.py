"""Pieces of work in which a request to the operating system is refused, and what is demanded of them."""

import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from io import BufferedWriter
from pathlib import Path
from typing import Any

import pytest

import inteco_abs.experiment.virtual_run
from inteco_abs.errors import AbsError, SessionError
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.mock_board import Device
from inteco_abs.realtime import TickRing, memory
from inteco_abs.realtime.processes.recorder import recover_run
from inteco_abs.rig import plant
from inteco_abs.sessions import TICK, file_writer, provenance, read_session, recover_session
from inteco_abs.sessions.mcap_writer import McapWriter
from inteco_abs.signals import Phase
from tests.commit import drawn_by_the_commit
from tests.faults.operations import Refusal, Requests, asking
from tests.faults.stage import SHORTEST, configured

LASTS = ("once", "kind", "all")


@dataclass
class Run:
    """What became of a piece of work."""

    requests: Requests
    expected: bytes
    """Ticks that must not be lost."""
    devices: list[Device] = field(default_factory=list)
    result: Any = None
    error: BaseException | None = None


class Place:
    """Folders for a session, for a second one, and for memory."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "disk"
        self.out, self.spill, self.memory = (self.folder / name for name in ("out", "spill", "memory"))
        self.session = self.out / "stop.mcap"
        self.config = configured(*SHORTEST)
        self.whole = b""
        """Ticks of the stop."""
        self.requests = Requests(str(self.folder))
        self.ring, self.cut = b"", b""
        """The stop as it was left in memory, and as a file that was cut in its middle."""

    def clear(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        for folder in (self.out, self.spill, self.memory):
            folder.mkdir(parents=True)

    def stop(self, **more: Any) -> Any:
        """One with everything that writes: a capture, a second place."""
        config = replace(self.config, session=replace(self.config.session, spill=str(self.spill)))
        return run_stop(config, Plan(self.session, seed=1, wire=self.out / "wire.jsonl"), **more)

    def stop_without_a_disk(self) -> Any:
        """One whose folder vanishes, and which therefore is left in memory."""

        def vanish(phase: Phase, _ticks: int) -> None:
            self.requests.aside = True
            if phase is Phase.BRAKING:
                shutil.rmtree(self.out, ignore_errors=True)
            self.requests.aside = False

        return run_stop(self.config, Plan(self.session, seed=1), vanish)

    def recover_memory(self) -> Any:
        return recover_run(self.memory / RING, self.session)

    def recover_cut_file(self) -> Any:
        return recover_session(self.spill / "cut.mcap", self.session)

    def perform(self, scene: str, refusal: Refusal | None = None) -> Run:
        self.clear()
        work = SCENES[scene](self)
        with pytest.MonkeyPatch.context() as patch:
            rings: list[TickRing] = []
            with asking(self.folder, refusal) as self.requests:
                run = Run(self.requests, b"")
                patch.setattr(inteco_abs.experiment.virtual_run, "Device", remembered(Device, run.devices))
                patch.setattr(inteco_abs.experiment.virtual_run, "TickRing", remembered(TickRing, rings))
                try:
                    run.result = work()
                except BaseException as error:  # noqa: BLE001  every exception is judged
                    run.error = error
        decided = rings[0].written * TICK.size if rings else None  # the other one has the rig's states
        run.expected = self.whole[:decided] if scene != CUT else bytes(read_session(self.spill / "cut.mcap").payload)
        if scene in STOPS and not rings:
            run.expected = b""
        return run

    def found(self) -> list[bytes]:
        """Ticks in every session that is there, and in every one that can be made of what is there."""
        for number, ring in enumerate(memory.left_rings(self.memory)):
            recover_run(ring, self.folder / f"recovered-{number}.mcap")
        return [bytes(session.payload) for session in map(readable, self.folder.rglob("*.mcap")) if session]

    def strays(self) -> set[str]:
        """Files that are neither session nor capture nor memory that was kept."""
        kept = {path.name for path in memory.left_rings(self.memory)}
        names = {path.name for path in self.folder.rglob("*") if path.is_file()}
        return names - {"stop.mcap", "wire.jsonl", "cut.mcap"} - kept


RING = "inteco-abs-0.ring"
CUT = "recovering a file that was cut"


def from_memory(place: Place) -> Callable[[], Any]:
    (place.memory / RING).write_bytes(place.ring)
    return place.recover_memory


def from_cut_file(place: Place) -> Callable[[], Any]:
    (place.spill / "cut.mcap").write_bytes(place.cut)
    return place.recover_cut_file


STOPS: dict[str, Callable[[Place], Callable[[], Any]]] = {
    "a stop": lambda place: place.stop,
    "a stop whose folder vanishes": lambda place: place.stop_without_a_disk,
}
SCENES = {**STOPS, "recovering what was left in memory": from_memory, CUT: from_cut_file}


def remembered(kind, made):
    class Remembered(kind):
        def __init__(self, *arguments, **named):
            super().__init__(*arguments, **named)
            made.append(self)

    return Remembered


def readable(path):
    try:
        return read_session(path)
    except SessionError:  # it was cut before anything of use
        return None


@contextmanager
def prepared_place():
    """Slices, chunks and buffers of a few ticks, so that the disk is written to all along; the disk is memory."""
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory(prefix="abs-", dir=memory.FOLDER) as folder:
        where = Place(Path(folder))
        patch.setattr(memory, "FOLDER", where.memory)
        patch.setattr(inteco_abs.experiment.virtual_run, "_SLICE_TICKS", 25)
        patch.setattr(file_writer, "McapWriter", partial(McapWriter, chunk_bytes=2048))
        patch.setattr(file_writer, "BufferedWriter", partial(BufferedWriter, buffer_size=1024))
        patch.setattr(plant, "MOST_CUTS", 1)
        patch.setattr(provenance, "_git", lambda *_: None)
        where.clear()
        where.stop()
        where.whole, where.cut = bytes(read_session(where.session).payload), where.session.read_bytes()
        where.cut = where.cut[: len(where.cut) * 2 // 3]
        where.clear()
        with pytest.raises(SessionError, match="kept in"):
            where.stop_without_a_disk()
        (ring,) = memory.left_rings(where.memory)
        where.ring = ring.read_bytes()
        yield where


def problems(place: Place, run: Run) -> Iterator[str]:
    requests, error = run.requests, run.error
    if any(any(device.duties) for device in run.devices):
        yield "outputs were left on"
    if error is not None and not isinstance(error, AbsError):
        yield f"raised {error!r}"
    if not requests.refused and requests.refusal.number < len(requests.kinds):
        yield "nothing was refused"
    cannot_remove = requests.refused_kind == "unlink" or requests.refusal.lasts == "all"
    strays = {name for name in place.strays() if f"{name} is complete" not in str(error)}
    if strays and not cannot_remove:
        yield f"left {sorted(strays)}"
    if not run.expected and not cannot_remove and place.session.exists():
        yield "no tick was decided, and there is a session"
    if error is None and not made_whole(run):
        yield f"{run.result.card['session']} is not whole"
    found = place.found()
    if not all(place.whole.startswith(payload) for payload in found):
        yield "ticks that never were"
    if run.expected and run.expected not in found and "The run is lost" not in str(error):
        most = max(map(len, found), default=0) // TICK.size
        yield f"of {len(run.expected) // TICK.size} ticks {most} are there, and no warning was given: {error!r}"


def made_whole(run: Run) -> bool:
    """Whether the session that the result names has everything."""
    session = readable(Path(run.result.card["session"]))
    return session is not None and not session.incomplete and session.payload == run.expected


FEWER = 3
"""Requests by which runs of one scene differ: the texts of durations and dates are not always of one length."""


def refuse(place: Place, scene: str, ways: int, step: int = 1) -> tuple[Counter[str], int, list[str]]:
    """One request in `step` refused in so many ways, which go by turns: requests by kind, runs, violations."""
    kinds = place.perform(scene).requests.kinds
    numbers = range(drawn_by_the_commit(step), len(kinds), step)
    refusals = [Refusal(number, LASTS[(number + way) % len(LASTS)]) for number in numbers for way in range(ways)]
    bad, refused = [], 0
    for refusal in refusals:
        run = place.perform(scene, refusal)
        refused += bool(run.requests.refused)
        bad += [f"{scene}, {refusal} ({run.requests.refused_kind}): {problem}" for problem in problems(place, run)]
    if len(refusals) - refused > FEWER * ways:
        bad.append(f"{scene}: {len(refusals) - refused} runs ended before the request that was to be refused")
    return Counter(kinds), len(refusals), bad
