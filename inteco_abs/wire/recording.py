"""Records the messages of a link."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from inteco_abs.boards import family_of, protocol_name, protocol_of
from inteco_abs.boards.transports.links import Link
from inteco_abs.config import RigConfig
from inteco_abs.errors import CaptureError, ConfigError, ConfigIssue
from inteco_abs.version import __version__
from inteco_abs.wire.capture import Capture, Record, RecordKind, check_target, write_capture

_OUT, _IN, _ERROR = (kind.value for kind in (RecordKind.OUT, RecordKind.IN, RecordKind.ERROR))
MOST_MESSAGES: Final = 300_000
"""A hundred thousand ticks of three messages; about 150 MB of memory with the frames of an RT-DAC/USB2."""


class RecordingLink(Link):
    """Forwards to `inner`, and keeps every message and failure in memory until `save` writes them to `path`.

    `save` is separate from `close`, which must not wait: saving a long run takes seconds. After `most_messages` further
    messages are only counted, with a warning in the file, as a replay needs the beginning. Answers that `discard` drops
    are not recorded. `endpoints` are the addresses of OUT and IN, if any; `now_ns` is a monotonic clock. Without a
    `path` nothing is written; `capture` returns the messages. Raises CaptureError if no capture can be written at
    `path`, ConfigError for an unknown `board`.
    """

    def __init__(
        self,
        inner: Link,
        path: Path | None,
        *,
        board: str,
        endpoints: tuple[int | None, int | None] = (None, None),
        now_ns: Callable[[], int] = time.monotonic_ns,
        most_messages: int = MOST_MESSAGES,
    ) -> None:
        if path is not None:
            check_target(path)
        self.dropped = 0
        """Number of messages that were not kept."""
        self._inner = inner
        self.engines, self.keeps_boundaries = inner.engines, inner.keeps_boundaries
        self._path = path
        self._board = protocol_of(board).board
        self._endpoints = dict(zip((_OUT, _IN), endpoints, strict=True))
        self._now_ns = now_ns
        self._most = most_messages
        # time, kind, data, text, of: plain values, which the garbage collector does not traverse
        self._kept: list[tuple[int, str, bytes, str, str]] = []
        self._start_ns = now_ns()

    @property  # all of these are the inner link's
    def timeout_s(self) -> float:
        """Time-out of a call, s."""
        return self._inner.timeout_s

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        self._inner.timeout_s = timeout_s

    @property
    def engine(self) -> str:
        """The engine in use."""
        return self._inner.engine

    @engine.setter
    def engine(self, engine: str) -> None:
        self._inner.engine = engine

    def write(self, data: bytes | bytearray) -> None:
        """Send one message."""
        start_ns = self._now_ns()
        try:
            self._inner.write(data)
        except BaseException as error:
            self._keep(self._now_ns(), _ERROR, bytes(data), _words(error), "out")
            raise
        self._keep(start_ns, _OUT, bytes(data))

    def read(self, length: int) -> bytes:
        """Receive one message."""
        try:
            data = self._inner.read(length)
        except BaseException as error:
            self._keep(self._now_ns(), _ERROR, b"", _words(error), "in")
            raise
        self._keep(self._now_ns(), _IN, data)
        return data

    def exchange(self, first: bytes | bytearray, second: bytes, length: int) -> bytes:
        """Send two messages and receive one, by the inner link's engine."""
        start_ns = self._now_ns()
        try:
            data = self._inner.exchange(first, second, length)
        except BaseException as error:
            self._keep(start_ns, _OUT, bytes(first))
            self._keep(start_ns, _OUT, bytes(second))
            self._keep(self._now_ns(), _ERROR, b"", _words(error), "exchange")
            raise
        self._keep(start_ns, _OUT, bytes(first))
        self._keep(start_ns, _OUT, bytes(second))
        self._keep(self._now_ns(), _IN, data)
        return data

    def discard(self, length: int) -> None:
        """Drop old answers."""
        self._inner.discard(length)

    def prepare(self, length: int) -> None:
        """Prepare the inner link; raises its errors."""
        self._inner.prepare(length)

    def close(self) -> None:
        """Close the link."""
        self._inner.close()

    def save(self) -> None:
        """Write everything kept so far. Raises CaptureError."""
        if self._path is not None:
            write_capture(self._path, self.capture())

    def capture(self) -> Capture:
        """Return everything kept so far."""
        records = [
            Record((at_ns - self._start_ns) * 1e-9, RecordKind(kind), self._endpoints.get(kind), data, text, of)
            for at_ns, kind, data, text, of in self._kept
        ]
        if self.dropped:
            text = f"{self.dropped} more messages were not recorded: the limit is {self._most}"
            records.append(Record(records[-1].t_s if records else 0.0, RecordKind.WARNING, text=text))
        recorded_by = f"inteco-abs {__version__}"
        name = str(self._path or "the recording")
        return Capture(self._board, recorded_by, "monotonic", tuple(records), name, self._start_ns)

    def _keep(self, at_ns: int, kind: str, data: bytes, text: str = "", of: str = "") -> None:
        if len(self._kept) < self._most:
            self._kept.append((at_ns, kind, data, text, of))
        else:
            self.dropped += 1


class Recording:
    """Wraps each link to the board of `config` in a recording, if there is a `path` or `keep`."""

    def __init__(self, path: Path | None, config: RigConfig, now_ns: Callable[[], int], *, keep: bool) -> None:
        self._path, self._config, self._now_ns = path, config, now_ns
        self._wanted = keep or path is not None
        self._links: list[RecordingLink] = []

    def __call__(self, link: Link) -> Link:
        """Return `link`, wrapped in a recording if one is wanted."""
        if not self._wanted:
            return link
        self._links.append(
            RecordingLink(link, self._path, board=protocol_name(self._config.board), now_ns=self._now_ns)
        )
        return self._links[-1]

    def capture(self) -> Capture | None:
        """Return the capture of the newest link; None if there was no link."""
        return self._links[-1].capture() if self._links else None

    def save(self) -> None:
        """Save all recordings that have a path. Raises CaptureError."""
        for link in self._links:
            link.save()


@contextmanager
def record_wire(
    path: Path | None, config: RigConfig, now_ns: Callable[[], int] = time.monotonic_ns, *, keep: bool = False
) -> Iterator[Recording]:
    """Yield a recording that wraps links, and save it at `path` at the end; without a path it stays in memory.

    Raises CaptureError if the file cannot be written, or adds a note to the exception that ends the context.
    """
    if path is not None or keep:
        check_recordable("--frames" if path is None else "--record-wire", config)
    if path is not None:
        check_target(path)
    around = Recording(path, config, now_ns, keep=keep)
    try:
        yield around
    except BaseException as error:
        try:
            around.save()
        except CaptureError as second:
            error.add_note(str(second))
        raise
    around.save()


def check_recordable(option: str, config: RigConfig) -> None:
    """Raise ConfigError naming `option` if the profile's board has no messages to record."""
    if not family_of(config.board.kind).protocols:
        raise ConfigError([ConfigIssue(option, f"a {config.board.kind} board has registers, no messages to record")])
    protocol_name(config.board)


def _words(error: BaseException) -> str:
    return str(error) or type(error).__name__
