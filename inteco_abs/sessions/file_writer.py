"""Writes the file of a session: MCAP messages, metadata and attachments, durably, readable after each flush."""

from __future__ import annotations

import hashlib
import json
import os
import time
import uuid
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import version
from io import BufferedWriter
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from inteco_abs.control import GainChange
from inteco_abs.errors import SessionError, describe_disk
from inteco_abs.format import (
    IO_NAME,
    IO_TOPIC,
    TICK,
    TRUTH,
    Message,
    io_frame_descriptor,
    pack_result,
)
from inteco_abs.quantities import Quantity
from inteco_abs.sessions.channels import (
    INFO,
    WARNING,
    Channel,
    StateEvents,
    describe_change,
    event_channel,
    pack_event,
    pack_parameters,
    parameter_channel,
    result_channel,
    row_channel,
)
from inteco_abs.sessions.content import ATTACHMENT_HASH
from inteco_abs.sessions.disk import Disk
from inteco_abs.sessions.files import check_output
from inteco_abs.sessions.mcap_writer import McapWriter, Messages
from inteco_abs.sessions.reader import stored_rows

if TYPE_CHECKING:
    import numpy.typing as npt

FORMAT_VERSION: Final = "5"
_MOST_WAITING: Final = 1 << 18  # bytes


class FileWriter:
    """A session file being written at `path`; a context manager. Raises SessionError if the disk fails.

    `session_id` and `epoch_ns` (UNIX time of the monotonic clock's zero) are given for another file of the same
    session; `internals` and `gains` are what the controller declares. With `durable`, a thread syncs the file to the
    disk after each `flush`, and `begin` and `finish` wait until it is there, which may take seconds. Leaving the
    context closes the file; only `finish` completes it.
    """

    def __init__(
        self,
        path: Path,
        start_ns: int,
        session_id: str = "",
        epoch_ns: int | None = None,
        *,
        internals: Iterable[Quantity] = (),
        gains: Iterable[Quantity] = (),
        durable: bool = False,
    ) -> None:
        check_output(path)
        self.path = path
        self.session_id = session_id or str(uuid.uuid4())
        self._epoch_ns = time.time_ns() - start_ns if epoch_ns is None else epoch_ns
        self.started_ns = self._epoch_ns + start_ns
        """UNIX time of the session's beginning."""
        self._durable = durable
        self._read = False
        self._hash = hashlib.sha256()
        self._attached: dict[str, str] = {}
        self.written = 0
        """Number of ticks added."""
        self._packed = self._truths = 0
        """Number of ticks and of truths packed."""
        self._newest_ns = self.started_ns
        self._states = StateEvents()
        self._log = set[tuple[int, int, str]]()
        self._disk = Disk(path)
        self._file = BufferedWriter(self._disk)
        self._writer = McapWriter(self._file, f"inteco-abs/{version('inteco-abs')}")
        self._changes = deque[GainChange]()
        """Changes of gains whose tick did not come yet."""
        self._waiting = {message.topic: bytearray() for message in (TICK, TRUTH)}
        """Ticks and states that are not in the chunk yet."""
        self._tick_channel = self._channel(row_channel(TICK, internals))
        self._truth_channel = -1
        self._event_channel = self._channel(event_channel())
        self._parameter_channel = self._channel(parameter_channel(gains))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except SessionError:
            if error is None:  # another error was raised before
                raise

    def close(self) -> None:
        """Close the file; without `finish` it stays cut."""
        (self._disk if self._read else self._file).close()

    def stored(self) -> Iterator[tuple[bytes, bytes]]:
        """Rows in the file, as `stored_rows`, even if it was unlinked; ends the writing.

        Raises SessionError if the disk cannot be read.
        """
        self._read = True  # buffered bytes must not be written any more: the position in the file changes
        try:
            self._disk.seek(0)
            yield from stored_rows(self._disk, os.fstat(self._disk.fileno()).st_size, self.path)
        except OSError as error:
            raise SessionError(f"{self.path} cannot be read again: {describe_disk(error)}") from error

    @property
    def payload_sha256(self) -> str:
        """Hash of the tick payloads so far; independent of compression and time of day."""
        return self._hash.hexdigest()

    def describe(self, name: str, facts: Mapping[str, str]) -> None:
        """Add the metadata record `inteco_abs.{name}`; a later one of the same name updates it."""
        self._pack()
        self._writer.add_metadata(f"inteco_abs.{name}", facts)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Add an attachment."""
        self._pack()
        self._writer.add_attachment(self.started_ns, name, media_type, data)
        self._attached[ATTACHMENT_HASH + name] = hashlib.sha256(data).hexdigest()

    def begin(self, parameters: Mapping[str, float]) -> None:
        """Write the parameters in force from tick 0, and everything so far to the disk."""
        self._writer.add_message(self._parameter_channel, self.started_ns, pack_parameters(parameters))
        facts = {"format_version": FORMAT_VERSION, "session_id": self.session_id, "started_utc": utc(self.started_ns)}
        self.describe("session", facts)
        self._writer.end_chunk()
        self._settle(wait=True)

    def supervise(self, band: float) -> None:
        """Log each step of a law that falls back when its slip swings to both sides of `band`; before the ticks."""
        self._states = StateEvents(band)

    def change(self, changes: Iterable[GainChange]) -> None:
        """Add changes of gains, in order, before the ticks from which on they hold."""
        self._changes += changes

    def ticks(self, records: bytes) -> None:
        """Add tick records, back to back, and an event for every change of phase and every fault among them."""
        self._hash.update(records)
        self.written += len(records) // TICK.size
        self._wait(TICK, records)

    def truths(self, records: bytes) -> None:
        """Add states of the simulated rig, back to back."""
        self._wait(TRUTH, records)

    def _wait(self, message: Message, records: bytes) -> None:
        """Keep messages until the flush, which packs them all at once, in a tenth of the time."""
        self._waiting[message.topic] += records
        if sum(map(len, self._waiting.values())) > _MOST_WAITING:
            self._pack()

    def _pack(self) -> None:
        """Put the waiting messages into the chunk by time, with the events among them."""
        if not any(self._waiting.values()):
            return
        ticks, states = (message.array(bytes(self._waiting[message.topic])) for message in (TICK, TRUTH))
        for waiting in self._waiting.values():
            waiting.clear()
        tick_ns, state_ns = (rows["time_ns"] + np.uint64(self._epoch_ns % (1 << 64)) for rows in (ticks, states))
        before = np.searchsorted(state_ns, tick_ns, side="right")
        turns = np.diff(before, prepend=0)  # states before each tick and after the previous one
        events, changes = dict(self._states.among(ticks)), self._changes_among(ticks)
        single = events.keys() | changes.keys()
        edges = {0, *(np.flatnonzero(np.diff(turns)) + 1).tolist(), *single, *(at + 1 for at in single), len(ticks)}
        for start, end in pairwise(sorted(edges)):
            first = int(before[start] - turns[start])
            rows = slice(start, end)
            if end - start == 1 or turns[start] > 1:  # few
                for at in range(start, end):
                    self._pack_states(states[first : before[at]], state_ns[first : before[at]])
                    for level, text in events.get(at, ()):
                        self.event(int(tick_ns[at]), level, text)
                    for change in changes.get(at, ()):
                        self._put_change(int(tick_ns[at]), change)
                    self._writer.add_messages(self._tick_messages(ticks[at : at + 1], tick_ns[at : at + 1]))
                    first = before[at]
            elif turns[start]:
                known = slice(first, first + end - start)
                known_ns = state_ns[known]
                self._writer.add_messages(
                    self._state_messages(states[known], known_ns), self._tick_messages(ticks[rows], tick_ns[rows])
                )
            else:
                self._writer.add_messages(self._tick_messages(ticks[rows], tick_ns[rows]))
        last = int(before[-1]) if len(ticks) else 0
        self._pack_states(states[last:], state_ns[last:])
        for times_ns in (tick_ns, state_ns):
            self._newest_ns = max(self._newest_ns, int(times_ns.max(initial=0)))

    def _changes_among(self, ticks: npt.NDArray[np.void]) -> dict[int, list[GainChange]]:
        """Take the changes up to the last of `ticks`, by the index of the first tick that has them."""
        found: dict[int, list[GainChange]] = {}
        while self._changes and len(ticks) and self._changes[0].tick <= ticks["tick"][-1]:
            change = self._changes.popleft()
            found.setdefault(int(np.searchsorted(ticks["tick"], change.tick)), []).append(change)
        return found

    def _put_change(self, stamp_ns: int, change: GainChange) -> None:
        data = pack_parameters({change.name: change.value}, change.tick)
        self._writer.add_message(self._parameter_channel, stamp_ns, data)
        self.event(stamp_ns, INFO, describe_change(change))

    def _pack_states(self, rows: npt.NDArray[np.void], times_ns: npt.NDArray[np.uint64]) -> None:
        if len(rows):
            self._writer.add_messages(self._state_messages(rows, times_ns))

    def _tick_messages(self, rows: npt.NDArray[np.void], times_ns: npt.NDArray[np.uint64]) -> Messages:
        first, self._packed = self._packed, self._packed + len(rows)
        return Messages(self._tick_channel, first, times_ns, _plain(rows))

    def _state_messages(self, rows: npt.NDArray[np.void], times_ns: npt.NDArray[np.uint64]) -> Messages:
        if self._truth_channel < 0:
            self._truth_channel = self._channel(row_channel(TRUTH))
        first, self._truths = self._truths, self._truths + len(rows)
        return Messages(self._truth_channel, first, times_ns, _plain(rows))

    def frames(self, facts: Mapping[str, str], messages: Iterable[tuple[int, bytes]]) -> int:
        """Add raw frames, as monotonic time in ns and message; return their number. `facts` describe the channel.

        They have separate chunks: a damaged one loses no ticks.
        """
        self._end_chunk()
        channel = self._channel(Channel(IO_TOPIC, IO_NAME, io_frame_descriptor(), facts))
        count = 0
        for time_ns, data in messages:
            self._writer.add_message(channel, self._epoch_ns + time_ns, data, count & 0xFFFFFFFF)
            count += 1
        self._writer.end_chunk()
        return count

    def flush(self) -> None:
        """Write everything so far to the file, readable as it is. Raises SessionError if the file was removed."""
        self._end_chunk()
        self._settle(wait=False)

    @property
    def synced(self) -> int:
        """Number of ticks that are on the disk, as far as is known; 0 unless the file is durable."""
        return self._disk.synced

    def slow_syncs(self) -> list[tuple[int, int]]:
        """Beginning (monotonic clock) and duration, ns, of the syncs since the last call that took over a second."""
        return self._disk.slow_syncs()

    def warn(self, stamp_ns: int, text: str) -> None:
        """Add a warning to the log, at a wall clock time in ns."""
        self.event(stamp_ns, WARNING, text)

    def event(self, stamp_ns: int, level: int, text: str) -> None:
        """Add an entry to the log, at a wall clock time in ns, unless it has the same one already."""
        self._pack()
        line = stamp_ns, level, text
        if line in self._log:
            return
        self._log.add(line)
        self._writer.add_message(self._event_channel, stamp_ns, pack_event(stamp_ns, level, text))

    def finish(self, outcome: str, reason: str, result: Mapping[str, Any], ended_utc: str = "") -> None:
        """Complete the file: outcome, result card, hash of the payloads, index. Without `ended_utc`, it ends now."""
        self._pack()
        while self._changes:  # their ticks were lost
            self._put_change(self._newest_ns, self._changes.popleft())
        self._write_result(result)
        self._writer.end_chunk()  # the last ticks come before the result
        self.describe(
            "session",
            {
                "outcome": outcome,
                "reason": reason,
                "ticks": str(self.written),
                "overruns": str(result["overruns"]),
                "lost_ticks": str(result["lost_ticks"]),
                "ended_utc": ended_utc or utc(time.time_ns()),
            },
        )
        self.describe("timing", {f"late_us.{name}": repr(value) for name, value in result["lateness_us"].items()})
        self.describe("result", {"card": json.dumps(result)})
        self.describe("integrity", {"payload_sha256": self.payload_sha256, **self._attached})
        self._writer.finish()
        self._settle(wait=True)

    def _write_result(self, card: Mapping[str, Any]) -> None:
        """Write the card as a message, for viewers; this program reads it from the metadata."""
        self._writer.add_message(self._channel(result_channel()), self._newest_ns, pack_result(card))

    def discard(self) -> None:
        """Remove the file of a run without ticks. Raises SessionError if it cannot be removed."""
        with suppress(SessionError):  # what could not be written is removed anyway
            self._file.close()
        try:
            self.path.unlink(missing_ok=True)
        except OSError as error:
            raise SessionError(f"{self.path} has no tick and cannot be removed: {error.strerror}") from error

    def _end_chunk(self) -> None:
        self._pack()
        self._writer.end_chunk()

    def _settle(self, *, wait: bool) -> None:
        self._file.flush()
        self._disk.require_linked()
        if self._durable:
            self._disk.sync(self._packed, wait=wait)

    def _channel(self, channel: Channel) -> int:
        schema = self._writer.add_schema(channel.schema_name, channel.descriptor)
        return self._writer.add_channel(channel.topic, schema, channel.facts)


def _plain(rows: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    """The rows as whole messages, keys included."""
    return rows.view(f"V{rows.itemsize}")


def utc(unix_ns: int) -> str:
    """Date and time as in a session's metadata."""
    return datetime.fromtimestamp(unix_ns * 1e-9, UTC).isoformat(timespec="milliseconds")
