"""Bench of the open board, over the in-process link to its mock."""

from typing import ClassVar

from benches import FaultyLink, FrameBench, HandClock, SteeredDevice, configured

from firmware_protocol.open_board import COMMAND, DISARM, HELLO, IDENTITY, QUERY, REPORT, STATUS, decode
from inteco_abs.boards import InProcessLink, Link, board_behind
from inteco_abs.mock_board import front_end_of

QUESTIONS = {HELLO.kind, QUERY.kind}


class DeafFrames:
    """The mock's front end. While `deaf` it answers questions, and ignores all else."""

    def __init__(self, front_end) -> None:
        self.front_end = front_end
        self.device = front_end.device
        self.deaf = False
        self.ignored = 0

    def bulk_out(self, data: bytes | bytearray) -> None:
        if self.deaf and data[1] not in QUESTIONS:
            self.ignored += 1
        else:
            self.front_end.bulk_out(data)

    def bulk_in(self, length: int) -> bytes:
        return self.front_end.bulk_in(length)


class FrameLink(FaultyLink):
    """As `FaultyLink`. A fault in an answer affects no answer to DISARM: the one to the question behind it counts."""

    def __init__(self, inner) -> None:
        super().__init__(inner, b"")
        self.refuse_any = False
        self._disarms: set[int] = set()

    def write(self, data: bytes | bytearray) -> None:
        if self.refuse_any:
            self.refuse_any = False
            self._count()
            self._fail()
        if data[1] == DISARM.kind:
            self._disarms.add(data[3])
        else:
            self._disarms.discard(data[3])
        super().write(data)

    def _altered(self, answer: bytes) -> bytes:
        return answer if answer[1] == STATUS.kind and answer[3] in self._disarms else super()._altered(answer)


def untrusted_profiles(identity: tuple[int, str, str]) -> dict[str, tuple[list[str], tuple[str, ...]]]:
    """Settings with which the board must not be driven, and words of the reason."""
    _, name, _ = identity
    return {
        "another logic version": (["board.logic_version=0x0B02"], ("0x0B01", "was made for 0x0B02")),
        "another application name": (['board.application_names=["OPENABS"]'], (name, "OPENABS")),
        "no application name known": (["board.application_names=[]"], (name, "none")),
        "an unsigned profile": (['board.verified_by=""'], ("verified_by",)),
    }


class OpenBench:
    """An open board."""

    identity = (0x0B01, "OPENSIM", "20260101")
    real_profile = "open_board"
    profile = "sim_open"
    channels = 2
    messages_of_safe = 1
    sends_of_safe = 1
    dates_samples = True
    front_end_of = staticmethod(front_end_of)
    both_on: ClassVar = {"pwm0_width": 255, "pwm1_width": 255}
    untrusted: ClassVar = untrusted_profiles(identity)

    def __init__(self, *settings: str, earlier: dict[str, int] | None = None, seed: int = 0) -> None:
        self.config = configured(self.profile, settings)
        self.clock = HandClock()
        own = configured(self.profile, ())
        self.device = SteeredDevice(own, self.clock.now_ns, seed)
        self.device.logic_version = own.board.logic_version
        front_end = self.front_end_of(self.device)
        self.front_end = DeafFrames(front_end)
        known = {"pwm0_width", "pwm1_width", "encoder_reset"}
        self.leave(front_end, {name: value for name, value in (earlier or {}).items() if name in known})
        self.plug_in()

    def leave(self, _front_end, settings: dict[str, int]) -> None:
        """Leave the board as an earlier program did."""
        self.device.write(settings)

    def plug_in(self) -> None:
        """Connect a new host, with a new link and board object; the device stays."""
        self.link = FrameLink(self._connect())
        self.board = board_behind(self.link, self.config, self.clock.now_ns)

    def _connect(self) -> Link:
        return InProcessLink(self.front_end)

    @property
    def acts(self) -> list[str]:
        """What was done to the device so far, in order."""
        return ["read" if message[1] in QUESTIONS else "send" for message in self.link.written]

    @property
    def only_read(self) -> bool:
        """Whether the board was asked, and nothing else was written."""
        return set(self.acts) == {"read"}

    @property
    def settings_sent(self) -> list[dict[str, int]]:
        """Widths written so far."""
        return [widths for message in self.link.written if (widths := self._widths(message)) is not None]

    @staticmethod
    def _widths(message: bytes) -> dict[str, int] | None:
        kind, values = decode(message)
        if kind is DISARM:
            return {"pwm0_width": 0, "pwm1_width": 0}
        return {f"pwm{i}_width": values[f"width{i}"] for i in range(2)} if kind is COMMAND else None

    def settings_in(self, image: bytes) -> dict[str, int]:
        """Widths that a safe image sets."""
        found = self._widths(image)
        assert found is not None
        return found

    @staticmethod
    def unnumbered(settings: dict[str, int]) -> dict[str, int]:
        """Settings carry no number."""
        return settings

    def read_along(self) -> None:
        """Let another program ask for an answer that no one fetches."""
        self.front_end.bulk_out(QUERY.encode(sequence=200))

    die = FrameBench.die
    exchange = FrameBench.exchange
    roll = FrameBench.roll
    strike = FrameBench.strike
    unplug = FrameBench.unplug
    ignore_commands = FrameBench.ignore_commands

    def fail_next(self, way: str) -> None:
        """Make the next exchange fail in one of `WAYS_TO_FAIL`; command and request are one message."""
        names = {"wrong header": "tick", "wrong echo of the drive": "width0", "wrong echo of the brake": "width1"}
        answers = {"short answer": lambda answer: answer[:-1], "empty answer": lambda _answer: b""}
        if way in names:
            answers[way] = lambda answer: _otherwise(answer, names[way])
        self.link.change_next_answer = answers.get(way)
        self.link.refuse_next = "answer" if way == "no answer" else None
        self.link.refuse_any = "not delivered" in way


def _otherwise(answer: bytes, name: str) -> bytes:
    """An undamaged answer with another value; its sequence for `tick`."""
    message, values = decode(answer)
    sequence = values.pop("sequence")
    if name == "tick":
        return IDENTITY.encode(sequence=sequence) if message is REPORT else b""
    if name not in values:
        return b""
    return message.encode({**values, name: values[name] ^ 1}, sequence=sequence)
