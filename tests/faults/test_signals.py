"""A signal before every line of ours that `inteco-abs run` executes: outputs off, a whole session or none."""

import os
import random
import shutil
import signal
import sys
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import pytest

import inteco_abs.experiment
from inteco_abs.cli import main
from inteco_abs.mock_board import Device
from inteco_abs.rig import plant
from inteco_abs.sessions import TRUTH, provenance, read_session
from tests.faults.lines import OURS, Counting, Line, Strike, Tracing
from tests.faults.stage import SHORTEST

pytestmark = pytest.mark.untraced

INTERRUPTED = 130
SIGNALS = {
    "SIGINT": (signal.SIGINT,),
    "SIGTERM": (signal.SIGTERM,),
    "SIGHUP": (signal.SIGHUP,),
    "SIGINT twice": (signal.SIGINT, signal.SIGINT),
}
TOP = ("cli/__init__.py", "cli/verbs.py")
"""Always struck, as nobody is above them."""
DEADLY = (signal.SIGTERM, signal.SIGHUP)
"""Where nobody listens to them."""


class Died(BaseException):
    """The process would have been gone at this point, with nothing of ours executed any more."""


@dataclass
class Life:
    """One life of the command."""

    code: int | None = None
    """What it ended with; None if a signal killed it."""
    duties: list[tuple[float, float]] = field(default_factory=list)
    """Of every board that there was, when it ended."""
    escaped: BaseException | None = None
    said: str = ""
    struck: bool = True


@contextmanager
def handled(numbers, handler):
    """Signals handled so from outside of the command."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


class Command:
    """`inteco-abs run` in this process, in a folder that is empty each time."""

    def __init__(self, folder: Path, *options: str, virtual: bool = True) -> None:
        self.folder = folder
        settings = [word for setting in SHORTEST for word in ("--set", setting)]
        self._words = ["inteco-abs", "run", "--seed", "1", "--json", "--out", "stop.mcap", *settings, *options]
        self._words += ["--virtual"] if virtual else []

    def clear(self) -> None:
        for path in self.folder.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    def live(self, capsys, tracing: Tracing | None = None) -> Life:
        """From its first line to its last."""
        devices = []

        class Remembered(Device):
            def __init__(self, *arguments, **named):
                super().__init__(*arguments, **named)
                devices.append(self)

        life = Life()

        def die(*_):
            life.duties = [device.duties for device in devices]
            raise Died

        with pytest.MonkeyPatch.context() as patch, handled(DEADLY, die):
            patch.setattr(inteco_abs.experiment, "Device", Remembered)
            patch.setattr(sys, "argv", self._words)
            patch.chdir(self.folder)
            try:
                with tracing or nullcontext():
                    main()
            except SystemExit as end:
                life.code = int(end.code or 0)
            except Died:
                pass
            except BaseException as error:  # noqa: BLE001  whatever leaves is judged
                life.escaped = error
            else:
                raise AssertionError("the command returned")
        life.duties += [device.duties for device in devices]
        life.said = capsys.readouterr().err
        return life

    def struck(self, capsys, line: Line, n: int, numbers: tuple[int, ...]) -> Life:
        """The same with signals before the `n`-th execution of `line`."""
        self.clear()
        strike = Strike(line, n, *(partial(os.kill, os.getpid(), number) for number in numbers))
        life = self.live(capsys, strike)
        life.struck = strike.struck
        return life


@pytest.fixture
def command(tmp_path):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plant, "MOST_CUTS", 1)
        patch.setattr(provenance, "_git", lambda *_: None)
        yield partial(Command, tmp_path)


def problems(command: Command, life: Life) -> Iterator[str]:
    if not life.struck:
        yield "was never struck"
    if any(any(duties) for duties in life.duties):
        yield f"outputs were left on: {life.duties}"
    if life.escaped is not None and not nobody_left(life.escaped):
        yield f"{life.escaped!r} left the command"
    if "Traceback" in life.said or "internal error" in life.said:
        yield life.said
    if life.code is None:
        return  # killed, as the system does it, where nothing is open
    if life.code not in {0, INTERRUPTED}:
        yield f"ended with exit code {life.code}: {life.said}"
    for path in command.folder.iterdir():
        if path.name != "stop.mcap":
            yield f"left {path.name}"
        elif read_session(path).incomplete:
            yield "left a session that is cut"


def nobody_left(error: BaseException) -> bool:
    """Whether an interrupt came at the first or last line of the command, around which there is nothing of ours.

    There always are such lines; Python then ends with the same code, and a traceback.
    """
    ours = [frame.filename for frame in traceback.extract_tb(error.__traceback__) if frame.filename.startswith(OURS)]
    return isinstance(error, KeyboardInterrupt) and set(ours) <= {str(Path(OURS, "cli", "__init__.py"))}


def deliveries(times: dict[Line, int], draw: random.Random) -> list[tuple[Line, int]]:
    """Each line at its first and its last execution and at one between."""
    return [
        (line, n)
        for line, most in times.items()
        for n in sorted({1, most, draw.randint(1, most)})
    ]  # fmt: skip


def strike_each(command: Command, capsys, record_property, names, share: float):
    """Signals of these names at a share of all moments, drawn with a fixed seed."""
    command.live(capsys)  # imports happen once, and what is cached is computed once
    command.clear()
    counting, draw = Counting(), random.Random(3)
    command.live(capsys, counting)
    times = counting.times
    every = [(name, *moment) for moment in deliveries(times, draw) for name in names]
    drawn = draw.sample(every, round(share * len(every)))
    top = [each for each in every if str(each[1]).startswith(TOP) and signal.SIGINT in SIGNALS[each[0]]]
    chosen = list(dict.fromkeys([*drawn, *top]))
    bad, ends = [], Counter()
    for name, line, n in chosen:
        life = command.struck(capsys, line, n, SIGNALS[name])
        ends["killed" if life.code is None else life.code] += 1
        bad += [f"{name} at {line}, execution {n}: {problem}" for problem in problems(command, life)]
    left_on = sum("left on" in problem for problem in bad)
    how = ", ".join(f"{number} with {end}" for end, number in sorted(ends.items(), key=str))
    where = f"{', '.join(names)} before {len(times)} lines of a run: {len(chosen)} of {len(every)}"
    record_property("told", f"{where} delivered ({how}); outputs left on: {left_on}, other violations: {len(bad)}")
    assert not bad, "\n".join(bad)


def test_a_signal_before_any_line_of_a_run_leaves_outputs_off_and_no_cut_session(command, capsys, record_property):
    strike_each(command(), capsys, record_property, SIGNALS, 0.008)


@pytest.mark.long
@pytest.mark.parametrize(
    ("profile", "name"),
    [*(("sim_usb2", name) for name in SIGNALS), ("sim_usb", "SIGTERM"), ("sim_pci", "SIGINT twice")],
)
def test_a_signal_before_every_line_of_a_run_does_likewise(command, capsys, record_property, profile, name):
    strike_each(command("--set", f"profile={profile}"), capsys, record_property, [name], 1.0)


class TestInRealTime:
    """The process that the user started, and hears the signals; the board is another's, which keeps its own record."""

    pytestmark = pytest.mark.xdist_group("real time")
    FILES = ("realtime/supervisor.py", "realtime/hearing.py", "realtime/beating.py", "experiment.py")

    @pytest.fixture
    def struck(self, command, capsys, memories, left_processes):
        """Lines of the supervisor's process, and what is amiss after signals before one of them."""
        run, counting = command(virtual=False), Counting()
        run.live(capsys)
        run.clear()
        run.live(capsys, counting)

        def strike(line, name):
            life = run.struck(capsys, line, 1, SIGNALS[name])
            truth = memories[-1].truth_reader().newest()
            duties = TRUTH.array(truth)[["drive", "brake"]][0].item() if truth else (0.0, 0.0)
            # the mock board ends by itself with the process that the user started, which is the tests' own here
            left = [words for words in left_processes() if b"simulator" not in words]
            if any(duties) or left or life.escaped or life.code not in {0, 3, INTERRUPTED}:
                return life, f"{name} before {line}: {duties}, {left}, {life}"
            return life, ""

        return [line for line in counting.times if str(line).partition(":")[0] in self.FILES], strike

    def test_who_interrupts_just_before_the_loop_is_let_go_is_told_so(self, struck):
        lines, strike = struck
        (line,) = (each for each in lines if "prepare(supervisor_wishes())" in each.text)
        life, problem = strike(line, "SIGINT")
        assert not problem
        assert (life.struck, life.code) == (True, INTERRUPTED)

    @pytest.mark.long
    def test_a_signal_before_a_line_of_the_supervisor_leaves_outputs_off(self, struck, record_property):
        (lines, strike), draw = struck, random.Random(4)
        found = [strike(line, draw.choice(["SIGINT", "SIGINT twice"])) for line in draw.sample(lines, 40)]
        delivered, bad = sum(life.struck for life, _ in found), [problem for _, problem in found if problem]
        record_property("told", f"supervisor: {delivered} signals before {len(lines)} lines, violations: {len(bad)}")
        assert delivered
        assert not bad, "\n".join(bad)
