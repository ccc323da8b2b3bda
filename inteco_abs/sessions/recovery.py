"""Recovers a session from a damaged file: every tick of every chunk whose checksum is right.

`recover_run` in `inteco_abs.realtime.processes.recorder` recovers the memory of a killed run.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from inteco_abs.config import RigConfig, parse_config
from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.format import IO_TOPIC, LOG_TOPIC, PARAMETERS_TOPIC, TICK, TRUTH, Message
from inteco_abs.sessions.card import RunningCard
from inteco_abs.sessions.channels import gains_of, internals_of
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
from inteco_abs.sessions.content import CONFIG_NAME, FLAT, RECOVERED, Batch, Content, changes_among
from inteco_abs.sessions.copying import copy_rows
from inteco_abs.sessions.file_writer import FileWriter, utc
from inteco_abs.sessions.files import atomic_write, check_output
from inteco_abs.sessions.migration import MessageLayout, migrated
from inteco_abs.sessions.reader import check_data, regular_file
from inteco_abs.sessions.rows import in_step
from inteco_abs.sessions.scanner import IntactRecord, Scan
from inteco_abs.sessions.storage import RowsOnDisk

_LATEST_NS: Final = 1 << 63
_BLOCK_TICKS: Final = 4096
_MOST_LISTED: Final = 5
_MOST_LOSSES: Final = 1000
_REWRITTEN: Final = ("format_version", "outcome", "reason", "ticks", "overruns", "lost_ticks", "ended_utc")

Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class Recovery:
    """Result of a recovery."""

    card: dict[str, Any]
    missing: tuple[tuple[int, int], ...]
    """First and last missing tick of each gap; a gap at the end is known only if the file has the number of ticks."""
    losses: tuple[str, ...]
    """Descriptions; empty if nothing was lost."""


def recover_session(source: Path, out: Path) -> Recovery:
    """Write the intact part of the session at `source` to `out`, as a session with the outcome `recovered`.

    A chunk with a wrong checksum is left out. Raises ConfigError or SessionError if `out` cannot be written, and
    SessionError without an intact tick.
    """
    check_output(out)
    with RowsOnDisk(out.parent) as ticks, RowsOnDisk(out.parent) as truths, RowsOnDisk(out.parent) as frames:
        with regular_file(source) as (file, size):
            intact = _Intact(_IntactRows(TICK, ticks), _IntactRows(TRUTH, truths), _IntactFrames(frames), size)
            intact.gather(file, size)
        return _RecoveredSession(source, out, intact).write()


class _IntactRows:
    """Intact ticks or truths."""

    def __init__(self, message: Message, rows: RowsOnDisk) -> None:
        self._message = message
        self._rows = rows
        self._number = self._time_ns = self._kept = -1
        self.count = self.first_ns = self.last_ns = 0
        """Number of rows kept, and times of the first and the last."""
        self.gaps: list[tuple[int, int]] = []
        """First and last number of rows missing among the kept ones."""

    def blocks(self) -> Iterator[Array]:
        """All kept rows, from the disk."""
        return map(self._message.array, self._rows.blocks(_BLOCK_TICKS * self._message.size))

    def check(self, batch: Batch, epoch_ns: int | None) -> int:
        """Return the epoch of the next messages. Raises DamagedError if they do not follow the previous ones."""
        log_time, times = batch.log_time, batch.values["time_ns"]
        if max(log_time.max(), times.max()) >= _LATEST_NS:
            raise DamagedError("its times are not valid dates")
        epochs = log_time.astype(np.int64) - times.astype(np.int64)
        if (epochs != (epochs[0] if epoch_ns is None else epoch_ns)).any():
            raise DamagedError("its two clocks do not match")
        numbers = self._numbers(batch)
        forward = np.diff(numbers, prepend=self._number) > 0
        if not forward.all() or (np.diff(times.astype(np.int64), prepend=self._time_ns) < 0).any():
            raise DamagedError("it repeats earlier rows")
        self._number, self._time_ns = int(numbers[-1]), int(times[-1])
        return int(epochs[0])

    def keep(self, batch: Batch) -> None:
        """Keep rows that were checked."""
        numbers, times_ns = self._numbers(batch), batch.values["time_ns"]
        steps = np.diff(numbers, prepend=self._kept)
        self.gaps += [(int(numbers[at] - steps[at]) + 1, int(numbers[at]) - 1) for at in np.flatnonzero(steps > 1)]
        self.first_ns = self.first_ns if self.count else int(times_ns[0])
        self._kept, self.last_ns = int(numbers[-1]), int(times_ns[-1])
        self.count += len(numbers)
        self._rows.write(batch.upgraded)

    def _numbers(self, batch: Batch) -> npt.NDArray[np.int64]:
        return (batch.values["tick"] if self._message is TICK else batch.sequence).astype(np.int64)

    @property
    def newest(self) -> tuple[int, int]:
        """Number and time of the last row checked."""
        return self._number, self._time_ns

    @newest.setter
    def newest(self, newest: tuple[int, int]) -> None:
        self._number, self._time_ns = newest


class _IntactFrames:
    """Intact raw frames."""

    _HEAD: Final = struct.Struct("<QI")

    def __init__(self, rows: RowsOnDisk) -> None:
        self._rows = rows
        self._sequence = -1
        self.number = 0

    def add(self, run: VariableRun) -> None:
        """Add all frames of `run` or none. Raises DamagedError if they do not follow the previous ones."""
        sequence, parts = self._sequence, list[bytes]()
        for number, log_time, data in run.messages():
            if number <= sequence:
                raise DamagedError("it repeats earlier frames")
            sequence = number
            parts += self._HEAD.pack(log_time, len(data)), data
        self._rows.write(b"".join(parts))
        self._sequence, self.number = sequence, self.number + run.number

    def messages(self, epoch_ns: int) -> Iterator[tuple[int, bytes]]:
        """Monotonic time in ns and message of each frame, from the disk."""
        data, at = self._rows.contents(), 0
        while at < len(data):
            log_time, length = self._HEAD.unpack_from(data, at)
            at += self._HEAD.size
            yield log_time - epoch_ns, bytes(data[at : at + length])
            at += length


class _Intact:
    """The intact content of a file."""

    def __init__(self, ticks: _IntactRows, truths: _IntactRows, frames: _IntactFrames, size: int) -> None:
        self.content = Content(budget=DecompressionBudget(size))
        self.frames = frames
        self.rows = {TICK.topic: ticks, TRUTH.topic: truths}
        self.losses: list[str] = []
        """Descriptions of the first losses."""
        self.data_ended = False
        self.epoch_ns: int | None = None

    def gather(self, file: BinaryIO, size: int) -> None:
        """Collect every intact record."""
        for part in Scan(file, size):
            if isinstance(part, IntactRecord):
                self._take(part)
            elif not self.data_ended:  # after the data there is only the index, which is written again
                self._lose(f"bytes {part.start}..{part.end - 1}: {part.problem}")
        if not self.data_ended:
            self._lose("the data has no end: what came after the last tick is not known")

    def _lose(self, problem: str) -> None:
        if len(self.losses) < _MOST_LOSSES:
            self.losses.append(problem)

    def _take(self, record: IntactRecord) -> None:
        entry = record.entry
        try:
            if record.raw is not None:
                self._take_chunk(record.raw)
            elif entry.opcode == Opcode.DATA_END:
                self.data_ended = True
                check_data(entry, record.crc)
            elif entry.opcode not in {Opcode.SCHEMA, Opcode.CHANNEL}:  # copies in the index have no checksum
                self.content.take(entry)
        except DamagedError as error:
            self._lose(f"byte {entry.start}: {kind(entry.opcode)}: {error}")

    def _take_chunk(self, raw: bytes) -> None:
        """Keep all rows of the chunk or none."""
        runs: dict[str, list[FixedRun]] = {}
        for part in chunk_parts(raw, self.content.variable_size):
            if isinstance(part, Entry):
                self.content.take(part)
                continue
            self.content.budget.part()
            if isinstance(part, VariableRun):
                self.frames.add(part)
            else:
                runs.setdefault(self._topic(part), []).append(part)
        layouts = {topic: self.content.layouts.get(topic) or MessageLayout(FLAT[topic]) for topic in FLAT}
        batches = {topic: Batch.of(runs[topic], layouts[topic]) for topic in FLAT if topic in runs}
        before = {topic: rows.newest for topic, rows in self.rows.items()}
        epoch_ns = self.epoch_ns
        try:
            for topic, batch in batches.items():
                epoch_ns = self.rows[topic].check(batch, epoch_ns)
        except DamagedError:
            for topic, newest in before.items():
                self.rows[topic].newest = newest
            raise
        self.epoch_ns = epoch_ns
        for topic, batch in batches.items():
            self.rows[topic].keep(batch)
            if topic == TICK.topic:
                self.content.hash.update(batch.data)
        self.content.take_log(runs.get(LOG_TOPIC, ()))
        self.content.take_parameters(runs.get(PARAMETERS_TOPIC, ()))

    def _topic(self, run: FixedRun) -> str:
        """Topic of messages; if their channel's declaration is lost, by their size."""
        if run.channel in self.content.channels:
            self.content.check_schemas()
            return self.content.channels[run.channel][0]
        size = run.rows.dtype["data"].itemsize
        return next((topic for topic, message in FLAT.items() if size == message.size), "")


class _RecoveredSession:
    """The session made of the intact content of `source`."""

    def __init__(self, source: Path, out: Path, intact: _Intact) -> None:
        self._source, self._out = source, out
        self._facts = migrated(intact.content.metadata)
        self._content = intact.content
        self._ticks, self._truths = intact.rows[TICK.topic], intact.rows[TRUTH.topic]
        self._frames = intact.frames
        self._epoch_ns = intact.epoch_ns or 0
        self._losses = intact.losses
        for name in self._content.altered_attachments():
            del self._content.attachments[name]
            self._losses.append(f"attachment {name!r} does not match the hash that was recorded with it")
        if not self._ticks.count:
            because = f": {self._losses[0]}" if self._losses else ""
            raise SessionError(f"{source}: has no intact tick, so there is nothing to recover{because}")
        if intact.content.unsupported:
            problem = f"cannot be recovered here without losses: {intact.content.unsupported}; recover it with that"
            raise SessionError(f"{source}: {problem}")
        self._missing = self._gaps()

    def write(self) -> Recovery:
        """Write the file atomically."""
        session = self._facts.get("session", {})
        start_ns = self._ticks.first_ns
        with (
            atomic_write(self._out) as part,
            FileWriter(
                part,
                start_ns,
                session.get("session_id", ""),
                self._epoch_ns,
                internals=internals_of(self._content.channel_facts),
                gains=gains_of(self._content.channel_facts),
                durable=True,
            ) as recorder,
        ):
            self._write_header(recorder)
            running = self._copy(recorder)
            self._copy_frames(recorder)
            self._check_hash()
            card = self._card(running, recorder.payload_sha256)
            recorder.describe("recovery", self._recovery())
            ended = session.get("ended_utc") or utc(self._epoch_ns + self._ticks.last_ns)
            recorder.finish(RECOVERED, card["explanation"], card, ended)
        return Recovery(card, self._missing, tuple(self._losses))

    def _gaps(self) -> tuple[tuple[int, int], ...]:
        gaps, (last, _) = [*self._ticks.gaps], self._ticks.newest
        recorded = self._facts.get("session", {}).get("ticks", "")
        if recorded.isdecimal() and len(recorded) < 10 and int(recorded) > last + 1:
            gaps.append((last + 1, int(recorded) - 1))
        if gaps:
            listed = ", ".join(f"{first}..{last}" for first, last in gaps[:_MOST_LISTED])
            more = ", ..." if len(gaps) > _MOST_LISTED else ""
            self._losses.append(f"ticks {listed}{more} are missing")
        return tuple(gaps)

    def _check_hash(self) -> None:
        recorded = self._facts.get("integrity", {}).get("payload_sha256")
        if not self._losses and recorded != self._content.hash.hexdigest():
            self._losses.append(
                "the ticks do not match the hash that was recorded with them"
                if recorded
                else "no hash says that these are all of the ticks"
            )

    def _write_header(self, recorder: FileWriter) -> None:
        for name, attached in self._content.attachments.items():
            recorder.attach(name, attached.media_type, attached.data)
        recorder.begin(dict(self._parameters()))
        recorder.change(changes_among(self._content.parameters))
        for name, facts in self._facts.items():
            kept = {key: value for key, value in facts.items() if name != "session" or key not in _REWRITTEN}
            if name not in {"result", "integrity", "recovery", "frames"}:
                recorder.describe(name, kept)

    def _parameters(self) -> list[tuple[str, float]]:
        """Reference and gains in force, those that are intact."""
        found = []
        for key, value in self._facts.get("controller", {}).items():
            name = key.removeprefix("gain.")
            if (key == "reference_slip" or key != name) and not key.endswith(".hex"):
                try:
                    found.append((name, float(value)))
                except ValueError:
                    continue
        return found

    def _copy(self, recorder: FileWriter) -> RunningCard:
        """Copy the rows in blocks, with the log; return their card."""
        card = RunningCard(self._config())
        known = (
            (TICK.array(b"") if ticks is None else ticks, TRUTH.array(b"") if truths is None else truths)
            for ticks, truths in zip_longest(self._ticks.blocks(), self._truths.blocks())
        )
        blocks = in_step(known, _BLOCK_TICKS, self._truths.count)
        for block in copy_rows(recorder, blocks, self._content.events, self._epoch_ns):
            card.add(*block)
        return card

    def _copy_frames(self, recorder: FileWriter) -> None:
        """Copy the raw frames, if there are any, with the number of missing ones."""
        recorded = dict(self._facts.get("frames", {}))
        facts = self._content.channel_facts.get(IO_TOPIC)
        if facts is None and not recorded:
            return
        if facts is not None:
            recorder.frames(facts, self._frames.messages(self._epoch_ns))
        number = recorded.get("messages", "")
        missing = int(number) - self._frames.number if number.isdecimal() and len(number) < 10 else 0
        if missing > 0:
            self._losses.append(f"{missing} raw frames are missing")
        if not recorded:
            recorded["missing"] = "the file no longer has their number"
        recorder.describe("frames", {**recorded, "messages": str(self._frames.number)})

    def _recovery(self) -> dict[str, str]:
        session = self._facts.get("session", {})
        earlier = self._facts.get("recovery", {}).get("lost", "")
        return {
            "source": self._source.name,
            "outcome": session.get("outcome", ""),
            "reason": session.get("reason", ""),
            "missing_ticks": json.dumps(self._missing),
            "lost": "; ".join(([earlier] if earlier else []) + self._losses[:_MOST_LISTED]),
        }

    def _card(self, running: RunningCard, payload_sha256: str) -> dict[str, Any]:
        """The result card; without an intact configuration it has no metrics but the timing."""
        rig = self._facts.get("rig", {})
        losses = "; ".join(self._losses[:_MOST_LISTED])
        return {
            "schema_version": 1,
            "session": str(self._out),
            "outcome": RECOVERED,
            "reason": "NONE",
            "explanation": f"recovered from {self._source.name}{f': {losses}' if losses else ''}",
            "board": rig.get("board"),
            "rig": rig.get("drawn"),
            **running.card(),
            "lost_ticks": sum(last - first + 1 for first, last in self._missing),
            "link_errors": running.link_errors,
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
