"""Validates a session: checksums, gaps, time, schema, hash, required parts, index."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from inteco_abs.errors import SessionError
from inteco_abs.format import TICK, TRUTH
from inteco_abs.sessions.container import DamagedError, DecompressionBudget, Entry, Opcode, fields, kind
from inteco_abs.sessions.content import CONFIG_NAME, LIBRARY, Batch, Content
from inteco_abs.sessions.migration import migrated
from inteco_abs.sessions.reader import check_data, ends_well, opened
from inteco_abs.sessions.scanner import Damage, IntactRecord, Scan, checksum

_MOST_ALIKE: Final = 20
"""Issues of one kind that are listed one by one."""
_AT_THE_START: Final = ("rig", "controller")
_AT_THE_END: Final = ("timing", "result", "integrity")


class Severity(StrEnum):
    """Whether the rest of the session can be trusted."""

    LOSS = "loss"
    """Something is missing; the rest is right."""
    WRONG = "wrong"
    """Something is not what was recorded, or the file cannot be used."""


class SessionIssue(NamedTuple):
    """One thing wrong with a session."""

    severity: Severity
    place: str
    problem: str


@dataclass(slots=True)
class Inspection:
    """Result of the validation of the file at `path`."""

    path: Path
    ticks: int = 0
    findings: list[SessionIssue] = field(default_factory=list)
    _alike: dict[str, int] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """`well`, `losses` or `wrong`."""
        severities = {finding.severity for finding in self.findings}
        return "wrong" if Severity.WRONG in severities else "losses" if severities else "well"

    def loss(self, place: str, problem: str) -> None:
        self._add(Severity.LOSS, place, problem)

    def wrong(self, place: str, problem: str) -> None:
        self._add(Severity.WRONG, place, problem)

    def _add(self, severity: Severity, place: str, problem: str) -> None:
        sort = place.partition(" ")[0]
        count = self._alike[sort] = self._alike.get(sort, 0) + 1
        if count <= _MOST_ALIKE:
            self.findings.append(SessionIssue(severity, place, problem))
        elif count == _MOST_ALIKE + 1:
            self.findings.append(SessionIssue(severity, f"{sort} ...", "and more of this kind"))


def validate(path: Path) -> Inspection:
    """Check the session at `path`; raises nothing."""
    inspection = Inspection(path)
    try:
        with opened(path) as (file, size):
            _Inspector(file, size, inspection).inspect()
    except SessionError as error:
        inspection.wrong("file", str(error).removeprefix(f"{path}: "))
    return inspection


class _Inspector:
    """Checks one open file."""

    def __init__(self, file: BinaryIO, size: int, inspection: Inspection) -> None:
        self._file, self._size, self._inspection = file, size, inspection
        self._content = Content(budget=DecompressionBudget(size))
        self._numbers = {TICK.topic: _Numbers("tick"), TRUTH.topic: _Numbers("truth")}
        self._chunks: set[int] = set()
        self._indexed: set[int] = set()
        self._counted: int | None = None
        self._data_ended = self._footed = False

    def inspect(self) -> None:
        for part in Scan(self._file, self._size):
            if isinstance(part, Damage):
                self._damage(part)
            else:
                self._intact(part)
        self._check_end()
        self._check_index()
        self._check_content()

    def _damage(self, damage: Damage) -> None:
        place = f"bytes {damage.start}..{damage.end - 1}"
        if damage.tail:
            self._inspection.loss(place, f"the file ends early: {damage.problem}")
        elif self._data_ended:
            self._inspection.loss(place, f"the index is damaged: {damage.problem}")
        else:
            self._inspection.wrong(place, damage.problem)

    def _intact(self, record: IntactRecord) -> None:
        entry = record.entry
        try:
            if record.raw is not None:
                self._chunk(entry, record.raw)
            elif entry.opcode == Opcode.DATA_END:
                self._data_ended = True
                check_data(entry, record.crc)
            elif entry.opcode == Opcode.FOOTER:
                self._footer(entry)
            elif entry.opcode == Opcode.CHUNK_INDEX:
                self._indexed.add(fields(entry.opcode, entry.data)[2])
            elif entry.opcode == Opcode.STATISTICS:
                self._counted = fields(entry.opcode, entry.data)[0]
            elif not self._data_ended:  # after it, there are only copies
                self._content.take(entry)
        except DamagedError as error:
            self._inspection.wrong(f"byte {entry.start}", f"{kind(entry.opcode)}: {error}")

    def _chunk(self, entry: Entry, raw: bytes) -> None:
        self._chunks.add(entry.start)
        for topic, batch in self._content.take_chunk(raw).items():
            self._numbers[topic].follow(batch, self._inspection)

    def _footer(self, entry: Entry) -> None:
        self._footed = True
        start, _, crc = fields(entry.opcode, entry.data)
        if crc and (start > entry.at or crc != checksum(self._file, start, entry.end - 4)):
            self._inspection.loss(f"byte {entry.start}", "the index fails its checksum: viewers may refuse the file")

    def _check_end(self) -> None:
        if not self._data_ended:
            self._inspection.loss("end", "the data has no end: what came after it is not known")
        elif not self._footed or not ends_well(self._file, self._size):
            self._inspection.loss("end", "the file has no footer at its end: viewers may refuse it")

    def _check_index(self) -> None:
        if not self._footed:
            return
        if self._chunks != self._indexed:
            self._inspection.loss("index", "it lists other chunks than the file has: viewers will not show all ticks")
        if self._counted not in {None, self._content.messages}:
            self._inspection.loss("index", f"it counts {self._counted} messages, the file has {self._content.messages}")

    def _check_content(self) -> None:
        content, inspection = self._content, self._inspection
        inspection.ticks = self._numbers[TICK.topic].count
        if not (content.announces_ticks or content.library.startswith(LIBRARY)):
            inspection.wrong("file", "is an MCAP file, but not a session of this program")
            return
        try:
            content.check_schemas()
        except DamagedError as error:
            inspection.wrong("schema", str(error))
        if content.unsupported:
            inspection.loss("schema", f"not all of it could be checked: {content.unsupported}")
        if not inspection.ticks:
            inspection.loss("ticks", "there are none")
        self._check_hash()
        whole = self._data_ended
        metadata = migrated(content.metadata)
        for name in (*_AT_THE_START, *(_AT_THE_END if whole else ())):
            if name not in metadata:
                inspection.loss(f"metadata {name}", "is missing")
        if CONFIG_NAME not in content.attachments:
            inspection.loss(f"attachment {CONFIG_NAME}", "is missing: the session cannot be replayed")
        self._check_frames(metadata.get("frames", {}))
        self._check_session(metadata.get("session", {}))

    def _check_hash(self) -> None:
        recorded = self._content.metadata.get("integrity", {}).get("payload_sha256")
        if recorded is None and self._data_ended:
            self._inspection.wrong("hash", "is missing, so the ticks cannot be checked against it")
        elif recorded not in {None, self._content.hash.hexdigest()}:
            self._inspection.wrong("hash", "the ticks do not match the hash that was recorded with them")
        for name in self._content.altered_attachments():
            self._inspection.wrong(f"attachment {name}", "does not match the hash that was recorded with it")

    def _check_frames(self, facts: dict[str, str]) -> None:
        found = self._content.frames
        if facts.get("messages", str(found)) != str(found):
            self._inspection.wrong("metadata frames", f"it says {facts['messages']} raw frames, the file has {found}")
        if "missing" in facts:
            self._inspection.loss("metadata frames", f"not all raw frames were kept: {facts['missing']}")

    def _check_session(self, facts: dict[str, str]) -> None:
        inspection = self._inspection
        missing = [key for key in ("session_id", "started_utc") if key not in facts]
        if self._data_ended:
            missing += [key for key in ("outcome", "ticks") if key not in facts]
            if facts.get("ticks", str(inspection.ticks)) != str(inspection.ticks):
                inspection.wrong("metadata session", f"it says {facts['ticks']} ticks, the file has {inspection.ticks}")
        if missing:
            inspection.loss("metadata session", f"lacks {', '.join(missing)}")
        lost = self._content.metadata.get("recovery", {}).get("lost")
        if lost:
            inspection.loss("metadata recovery", f"the session was recovered from a damaged file: {lost}")


class _Numbers:
    """Compares number and time of each tick, or of each state of the simulated rig, with the previous one."""

    def __init__(self, name: str) -> None:
        self._name = name
        self.count = 0
        self._number = self._time_ns = self._sequence = -1
        self._epoch_ns: int | None = None

    def follow(self, batch: Batch, inspection: Inspection) -> None:
        """Check the next messages of the topic."""
        time_ns, log_time = batch.values["time_ns"].astype(np.int64), batch.log_time.astype(np.int64)
        sequence = batch.sequence.astype(np.int64)
        numbers = batch.values["tick"].astype(np.int64) if self._name == "tick" else sequence
        if self._epoch_ns is None:
            self._epoch_ns = int(log_time[0]) - int(time_ns[0])
        self._check_numbers(numbers, inspection)
        self._check_times(numbers, time_ns, log_time, inspection)
        if self._name == "tick":
            self._check_sequence(numbers, sequence, inspection)
        self.count += len(numbers)
        self._number, self._time_ns, self._sequence = int(numbers[-1]), int(time_ns[-1]), int(sequence[-1])

    def _check_numbers(self, numbers: npt.NDArray[np.int64], inspection: Inspection) -> None:
        steps = np.diff(numbers, prepend=self._number)
        for at in np.flatnonzero(steps != 1).tolist():
            number, before = int(numbers[at]), int(numbers[at] - steps[at])
            place = f"{self._name} {number}"
            if number > before:
                inspection.loss(place, f"{self._name}s {before + 1}..{number - 1} are missing before it")
            else:
                inspection.wrong(place, f"comes after {self._name} {before}")

    def _check_times(
        self,
        numbers: npt.NDArray[np.int64],
        time_ns: npt.NDArray[np.int64],
        log_time: npt.NDArray[np.int64],
        inspection: Inspection,
    ) -> None:
        steps = np.diff(time_ns, prepend=self._time_ns)
        standing = steps <= 0 if self._name == "tick" else steps < 0
        for at in np.flatnonzero(standing).tolist():
            inspection.wrong(f"{self._name} {numbers[at]}", f"its time is {-steps[at]} ns before the previous one's")
        for at in np.flatnonzero(log_time - time_ns != self._epoch_ns)[:1].tolist():
            inspection.wrong(f"{self._name} {numbers[at]}", "its wall clock does not match its monotonic clock")

    def _check_sequence(
        self, numbers: npt.NDArray[np.int64], sequence: npt.NDArray[np.int64], inspection: Inspection
    ) -> None:
        """Messages that were lost or repeated although the ticks' numbers have no gap."""
        odd = (np.diff(sequence, prepend=self._sequence) != 1) & (np.diff(numbers, prepend=self._number) == 1)
        for at in np.flatnonzero(odd).tolist():
            inspection.wrong(
                f"tick {numbers[at]}", f"is message {sequence[at]}, which does not follow the previous one"
            )
