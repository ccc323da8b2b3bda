"""The content of a session, collected record by record."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from inteco_abs.control import GainChange
from inteco_abs.format import IO_TOPIC, LOG_TOPIC, PARAMETERS_TOPIC, TICK, TRUTH, Message
from inteco_abs.format import fields as wire_fields
from inteco_abs.sessions.container import (
    DamagedError,
    DecompressionBudget,
    Entry,
    FixedRun,
    Opcode,
    VariableRun,
    attachment,
    chunk_parts,
    fields,
    text_map,
)
from inteco_abs.sessions.migration import MessageLayout, message_layout, newer

CONFIG_NAME: Final = "config.toml"
"""Name of the attachment with the configuration of the run."""
LAW_NAME: Final = "law.zip"
"""Modules of the shipped controller and estimator that decided."""
CONTROLLER_SOURCE: Final = "controller.py"
"""Source of a user's controller."""
CONTROLLER_FILES: Final = "controller.zip"
"""The same with the files beside it that it loads."""
RECOVERED: Final = "recovered"
"""Outcome of a session that was recovered from a damaged file."""
LIBRARY: Final = "inteco-abs/"
PREFIX: Final = "inteco_abs."
ATTACHMENT_HASH: Final = "sha256."
"""Before an attachment's name, in the record `integrity`."""
FLAT: Final[Mapping[str, Message]] = {TICK.topic: TICK, TRUTH.topic: TRUTH}
"""Messages that become rows."""
_LONGEST_EVENT: Final = 1000
_HIGHEST_LEVEL: Final = 5
_DOUBLE: Final = struct.Struct("<d")
_FIXED32: Final = struct.Struct("<I")


class LogEntry(NamedTuple):
    """A line of the session's log."""

    unix_ns: int
    level: int
    """Level as in `foxglove.Log`: 2 information, 3 warning, 4 error."""
    text: str


class Parameters(NamedTuple):
    """Gains and reference in force from `tick`."""

    tick: int
    values: dict[str, float]


class Attached(NamedTuple):
    """A file in the session."""

    media_type: str
    data: bytes


class Batch(NamedTuple):
    """The ticks or truths of one chunk."""

    data: bytes
    """Messages as recorded."""
    upgraded: bytes
    """Messages of this version."""
    values: npt.NDArray[np.void]
    """One row per message, a view of `upgraded`."""
    sequence: npt.NDArray[np.uint32]
    log_time: npt.NDArray[np.uint64]
    """UNIX time, ns."""

    @classmethod
    def of(cls, runs: Sequence[FixedRun], found: MessageLayout) -> Self:
        """The messages of `runs`. Raises DamagedError unless each of them has the layout `found`."""
        data = b"".join([run.rows["data"].tobytes() for run in runs])
        sizes = {run.rows.dtype["data"].itemsize for run in runs}
        if sizes != {found.message.size} or not found.well_formed(data):
            data = _repacked(runs, found)
        sequence, log_time = (np.concatenate([run.rows[name] for run in runs]) for name in ("sequence", "log_time"))
        upgraded = found.upgraded(data)
        return cls(data, upgraded, FLAT[found.message.topic].array(upgraded), sequence, log_time)


def _repacked(runs: Sequence[FixedRun], found: MessageLayout) -> bytes:
    """The messages as recorded, if another program encoded them again without zeros; else raises DamagedError."""
    try:
        data = b"".join(found.message.repacked(each) for run in runs for each in run.rows["data"].tolist())
    except ValueError:
        data = b""
    if not data or not found.well_formed(data):
        message = found.message
        raise DamagedError(
            f"a message of {message.topic} does not match the {message.name} that the file declares, "
            "or has an unknown value"
        )
    return data


@dataclass(slots=True)
class Content:
    """What was read so far."""

    budget: DecompressionBudget = field(default_factory=lambda: DecompressionBudget(0))
    library: str = LIBRARY
    """Program that wrote the file; this one, unless the header names another."""
    schemas: dict[int, tuple[str, bytes]] = field(default_factory=dict)
    channels: dict[int, tuple[str, int]] = field(default_factory=dict)
    """Topic and schema by the channel's number."""
    layouts: dict[str, MessageLayout] = field(default_factory=dict)
    """Known layouts of ticks and truths by topic."""
    undecoded: set[int] = field(default_factory=set)
    """Numbers of the channels of ticks and truths whose layout is not known yet."""
    channel_facts: dict[str, dict[str, str]] = field(default_factory=dict)
    variable_size: set[int] = field(default_factory=set)
    """Numbers of the channels of raw frames."""
    frames: int = 0
    """Number of raw frames."""
    messages: int = 0
    """Number of messages in all channels."""
    events: list[LogEntry] = field(default_factory=list)
    parameters: list[Parameters] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    """Metadata by record name without `inteco_abs.`; records of one name are merged, the later one wins."""
    attachments: dict[str, Attached] = field(default_factory=dict)
    epoch_ns: int | None = None
    """UNIX time of the monotonic clock's zero; None before the first tick."""
    incomplete: str = ""
    """Where a cut file ends; empty for a complete one."""
    hash: hashlib._Hash = field(default_factory=hashlib.sha256)
    """Hash of the ticks as recorded."""

    def take(self, entry: Entry) -> None:
        """Read one record that is not a message. Raises DamagedError."""
        if not entry.opcode:
            raise DamagedError("has no type")
        if entry.opcode == Opcode.MESSAGE:
            raise DamagedError("stands outside of a chunk")
        self.budget.part()
        taker = _TAKERS.get(entry.opcode)
        if taker is not None:
            taker(self, entry.data)

    def take_chunk(self, raw: bytes) -> dict[str, Batch]:
        """Read an unpacked chunk; return its ticks and truths by topic. Raises DamagedError."""
        runs: dict[str, list[FixedRun]] = {}
        for part in chunk_parts(raw, self.variable_size):
            if isinstance(part, Entry):
                self.take(part)
            elif isinstance(part, VariableRun):
                self.budget.part()
                self.frames += part.number
                self.messages += part.number
            elif part.channel in self.channels:
                self.budget.part()
                runs.setdefault(self.channels[part.channel][0], []).append(part)
                self.messages += len(part.rows)
            else:
                raise DamagedError(f"has a message of channel {part.channel}, which is not declared")
        if runs.keys() & FLAT.keys():
            self.check_schemas()
        self.take_log(runs.get(LOG_TOPIC, ()))
        self.take_parameters(runs.get(PARAMETERS_TOPIC, ()))
        batches = self.batches(runs)
        if TICK.topic in batches:
            ticks = batches[TICK.topic]
            self.hash.update(ticks.data)
            if self.epoch_ns is None:
                self.epoch_ns = int(ticks.log_time[0]) - int(ticks.values["time_ns"][0])
        return batches

    def batches(self, runs: Mapping[str, Sequence[FixedRun]]) -> dict[str, Batch]:
        """Ticks and truths among messages by topic. Raises DamagedError."""
        return {topic: Batch.of(runs[topic], self.layouts[topic]) for topic in FLAT if topic in runs}

    def runs(self, raw: bytes, topics: Collection[str]) -> dict[str, list[FixedRun]]:
        """Messages of `topics` in an unpacked chunk whose channels are known, by topic. Raises DamagedError."""
        found: dict[str, list[FixedRun]] = {}
        for part in chunk_parts(raw, self.variable_size):
            if isinstance(part, FixedRun) and part.channel in self.channels:
                topic = self.channels[part.channel][0]
                if topic in topics:
                    found.setdefault(topic, []).append(part)
        return found

    def take_log(self, runs: Iterable[FixedRun]) -> None:
        """Read log entries. Raises DamagedError at one that is not valid."""
        for run in runs:
            self.budget.part(len(run.rows), run.rows.nbytes)
            self.events += map(event, run.rows["log_time"].tolist(), run.rows["data"].tolist())

    def take_parameters(self, runs: Iterable[FixedRun]) -> None:
        """Read gains and reference. Raises DamagedError at a message that is not valid."""
        for run in runs:
            self.budget.part(len(run.rows), run.rows.nbytes)
            self.parameters += map(parameters, run.rows["data"].tolist())

    def check_schemas(self) -> None:
        """Find the layouts of ticks and truths. Raises DamagedError if this version cannot read them."""
        for channel in sorted(self.undecoded):
            topic, number = self.channels[channel]
            found = message_layout(FLAT[topic], *self.schemas.get(number, ("", b"")))
            if self.layouts.setdefault(topic, found) is not found:
                raise DamagedError(f"{topic} is declared twice, with two layouts")
            self.undecoded.discard(channel)

    def altered_attachments(self) -> list[str]:
        """Names of the attachments that do not match their recorded hashes."""
        recorded = self.metadata.get("integrity", {})
        found = {name: hashlib.sha256(attached.data).hexdigest() for name, attached in self.attachments.items()}
        return [name for name, digest in found.items() if recorded.get(ATTACHMENT_HASH + name, digest) != digest]

    @property
    def unsupported(self) -> str:
        """What this version does not know, or does not find, in the session; empty if nothing."""
        unknown = [problem for topic in FLAT if topic in self.layouts for problem in self.layouts[topic].unknown]
        problems = [problem for problem in (newer(self.metadata), *unknown) if problem]
        return "; ".join([*problems, f"{self.library} wrote it"]) if problems else ""

    @property
    def announces_ticks(self) -> bool:
        """Whether a channel has the topic of ticks."""
        return any(topic == TICK.topic for topic, _ in self.channels.values())

    def _take_header(self, data: memoryview) -> None:
        _, self.library = fields(Opcode.HEADER, data, exact=True)

    def _take_schema(self, data: memoryview) -> None:
        number, name, _, descriptor = fields(Opcode.SCHEMA, data, exact=True)
        self.schemas[number] = name, bytes(descriptor)

    def _take_channel(self, data: memoryview) -> None:
        number, schema, topic, _, facts = fields(Opcode.CHANNEL, data, exact=True)
        self.channels[number] = topic, schema
        if topic == IO_TOPIC:
            self.variable_size.add(number)
        (self.undecoded.add if topic in FLAT else self.undecoded.discard)(number)
        self.channel_facts[topic] = text_map(facts, self.budget)

    def _take_metadata(self, data: memoryview) -> None:
        name, facts = fields(Opcode.METADATA, data, exact=True)
        self.metadata.setdefault(name.removeprefix(PREFIX), {}).update(text_map(facts, self.budget))

    def _take_index(self, data: memoryview) -> None:
        fields(Opcode.MESSAGE_INDEX, data, exact=True)  # a wrong length would hide the chunks after it

    def _take_attachment(self, data: memoryview) -> None:
        name, media_type, content = attachment(data)
        self.attachments[name] = Attached(media_type, content)


_TAKERS: Final[Mapping[int, Callable[[Content, memoryview], None]]] = {
    Opcode.HEADER: Content._take_header,  # noqa: SLF001  the class's own table
    Opcode.SCHEMA: Content._take_schema,  # noqa: SLF001
    Opcode.CHANNEL: Content._take_channel,  # noqa: SLF001
    Opcode.METADATA: Content._take_metadata,  # noqa: SLF001
    Opcode.MESSAGE_INDEX: Content._take_index,  # noqa: SLF001
    Opcode.ATTACHMENT: Content._take_attachment,  # noqa: SLF001
}


def changes_among(found: Iterable[Parameters]) -> list[GainChange]:
    """Gains that were changed while the run lasted, in the order in which they took effect."""
    changes = [GainChange(part.tick, *each) for part in found if part.tick for each in part.values.items()]
    return sorted(changes, key=lambda change: change.tick)


def event(log_time: int, data: bytes) -> LogEntry:
    """Decode a `foxglove.Log`. Raises DamagedError if it is not valid."""
    try:
        found = dict(wire_fields(data))
    except ValueError as error:
        raise DamagedError(f"an event cannot be read: {error}") from error
    level, text = found.get(2, 0), found.get(3, b"")
    if not isinstance(level, int) or level > _HIGHEST_LEVEL or not isinstance(text, bytes):
        raise DamagedError("an event cannot be read: its level or its text is not valid")
    return LogEntry(log_time, level, text[:_LONGEST_EVENT].decode("utf-8", "replace"))


def parameters(data: bytes) -> Parameters:
    """Decode a `Params` message. Raises DamagedError if it is not valid."""
    tick, values = 0, {}
    try:
        for number, value in wire_fields(data):
            if number == 1:
                entry = dict(wire_fields(_raw(value)))
                (values[str(_raw(entry.get(1)), "utf-8")],) = _DOUBLE.unpack(_raw(entry.get(2)))
            elif number == 2:
                (tick,) = _FIXED32.unpack(_raw(value))
            else:
                raise ValueError(f"field {number} is unknown")  # noqa: TRY301  gets its name below, as all others
    except (ValueError, struct.error) as error:
        raise DamagedError(f"parameters cannot be read: {error}") from error
    return Parameters(tick, values)


def _raw(value: int | bytes | None) -> bytes:
    if not isinstance(value, bytes):
        raise ValueError(f"{value} is not bytes")  # noqa: TRY004  of the data, not of an argument
    return value
