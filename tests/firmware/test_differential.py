"""The firmware's open logic beside the mock board's: the same frames, damage and time give the same answers.

Only the challenges differ, which each draws as it likes. Time passes in whole milliseconds, at which both look at a
watchdog without a tick.
"""

from benches import SteeredDevice, configured
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from firmware_protocol import open_board
from firmware_protocol.open_board import (
    ARM,
    CHALLENGE_MASK,
    CLEAR,
    COMMAND,
    CONFIGURE,
    DISARM,
    HELLO,
    IDENTITY,
    MESSAGES,
    OVERHEAD_BYTES,
    QUERY,
    STATUS,
    SYNC,
)
from firmware_protocol.rtdac_usb import FRAME_BYTES
from inteco_abs.boards.families.open.mock import FrameStream, OpenFrontEnd

OTHERS = {"name", "date", "unique_id"}
"""Fields of IDENTITY that name the board."""


class Device(SteeredDevice):
    """Wheels at rest, and inputs that a test sets."""

    levels = 0

    def pins(self):
        return self.levels


class MockBoard:
    """The mock board, as a `HostBoard` is used; its clock is the firmware's."""

    def __init__(self, firmware):
        self.device = Device(configured("sim_open", ()), lambda: 1000 * firmware.clock_us)
        self.device.seize()
        self.device.show(0, 0)
        self.stream = FrameStream(OpenFrontEnd(self.device))

    def asked(self, data):
        return self.stream.feed(data)

    @property
    def widths(self):
        self.device.catch_up()
        return tuple(self.device.settings.get(f"pwm{i}_width", 0) for i in range(2))


def frames(data):
    """Frames of the open logic; a damaged byte may have been the vendor's READ, which the mock does not have."""
    while data:
        size = OVERHEAD_BYTES + data[2] if data[0] == SYNC else FRAME_BYTES
        if data[0] == SYNC:
            yield data[:size]
        data = data[size:]


class Answers:
    """Frames of one board, without what may differ."""

    def __init__(self):
        self.challenge = 0
        self.report = 0

    def of(self, data):
        """Names and fields; in place of a challenge, whether it is another one."""
        found = []
        for frame in frames(data):
            message, values = open_board.decode(frame)
            if message is STATUS:
                before, self.challenge = self.challenge, values["challenge"]
                values["challenge"] = self.challenge != before
            if message is IDENTITY:
                values = {name: value for name, value in values.items() if name not in OTHERS}
            if message.name == "REPORT":
                self.report = values["sequence"]
            found.append((message.name, values))
        return found


rates = st.sampled_from([0, 0, 100, 500, 1000, 2000, 4000, 333, 8000])
configurations = st.fixed_dictionaries(
    {
        "watchdog_ms": st.integers(0, 255) | st.integers(2, 100),
        "tick_hz": rates,
        "stop_pins": st.sampled_from([0, 0, 0, 1, 0x8002]),
        "pwm_mode": st.sampled_from([0, 1, 1, 2]),
        "pwm_prescaler": st.integers(0, 0xFFFF),
    }
)
width = st.sampled_from([0, 1, 255, 256, 4095, 4096]) | st.integers(0, 0xFFFF)
sequence = st.none() | st.integers(0, 255)
"""None: that of the newest REPORT."""
steps = st.one_of(
    st.tuples(st.just("frame"), st.sampled_from([HELLO, DISARM, QUERY, CLEAR]), st.just({}), sequence),
    st.tuples(st.just("frame"), st.just(CONFIGURE), configurations, sequence),
    st.tuples(st.just("frame"), st.just(COMMAND), st.fixed_dictionaries({"width0": width, "width1": width}), sequence),
    st.tuples(st.just("arm"), st.sampled_from([0, 0, 0, 0, 1, 0x8000])),
    st.tuples(st.just("bytes"), st.binary(max_size=12).map(lambda data: bytes(byte & 0x7F for byte in data))),
    st.tuples(st.just("damage"), st.integers(0, 300), st.integers(0, 255)),
    st.tuples(st.just("wait"), st.sampled_from([1, 1, 2, 3, 20, 130])),
    st.tuples(st.just("inputs"), st.sampled_from([0, 1, 0x8002, 0xFFFF])),
    st.tuples(st.just("turn"), st.integers(-(2**31), 2**31 - 1)),
)
WORKING = {"watchdog_ms": 20, "tick_hz": 0, "stop_pins": 0, "pwm_mode": 1, "pwm_prescaler": 2}


class Pair:
    """Both boards, which get the same."""

    def __init__(self, firmware):
        firmware.reset()
        self.boards = firmware, MockBoard(firmware)
        self.answers = Answers(), Answers()
        self._damage = None
        self._counts = [0, 0]

    def deliver(self, data_of):
        """Deliver to each board the bytes made for its own challenge and reports; both must answer the same."""
        found = []
        for board, answers in zip(self.boards, self.answers, strict=True):
            data = data_of(answers)
            if data and self._damage is not None:
                at, byte = self._damage
                data = data[: at % len(data)] + bytes([byte & 0x7F]) + data[at % len(data) + 1 :]
            found.append(answers.of(board.asked(data)))
        self._damage = None if data else self._damage
        assert found[0] == found[1]
        assert self.boards[0].widths == self.boards[1].widths

    def take(self, step):
        kind, *values = step
        firmware, mock = self.boards
        if kind == "frame":
            message, fields, number = values
            self.deliver(lambda answers: message.encode(fields, sequence=answers.report if number is None else number))
        elif kind == "arm":
            # the frames differ: neither may be damaged, or the end of another
            self._damage = None
            self.wait(3)
            self.deliver(lambda answers: ARM.encode({"answer": answers.challenge ^ CHALLENGE_MASK ^ values[0]}))
        elif kind == "bytes":
            self.deliver(lambda _answers: values[0])
        elif kind == "damage":
            self._damage = values
        elif kind == "wait":
            self.wait(values[0])
        elif kind == "inputs":
            firmware.inputs = mock.device.levels = values[0]
        else:
            self.turn(values[0])

    def wait(self, milliseconds):
        for _ in range(milliseconds):
            self.boards[0].advance(1000)
            self.deliver(lambda _answers: b"")

    def turn(self, counts):
        firmware, mock = self.boards
        for channel in range(2):
            firmware.turn(channel, counts)
        self._counts = [count + counts for count in self._counts]
        mock.device.show(*self._counts)


def armed(**configuration):
    """Steps to an armed board."""
    return [
        ("frame", CONFIGURE, WORKING | configuration, 0),
        ("arm", 0),
    ]


COMMANDED = [("frame", COMMAND, {"width0": 9, "width1": 8}, None), ("wait", 1)]


@given(st.lists(steps, max_size=40), st.sampled_from([[], armed(), armed(tick_hz=1000), armed(tick_hz=4000)]))
@example([("wait", 3), *COMMANDED * 5, ("wait", 30)], armed(tick_hz=1000))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_both_answer_the_same(board, taken, first):
    pair = Pair(board)
    for step in [*first, *taken, ("wait", 3), ("frame", QUERY, {}, 1)]:
        pair.take(step)


def test_every_kind_of_answer_occurs_in_both(board):
    pair, seen = Pair(board), set()
    of = Answers.of
    try:
        Answers.of = lambda self, data: (found := of(self, data), seen.update(name for name, _ in found))[0]
        for step in (*armed(tick_hz=1000), ("wait", 2), ("frame", HELLO, {}, 0), ("arm", 1)):
            pair.take(step)
    finally:
        Answers.of = of
    assert seen == {message.name for message in MESSAGES.values() if not message.from_host}
