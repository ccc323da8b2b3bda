"""Test benches: a board, its mock device, and a link between them that fails on a test's request."""

import os
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import count
from typing import ClassVar

from firmware_protocol import rtdac_usb, rtdac_usb2
from inteco_abs.boards import InProcessLink, Link, SocketLink, board_behind
from inteco_abs.boards.families.usb.mock import ByteStream
from inteco_abs.boards.transports.serial_link import SerialLink
from inteco_abs.config import RigConfig, load_config
from inteco_abs.errors import LinkError
from inteco_abs.mock_board import Device, FrontEnd, PtyServer, SocketServer, front_end_of
from inteco_abs.rig import Plant
from inteco_abs.signals import Command, Sample

BENCHES_OF_A_TEST = 8
COUNTER_RANGE = 1 << 32


def two_complement(count: int) -> int:
    return (count + COUNTER_RANGE // 2) % COUNTER_RANGE - COUNTER_RANGE // 2


@cache
def configured(profile: str, settings: tuple[str, ...]) -> RigConfig:
    """Configurations cannot be changed, and some tests make thousands of benches with the same one."""
    return load_config(settings=settings, profile=profile)


class HandClock:
    """Time that moves only when a test moves it."""

    def __init__(self) -> None:
        self.time_ns = 5_000_000_321

    def now_ns(self) -> int:
        return self.time_ns

    def advance(self, duration_ns: int) -> None:
        self.time_ns += duration_ns


class SeizedPlant(Plant):
    """Wheels that nothing turns."""

    def advance(self, drive: float, brake: float, duration_s: float) -> None:
        pass


class SteeredDevice(Device):
    """The mock device, whose counters a test may set."""

    shown: tuple[int, int] | None = None

    def show(self, wheel: int, road: int) -> None:
        """Show these counts from now on, regardless of the rig."""
        self.shown = (two_complement(road), two_complement(wheel))

    def seize(self) -> None:
        """Keep the wheels at rest, for tests in which the outputs need not move them."""
        self.plant = SeizedPlant(self.plant.parameters, 0.0, 0.0)

    def counts(self) -> tuple[int, int]:
        self.catch_up()
        return super().counts() if self.shown is None else self.shown


class FaultyAnswers:
    """The mock's front end. While `deaf` it ignores settings; an answer can arrive late, even later, or twice."""

    def __init__(self, front_end: FrontEnd, request: bytes) -> None:
        self.front_end = front_end
        self.device = front_end.device
        self.rejected = 0
        self.deaf = False
        self.ignored = 0
        self.next_answer = "in time"
        self._request = request
        self._queue: list[bytes] = []
        self._held: list[bytes] = []

    def bulk_out(self, data: bytes | bytearray) -> None:
        if data == self._request:
            self._queue += self._held
            self._held.clear()
        if self.deaf and len(data) > len(self._request):
            self.ignored += 1
        else:
            self.front_end.bulk_out(data)

    def bulk_in(self, length: int) -> bytes:
        arrival, self.next_answer = self.next_answer, "in time"
        answer = self.front_end.bulk_in(length)
        if arrival == "after the next request":
            self._held.append(answer)
        elif answer:
            self._queue += [answer, answer] if arrival == "twice" else [answer]
        return self._queue.pop(0) if self._queue and not arrival.startswith("after") else b""


class FaultyLink(Link):
    """Forwards and keeps every message, and fails on request; `failed` counts the failures."""

    def __init__(self, inner: Link, request: bytes) -> None:
        self.written: list[bytes] = []
        self.closed = False
        self.failed = 0
        self.operations = 0
        self.unplugged = False
        self.before_operation: Callable[[int], None] = lambda _number: None
        self.change_answer: Callable[[bytes], bytes] = bytes
        self.change_next_answer: Callable[[bytes], bytes] | None = None
        self.refuse_next: str | None = None
        self._inner = inner
        self._request = request

    def write(self, data: bytes | bytearray) -> None:
        self._count()
        message = "request" if data == self._request else "send"
        if self.refuse_next == message:
            self.refuse_next = None
            self._fail()
        self.written.append(bytes(data))
        self._inner.write(data)

    def read(self, length: int) -> bytes:
        self._count()
        answer = self._inner.read(length)
        if self.refuse_next == "answer":
            self.refuse_next = None
            self._fail()
        return self._altered(answer)

    def _altered(self, answer: bytes) -> bytes:
        if self.change_next_answer is not None:
            change, self.change_next_answer = self.change_next_answer, None
            self.failed += 1
            answer = change(answer)
        return self.change_answer(answer)

    def close(self) -> None:
        self.closed = True
        self._inner.close()

    def _count(self) -> None:
        number, self.operations = self.operations, self.operations + 1
        if self.unplugged:
            self._fail()
        self.before_operation(number)

    def _fail(self) -> None:
        self.failed += 1
        raise LinkError("the cable is unplugged")


class LateByMany(Link):
    """From `begin` on, every answer arrives a number of exchanges late."""

    def __init__(self, link):
        self._link = link
        self._seen = []
        self._behind = 0

    def begin(self, exchanges):
        """Delay answers by this number of exchanges from now on."""
        self._behind = exchanges

    def write(self, data):
        self._link.write(data)

    def read(self, length):
        self._seen.append(self._link.read(length))
        return self._seen[-1 - self._behind]

    def discard(self, length):
        """Nothing more has arrived."""

    def close(self):
        self._link.close()


def _flipped(offset: int) -> Callable[[bytes], bytes]:
    return lambda answer: answer[:offset] + bytes([answer[offset] ^ 1]) + answer[offset + 1 :]


WAYS_TO_FAIL = (
    "short answer",
    "empty answer",
    "wrong header",
    "wrong echo of the drive",
    "wrong echo of the brake",
    "no answer",
    "command not delivered",
    "request not delivered",
)


class FrameBench:
    """A board that is written to and read in frames, over the in-process link to its mock.

    `settings` are those of `load_config`, `earlier` the outputs that an earlier program left. The attributes of the
    classes below define the board and its frames.
    """

    link_type = FaultyLink
    profile: ClassVar[str]
    real_profile: ClassVar[str]
    """The shipped profile of the real board, without a sign-off."""
    wiring: ClassVar[tuple[str, ...]] = ()
    """Settings that make the profile this bench's."""
    identity: ClassVar[tuple[int, str, str]]
    """The device's header: logic version, name and date."""
    channels: ClassVar[int]
    """PWM channels."""
    both_on: ClassVar[dict[str, int]]
    """Outputs as an earlier program may leave them: drive and brake at full duty."""
    request: ClassVar[bytes]
    messages_of_safe = 1
    """Messages of one attempt to make the board safe on a link that fails."""
    sends_of_safe = 1
    """Before SAFE is read back."""
    untrusted: ClassVar[dict[str, tuple[list[str], tuple[str, ...]]]]
    """Settings with which the board must not be driven, and words of the reason."""
    dates_samples = False
    """Whether the board's clock dates the samples."""
    header_bytes = 8
    """Length of an answer's header, with which a safe image begins."""
    echoes: ClassVar[tuple[int, int]]
    """Bytes of the answer that repeat the widths of drive and brake."""
    front_end_of = staticmethod(front_end_of)

    def __init__(self, *settings: str, earlier: dict[str, int] | None = None, seed: int = 0) -> None:
        own = configured(self.profile, self.wiring).board
        self.config = configured(self.profile, (*self.wiring, *settings))
        self.clock = HandClock()
        board = replace(self.config.board, logic_version=own.logic_version)
        self.device = SteeredDevice(replace(self.config, board=board), self.clock.now_ns, seed)
        front_end = self.front_end_of(self.device)
        if earlier is not None:
            front_end.bulk_out(self.encode(earlier))
        self.front_end = FaultyAnswers(front_end, self.request)
        self.plug_in()

    @staticmethod
    def encode(settings: dict[str, int]) -> bytes:
        """The frame with these settings."""
        raise NotImplementedError

    @staticmethod
    def decode(frame: bytes) -> dict[str, int]:
        """Settings of a frame."""
        raise NotImplementedError

    def plug_in(self) -> None:
        """Connect a new host, with a new link and board object; the device stays."""
        self.link = self.link_type(self._connect(), self.request)
        self.board = board_behind(self.link, self.config, self.clock.now_ns)

    def die(self) -> None:
        """Remove the host without a message to the board."""
        self.link.close()

    def _connect(self) -> Link:
        return InProcessLink(self.front_end)

    @property
    def acts(self) -> list[str]:
        """Accesses to the device so far: "read" and "send", in order."""
        return ["read" if message == self.request else "send" for message in self.link.written]

    @property
    def only_read(self) -> bool:
        """Whether the board was read, and nothing else was written."""
        return set(self.acts) == {"read"}

    @property
    def frames_sent(self) -> list[bytes]:
        """Settings written so far, as they went over the link."""
        return [message for message in self.link.written if message != self.request]

    @property
    def settings_sent(self) -> list[dict[str, int]]:
        """Settings written so far."""
        return [self.decode(frame) for frame in self.frames_sent]

    def settings_in(self, image: bytes) -> dict[str, int]:
        """Settings that a safe image stands for, unnumbered."""
        return self.unnumbered(self.decode(image[self.header_bytes :]))

    def unnumbered(self, settings: dict[str, int]) -> dict[str, int]:
        """Settings without the number that each frame carries."""
        number = f"pwm{self.config.board.numbering_pwm}_prescaler"
        return {name: value for name, value in settings.items() if name != number}

    def read_along(self) -> None:
        """Let another program request an answer that no one fetches."""
        self.front_end.bulk_out(self.request)

    def exchange(self, drive: float = 0.0, brake: float = 0.0, periods: float = 1.0) -> Sample:
        """One exchange, `periods` after the last one."""
        self.clock.advance(round(periods * self.config.period_ns))
        return self.board.exchange(Command(drive, brake))

    def roll(self, exchanges: int = 20) -> Sample:
        """Newest sample after driving at full duty from 60 rad/s on."""
        self.device.plant.wheel_speed = self.device.plant.road_speed = 60.0
        for _ in range(exchanges):
            sample = self.exchange(1.0, 0.0)
        return sample

    def fail_next(self, way: str) -> None:
        """Make the next exchange fail in one of `WAYS_TO_FAIL`."""
        changes = {
            "short answer": lambda answer: answer[:-1],
            "empty answer": lambda _answer: b"",
            "wrong header": _flipped(2),
            "wrong echo of the drive": _flipped(self.echoes[0]),
            "wrong echo of the brake": _flipped(self.echoes[1]),
        }
        refusals = {"no answer": "answer", "command not delivered": "send", "request not delivered": "request"}
        self.link.change_next_answer = changes.get(way)
        self.link.refuse_next = refusals.get(way)

    def strike(self, errors: dict[int, BaseException]) -> list[int]:
        """Raise each error at the link's use of that number, from 0; the list is of those that it has come to."""
        reached: list[int] = []

        def before_operation(number: int) -> None:
            if number in errors:
                reached.append(number)
                raise errors[number]

        self.link.before_operation = before_operation
        return reached

    def unplug(self) -> None:
        """Fail every further transfer."""
        self.link.unplugged = True

    def ignore_commands(self) -> None:
        """From now on the device answers, but ignores commands."""
        self.front_end.deaf = True


def untrusted_profiles(
    identity: tuple[int, str, str], another_logic: tuple[str, ...]
) -> dict[str, tuple[list[str], tuple[str, ...]]]:
    version, name, _ = identity
    return {
        "another logic version": ([*another_logic], (f"0x{version:04X}", "was made for 0x01")),
        "another application name": (
            ['board.application_names=["ABSRIG", "ABSOLD"]'],
            (name, "ABSRIG", "ABSOLD"),
        ),
        "no application name known": (["board.application_names=[]"], (name, "none")),
        "an unsigned profile": (['board.verified_by=""'], ("verified_by",)),
    }


class Usb2Bench(FrameBench):
    """An RT-DAC/USB2."""

    profile, real_profile = "sim_usb2", "usb2_generic_0103"
    identity = (0x0103, "ABSSIM", "20260101")
    header_bytes = 18
    untrusted = untrusted_profiles(identity, ("board.logic_version=0x0111",))
    channels = 8
    both_on: ClassVar = {"pin_mode": 1 << 2 | 1 << 5, "pin_direction": 0, "pwm0_width": 255, "pwm1_width": 255}
    request = rtdac_usb2.READ_REQUEST
    echoes = (44, 50)
    encode = staticmethod(rtdac_usb2.encode_send)
    decode = staticmethod(rtdac_usb2.decode_send)


class ClockedBench(Usb2Bench):
    """An RT-DAC/USB2 with a clock, and with no PWM channel to spare for numbers."""

    wiring = ("board.numbering_pwm=-1", "board.timer=0")
    dates_samples = True
    sends_of_safe = 2  # the first holds the timer at zero

    def unnumbered(self, settings: dict[str, int]) -> dict[str, int]:
        """Settings as they are once the timer runs."""
        return super().unnumbered({**settings, "timer_reset": 0})


class Usb0111Bench(FrameBench):
    """An RT-DAC/USB with logic 0x0111."""

    profile, real_profile = "sim_usb", "usb1_0111"
    identity = (0x0111, "ABSIM", "")
    untrusted = untrusted_profiles(identity, ("board.logic_version=0x0112", "board.numbering_pwm=-1"))
    channels = 4
    both_on: ClassVar = {"pin_mode": 0b11, "pwm0_width": 255, "pwm1_width": 255}
    request = rtdac_usb.READ_REQUEST
    echoes = (24, 29)
    encode = staticmethod(partial(rtdac_usb.encode_send, logic=0x0111))
    decode = staticmethod(partial(rtdac_usb.decode_send, logic=0x0111))


class Usb0112Bench(Usb0111Bench):
    """An RT-DAC/USB with logic 0x0112, which has no PWM channel to spare for numbers."""

    real_profile = "usb1_0112"
    wiring = ("board.logic_version=0x0112", "board.verified_logic=0x0112", "board.numbering_pwm=-1")
    identity = (0x0112, "ABSIM", "")
    untrusted = untrusted_profiles(identity, ("board.logic_version=0x0111",))
    channels = 2
    encode = staticmethod(partial(rtdac_usb.encode_send, logic=0x0112))
    decode = staticmethod(partial(rtdac_usb.decode_send, logic=0x0112))


class PumpedLink(SocketLink):
    """The host's end of a local socket; the board's side runs at once after each write.

    So only the test advances the time; a thread for the board would advance the rig at any moment.
    """

    def __init__(self, path: str, server: SocketServer) -> None:
        self._server = server
        connecting = threading.Thread(target=super().__init__, args=(path,))
        connecting.start()
        while connecting.is_alive():
            server.step()
        connecting.join()

    def write(self, data: bytes | bytearray) -> None:
        super().write(data)
        self._server.step()

    def close(self) -> None:
        super().close()
        while self._server.busy:
            self._server.step()


class PromptLink(FaultyLink):
    """Drops late answers as its inner link does: for a socket, without waiting for them."""

    def discard(self, length: int) -> None:
        self._count()
        self._inner.discard(length)


class SocketBench(Usb2Bench):
    """The same over a local socket, as the processes of a real-time run have it."""

    link_type = PromptLink
    _numbers = count()
    _open: ClassVar[deque[tuple[SocketServer, SocketLink]]] = deque()

    def _connect(self) -> Link:
        if not hasattr(self, "server"):
            self._path = f"\0inteco-abs-{os.getpid()}-{next(self._numbers)}"  # a name without a file
            self.server = SocketServer(self.front_end, self._path)
        link = PumpedLink(self._path, self.server)
        self._open.append((self.server, link))
        self.close_all_but(BENCHES_OF_A_TEST)
        return link

    @classmethod
    def close_all_but(cls, newest: int) -> None:
        """Close all but the newest benches, which the tracebacks of raised errors keep alive."""
        while len(cls._open) > newest:
            server, link = cls._open.popleft()
            server.close()
            SocketLink.close(link)


class Counted:
    """Of a stream: counts the bytes that have arrived."""

    arrived = 0

    def feed(self, data: bytes | bytearray) -> bytes:
        self.arrived += len(data)
        return super().feed(data)


class CountingStream(Counted, ByteStream):
    """The mock's bytes, counted."""


class Pumped:
    """Of a line: the board's side runs at once, as in `PumpedLink`."""

    def write(self, data: bytes | bytearray) -> None:
        wanted = self._stream.arrived + len(data)
        super().write(data)
        while self._stream.arrived < wanted:
            self._server.step()


class PumpedPort(Pumped, SerialLink):
    """The host's end of a pseudo-terminal."""

    def __init__(self, server: PtyServer, stream: CountingStream) -> None:
        self._server = server
        self._stream = stream
        super().__init__(server.name, timeout_s=0.3, quiet_s=0.0)  # nothing is ever on its way


class OnPty:
    """Connects a bench over pyserial and a pseudo-terminal."""

    stream_of: ClassVar[type[Counted]] = CountingStream
    line_of: ClassVar[type[Pumped]] = PumpedPort
    _open: ClassVar[deque[tuple[PtyServer, list[Pumped]]]] = deque()

    def _connect(self) -> Link:
        if not hasattr(self, "server"):
            self.stream = self.stream_of(self.front_end)
            self.server, self._links = PtyServer(self.stream), []
            self._open.append((self.server, self._links))
            self.close_all_but(BENCHES_OF_A_TEST)
        self._links.append(self.line_of(self.server, self.stream))
        return self._links[-1]

    @classmethod
    def close_all_but(cls, newest: int) -> None:
        """As for sockets: a terminal has two descriptors here, and a port five."""
        while len(cls._open) > newest:
            server, links = cls._open.popleft()
            for link in links:
                link.close()
            server.hang_up()


class PtyBench(OnPty, Usb0111Bench):
    """The same over pyserial and a pseudo-terminal."""

    link_type = PromptLink
