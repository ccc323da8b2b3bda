"""Shows a run to Lichtblick and Foxglove while it lasts: a websocket on this computer only, in the recorder's process.

It looks at the newest tick a hundred times a second and takes nothing out of the ring, so whatever becomes of it, the
recording is whole. Protocol: foxglove.sdk.v1; fact sheet on sessions and views, section 8.4.
"""

from __future__ import annotations

import importlib.util
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any, Final

from inteco_abs.errors import AbsError
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import RunMemory, Word
from inteco_abs.realtime.ring import RingReader
from inteco_abs.records import TICK

HOST: Final = "127.0.0.1"
PERIOD_S: Final = 0.01
_SHOWN: Final = ("time_ns", "tick")


def insist_on_foxglove(port: int) -> None:
    """Raise AbsError if what serves is not installed, or cannot have that port now."""
    if importlib.util.find_spec("foxglove") is None:
        raise AbsError("--foxglove needs foxglove-sdk: pip install 'inteco-abs[foxglove]'; nothing was started")
    with socket.socket() as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does: a port just left is free
        try:
            trial.bind((HOST, port))
        except OSError as error:
            raise _not_served(port, error.strerror or str(error)) from error


def _not_served(port: int, why: str) -> AbsError:
    return AbsError(
        f"--foxglove: {address(port)} cannot be served: {why}; name another port, or 0 for any that is free; "
        "nothing was started"
    )


def address(port: int) -> str:
    """Where a viewer finds the run."""
    return f"ws://{HOST}:{port}"


@contextmanager
def live_view(memory: RunMemory, job: Job) -> Iterator[None]:
    """Serve the run in `memory` meanwhile, if its job asks for that; its port is then the word LIVE_PORT.

    Raises AbsError where that port cannot be had. What goes wrong later ends the view, and nothing else.
    """
    if job.live_port is None:
        yield
        return
    view = _View(memory.tick_reader(), job.live_port, job.session_id, memory.words[Word.EPOCH_NS])
    memory.words[Word.LIVE_PORT] = view.port
    try:
        yield
    finally:
        view.close()


class _View:
    """Serves the newest ticks that `reader` finds; `epoch_ns` is the UNIX time of the monotonic clock's zero."""

    def __init__(self, reader: RingReader, port: int, session_id: str, epoch_ns: int) -> None:
        import foxglove  # noqa: PLC0415  heavy, and an extra

        self._reader = reader
        self._epoch_ns = epoch_ns
        # all three are kept: what is logged to a channel that the garbage collector took is lost without a word
        self._context = foxglove.Context()
        schema = foxglove.Schema(name=TICK.name, encoding="protobuf", data=TICK.descriptor())
        self._channel: Any = foxglove.Channel(
            TICK.topic, message_encoding="protobuf", schema=schema, context=self._context
        )
        try:
            self._server: Any = foxglove.start_server(
                name="inteco-abs", host=HOST, port=port, context=self._context, session_id=session_id
            )
        except (RuntimeError, OSError) as error:
            raise _not_served(port, str(error)) from error
        self.port: int = self._server.port
        self._over = Event()
        self._thread = Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Show the last tick, and stop."""
        self._over.set()
        self._thread.join()
        self._server.stop()

    def _serve(self) -> None:
        shown = -1
        try:
            over = False
            while not over:
                over = self._over.wait(PERIOD_S)
                shown = self._show(shown)
        except Exception as error:  # noqa: BLE001  whatever the library raises, the recording goes on
            print(f"inteco-abs: the live view has ended, and the run goes on: {error}", file=sys.stderr)  # noqa: T201

    def _show(self, shown: int) -> int:
        """The newest tick, unless it was `shown`; its number."""
        record = self._reader.newest()
        if record is None:
            return shown
        ((time_ns, number),) = TICK.values(record, _SHOWN)
        if number != shown:
            self._channel.log(record, log_time=self._epoch_ns + time_ns)
        return int(number)
