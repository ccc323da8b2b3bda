"""Serves a run to Lichtblick and Foxglove while it lasts, over a websocket on this computer, in the recorder's process.

The server reads the newest tick a hundred times a second and takes nothing out of the ring, so the recording stays
whole. Any program of this computer may connect, a few at a time; web pages may not, except those of this computer and
of the Foxglove app. Protocol: foxglove.sdk.v1 (docs.foxglove.dev, "WebSocket protocol"): texts in JSON, ticks in
binary.
"""

from __future__ import annotations

import base64
import importlib.util
import json
import re
import selectors
import socket
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread
from typing import Any, Final

from inteco_abs.errors import AbsError
from inteco_abs.format import TICK
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Field, RunMemory
from inteco_abs.realtime.ring import RingReader

HOST: Final = "127.0.0.1"
PERIOD_S: Final = 0.01
MOST_VIEWERS: Final = 16
"""Most connections at a time, with or without a handshake: each holds a descriptor of the recorder."""
_SHOWN: Final = ("time_ns", "tick")
_PROTOCOL: Final[Any] = "foxglove.sdk.v1"
_ORIGINS: Final[Any] = (
    None,  # a browser names the page that asks; other programs name none
    re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?"),
    "https://app.foxglove.dev",
    re.compile(r"(?!https?:)[a-z][a-z0-9+.-]*://.*"),  # a viewer installed here, such as file://; no page can say so
)
_HOSTS: Final = (HOST, "localhost")
_CHANNEL: Final = 1
_MESSAGE: Final = struct.Struct("<BIQ")
"""Type, subscription, time in ns; a tick follows."""
_MESSAGE_DATA: Final = 1
_HANDSHAKE_S: Final = 5.0
_FAREWELL_S: Final = 0.5
"""Time for what a viewer has not received when the run is over."""
_LONGEST_REQUEST: Final = 1 << 16
_MOST_BEHIND: Final = 1 << 16
"""Bytes that may wait for a viewer before it misses ticks."""


def require_foxglove(port: int) -> None:
    """Raise AbsError if websockets is not installed, or the port is taken."""
    if importlib.util.find_spec("websockets") is None:
        raise AbsError("--foxglove needs websockets: pip install 'inteco-abs[foxglove]'; nothing was started")
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
    """Return the address at which a viewer finds the run."""
    return f"ws://{HOST}:{port}"


@contextmanager
def live_view(memory: RunMemory, job: Job) -> Iterator[None]:
    """Serve the run in `memory` inside the context if its job asks for it; LIVE_PORT then holds the port.

    Raises AbsError if the port is taken. A later failure ends the view only.
    """
    if job.live_port is None:
        yield
        return
    view = _View(memory.tick_reader(), job.live_port, job.session_id, memory.words[Field.EPOCH_NS])
    memory.words[Field.LIVE_PORT] = view.port
    try:
        yield
    finally:
        view.close()


class _View:
    """Serves the newest ticks of `reader`; `epoch_ns` is the UNIX time of the monotonic clock's zero, ns."""

    def __init__(self, reader: RingReader, port: int, session_id: str, epoch_ns: int) -> None:
        import websockets.server  # noqa: F401, PLC0415  an extra; loaded before ticks come

        self._reader = reader
        self._epoch_ns = epoch_ns
        self._shown = -1
        self._introduction = _introduction(session_id)
        self._viewers: set[_Viewer] = set()
        self._selector = selectors.DefaultSelector()
        try:
            self._listener = socket.create_server((HOST, port))
        except OSError as error:
            raise _not_served(port, error.strerror or str(error)) from error
        self._listener.setblocking(False)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self.port: int = self._listener.getsockname()[1]
        self._over = Event()
        self._thread = Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Send the last tick, and stop."""
        self._over.set()
        self._thread.join()

    def _serve(self) -> None:
        try:
            while not self._over.is_set():
                self._listen(PERIOD_S)
                self._show()
            self._leave()
        except Exception as error:  # noqa: BLE001  a viewer must not end the recording
            print(f"inteco-abs: the live view has ended, and the run continues: {error}", file=sys.stderr)  # noqa: T201
        finally:
            self._selector.close()
            for one in (self._listener, *(viewer.socket for viewer in self._viewers)):
                one.close()

    def _listen(self, most_s: float) -> None:
        """Serve the viewers' requests for `most_s` or a little longer."""
        end = time.monotonic() + most_s
        while True:
            for key, _ in self._selector.select(max(0.0, end - time.monotonic())):
                if key.data is None:
                    self._admit()
                else:
                    key.data.receive()
            self._drop_gone()
            if time.monotonic() >= end:
                return

    def _admit(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:  # gone again, or no descriptor left: not at once again
            time.sleep(PERIOD_S)
            return
        if len(self._viewers) >= MOST_VIEWERS:
            connection.close()
            return
        viewer = _Viewer(connection, self.port, self._introduction)
        self._viewers.add(viewer)
        self._selector.register(connection, selectors.EVENT_READ, viewer)

    def _drop_gone(self) -> None:
        """Send what still waits, and drop viewers that have left or have not completed the handshake in time."""
        for viewer in self._viewers:
            viewer.send()
        for viewer in [each for each in self._viewers if each.gone]:
            self._viewers.discard(viewer)
            self._selector.unregister(viewer.socket)
            viewer.socket.close()

    def _show(self) -> None:
        """Send the newest tick, unless it has been sent."""
        record = self._reader.newest()
        if record is None:
            return
        ((time_ns, number),) = TICK.values(record, _SHOWN)
        if number != self._shown:
            self._shown = number
            for viewer in self._viewers:
                viewer.show(self._epoch_ns + time_ns, record)

    def _leave(self) -> None:
        self._show()
        for viewer in self._viewers:
            viewer.leave()
        end = time.monotonic() + _FAREWELL_S
        while self._viewers and time.monotonic() < end:
            self._listen(PERIOD_S)


class _Viewer:
    """One connection, from its first byte on, with the library's protocol; no call waits for the other end."""

    def __init__(self, connection: socket.socket, port: int, introduction: tuple[str, str]) -> None:
        from websockets.server import ServerProtocol  # noqa: PLC0415  an extra

        connection.setblocking(False)
        self.socket = connection
        self._hosts = {f"{host}:{port}" for host in _HOSTS}
        self._introduction = introduction
        self._protocol: Any = ServerProtocol(origins=_ORIGINS, subprotocols=[_PROTOCOL], max_size=_LONGEST_REQUEST)
        self._subscriptions: set[int] = set()
        self._untaken = bytearray()
        self._opened = False
        self._broken = False
        self._patience_s = time.monotonic() + _HANDSHAKE_S

    @property
    def gone(self) -> bool:
        """Whether nothing is left to send to it."""
        late = not self._opened and time.monotonic() > self._patience_s
        return self._broken or late or (not self._untaken and self._protocol.close_expected())

    def receive(self) -> None:
        """Read what has arrived, and answer it."""
        try:
            data = self.socket.recv(_LONGEST_REQUEST)
        except BlockingIOError:
            return
        except OSError:
            self._broken = True
            return
        if data:
            self._protocol.receive_data(data)
        else:
            self._protocol.receive_eof()
            self._broken = True
        for event in self._protocol.events_received():
            if not self._opened:
                self._answer(event)
            elif getattr(event, "opcode", None) == 1:  # text
                self._handle(event.data)
        self.send()

    def show(self, log_time_ns: int, record: bytes) -> None:
        """Send one tick to each subscription, unless the viewer is too slow or is leaving."""
        if len(self._untaken) > _MOST_BEHIND or self._protocol.close_expected():
            self.send()
            return
        for subscription in self._subscriptions:
            self._protocol.send_binary(_MESSAGE.pack(_MESSAGE_DATA, subscription, log_time_ns) + record)
        self.send()

    def leave(self) -> None:
        """Close the connection: the run is over."""
        if self._opened:
            with suppress(Exception):  # it is closing already
                self._protocol.send_close(1001)
            self.send()
        else:
            self._broken = True

    def _answer(self, request: Any) -> None:
        """Accept or reject the handshake."""
        hosts = request.headers.get_all("Host")
        if len(hosts) == 1 and hosts[0] in self._hosts:
            response = self._protocol.accept(request)
        else:  # a page whose host name resolves to this computer
            response = self._protocol.reject(403, f"Connect to one of {', '.join(sorted(self._hosts))}.\n")
        self._protocol.send_response(response)
        if response.status_code == 101:  # switching protocols
            self._opened = True
            for text in self._introduction:
                self._protocol.send_text(text.encode())

    def _handle(self, data: bytes) -> None:
        """Subscribe or unsubscribe; other operations are not offered."""
        try:
            request = json.loads(data)
            if request["op"] == "subscribe":
                wanted = {each["id"] for each in request["subscriptions"] if each["channelId"] == _CHANNEL}
                if all(type(each) is int and 0 <= each < 1 << 32 for each in wanted):
                    self._subscriptions = set(sorted(self._subscriptions | wanted)[:MOST_VIEWERS])
            elif request["op"] == "unsubscribe":
                self._subscriptions -= set(request["subscriptionIds"])
        except (ValueError, TypeError, LookupError, RecursionError):
            self._protocol.fail(1008, "not a message of this protocol")

    def send(self) -> None:
        """Send as much as the other end accepts now."""
        for data in self._protocol.data_to_send():
            self._untaken += data  # b"" asks for an end of sending, which closing gives
        try:
            del self._untaken[: self.socket.send(self._untaken) if self._untaken else 0]
        except BlockingIOError:
            pass
        except OSError:
            self._broken = True


def _introduction(session_id: str) -> tuple[str, str]:
    """Return the first two messages to each viewer: server and channel."""
    info = {"op": "serverInfo", "name": "inteco-abs", "capabilities": [], "sessionId": session_id}
    channel = {
        "id": _CHANNEL,
        "topic": TICK.topic,
        "encoding": "protobuf",
        "schemaName": TICK.name,
        "schema": base64.b64encode(TICK.descriptor()).decode(),
        "schemaEncoding": "protobuf",
    }
    return json.dumps(info), json.dumps({"op": "advertise", "channels": [channel]})
