"""Benches of the RT-DAC4/PCI: as messages to the mock, and by a double of the files under /sys."""

from collections import deque
from collections.abc import Callable
from itertools import count, groupby
from pathlib import Path
from typing import ClassVar

from benches import BENCHES_OF_A_TEST, FaultyLink, FrameBench, HandClock, SteeredDevice, configured
from pci_bus import LiveRegisters, add_board

from firmware_protocol.register_messages import decode_answer, decode_request, encode_answer, encode_request
from firmware_protocol.registers import Write
from firmware_protocol.rtdac_pci import ENCODER_INDEX, ENCODER_RESET, LOGIC, PWM_INDEX, PWM_WIDTH
from inteco_abs.boards import InProcessLink, Link, LinkedRegisters, Registers
from inteco_abs.boards.families.pci import RtdacPci
from inteco_abs.boards.families.pci.mock import PciFrontEnd
from inteco_abs.boards.transports.sysfs import SysfsRegisters

INDEXES = (PWM_INDEX.offset, ENCODER_INDEX.offset)
ALL_ONES = 0xFFFFFFFF


class DeafRegisters:
    """The mock's registers. While `deaf` they ignore settings, but not the index registers, which reading needs."""

    def __init__(self, front_end: PciFrontEnd) -> None:
        self.front_end = front_end
        self.device = front_end.device
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
        self.front_end.bulk_out(encode_request(number, steps))

    def bulk_in(self, length: int) -> bytes:
        return self.front_end.bulk_in(length)


def is_index(step: Write | int) -> bool:
    return isinstance(step, Write) and step.offset in INDEXES


def is_setting(step: Write | int) -> bool:
    return isinstance(step, Write) and step.offset not in INDEXES


def is_width(step: Write | int) -> bool:
    return isinstance(step, Write) and step.offset == PWM_WIDTH.offset


class RegisterLink(FaultyLink):
    """As `FaultyLink`, for accesses to registers.

    A fault in an answer affects the one with the logic's version: each exchange has one.
    """

    def __init__(self, inner: Link) -> None:
        super().__init__(inner, b"")
        self.change_next_value: tuple[tuple[int, int | None], Callable[[int], int]] | None = None
        self.change_after: tuple[int, int | None] | None = None
        """What must have been asked for before that."""
        self.refuse_step: Callable[[Write | int], bool] | None = None
        self._selected: dict[int, int] = {}
        self._asked: list[tuple[int, int | None]] = []

    def write(self, data: bytes | bytearray) -> None:
        self._count()
        _, steps = decode_request(data)
        if self.refuse_step is not None and any(map(self.refuse_step, steps)):
            self.refuse_step = None
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
        return self._altered(answer) if (LOGIC.offset, None) in self._asked else answer

    def _changed(self, answer: bytes) -> bytes:
        which, change = self.change_next_value or (None, int)
        first = 0
        if self.change_after is not None:
            if self.change_after not in self._asked:
                return answer
            first, self.change_after = self._asked.index(self.change_after), None
        if which not in self._asked[first:]:
            return answer
        at = self._asked.index(which, first)
        self.change_next_value = None
        self.failed += 1
        number, values = decode_answer(answer)
        return encode_answer(number, [*values[:at], change(values[at]), *values[at + 1 :]])


class PciBench:
    """An RT-DAC4/PCI, its accesses as messages over the in-process link to the mock."""

    identity = (0x050F, "", "")
    real_profile = "pci_abs_50f"
    channels = 2
    messages_of_safe = 2
    sends_of_safe = 1
    dates_samples = False
    both_on: ClassVar = {"pwm0_width": 255, "pwm1_width": 255}
    untrusted: ClassVar = {
        "another logic version": (["board.logic_version=0x0510"], ("0x050F", "0x0510")),
        # the board reports no name: these cases use the nearest keys of its profile
        "another application name": (["board.verified_logic=0x0510"], ("0x050F", "0x0510")),
        "no application name known": (['board.read_only="not wired yet"'], ("not wired yet",)),
        "an unsigned profile": (['board.verified_by=""'], ("verified_by",)),
    }

    def __init__(self, *settings: str, earlier: dict[str, int] | None = None, seed: int = 0) -> None:
        self.config = configured("sim_pci", settings)
        self.clock = HandClock()
        self.device = SteeredDevice(self.config, self.clock.now_ns, seed)
        own = {f"pwm{i}_{name}" for i in range(2) for name in ("mode", "prescaler", "width")} | {ENCODER_RESET.name}
        self.device.write({name: value for name, value in (earlier or {}).items() if name in own})
        self.front_end = DeafRegisters(PciFrontEnd(self.device))
        self.plug_in()

    def plug_in(self) -> None:
        """Connect a new host, with a new carrier and board object; the device stays."""
        self.link = RegisterLink(InProcessLink(self.front_end))
        self.board = RtdacPci(self._carrier(), self.config.board, self.clock.now_ns, self.config.period_ns)

    def die(self) -> None:
        """Remove the host without a message to the board."""
        self.link.close()

    def _carrier(self):
        return LinkedRegisters(self.link)

    @property
    def steps(self) -> list[Write | int]:
        """All accesses so far, in order."""
        return [step for message in self.link.written for step in decode_request(message)[1]]

    @property
    def acts(self) -> list[str]:
        """What was done to the device so far, "read" and "send" in turn; which channel is asked for is neither."""
        kinds = ["send" if is_setting(step) else "read" for step in self.steps if not is_index(step)]
        return [kind for kind, _ in groupby(kinds)]

    @property
    def only_read(self) -> bool:
        """Whether the board was asked something, and nothing was written but which channel is asked for."""
        return self.acts == ["read"]

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

    @staticmethod
    def settings_in(image: bytes) -> dict[str, int]:
        """Widths that a safe image sets."""
        words = [int.from_bytes(image[at : at + 4], "little") for at in range(0, len(image), 4)]
        assert words[::4] == [PWM_INDEX.offset] * 2
        assert words[2::4] == [PWM_WIDTH.offset] * 2
        return {f"pwm{channel}_width": width for channel, width in zip(words[1::4], words[3::4], strict=True)}

    @staticmethod
    def unnumbered(settings: dict[str, int]) -> dict[str, int]:
        """Accesses to registers carry no number that stays."""
        return settings

    def read_along(self) -> None:
        """Let another program request an answer that no one fetches."""
        self.front_end.bulk_out(encode_request(0, [LOGIC.offset]))

    exchange = FrameBench.exchange
    roll = FrameBench.roll
    strike = FrameBench.strike
    unplug = FrameBench.unplug
    ignore_commands = FrameBench.ignore_commands

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
        self.link.change_after = version if "echo" in way else None  # what is read before it was there before
        self.link.refuse_step = refusals.get(way)


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
    """Closes the link behind the double when the host closes the board."""

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
        self.close_all_but(BENCHES_OF_A_TEST)
        return self.registers

    def die(self) -> None:
        """The kernel closes what the host had open."""
        self.registers.close()

    @classmethod
    def close_all_but(cls, newest: int) -> None:
        """As for `SocketBench`: tests that do not enter the board do not leave it either."""
        while len(cls._open) > newest:
            cls._open.popleft().close()
