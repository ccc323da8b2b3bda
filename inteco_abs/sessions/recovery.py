"""Makes a whole session of a damaged file: every tick of every chunk that proves itself, and nothing else."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from inteco_abs.config import RigConfig, parse_config
from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.format import IO_TOPIC, LOG_TOPIC, TICK, TRUTH, Message
from inteco_abs.sessions.card import link_errors, result_card, timing_card
from inteco_abs.sessions.container import (
    DamagedError,
    DecompressionBudget,
    Entry,
    FixedRun,
    Opcode,
    VariableRun,
    chunk_parts,
    kind,
)
from inteco_abs.sessions.content import FLAT, Batch, Content
from inteco_abs.sessions.file_writer import FileWriter, utc
from inteco_abs.sessions.files import atomic_write, check_output
from inteco_abs.sessions.migration import MessageLayout, migrated
from inteco_abs.sessions.reader import check_data, regular_file
from inteco_abs.sessions.recorded_config import CONFIG_NAME, RECOVERED
from inteco_abs.sessions.scanner import Scan, WholeRecord
from inteco_abs.sessions.storage import Rows, RowsOnDisk

_LATEST_NS: Final = 1 << 63
_BLOCK_TICKS: Final = 4096
_MOST_IN_WORDS: Final = 5
_MOST_LOSSES: Final = 1000
_WRITTEN_ANEW: Final = ("format_version", "outcome", "reason", "ticks", "overruns", "lost_ticks", "ended_utc")

Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class Recovery:
    """What was made of a damaged file."""

    card: dict[str, Any]
    missing: tuple[tuple[int, int], ...]
    """First and last of the ticks of each gap; of the last one only where the file says how many there were."""
    losses: tuple[str, ...]
    """In words; empty if nothing was lost."""


def recover_session(source: Path, out: Path) -> Recovery:
    """Write what is whole of the session at `source` to `out`, as a session with the outcome `recovered`.

    A chunk whose checksum fails gives no tick. Raises ConfigError or SessionError if `out` cannot be written, and
    SessionError if there is no tick to recover.
    """
    check_output(out)
    with RowsOnDisk(out.parent) as ticks, RowsOnDisk(out.parent) as truths, RowsOnDisk(out.parent) as frames:
        with regular_file(source) as (file, size):
            remains = _Remains(_Taken(TICK, ticks), _Taken(TRUTH, truths), _TakenFrames(frames), size)
            remains.gather(file, size)
        return _Anew(source, out, remains).write()


class _Taken:
    """Ticks or truths that were taken."""

    def __init__(self, message: Message, rows: Rows) -> None:
        self._message = message
        self._rows = rows
        self._number = self._time_ns = -1

    def array(self) -> Array:
        """Everything taken, on the disk."""
        return self._message.array(self._rows.contents())

    def judge(self, batch: Batch, epoch_ns: int | None) -> int:
        """Epoch of messages that come after those that were judged. Raises DamagedError if they do not."""
        log_time, times = batch.log_time, batch.values["time_ns"]
        if max(log_time.max(), times.max()) >= _LATEST_NS:
            raise DamagedError("its times are of no date")
        epochs = log_time.astype(np.int64) - times.astype(np.int64)
        if (epochs != (epochs[0] if epoch_ns is None else epoch_ns)).any():
            raise DamagedError("its two clocks do not go together")
        numbers = batch.values["tick"] if self._message is TICK else batch.sequence
        forward = np.diff(numbers.astype(np.int64), prepend=self._number) > 0
        if not forward.all() or (np.diff(times.astype(np.int64), prepend=self._time_ns) < 0).any():
            raise DamagedError("it repeats what was there before")
        self._number, self._time_ns = int(numbers[-1]), int(times[-1])
        return int(epochs[0])

    def keep(self, data: bytes) -> None:
        """Rows that were judged."""
        self._rows.write(data)

    @property
    def newest(self) -> tuple[int, int]:
        """Number and time of the last row judged."""
        return self._number, self._time_ns

    def back_to(self, newest: tuple[int, int]) -> None:
        """Forget what was judged after that."""
        self._number, self._time_ns = newest


class _TakenFrames:
    """Raw frames that were taken."""

    _HEAD: Final = struct.Struct("<QI")

    def __init__(self, rows: Rows) -> None:
        self._rows = rows
        self._sequence = -1
        self.number = 0

    def take(self, stretch: VariableRun) -> None:
        """All of them or none. Raises DamagedError if they do not come after those that were taken."""
        sequence, parts = self._sequence, list[bytes]()
        for number, log_time, data in stretch.messages():
            if number <= sequence:
                raise DamagedError("it repeats what was there before")
            sequence = number
            parts += self._HEAD.pack(log_time, len(data)), data
        self._rows.write(b"".join(parts))
        self._sequence, self.number = sequence, self.number + stretch.number

    def messages(self, epoch_ns: int) -> Iterator[tuple[int, bytes]]:
        """Monotonic time in ns and message of each, from the disk."""
        data, at = self._rows.contents(), 0
        while at < len(data):
            log_time, length = self._HEAD.unpack_from(data, at)
            at += self._HEAD.size
            yield log_time - epoch_ns, bytes(data[at : at + length])
            at += length


class _Remains:
    """What is whole in a file."""

    def __init__(self, ticks: _Taken, truths: _Taken, frames: _TakenFrames, size: int) -> None:
        self.content = Content(budget=DecompressionBudget(size))
        self.frames = frames
        self.rows = {TICK.topic: ticks, TRUTH.topic: truths}
        self.losses: list[str] = []
        """In words, as many as anybody would read."""
        self.data_ended = False
        self.epoch_ns: int | None = None

    def gather(self, file: BinaryIO, size: int) -> None:
        """Everything that proves itself. Raises SessionError if another version wrote it."""
        for part in Scan(file, size):
            if isinstance(part, WholeRecord):
                self._take(part)
            elif not self.data_ended:  # behind the data's end there is only an index, which is made anew
                self._lose(f"bytes {part.start}..{part.end - 1}: {part.problem}")
        if not self.data_ended:
            self._lose("the data has no end: what came after the last tick is not known")

    def _lose(self, problem: str) -> None:
        if len(self.losses) < _MOST_LOSSES:
            self.losses.append(problem)

    def _take(self, whole: WholeRecord) -> None:
        entry = whole.entry
        try:
            if whole.raw is not None:
                self._take_chunk(whole.raw)
            elif entry.opcode == Opcode.DATA_END:
                self.data_ended = True
                check_data(entry, whole.crc)
            elif entry.opcode not in {Opcode.SCHEMA, Opcode.CHANNEL}:  # the index's copies have no checksum each
                self.content.take(entry)
        except DamagedError as error:
            self._lose(f"byte {entry.start}: {kind(entry.opcode)}: {error}")

    def _take_chunk(self, raw: bytes) -> None:
        """All of its rows or none."""
        runs: dict[str, list[FixedRun]] = {}
        for part in chunk_parts(raw, self.content.variable_size):
            if isinstance(part, Entry):
                self.content.take(part)
                continue
            self.content.budget.part()
            if isinstance(part, VariableRun):
                self.frames.take(part)
            else:
                runs.setdefault(self._topic(part), []).append(part)
        layouts = {topic: self.content.layouts.get(topic) or MessageLayout(FLAT[topic]) for topic in FLAT}
        batches = {topic: Batch.of(runs[topic], layouts[topic]) for topic in FLAT if topic in runs}
        before = {topic: rows.newest for topic, rows in self.rows.items()}
        epoch_ns = self.epoch_ns
        try:
            for topic, batch in batches.items():
                epoch_ns = self.rows[topic].judge(batch, epoch_ns)
        except DamagedError:
            for topic, newest in before.items():
                self.rows[topic].back_to(newest)
            raise
        self.epoch_ns = epoch_ns
        for topic, batch in batches.items():
            self.rows[topic].keep(batch.upgraded)
            if topic == TICK.topic:
                self.content.hash.update(batch.data)
        self.content.take_log(runs.get(LOG_TOPIC, ()))

    def _topic(self, run: FixedRun) -> str:
        """Of a message; where its channel's declaration is lost, by the layout that no other message has."""
        if run.channel in self.content.channels:
            self.content.check_schemas()
            return self.content.channels[run.channel][0]
        size = run.rows.dtype["data"].itemsize
        return next((topic for topic, message in FLAT.items() if size == message.size), "")


class _Anew:
    """The session that is made of the remains of `source`."""

    def __init__(self, source: Path, out: Path, remains: _Remains) -> None:
        self._source, self._out = source, out
        self._facts = migrated(remains.content.metadata)
        self._content = remains.content
        self._ticks, self._truths = remains.rows[TICK.topic].array(), remains.rows[TRUTH.topic].array()
        self._frames = remains.frames
        self._epoch_ns = remains.epoch_ns or 0
        self._losses = remains.losses
        for name in self._content.altered_attachments():
            del self._content.attachments[name]
            self._losses.append(f"attachment {name!r} does not match the hash that was recorded with it")
        if not len(self._ticks):
            because = f": {self._losses[0]}" if self._losses else ""
            raise SessionError(f"{source}: holds no tick that is whole, so there is nothing to recover{because}")
        if remains.content.unsupported:
            problem = f"cannot be recovered here without losses: {remains.content.unsupported}; recover it with that"
            raise SessionError(f"{source}: {problem}")
        self._missing = self._gaps()

    def write(self) -> Recovery:
        """The file, as a whole or not at all."""
        session = self._facts.get("session", {})
        start_ns = int(self._ticks["time_ns"][0])
        internals = self._internals()
        with (
            atomic_write(self._out) as part,
            FileWriter(
                part, start_ns, internals, session.get("session_id", ""), self._epoch_ns, durable=True
            ) as recorder,
        ):
            self._introduce(recorder)
            self._copy(recorder)
            self._copy_frames(recorder)
            self._check_hash()
            card = self._card(recorder.payload_sha256)
            recorder.describe("recovery", self._recovery())
            ended = session.get("ended_utc") or utc(self._epoch_ns + int(self._ticks["time_ns"][-1]))
            recorder.finish(RECOVERED, card["explanation"], card, ended)
        return Recovery(card, self._missing, tuple(self._losses))

    def _gaps(self) -> tuple[tuple[int, int], ...]:
        numbers = self._ticks["tick"].astype(np.int64)
        steps = np.diff(numbers, prepend=-1)
        gaps = [(int(numbers[at] - steps[at]) + 1, int(numbers[at]) - 1) for at in np.flatnonzero(steps > 1)]
        told = self._facts.get("session", {}).get("ticks", "")
        if told.isdecimal() and len(told) < 10 and int(told) > numbers[-1] + 1:
            gaps.append((int(numbers[-1]) + 1, int(told) - 1))
        if gaps:
            words = ", ".join(f"{first}..{last}" for first, last in gaps[:_MOST_IN_WORDS])
            more = ", ..." if len(gaps) > _MOST_IN_WORDS else ""
            self._losses.append(f"ticks {words}{more} are missing")
        return tuple(gaps)

    def _check_hash(self) -> None:
        recorded = self._facts.get("integrity", {}).get("payload_sha256")
        if not self._losses and recorded != self._content.hash.hexdigest():
            self._losses.append(
                "the ticks do not match the hash that was recorded with them"
                if recorded
                else "no hash says that these are all of the ticks"
            )

    def _internals(self) -> list[str]:
        """Names of c0..c3, if their channel's declaration survived."""
        try:
            names = json.loads(self._content.channel_facts[TICK.topic]["internals"])
        except (KeyError, ValueError, RecursionError):
            return []
        return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []

    def _introduce(self, recorder: FileWriter) -> None:
        for name, attached in self._content.attachments.items():
            recorder.attach(name, attached.media_type, attached.data)
        recorder.begin(dict(self._parameters()))
        for name, facts in self._facts.items():
            kept = {key: value for key, value in facts.items() if name != "session" or key not in _WRITTEN_ANEW}
            if name not in {"result", "integrity", "recovery", "frames"}:
                recorder.describe(name, kept)

    def _parameters(self) -> list[tuple[str, float]]:
        """Reference and gains in force, as far as they survived."""
        found = []
        for key, value in self._facts.get("controller", {}).items():
            name = key.removeprefix("gain.")
            if (key == "reference_slip" or key != name) and not key.endswith(".hex"):
                try:
                    found.append((name, float(value)))
                except ValueError:
                    continue
        return found

    def _copy(self, recorder: FileWriter) -> None:
        """Ticks in blocks, each behind the log of its time and followed by its truths."""
        truths_ns, done = self._truths["time_ns"], 0
        log = sorted(self._content.events, reverse=True)
        for at in range(0, len(self._ticks), _BLOCK_TICKS):
            block = self._ticks[at : at + _BLOCK_TICKS]
            last = at + _BLOCK_TICKS >= len(self._ticks)
            end = len(truths_ns) if last else int(np.searchsorted(truths_ns, block["time_ns"][-1], side="right"))
            until_ns = self._epoch_ns + int(block["time_ns"][-1])
            while log and (last or log[-1].unix_ns <= until_ns):
                recorder.event(*log.pop())
            recorder.ticks(block.tobytes())
            recorder.truths(self._truths[done:end].tobytes())
            done = end

    def _copy_frames(self, recorder: FileWriter) -> None:
        """The raw frames, if there were any, and what became of them."""
        told = dict(self._facts.get("frames", {}))
        facts = self._content.channel_facts.get(IO_TOPIC)
        if facts is None and not told:
            return
        if facts is not None:
            recorder.frames(facts, self._frames.messages(self._epoch_ns))
        number = told.get("messages", "")
        missing = int(number) - self._frames.number if number.isdecimal() and len(number) < 10 else 0
        if missing > 0:
            self._losses.append(f"{missing} raw frames are missing")
        if not told:
            told["missing"] = "the file did not say any more how many there were"
        recorder.describe("frames", {**told, "messages": str(self._frames.number)})

    def _recovery(self) -> dict[str, str]:
        session = self._facts.get("session", {})
        earlier = self._facts.get("recovery", {}).get("lost", "")
        return {
            "source": self._source.name,
            "outcome": session.get("outcome", ""),
            "reason": session.get("reason", ""),
            "missing_ticks": json.dumps(self._missing),
            "lost": "; ".join(([earlier] if earlier else []) + self._losses[:_MOST_IN_WORDS]),
        }

    def _card(self, payload_sha256: str) -> dict[str, Any]:
        """The result card, with its metrics if the configuration survived."""
        config = self._config()
        metrics = timing_card(self._ticks) if config is None else result_card(config, self._ticks, self._truths)
        rig = self._facts.get("rig", {})
        told = f"made of what is whole in {self._source.name}"
        return {
            "schema_version": 1,
            "session": str(self._out),
            "outcome": RECOVERED,
            "reason": "NONE",
            "explanation": f"{told}: {'; '.join(self._losses[:_MOST_IN_WORDS])}" if self._losses else told,
            "board": rig.get("board"),
            "rig": rig.get("drawn"),
            **metrics,
            "lost_ticks": sum(last - first + 1 for first, last in self._missing),
            "link_errors": link_errors(self._ticks),
            "payload_sha256": payload_sha256,
        }

    def _config(self) -> RigConfig | None:
        stored = self._content.attachments.get(CONFIG_NAME)
        if stored is None:
            return None
        try:
            return parse_config(stored.data.decode("utf-8"))
        except (ConfigError, UnicodeDecodeError):
            return None
