"""Benches: a board, the mock device at its far end, and between them a link that fails when a test says so."""

import os
import tempfile
import threading
from collections import deque
from collections.abc import Callable
from itertools import count, dropwhile, takewhile
from pathlib import Path
from typing import ClassVar

import pytest
from pci_bus import LiveRegisters, add_board

from firmware_protocol.register_messages import decode_answer, decode_request, encode_answer, encode_request
from firmware_protocol.registers import Write
from firmware_protocol.rtdac_pci import ENCODER_INDEX, ENCODER_RESET, LOGIC, PWM_INDEX, PWM_WIDTH
from firmware_protocol.rtdac_usb2 import FRAME_BYTES, READ_REQUEST, SEND_COMMAND, decode_send, encode_send
from inteco_abs.boards import (
    InProcessLink,
    Link,
    LinkedRegisters,
    Registers,
    RtdacPci,
    RtdacUsb2,
    SocketLink,
    SysfsRegisters,
)
from inteco_abs.config import load_config
from inteco_abs.errors import LinkError
from inteco_abs.mock_board import Device, PciFace, SocketServer, Usb2Face
from inteco_abs.signals import Command, Sample

_BENCHES_OF_A_TEST = 8
COUNTER_RANGE = 1 << 32
POWERED_PINS = {"pin_mode": 1 << 2 | 1 << 5, "pin_direction": 0}
BOTH_ON = {**POWERED_PINS, "pwm0_width": 255, "pwm1_width": 255}


def two_complement(count: int) -> int:
    return (count + COUNTER_RANGE // 2) % COUNTER_RANGE - COUNTER_RANGE // 2


class HandClock:
    """Time that moves only when a test moves it."""

    def __init__(self) -> None:
        self.time_ns = 5_000_000_321

    def now_ns(self) -> int:
        return self.time_ns

    def advance(self, duration_ns: int) -> None:
        self.time_ns += duration_ns


class SteeredDevice(Device):
    """The mock device, whose counters a test may set."""

    shown: tuple[int, int] | None = None

    def show(self, wheel: int, road: int) -> None:
        self.shown = (two_complement(road), two_complement(wheel))

    def counts(self) -> tuple[int, int]:
        return super().counts() if self.shown is None else self.shown


class MoodyFace:
    """The mock's endpoints. Deaf, they ignore SEND frames; an answer can come late, even later, or twice."""

    def __init__(self, face: Usb2Face) -> None:
        self.face = face
        self.device = face.device
        self.deaf = False
        self.ignored = 0
        self.next_answer = "in time"
        self._queue: list[bytes] = []
        self._held: list[bytes] = []

    def bulk_out(self, data: bytes | bytearray) -> None:
        if bytes(data) == READ_REQUEST:
            self._queue += self._held
            self._held.clear()
        if self.deaf and len(data) == FRAME_BYTES:
            self.ignored += 1
        else:
            self.face.bulk_out(data)

    def bulk_in(self, length: int) -> bytes:
        mood, self.next_answer = self.next_answer, "in time"
        answer = self.face.bulk_in(length)
        if mood == "after the next request":
            self._held.append(answer)
        elif answer:
            self._queue += [answer, answer] if mood == "twice" else [answer]
        return self._queue.pop(0) if self._queue and not mood.startswith("after") else b""


class FaultyLink(Link):
    """Hands every message on, keeps a copy of it, and fails when told to; `failed` counts the failures."""

    def __init__(self, inner: Link) -> None:
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

    def write(self, data: bytes | bytearray) -> None:
        self._count()
        message = "request" if bytes(data) == READ_REQUEST else "send"
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


class Usb2Bench:
    """An RT-DAC/USB2 over the in-process link to the mock.

    `settings` are those of `load_config`, `earlier` the outputs as an earlier program left them.
    """

    link_type = FaultyLink
    identity = (0x0103, "ABSSIM", "20260101")
    real_profile = "usb2_generic_0103"
    pwm_channels = 8
    messages_of_safe = 1
    untrusted: ClassVar = {
        "another logic version": ("board.logic_version=0x0111", ("0x0103", "0x0111")),
        "another application name": (
            'board.application_names=["ABSRIG", "ABSOLD"]',
            ("ABSSIM", "ABSRIG", "ABSOLD"),
        ),
        "no application name known": ("board.application_names=[]", ("ABSSIM", "none")),
        "an unsigned profile": ('board.verified_by=""', ("verified_by",)),
    }

    def __init__(self, *settings: str, earlier: dict[str, int] | None = None, seed: int = 0) -> None:
        self.config = load_config(settings=settings)
        self.clock = HandClock()
        self.device = SteeredDevice(self.config, self.clock.now_ns, seed)
        face = Usb2Face(self.device)
        if earlier is not None:
            face.bulk_out(encode_send(earlier))
        self.face = MoodyFace(face)
        self.plug_in()

    def plug_in(self) -> None:
        """A new host: link and board of its own; the device stays as it is."""
        self.link = self.link_type(self._connect())
        self.board = RtdacUsb2(self.link, self.config.board, self.clock.now_ns, self.config.period_ns)

    def die(self) -> None:
        """The host is gone, without a word to the board."""
        self.link.close()

    def _connect(self) -> Link:
        return InProcessLink(self.face)

    @property
    def only_read(self) -> bool:
        """Whether the board was asked something, and nothing was written to it but that."""
        return set(self.link.written) == {READ_REQUEST}

    @property
    def frames_sent(self) -> list[bytes]:
        """Settings written so far, as they went over the link."""
        return [message for message in self.link.written if message != READ_REQUEST]

    @property
    def settings_sent(self) -> list[dict[str, int]]:
        """Settings written so far."""
        return [decode_send(frame) for frame in self.frames_sent]

    @property
    def read_back(self) -> bool:
        """Whether the board was asked what it does, after the newest settings."""
        return self.link.written[-2:] == [self.frames_sent[-1], READ_REQUEST]

    @property
    def first_written(self) -> bytes:
        """The first that was written, in the form of a SAFE image."""
        return self.plain(self.frames_sent[0])

    @property
    def wrote_first(self) -> bool:
        """Whether nothing was asked before something was written."""
        return self.link.written[0] == self.frames_sent[0]

    @staticmethod
    def plain(image: bytes) -> bytes:
        """A SAFE image without the number that it carries."""
        return image[:82] + b"\0\0" + image[84:]

    @staticmethod
    def widths_in(image: bytes) -> list[int]:
        """Widths that a SAFE image sets."""
        sent = decode_send(image)
        return [sent[f"pwm{channel}_width"] for channel in range(8)]

    def ask(self) -> None:
        """Ask the board past this host, as another has done that did not wait for the answer."""
        self.face.bulk_out(READ_REQUEST)

    def exchange(self, drive: float = 0.0, brake: float = 0.0, periods: float = 1.0) -> Sample:
        """One exchange, `periods` after the last one."""
        self.clock.advance(round(periods * self.config.period_ns))
        return self.board.exchange(Command(drive, brake))

    def spin_up(self, exchanges: int = 100) -> Sample:
        """Newest sample after driving at full duty."""
        for _ in range(exchanges):
            sample = self.exchange(1.0, 0.0)
        return sample

    def fail_next(self, way: str) -> None:
        """Make the next exchange fail in one of `WAYS_TO_FAIL`."""
        changes = {
            "short answer": lambda answer: answer[:-1],
            "empty answer": lambda _answer: b"",
            "wrong header": _flipped(2),
            "wrong echo of the drive": _flipped(44),
            "wrong echo of the brake": _flipped(50),
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
        """Nothing gets through any more."""
        self.link.unplugged = True

    def ignore_commands(self) -> None:
        """From now on the device answers and does not do what it is told."""
        self.face.deaf = True


class PumpedLink(SocketLink):
    """The host's end of a local socket. The board's process does its part at once, whenever there is one to do.

    So time moves for both only when a test moves it; a thread for the board would move the rig whenever it liked.
    """

    def __init__(self, path: str, server: SocketServer) -> None:
        self._server = server
        visitor = threading.Thread(target=super().__init__, args=(path,))
        visitor.start()
        while visitor.is_alive():
            server.step()
        visitor.join()

    def write(self, data: bytes | bytearray) -> None:
        super().write(data)
        self._server.step()

    def close(self) -> None:
        super().close()
        while self._server.busy:
            self._server.step()


class PromptLink(FaultyLink):
    """Drops late answers the way its inner link does, which for a socket is without waiting for them."""

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
            self.server = SocketServer(self.face, self._path)
        link = PumpedLink(self._path, self.server)
        self._open.append((self.server, link))
        self.close_all_but(_BENCHES_OF_A_TEST)
        return link

    @classmethod
    def close_all_but(cls, newest: int) -> None:
        """Errors that tests raise again and again keep the benches that they have met: these close by number."""
        while len(cls._open) > newest:
            server, link = cls._open.popleft()
            server.close()
            SocketLink.close(link)


INDEXES = (PWM_INDEX.offset, ENCODER_INDEX.offset)
ALL_ONES = 0xFFFFFFFF


class MoodyRegisters:
    """The mock's registers. Deaf, they take no setting; the index registers, which reading needs, go on working."""

    def __init__(self, face: PciFace) -> None:
        self.face = face
        self.device = face.device
        self.deaf = False
        self._ignored_widths = 0

    @property
    def ignored(self) -> int:
        """Commands: each is two widths."""
        return self._ignored_widths // 2

    def bulk_out(self, data: bytes | bytearray) -> None:
        number, steps = decode_request(data)
        if self.deaf:
            self._ignored_widths += sum(is_width(step) for step in steps)
            steps = [step for step in steps if not is_setting(step)]
        self.face.bulk_out(encode_request(number, steps))

    def bulk_in(self, length: int) -> bytes:
        return self.face.bulk_in(length)


def is_setting(step: Write | int) -> bool:
    return isinstance(step, Write) and step.offset not in INDEXES


def is_width(step: Write | int) -> bool:
    return isinstance(step, Write) and step.offset == PWM_WIDTH.offset


class RegisterLink(Link):
    """As `FaultyLink`, for accesses to registers.

    What is to go wrong with an answer goes wrong with that which has the logic's version: there is one in an exchange.
    """

    def __init__(self, inner: Link) -> None:
        self.written: list[bytes] = []
        self.closed = False
        self.failed = 0
        self.operations = 0
        self.unplugged = False
        self.before_operation: Callable[[int], None] = lambda _number: None
        self.change_answer: Callable[[bytes], bytes] = bytes
        self.change_next_answer: Callable[[bytes], bytes] | None = None
        self.change_next_value: tuple[tuple[int, int | None], Callable[[int], int]] | None = None
        self.refuse_next: Callable[[Write | int], bool] | None = None
        self._inner = inner
        self._selected: dict[int, int] = {}
        self._asked: list[tuple[int, int | None]] = []

    def write(self, data: bytes | bytearray) -> None:
        self._count()
        _, steps = decode_request(data)
        if self.refuse_next is not None and any(map(self.refuse_next, steps)):
            self.refuse_next = None
            self._fail()
        self.written.append(bytes(data))
        self._asked = []
        for step in steps:
            if isinstance(step, Write):
                self._selected[step.offset] = step.value
            else:
                index = PWM_INDEX.offset if step == PWM_WIDTH.offset else None
                self._asked.append((step, self._selected.get(index)))
        self._inner.write(data)

    def read(self, length: int) -> bytes:
        self._count()
        answer = self._changed(self._inner.read(length))
        if (LOGIC.offset, None) not in self._asked:
            return answer
        if self.change_next_answer is not None:
            change, self.change_next_answer = self.change_next_answer, None
            self.failed += 1
            answer = change(answer)
        return self.change_answer(answer)

    def close(self) -> None:
        self.closed = True
        self._inner.close()

    def _changed(self, answer: bytes) -> bytes:
        which, change = self.change_next_value or (None, int)
        if which not in self._asked:
            return answer
        self.change_next_value = None
        self.failed += 1
        number, values = decode_answer(answer)
        at = self._asked.index(which)
        return encode_answer(number, [*values[:at], change(values[at]), *values[at + 1 :]])

    def _count(self) -> None:
        number, self.operations = self.operations, self.operations + 1
        if self.unplugged:
            self._fail()
        self.before_operation(number)

    def _fail(self) -> None:
        self.failed += 1
        raise LinkError("the cable is unplugged")


class PciBench:
    """An RT-DAC4/PCI, its accesses as messages over the in-process link to the mock."""

    identity = (0x050F, "", "")
    real_profile = "pci_abs_50f"
    pwm_channels = 2
    messages_of_safe = 2
    untrusted: ClassVar = {
        "another logic version": ("board.logic_version=0x0510", ("0x050F", "0x0510")),
        # it tells no name: the nearest are other things that a profile says of the board
        "another application name": ("board.verified_logic=0x0510", ("0x050F", "0x0510")),
        "no application name known": ('board.read_only="not wired yet"', ("not wired yet",)),
        "an unsigned profile": ('board.verified_by=""', ("verified_by",)),
    }

    def __init__(self, *settings: str, earlier: dict[str, int] | None = None, seed: int = 0) -> None:
        self.config = load_config(settings=settings, profile="sim_pci")
        self.clock = HandClock()
        self.device = SteeredDevice(self.config, self.clock.now_ns, seed)
        own = {f"pwm{i}_{name}" for i in range(2) for name in ("mode", "prescaler", "width")} | {ENCODER_RESET.name}
        self.device.write({name: value for name, value in (earlier or {}).items() if name in own})
        self.face = MoodyRegisters(PciFace(self.device))
        self.plug_in()

    def plug_in(self) -> None:
        """A new host: carrier and board of its own; the device stays as it is."""
        self.link = RegisterLink(InProcessLink(self.face))
        self.board = RtdacPci(self._carrier(), self.config.board, self.clock.now_ns, self.config.period_ns)

    def die(self) -> None:
        """The host is gone, without a word to the board."""
        self.link.close()

    def _carrier(self):
        return LinkedRegisters(self.link)

    @property
    def steps(self) -> list[Write | int]:
        """All accesses so far, in order."""
        return [step for message in self.link.written for step in decode_request(message)[1]]

    @property
    def only_read(self) -> bool:
        """Whether the board was asked something, and nothing was written but which channel is asked for."""
        return bool(self.steps) and not any(map(is_setting, self.steps))

    @property
    def frames_sent(self) -> list[bytes]:
        """Messages so far that write settings."""
        return [message for message in self.link.written if any(map(is_setting, decode_request(message)[1]))]

    @property
    def settings_sent(self) -> list[dict[str, int]]:
        """What the host had written, after each width that it wrote."""
        known, sent, channel = {"pwm0_width": 0, "pwm1_width": 0}, [], 0
        for step in self.steps:
            if isinstance(step, Write) and step.offset == PWM_INDEX.offset:
                channel = step.value
            elif is_width(step):
                known[f"pwm{channel}_width"] = step.value
                sent.append(dict(known))
        return sent

    @property
    def read_back(self) -> bool:
        """Whether the board was asked for both widths after the newest settings."""
        steps = self.steps
        newest = max(i for i, step in enumerate(steps) if is_setting(step))
        return [step for step in steps[newest:] if step == PWM_WIDTH.offset] == [PWM_WIDTH.offset] * 2

    @property
    def first_written(self) -> bytes:
        """The first that was written, up to the next question, in the form of a SAFE image."""
        after_questions = dropwhile(lambda step: isinstance(step, int), self.steps)
        writes = takewhile(lambda step: isinstance(step, Write), after_questions)
        return b"".join(number.to_bytes(4, "little") for write in writes for number in write)

    @property
    def wrote_first(self) -> bool:
        """Whether nothing was asked before something was written."""
        return isinstance(self.steps[0], Write)

    @staticmethod
    def plain(image: bytes) -> bytes:
        """A SAFE image carries no number."""
        return image

    @staticmethod
    def widths_in(image: bytes) -> list[int]:
        """Widths that a SAFE image sets, by channel."""
        words = [int.from_bytes(image[at : at + 4], "little") for at in range(0, len(image), 4)]
        assert words[::4] == [PWM_INDEX.offset] * 2
        assert words[2::4] == [PWM_WIDTH.offset] * 2
        return [width for _, width in sorted(zip(words[1::4], words[3::4], strict=True))]

    def ask(self) -> None:
        """Ask the board past this host, as another has done that did not wait for the answer."""
        self.face.bulk_out(encode_request(0, [LOGIC.offset]))

    exchange = Usb2Bench.exchange
    spin_up = Usb2Bench.spin_up
    strike = Usb2Bench.strike
    unplug = Usb2Bench.unplug
    ignore_commands = Usb2Bench.ignore_commands

    def fail_next(self, way: str) -> None:
        """Make the next exchange fail in one of `WAYS_TO_FAIL`, or in what comes nearest to it on a bus."""
        drive, brake, version = (PWM_WIDTH.offset, 0), (PWM_WIDTH.offset, 1), (LOGIC.offset, None)
        answers = {"short answer": lambda answer: answer[:-1], "empty answer": lambda _answer: b""}
        values = {
            "wrong header": (version, lambda value: value ^ 1),
            "no answer": (version, lambda _value: ALL_ONES),
            "wrong echo of the drive": (drive, lambda value: value ^ 1),
            "wrong echo of the brake": (brake, lambda value: value ^ 1),
        }
        refusals = {"command not delivered": is_width, "request not delivered": lambda step: step == LOGIC.offset}
        self.link.change_next_answer = answers.get(way)
        self.link.change_next_value = values.get(way)
        self.link.refuse_next = refusals.get(way)


class StepwiseRegisters(LinkedRegisters):
    """One message for each access, as on a bus."""

    run = Registers.run

    def read(self, offset):
        return LinkedRegisters.run(self, (offset,))[0]

    def write(self, offset, value):
        LinkedRegisters.run(self, (Write(offset, value),))


class StepwisePciBench(PciBench):
    """An RT-DAC4/PCI whose accesses fail one by one."""

    def _carrier(self):
        return StepwiseRegisters(self.link)


class WatchedRegisters(SysfsRegisters):
    """Tells the link behind the double when the host lets go of the board."""

    link: RegisterLink

    def close(self) -> None:
        super().close()
        self.link.close()


class SysfsBench(PciBench):
    """The same as a computer has it, by files under /sys; the double behind them answers from the mock."""

    live = LiveRegisters()
    folder: Path
    _numbers = count()
    _open: ClassVar[deque[SysfsRegisters]] = deque()

    def _carrier(self):
        if not hasattr(self, "root"):
            self.root = self.folder / str(next(self._numbers))
            self._board_folder = add_board(self.root)
        self.live.connect(self._board_folder, self.link)
        self.registers = WatchedRegisters(root=self.root)
        self.registers.link = self.link
        self._open.append(self.registers)
        self.close_all_but(_BENCHES_OF_A_TEST)
        return self.registers

    def die(self) -> None:
        """The kernel closes what the host had open."""
        self.registers.close()

    @classmethod
    def close_all_but(cls, newest: int) -> None:
        """As for `SocketBench`: tests that do not enter the board do not leave it either."""
        while len(cls._open) > newest:
            cls._open.popleft().close()


BENCHES = {
    "rtdac-usb2": Usb2Bench,
    "rtdac-usb2 over a socket": SocketBench,
    "rtdac4-pci": PciBench,
    "rtdac4-pci by sysfs": SysfsBench,
}


@pytest.fixture(scope="session", params=BENCHES.values(), ids=BENCHES)
def new_bench(request):
    """Maker of benches; the contract tests run once for every board in `params`."""
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
        if request.param is SysfsBench:
            SysfsBench.folder = Path(folder)
            patch.setattr(os, "pread", SysfsBench.live.pread)
            patch.setattr(os, "pwrite", SysfsBench.live.pwrite)
        yield request.param
        SysfsBench.close_all_but(0)
    SocketBench.close_all_but(0)


@pytest.fixture(scope="session")
def new_pci_bench():
    return StepwisePciBench


@pytest.fixture(scope="session")
def new_usb2_bench():
    return Usb2Bench


@pytest.fixture(scope="session")
def both_on():
    """Outputs as an earlier program may leave them: drive and brake at full duty."""
    return BOTH_ON


@pytest.fixture(params=WAYS_TO_FAIL)
def way(request):
    return request.param


@pytest.fixture(scope="session")
def ways_to_fail():
    return WAYS_TO_FAIL


class MockBoard:
    """The mock on its own: raw messages in, raw answers out."""

    def __init__(self, *settings: str, seed: int = 0, **device) -> None:
        self.clock = HandClock()
        self.device = Device(load_config(settings=settings), self.clock.now_ns, seed, **device)
        self.face = Usb2Face(self.device)

    def send(self, **settings: int) -> None:
        self.face.bulk_out(encode_send(settings))

    def read(self) -> bytes:
        self.face.bulk_out(READ_REQUEST)
        return self.face.bulk_in(FRAME_BYTES)

    def run(self, duration_s: float) -> None:
        """Let the rig move on, at the rate at which a loop would look at it."""
        end_ns = self.clock.time_ns + round(duration_s * 1e9)
        while self.clock.time_ns < end_ns:
            self.clock.advance(min(500_000, end_ns - self.clock.time_ns))
            self.device.catch_up()


@pytest.fixture(scope="session")
def new_mock():
    return MockBoard


@pytest.fixture
def mock(new_mock):
    return new_mock()


class Wire:
    """Frames written out by hand, without the product's tables."""

    @staticmethod
    def frame(words: dict[int, int], command: int = SEND_COMMAND) -> bytes:
        image = [0] * (FRAME_BYTES // 2)
        image[0] = command
        for index, value in words.items():
            image[index] = value
        return b"".join(word.to_bytes(2, "little") for word in image)

    @staticmethod
    def words(frame: bytes) -> list[int]:
        return [int.from_bytes(frame[at : at + 2], "little") for at in range(0, len(frame), 2)]


@pytest.fixture(scope="session")
def wire():
    return Wire
