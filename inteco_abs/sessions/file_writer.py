"""Writes a session: an MCAP file that explains itself from its first flush on."""

from __future__ import annotations

import hashlib
import json
import os
import struct
import time
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib.metadata import version
from io import BufferedWriter, FileIO
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from inteco_abs.errors import SessionError, describe_disk
from inteco_abs.format import (
    IO_NAME,
    IO_TOPIC,
    LOG_NAME,
    LOG_TOPIC,
    PARAMETERS_NAME,
    PARAMETERS_TOPIC,
    RESULT,
    RESULT_NAME,
    RESULT_TOPIC,
    TICK,
    TRUTH,
    Message,
    chunk,
    double,
    integer,
    io_frame_descriptor,
    log_descriptor,
    pack_result,
    parameters_descriptor,
    result_descriptor,
    tag,
)
from inteco_abs.sessions.content import ATTACHMENT_HASH
from inteco_abs.sessions.files import check_output
from inteco_abs.sessions.mcap_writer import McapWriter
from inteco_abs.sessions.reader import stored_rows
from inteco_abs.signals import EXPLANATIONS, Phase, Reason

if TYPE_CHECKING:
    import numpy.typing as npt
    from typing_extensions import Buffer  # collections.abc has it from Python 3.12 on

FORMAT_VERSION: Final = "4"
_MOST_WAITING: Final = 1 << 18  # bytes
_STATE: Final = ("phase", "reason")
_INFO, _WARNING, _ERROR = 2, 3, 4  # levels of foxglove.Log


class _Disk(FileIO):
    """A new file whose refusals are SessionErrors."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            super().__init__(path, "xb+")
        except OSError as error:
            raise SessionError(f"{path} cannot be created: {describe_disk(error)}") from error

    def write(self, data: Buffer, /) -> int:
        """Write some of `data`."""
        try:
            return super().write(data)
        except OSError as error:
            raise self._refused(error) from error

    def close(self) -> None:
        """Close the file; raises SessionError for what the disk refuses only now."""
        try:
            super().close()
        except OSError as error:
            raise self._refused(error) from error

    def sync(self) -> None:
        """Wait until the disk has it for good."""
        try:
            os.fsync(self.fileno())
        except OSError as error:
            raise self._refused(error) from error

    def require_its_place(self) -> None:
        """Raise SessionError if the file is not where it was made: writing to it then goes well, and to nowhere."""
        try:
            found, ours = self.path.stat(), os.fstat(self.fileno())
        except OSError as error:
            raise SessionError(f"{self.name} is gone: {error.strerror}") from error
        if not os.path.samestat(found, ours):
            raise SessionError(f"{self.name} is gone: another file has its name")

    def _refused(self, error: OSError) -> SessionError:
        return SessionError(f"{self.name} cannot be written: {describe_disk(error)}")


class FileWriter:
    """A session being written at `path`; a context manager. Raises SessionError when the disk refuses.

    `session_id`, and `epoch_ns` (UNIX time of the monotonic clock's zero), are those of a session whose file is made
    anew. With `durable`, the disk must have taken in every change of phase and the end before writing goes on, which
    may take seconds. What is added first (`describe`, `attach`) reaches the file before the first tick. Leaving the
    context closes the file; only `finish` makes it complete.
    """

    def __init__(
        self,
        path: Path,
        start_ns: int,
        controller_internals: Sequence[str] = (),
        session_id: str = "",
        epoch_ns: int | None = None,
        *,
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
        self._in_doubt = True  # whether the disk has yet to take in what a power cut must not take away
        self._hash = hashlib.sha256()
        self._attached: dict[str, str] = {}
        self.written = 0
        """Ticks in the file, or on their way into it."""
        self._packed = self._truths = 0
        """Ticks and truths that have been packed."""
        self._newest_ns = self.started_ns
        self._before = (int(Phase.UNKNOWN), int(Reason.NONE))
        self._log = set[tuple[int, int, str]]()
        self._disk = _Disk(path)
        self._file = BufferedWriter(self._disk)
        self._writer = McapWriter(self._file, f"inteco-abs/{version('inteco-abs')}")
        self._waiting, self._kind = bytearray(), TICK
        """Drained messages of one kind on their way into the chunk."""
        self._tick_channel = self._flat(TICK, {"internals": json.dumps(list(controller_internals))})
        self._truth_channel = -1
        self._event_channel = self._channel(LOG_TOPIC, LOG_NAME, log_descriptor(), {})
        self._parameter_channel = self._channel(PARAMETERS_TOPIC, PARAMETERS_NAME, parameters_descriptor(), {})

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except SessionError:
            if error is None:  # else it has been said already
                raise

    def close(self) -> None:
        """No more is to come; without `finish` the file stays cut."""
        (self._disk if self._read else self._file).close()

    def stored(self) -> Iterator[tuple[bytes, bytes]]:
        """What the file has taken in by now, as `stored_rows`, even where it has lost its name; ends the writing.

        Raises SessionError if the disk does not give it back.
        """
        self._read = True  # what has not been written is not written any more: the place in the file is another
        try:
            self._disk.seek(0)
            yield from stored_rows(self._disk, os.fstat(self._disk.fileno()).st_size, self.path)
        except OSError as error:
            raise SessionError(f"{self.path} cannot be read again: {describe_disk(error)}") from error

    @property
    def payload_sha256(self) -> str:
        """Hash over the tick payloads so far: independent of compression and of the time of day."""
        return self._hash.hexdigest()

    def describe(self, name: str, facts: Mapping[str, str]) -> None:
        """Add the metadata record `inteco_abs.{name}`; a later one of the same name adds to it or replaces."""
        self._pack()
        self._writer.add_metadata(f"inteco_abs.{name}", facts)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Add a file."""
        self._pack()
        self._writer.add_attachment(self.started_ns, name, media_type, data)
        self._attached[ATTACHMENT_HASH + name] = hashlib.sha256(data).hexdigest()

    def begin(self, parameters: Mapping[str, float]) -> None:
        """Write the parameters in force from tick 0, and everything so far to the disk."""
        values = b"".join(chunk(1, chunk(1, name) + double(2, value)) for name, value in parameters.items())
        data = values + tag(2, 5) + struct.pack("<I", 0)
        stamp = self.started_ns
        self._writer.add_message(self._parameter_channel, stamp, data)
        self.describe(
            "session",
            {
                "format_version": FORMAT_VERSION,
                "session_id": self.session_id,
                "started_utc": utc(stamp),
            },
        )
        self.flush()

    def ticks(self, records: bytes) -> None:
        """Add tick records, back to back, and an event for every change of phase and every fault among them."""
        self._hash.update(records)
        self.written += len(records) // TICK.size
        self._wait(TICK, records)

    def truths(self, records: bytes) -> None:
        """Add states of the simulated rig, back to back."""
        self._wait(TRUTH, records)

    def _wait(self, kind: Message, records: bytes) -> None:
        """Keep drained messages until the flush, which packs them all at once: a tenth of the time."""
        if not records:
            return
        if kind is not self._kind:
            self._pack()
        self._kind = kind
        self._waiting += records
        if len(self._waiting) > _MOST_WAITING:
            self._pack()

    def _pack(self) -> None:
        """Put the waiting messages into the chunk, with the events among them."""
        records, self._waiting = self._waiting, bytearray()
        if not records:
            return
        rows = self._kind.array(records)
        times_ns = rows["time_ns"] + np.uint64(self._epoch_ns % (1 << 64))
        if self._kind is TICK:
            self._pack_ticks(rows, times_ns)
            return
        if self._truth_channel < 0:
            self._truth_channel = self._flat(TRUTH, {})
        self._writer.add_messages(self._truth_channel, self._truths, times_ns, _plain(rows))
        self._truths += len(rows)

    def _pack_ticks(self, rows: npt.NDArray[np.void], times_ns: npt.NDArray[np.uint64]) -> None:
        changes = [np.diff(rows[name], prepend=old) != 0 for name, old in zip(_STATE, self._before, strict=True)]
        data, start = _plain(rows), 0
        for end in (*np.flatnonzero(np.logical_or(*changes)).tolist(), len(rows)):
            self._writer.add_messages(self._tick_channel, self._packed, times_ns[start:end], data[start:end])
            self._packed += end - start
            if end < len(rows):
                self._changed(int(times_ns[end]), *(int(rows[name][end]) for name in _STATE))
            start = end
        self._newest_ns = int(times_ns[-1])

    def frames(self, facts: Mapping[str, str], messages: Iterable[tuple[int, bytes]]) -> int:
        """Add raw frames, as monotonic time in ns and message; how many there were. `facts` explain them.

        They have chunks of their own, so that a damaged one costs no tick.
        """
        self.flush()
        channel = self._channel(IO_TOPIC, IO_NAME, io_frame_descriptor(), facts)
        count = 0
        for time_ns, data in messages:
            stamp = self._epoch_ns + time_ns
            self._writer.add_message(channel, stamp, data, count & 0xFFFFFFFF)
            count += 1
        self.flush()
        return count

    def flush(self) -> None:
        """Everything so far into the file, readable even if nothing follows. Raises SessionError if that is gone."""
        self._pack()
        self._writer.end_chunk()
        self._settle()

    def warn(self, stamp_ns: int, text: str) -> None:
        """Add a warning to the log at a wall clock time in ns."""
        self.event(stamp_ns, _WARNING, text)

    def event(self, stamp_ns: int, level: int, text: str) -> None:
        """Add a line to the log at a wall clock time in ns, unless it is there already."""
        self._pack()
        line = stamp_ns, level, text
        if line in self._log:
            return
        self._log.add(line)
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        stamp = integer(1, seconds) + integer(2, nanoseconds)
        data = chunk(1, stamp) + integer(2, level) + chunk(3, text) + chunk(4, "inteco-abs")
        self._writer.add_message(self._event_channel, stamp_ns, data)

    def finish(self, outcome: str, reason: str, result: Mapping[str, Any], ended_utc: str = "") -> None:
        """Complete the file: how the run ended, its result card, the hash over its payloads, the index.

        It ended now, unless `ended_utc` says when.
        """
        self._pack()
        self._tell_result(result)
        self.flush()  # the last ticks come before what is said about them
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
        self._in_doubt = True
        self._settle()

    def _tell_result(self, card: Mapping[str, Any]) -> None:
        """The card where any viewer finds it; ours read the metadata, which the index has at a glance."""
        units = {"units": json.dumps({entry.name: entry.unit for entry in RESULT})}
        channel = self._channel(RESULT_TOPIC, RESULT_NAME, result_descriptor(), units)
        self._writer.add_message(channel, self._newest_ns, pack_result(card))

    def discard(self) -> None:
        """Remove the file: nothing ran, so there is nothing to keep. Raises SessionError if it cannot be removed."""
        with suppress(SessionError):  # what could not be written is not wanted any more
            self._file.close()
        try:
            self.path.unlink(missing_ok=True)
        except OSError as error:
            raise SessionError(f"{self.path} has no tick and cannot be removed: {error.strerror}") from error

    def _settle(self) -> None:
        self._file.flush()
        self._disk.require_its_place()
        if self._durable and self._in_doubt:
            self._disk.sync()
        self._in_doubt = False

    def _changed(self, stamp_ns: int, phase: int, reason: int) -> None:
        if phase != self._before[0]:
            self.event(stamp_ns, _INFO, f"phase {Phase(phase).name}")
        if reason != self._before[1]:
            self.event(stamp_ns, _ERROR, f"{Reason(reason).name}: {EXPLANATIONS[Reason(reason)]}")
        self._before = (phase, reason)
        self._in_doubt = True

    def _flat(self, message: Message, metadata: Mapping[str, str]) -> int:
        facts = {
            "units": json.dumps({column.name: column.unit for column in message.columns}),
            "describe": json.dumps({column.name: column.meaning for column in message.columns}),
            **metadata,
        }
        return self._channel(message.topic, message.name, message.descriptor(), facts)

    def _channel(self, topic: str, name: str, descriptor: bytes, metadata: Mapping[str, str]) -> int:
        return self._writer.add_channel(topic, self._writer.add_schema(name, descriptor), metadata)


def _plain(rows: npt.NDArray[np.void]) -> npt.NDArray[np.void]:
    """The rows as bytes, keys and all."""
    return rows.view(f"V{rows.itemsize}")


def utc(unix_ns: int) -> str:
    """Date and time as a session's metadata has them."""
    return datetime.fromtimestamp(unix_ns * 1e-9, UTC).isoformat(timespec="milliseconds")
