"""A websocket server on this computer for Lichtblick and Foxglove, for the channels of a run or of a session.

Any program of this computer may connect, a few at a time; web pages may not, except those of this computer and of the
Foxglove app. Protocol: foxglove.sdk.v1 (docs.foxglove.dev, "WebSocket protocol"): texts in JSON, messages in binary.
"""

from __future__ import annotations

import base64
import importlib.util
import json
import re
import selectors
import socket
import struct
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, NamedTuple

from inteco_abs.errors import AbsError
from inteco_abs.sessions import Channel

HOST: Final = "127.0.0.1"
PERIOD_S: Final = 0.01
"""Usual time between two messages of a channel."""
MOST_VIEWERS: Final = 16
"""Most connections at a time, with or without a handshake: each holds a descriptor of this process."""
MOST_IN_A_PERIOD: Final = 100
"""Most messages of answers that all viewers together get in one call of `listen`: a millisecond's work."""
_PROTOCOL: Final[Any] = "foxglove.sdk.v1"
_ORIGINS: Final[Any] = (
    None,  # a browser names the page that asks; other programs name none
    re.compile(r"https?://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?"),
    "https://app.foxglove.dev",
    re.compile(r"(?!https?:)[a-z][a-z0-9+.-]*://.*"),  # a viewer installed here, such as file://; no page can say so
)
_HOSTS: Final = (HOST, "localhost")
_MESSAGE: Final = struct.Struct("<BIQ")
"""Type, subscription, time in ns; a message follows."""
_CLOCK: Final = struct.Struct("<BQ")
"""Type, time in ns."""
_CALL: Final = struct.Struct("<BIII")
"""Type, service, call, length of the encoding's name, which follows, and then the request or response."""
_CONTROL: Final = struct.Struct("<BBfBQI")
"""Type, 1 to pause, speed, 1 to seek, to a time in ns, length of the request's name, which follows."""
_STATE: Final = struct.Struct("<BBQfBI")
"""Type, status, time in ns, speed, 1 after seeking, length of the request's name, which follows."""
_MESSAGE_DATA, _TIME, _RESPONSE, _PLAYBACK_STATE = 1, 2, 3, 5
_REQUEST, _CONTROL_REQUEST = 2, 3
_JSON: Final = b"json"
_TEXT, _BINARY = 1, 2
_HANDSHAKE_S: Final = 5.0
_FAREWELL_S: Final = 0.5
"""Time for what a viewer has not received when the run is over."""
_LONGEST_REQUEST: Final = 1 << 16
_MOST_SUBSCRIPTIONS: Final = 16
_MOST_KEPT: Final = 1000
"""Messages of a channel that later viewers get, too: the newest."""
_MOST_BEHIND: Final = 1 << 16
"""Bytes that may wait for a viewer before it misses messages that others follow."""


class Answer(NamedTuple):
    """Answer to a call: messages of one channel, and what is said after them."""

    topic: str
    messages: Iterator[tuple[int, bytes]]
    """UNIX times in ns and messages."""
    response: Mapping[str, Any]


class Service(NamedTuple):
    """What viewers may call; requests and responses are JSON objects, described by JSON schemas."""

    name: str
    request: Mapping[str, Any]
    response: Mapping[str, Any]
    call: Callable[[Mapping[str, Any]], Answer]
    """Raises ValueError, with the reason, if it refuses."""


class PlaybackState(NamedTuple):
    """What a viewer's playback controls show."""

    status: int
    """0 playing, 1 paused, 3 ended."""
    time_ns: int
    """UNIX time."""
    speed: float
    """Times real time."""


class PlaybackControl(NamedTuple):
    """What viewers may do with a playback; times are UNIX times in ns."""

    begin_ns: int
    end_ns: int
    state: Callable[[], PlaybackState]
    control: Callable[[bool, float, int | None], None]
    """Pause or not, speed, and where to seek, if anywhere. Called with all that a stranger may send."""


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


class FoxgloveServer:
    """Serves channels to viewers while `listen` is called; all calls come from one thread.

    With `playback`, `tell_time` says what time it is for the viewers, which then may go back, and viewers with playback
    controls use them. Raises AbsError if the port is taken.
    """

    def __init__(
        self,
        port: int,
        session_id: str,
        channels: Sequence[Channel],
        services: Sequence[Service] = (),
        playback: PlaybackControl | None = None,
    ) -> None:
        import websockets.server  # noqa: F401, PLC0415  an extra; loaded before messages come

        self._session_id, self._playback = session_id, playback
        self._services = dict(enumerate(services, 1))
        self._channels: dict[str, int] = {}
        self._facts: dict[str, str] = {}
        self._advertised: list[dict[str, Any]] = []
        self._kept: dict[int, list[tuple[int, bytes]]] = {}
        self._viewers: set[_Viewer] = set()
        self._selector = selectors.DefaultSelector()
        for channel in channels:
            self._advertise(channel)
        try:
            self._listener = socket.create_server((HOST, port))
        except OSError as error:
            raise _not_served(port, error.strerror or str(error)) from error
        self._listener.setblocking(False)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self.port: int = self._listener.getsockname()[1]

    def _advertise(self, channel: Channel) -> None:
        number = self._channels[channel.topic] = len(self._channels) + 1
        self.describe(channel)
        self._advertised.append(
            {
                "id": number,
                "topic": channel.topic,
                "encoding": "protobuf",
                "schemaName": channel.schema_name,
                "schema": base64.b64encode(channel.descriptor).decode(),
                "schemaEncoding": "protobuf",
            }
        )

    def describe(self, channel: Channel) -> None:
        """Send metadata of a channel to all viewers: the protocol has room for it in that of the server only."""
        self._facts |= {f"{channel.topic} {name}": text for name, text in channel.facts.items()}
        for viewer in self._viewers:
            viewer.tell(self._server_info())

    def send(self, topic: str, log_time_ns: int, data: bytes, *, keep: bool = False) -> None:
        """Send a message to all viewers of its channel, and with `keep` to those that come later, too."""
        channel = self._channels[topic]
        if keep:
            kept = self._kept.setdefault(channel, [])
            kept.append((log_time_ns, data))
            del kept[:-_MOST_KEPT]
        for viewer in self._viewers:
            viewer.show(channel, log_time_ns, data, always=keep)

    def forget(self, topic: str) -> None:
        """Keep no message of a channel any more."""
        self._kept.pop(self._channels[topic], None)

    def tell_time(self, time_ns: int) -> None:
        """Send the present time, UNIX time in ns; earlier than before, viewers drop what they have."""
        for viewer in self._viewers:
            viewer.tell_time(time_ns)

    def tell_state(self, *, did_seek: bool) -> None:
        """Send the state of the playback to all viewers."""
        for viewer in self._viewers:
            viewer.tell_state(did_seek=did_seek)

    @property
    def viewers(self) -> int:
        """Number of connections."""
        return len(self._viewers)

    def listen(self, most_s: float) -> None:
        """Serve the viewers' requests for `most_s` or a little longer."""
        end = time.monotonic() + most_s
        self._answer()
        while True:
            for key, _ in self._selector.select(max(0.0, end - time.monotonic())):
                if key.data is None:
                    self._admit()
                else:
                    key.data.receive()
            self._drop_gone()
            if time.monotonic() >= end:
                return

    def _answer(self) -> None:
        """Send a part of the answers that viewers wait for."""
        waiting = [viewer for viewer in self._viewers if viewer.waits]
        for viewer in waiting:
            viewer.answer(MOST_IN_A_PERIOD // len(waiting))

    def _admit(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:  # gone again, or no descriptor left: not at once again
            time.sleep(PERIOD_S)
            return
        if len(self._viewers) >= MOST_VIEWERS:
            connection.close()
            return
        viewer = _Viewer(connection, self.port, self._introduction, self._kept, self._called, self._playback)
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

    def leave(self) -> None:
        """Send what waits, and close all connections."""
        for viewer in self._viewers:
            viewer.leave()
        end = time.monotonic() + _FAREWELL_S
        while self._viewers and time.monotonic() < end:
            self.listen(PERIOD_S)

    def close(self) -> None:
        """Close everything at once."""
        self._selector.close()
        for one in (self._listener, *(viewer.socket for viewer in self._viewers)):
            one.close()

    def _called(self, number: int, request: Any) -> tuple[int, Answer]:
        """Call a service; return the number of the answer's channel, and the answer. Raises ValueError."""
        if number not in self._services:
            raise ValueError(f"no service {number}: must be one of {', '.join(map(str, self._services)) or 'none'}")
        if not isinstance(request, dict):
            raise ValueError("the request must be a JSON object")  # noqa: TRY004  refused as all others
        answer = self._services[number].call(request)
        return self._channels[answer.topic], answer

    def _server_info(self) -> str:
        info: dict[str, Any] = {
            "op": "serverInfo",
            "name": "inteco-abs",
            "capabilities": [],
            "metadata": self._facts,
            "sessionId": self._session_id,
        }
        if self._services:
            info["capabilities"] += ["services"]
            info["supportedEncodings"] = ["json"]
        if self._playback is not None:
            info["capabilities"] += ["time", "playbackControl"]
            info["dataStartTime"], info["dataEndTime"] = map(_stamp, (self._playback.begin_ns, self._playback.end_ns))
        return json.dumps(info)

    def _introduction(self) -> Iterator[str]:
        """The first messages to each viewer: server, channels and services."""
        yield self._server_info()
        yield json.dumps({"op": "advertise", "channels": self._advertised})
        if self._services:
            yield json.dumps(
                {"op": "advertiseServices", "services": [_service(*each) for each in self._services.items()]}
            )


def _stamp(time_ns: int) -> dict[str, int]:
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    return {"sec": seconds, "nsec": nanoseconds}


def _service(number: int, service: Service) -> dict[str, Any]:
    def described(name: str, schema: Mapping[str, Any]) -> dict[str, str]:
        return {
            "encoding": "json",
            "schemaName": f"{service.name}_{name}",
            "schemaEncoding": "jsonschema",
            "schema": json.dumps(schema),
        }

    return {
        "id": number,
        "name": service.name,
        "type": service.name,
        "request": described("request", service.request),
        "response": described("response", service.response),
    }


class _Viewer:
    """One connection, from its first byte on, with the library's protocol; no call waits for the other end."""

    def __init__(
        self,
        connection: socket.socket,
        port: int,
        introduction: Callable[[], Iterable[str]],
        kept: Mapping[int, Sequence[tuple[int, bytes]]],
        called: Callable[[int, Any], tuple[int, Answer]],
        playback: PlaybackControl | None,
    ) -> None:
        from websockets.server import ServerProtocol  # noqa: PLC0415  an extra

        connection.setblocking(False)
        self.socket = connection
        self._hosts = {f"{host}:{port}" for host in _HOSTS}
        self._introduction, self._kept, self._called, self._playback = introduction, kept, called, playback
        self._protocol: Any = ServerProtocol(origins=_ORIGINS, subprotocols=[_PROTOCOL], max_size=_LONGEST_REQUEST)
        self._subscriptions: dict[int, int] = {}
        """Channel of each subscription."""
        self._pending: tuple[int, int, int, Answer] | None = None
        """Subscription, service and call of an answer that is on its way."""
        self._untaken = bytearray()
        self._opened = False
        self._broken = False
        self._patience_s = time.monotonic() + _HANDSHAKE_S

    @property
    def gone(self) -> bool:
        """Whether nothing is left to send to it."""
        late = not self._opened and time.monotonic() > self._patience_s
        return self._broken or late or (not self._untaken and self._protocol.close_expected())

    @property
    def waits(self) -> bool:
        """Whether an answer is on its way to it."""
        return self._pending is not None

    def _takes(self, *, always: bool = False) -> bool:
        """Whether it can be sent messages: it is not leaving, and not too slow for what need not `always` come."""
        behind = len(self._untaken) > _MOST_BEHIND and not always
        return self._opened and not behind and not self._protocol.close_expected()

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
                self._accept(event)
            elif (opcode := getattr(event, "opcode", None)) in {_TEXT, _BINARY}:
                self._handle(event.data, self._subscribe if opcode == _TEXT else self._command)
        self.send()

    def show(self, channel: int, log_time_ns: int, data: bytes, *, always: bool) -> None:
        """Send one message to each subscription of its channel, unless the viewer is leaving, or too slow.

        What must `always` be sent is rare, and comes late to one that is slow.
        """
        if self._takes(always=always):
            for subscription in [each for each, of in self._subscriptions.items() if of == channel]:
                self._send_message(subscription, log_time_ns, data)
        self.send()

    def _send_message(self, subscription: int, log_time_ns: int, data: bytes) -> None:
        self._protocol.send_binary(_MESSAGE.pack(_MESSAGE_DATA, subscription, log_time_ns) + data)

    def tell(self, text: str) -> None:
        """Send a text."""
        if self._takes(always=True):
            self._protocol.send_text(text.encode())
            self.send()

    def tell_time(self, time_ns: int) -> None:
        """Send the present time."""
        if self._takes():
            self._protocol.send_binary(_CLOCK.pack(_TIME, time_ns))
            self.send()

    def tell_state(self, request: bytes = b"", *, did_seek: bool) -> None:
        """Send the state of the playback, as the answer to a named request if there is one."""
        if self._playback is not None and self._takes(always=True):
            state = self._playback.state()
            self._protocol.send_binary(_STATE.pack(_PLAYBACK_STATE, *state, did_seek, len(request)) + request)
            self.send()

    def answer(self, most: int) -> None:
        """Send up to `most` messages of the answer that is on its way, and the response after the last."""
        if self._pending is None or not self._takes():
            return
        subscription, service, call, answer = self._pending
        for _ in range(most):
            message = next(answer.messages, None)
            if message is None:
                self._pending = None
                head = _CALL.pack(_RESPONSE, service, call, len(_JSON)) + _JSON
                self._protocol.send_binary(head + json.dumps(answer.response).encode())
                break
            self._send_message(subscription, *message)
            self.send()
            if not self._takes():
                break
        self.send()

    def leave(self) -> None:
        """Close the connection: the run is over."""
        if self._opened:
            with suppress(Exception):  # it is closing already
                self._protocol.send_close(1001)
            self.send()
        else:
            self._broken = True

    def _accept(self, request: Any) -> None:
        """Accept or reject the handshake."""
        hosts = request.headers.get_all("Host")
        if len(hosts) == 1 and hosts[0] in self._hosts:
            response = self._protocol.accept(request)
        else:  # a page whose host name resolves to this computer
            response = self._protocol.reject(403, f"Connect to one of {', '.join(sorted(self._hosts))}.\n")
        self._protocol.send_response(response)
        if response.status_code == 101:  # switching protocols
            self._opened = True
            for text in self._introduction():
                self._protocol.send_text(text.encode())

    def _handle(self, data: bytes, handle: Callable[[bytes], None]) -> None:
        try:
            handle(data)
        except (ValueError, TypeError, LookupError, RecursionError, struct.error):
            self._protocol.fail(1008, "not a message of this protocol")

    def _subscribe(self, data: bytes) -> None:
        """Subscribe or unsubscribe; other operations are not offered."""
        request = json.loads(data)
        if request["op"] == "subscribe":
            wanted = {each["id"]: each["channelId"] for each in request["subscriptions"]}
            if not all(type(each) is int and 0 <= each < 1 << 32 for pair in wanted.items() for each in pair):
                return
            for subscription, channel in wanted.items():
                if subscription not in self._subscriptions and len(self._subscriptions) < _MOST_SUBSCRIPTIONS:
                    self._subscriptions[subscription] = channel
                    for message in self._kept.get(channel, ()):
                        self._send_message(subscription, *message)
        elif request["op"] == "unsubscribe":
            for subscription in request["subscriptionIds"]:
                self._subscriptions.pop(subscription, None)

    def _command(self, data: bytes) -> None:
        """Call a service or control the playback; other binary messages are not offered."""
        if data[:1] == bytes([_REQUEST]):
            self._call(data)
        elif data[:1] == bytes([_CONTROL_REQUEST]) and self._playback is not None:
            _, pause, speed, seeks, time_ns, length = _CONTROL.unpack_from(data)
            self._playback.control(bool(pause), speed, time_ns if seeks else None)
            self.tell_state(data[_CONTROL.size : _CONTROL.size + length], did_seek=bool(seeks))

    def _call(self, data: bytes) -> None:
        """Call a service."""
        _, service, call, length = _CALL.unpack_from(data)
        encoding, request = data[_CALL.size : _CALL.size + length], data[_CALL.size + length :]
        try:
            self._pending = self._answered(service, call, encoding, request)
        except ValueError as error:
            failure = {"op": "serviceCallFailure", "serviceId": service, "callId": call, "message": str(error)}
            self._protocol.send_text(json.dumps(failure).encode())

    def _answered(self, service: int, call: int, encoding: bytes, data: bytes) -> tuple[int, int, int, Answer]:
        if encoding != _JSON:
            raise ValueError(f"encoding {encoding!r}: must be json")
        if self._pending is not None:
            raise ValueError("the previous call is not answered yet; wait for it")
        try:
            request = json.loads(data)
        except ValueError:
            request = None
        channel, answer = self._called(service, request)
        subscription = next((each for each, of in self._subscriptions.items() if of == channel), None)
        if subscription is None:
            raise ValueError(f"subscribe to {answer.topic} first")
        return subscription, service, call, answer

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
