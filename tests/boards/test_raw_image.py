"""Every byte that a board is sent, in each known logic: its own first image, and only what the wiring means changed."""

import struct

import pytest
from benches import FaultyLink, HandClock, configured
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from firmware_protocol import rtdac_usb, rtdac_usb2
from inteco_abs.boards import InProcessLink, board_behind
from inteco_abs.boards.families.usb.mock import UsbFrontEnd
from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.boards.first_write import Remark
from inteco_abs.errors import ConfigError
from inteco_abs.mock_board import Device
from inteco_abs.signals import BoardFlags, Command

CLOCK = 20_000_000
POWER_INTERFACE = ("board.pwm_pins=[19, 23]", "board.pwm_functions=[]", "board.numbering_pwm=-1")
FREE_TIMER = ("board.constants.timer_mode=1", "board.constants.timer_reset=0")
THERMAL = ("board.constants.pwm_thermal_flags=3",)
WIRINGS = {
    "generic": (),
    "servo": ("board.frame_map=servo", *POWER_INTERFACE, *FREE_TIMER),
    "tras": ("board.frame_map=tras", *POWER_INTERFACE, *FREE_TIMER, *THERMAL),
    "rpend": ("board.frame_map=rpend", *POWER_INTERFACE, *FREE_TIMER, *THERMAL),
    "abs": ("board.frame_map=abs", *POWER_INTERFACE, *FREE_TIMER, *THERMAL),
}
MEASURED = {
    "generic": (*range(53, 69), *range(72, 76), *range(106, 139), *range(164, 196), *range(204, 220)),
    "servo": (*range(53, 61), *range(72, 76), *range(204, 220)),
    "tras": (*range(53, 57), 72, 73, *range(204, 220)),
    "rpend": (*range(53, 57), 72, 73, *range(204, 220)),
    "abs": (*range(53, 59), 72, 73),
}
"""Words with a name that the board alone writes, besides the header and the levels of the pins: they go out as zero."""
GATES = (*range(90, 106, 2), *range(148, 164, 2))
"""First words of the gate times of the generic logic, two each."""


def words(frame):
    return list(struct.unpack(f"<{len(frame) // 2}H", frame))


def frame(values):
    return struct.pack(f"<{len(values)}H", *values)


class Bench:
    """A board with the frames of one logic, whose mock has powered up with the words `image`."""

    def __init__(self, logic, image, *more, wiring=None):
        config = configured("sim_usb2", (*(WIRINGS[logic] if wiring is None else wiring), *more))
        self.clock = HandClock()
        self.device = Device(config, self.clock.now_ns)
        self.front_end = Usb2FrontEnd(self.device, frame(image))
        self.config = config
        self.period_ns = config.period_ns
        self.plug_in()

    def plug_in(self):
        self.link = FaultyLink(InProcessLink(self.front_end), rtdac_usb2.READ_REQUEST)
        self.board = board_behind(self.link, self.config, self.clock.now_ns)

    def exchange(self, drive, brake):
        self.clock.advance(self.period_ns)
        return self.board.exchange(Command(drive, brake))

    @property
    def sent(self):
        return [words(one) for one in self.link.written if one != rtdac_usb2.READ_REQUEST]


def powered_up(logic, data=None):
    """A READ image with something in each word; of what the SEND frame has no room for, only what fits."""
    read = rtdac_usb2.LOGICS[logic].read
    image = data or [(7919 * word + 12345) % 0x8000 for word in range(252)]
    for at in GATES:
        image[at + 1] &= 0x3FFF  # a gate time of 30 bits is all that can be sent
    for word in range(9):  # the header is the mock's own
        image[word] = 0
    for i in range(8):
        image[140 + i] &= 0x0FFF if logic == "generic" else 0x7FFF
    assert read.check(frame(image))
    return image


def expected(logic, image, drive=0, brake=0, number=None):
    """By hand, word by word, what the driver sends to a board that reads like `image`."""
    sent = [word & 0x7FFF for word in image]
    sent[0] = 0x8F0F
    for word in (*range(1, 9), *MEASURED[logic]):
        sent[word] = 0
    sent[50] &= ~0b11
    set_pins(logic, image, sent)
    set_pwm(logic, image, sent, (drive, brake), number)
    if logic == "generic":
        set_generic(image, sent)
    else:
        timers = 0b11 if logic == "servo" else 0b1  # the constants name the field, and so both timers of the servo
        sent[70], sent[71] = sent[70] & ~timers, sent[71] & ~timers | 1
    if logic in {"tras", "rpend", "abs"}:
        sent[31] |= 3
    if logic != "abs":
        for at in range(204, 220):  # what a converter has measured, and between that and a command's bit
            sent[at] = image[at] & 0x6000
    return sent


def set_pins(logic, image, sent):
    """26 bits of modes, directions and outputs, cut as 16 + 10 by the board and 15 + 11 by the host."""
    generic = logic == "generic"
    cleared = 0b100100 if generic else 1 << 19 | 1 << 23
    sent[16], sent[17] = 0, image[17] & 0x7C00  # the levels of 26 pins, and what is above them
    for word, change in (
        (10, lambda pins: pins | 0b100100 if generic else pins),
        (12, lambda pins: pins & ~cleared),
        (14, lambda pins: pins),
    ):
        if word == 10 and logic in {"tras", "rpend"}:
            continue  # they have no pin mode: these are words without a name
        pins = change(image[word] | (image[word + 1] & 0x3FF) << 16)
        sent[word], sent[word + 1] = pins & 0x7FFF, pins >> 15 | image[word + 1] & 0x7800


def set_pwm(logic, image, sent, widths, number):
    """The mode moves from bit 0 to bit 1, above the prescaler's last bit; two channels are the wiring's."""
    for i in range({"generic": 8, "servo": 4}.get(logic, 2)):
        at = 20 + 3 * i
        prescaler, mode, width = image[at], image[at + 1] & 1, image[at + 2] & 0x7FFF
        if i < len(widths):
            prescaler, mode, width = 44, 0, widths[i]
        if number is not None and i == 7:
            prescaler, width = prescaler & 0x8000 | number, width & 0x7000
        sent[at] = prescaler & 0x7FFF
        sent[at + 1] = prescaler >> 15 | mode << 1 | image[at + 1] & 0x7FFC
        sent[at + 2] = width


def set_generic(image, sent):
    """Gate times of meters, and what else only the generic logic has."""
    for at in GATES:
        value = image[at] | image[at + 1] << 16
        sent[at], sent[at + 1] = value & 0x7FFF, value >> 15
    sent[106] = image[106] & 0x7F00
    for at in range(140, 148):
        sent[at] = image[at] & 0x1FFF


@pytest.mark.parametrize("logic", WIRINGS)
def test_every_byte_sent_is_the_first_images_except_the_wirings_own(logic):
    image = powered_up(logic)
    bench = Bench(logic, image)
    numbered = logic == "generic"
    with bench.board:
        assert bench.sent == [expected(logic, image, number=1 if numbered else None)]
        assert bench.exchange(1.0, 0.4).board_flags is BoardFlags.NONE
        assert bench.exchange(0.2, 1.0).board_flags is BoardFlags.NONE
        bench.board.make_safe()
    pairs = ((0, 0), (255, 102), (51, 255), (0, 0), (0, 0))
    assert bench.sent == [
        expected(logic, image, *pair, number=i if numbered else None) for i, pair in enumerate(pairs, 1)
    ]


@pytest.mark.parametrize("logic", WIRINGS)
def test_the_rescue_after_a_death_sends_the_same_image_with_both_widths_zero(logic):
    image = powered_up(logic)
    bench = Bench(logic, image)
    bench.board.__enter__()
    bench.exchange(1.0, 0.5)
    safe = bench.board.safe_image
    bench.link.close()
    bench.plug_in()
    bench.board.rescue(safe)
    numbered = logic == "generic"
    assert bench.sent == [expected(logic, image, number=1 if numbered else None)]
    assert bench.device.duties == (0.0, 0.0)


@pytest.mark.parametrize("logic", ["tras", "rpend", "abs"])
def test_thermal_protection_is_on_in_every_frame_even_if_the_board_had_it_off(logic):
    image = [0] * 252
    bench = Bench(logic, image)
    with bench.board:
        bench.exchange(0.5, 0.5)
    assert [sent[31] for sent in bench.sent] == [3, 3, 3]
    assert bench.device.settings["pwm_thermal_flags"] == 3


@pytest.mark.parametrize("logic", ["servo", "tras", "rpend", "abs"])
def test_timer_0_runs_as_a_clock_of_20_mhz_once_the_board_is_open(logic):
    bench = Bench(logic, [0] * 252)
    with bench.board:
        first = bench.board.survey(["timer0_value"]).values["timer0_value"]
        bench.clock.advance(1_000_000)
        assert bench.board.survey(["timer0_value"]).values["timer0_value"] - first == CLOCK // 1000


@pytest.mark.untraced
@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large], max_examples=25)
@given(
    logic=st.sampled_from(sorted(WIRINGS)),
    seed=st.randoms(use_true_random=False),
    drive=st.integers(0, 255),
    brake=st.integers(0, 255),
)
def test_unknown_words_and_unused_channels_are_written_back_unchanged(logic, seed, drive, brake):
    image = powered_up(logic, [seed.randrange(0x10000) for _ in range(252)])
    bench = Bench(logic, image)
    with bench.board:
        bench.exchange(drive / 255, brake / 255)
    numbers = (1, 2, 3) if logic == "generic" else (None,) * 3
    pairs = ((0, 0), (drive, brake), (0, 0))
    for sent, pair, number in zip(bench.sent, pairs, numbers, strict=True):
        assert sent == expected(logic, image, *pair, number=number)


@pytest.mark.parametrize(("profile", "version"), [("sim_usb", 0x0111), ("sim_usb", 0x0112)])
def test_the_first_generation_keeps_its_unknown_bytes_too(profile, version):
    own = (
        ()
        if version == 0x0111
        else (f"board.logic_version={version}", f"board.verified_logic={version}", "board.numbering_pwm=-1")
    )
    config = configured(profile, own)
    logic = rtdac_usb.logic_of(version)
    image = bytearray(at * 37 % 128 for at in range(150))
    image[:8] = logic.read.encode({})[:8]
    clock = HandClock()
    front_end = UsbFrontEnd(Device(config, clock.now_ns), bytes(image))
    link = FaultyLink(InProcessLink(front_end), rtdac_usb.READ_REQUEST)
    with board_behind(link, config, clock.now_ns) as board:
        board.exchange(Command(0.5, 0.5))
    unnamed = [at for at in range(149) if not logic.read.named_bits[at] | logic.send.named_bits[at + 1]]
    frames = [one for one in link.written if one != rtdac_usb.READ_REQUEST]
    assert len(unnamed) > (5 if version == 0x0111 else 0)
    assert len(frames) == 3
    assert all([one[at + 1] for at in unnamed] == [image[at] for at in unnamed] for one in frames)


def test_one_bit_of_the_image_holds_the_sample_timer_at_zero():
    image = powered_up("abs")
    timed = [one for one in WIRINGS["abs"] if "timer" not in one]
    bench = Bench("abs", image, "board.timer=0", wiring=timed)
    with bench.board:
        assert bench.exchange(1.0, 0.4).board_flags is BoardFlags.NONE
    held = [word | (at == 70) for at, word in enumerate(expected("abs", image))]
    assert bench.sent == [
        held,
        expected("abs", image),
        expected("abs", image, 255, 102),
        held,
        expected("abs", image),
    ]


class TestConstants:
    def test_a_pin_is_an_output_of_that_level_and_the_others_stay(self):
        image = [0] * 252
        image[12], image[13], image[14] = 0xFFFF, 0x3FF, 0x0001
        bench = Bench("abs", image, "board.constants.pin21=1", "board.constants.pin25=0")
        with bench.board:
            sent = bench.device.settings
        assert sent["pin_output"] == 1 | 1 << 21
        assert sent["pin_direction"] == 0x3FFFFFF & ~(1 << 19 | 1 << 21 | 1 << 23 | 1 << 25)

    def test_a_whole_word_goes_out_in_every_frame(self):
        bench = Bench("abs", [0] * 252, "board.constants.w60=17")
        with bench.board:
            bench.exchange(0.5, 0.5)
        assert [sent[60] for sent in bench.sent] == [17] * 3

    def test_a_field_that_is_not_echoed_keeps_the_board_closed(self):
        bench = Bench("abs", [0] * 252)
        bench.link.change_answer = lambda answer: answer[:62] + b"\0\0" + answer[64:]
        with pytest.raises(Exception, match="pwm_thermal_flags = 0, not 3"):
            bench.board.__enter__()
        assert bench.device.duties == (0.0, 0.0)

    @pytest.mark.parametrize(
        ("setting", "words_of_it"),
        [
            ("thermal=3", "neither a field, a pin nor a word"),
            ("pwm_thermal_flagz=3", "did you mean pwm_thermal_flags"),
            ("pwm0_width=3", "the rest of"),
            ("pin_mode=3", "the rest of"),
            ("pwm_thermal_flags=4", "0..3"),
            ("w22=3", "carries pwm0_width"),
            ("w31=3", "carries pwm_thermal_flags"),
            ("w0=3", "w1 to w251"),
            ("w252=3", "w1 to w251"),
            ("w60=32768", "0..32767"),
            ("b60=3", "neither a field"),
            ("pin21=2", "0 or 1"),
            ("pin26=0", "neither a field"),
        ],
    )
    def test_what_cannot_be_is_refused_by_its_key(self, setting, words_of_it):
        key = setting.partition("=")[0]
        with pytest.raises(ConfigError, match=words_of_it) as refusal:
            Bench("abs", [0] * 252, f"board.constants.{setting}")
        assert f"board.constants.{key}" in str(refusal.value)

    def test_a_pin_carries_a_pwm_or_a_level(self):
        with pytest.raises(ConfigError, match=r"board\.constants: 19: already in board\.pwm_pins"):
            Bench("abs", [0] * 252, "board.constants.pin19=1")


class TestFirstWrite:
    def test_it_is_exactly_what_is_then_written(self):
        image = powered_up("abs")
        bench = Bench("abs", image)
        with bench.board.reading() as board:
            planned = board.first_write()
        assert not bench.sent
        bench.plug_in()
        with bench.board:
            sent = bench.sent[0]
        by_word = {int(one.place[1:]): one for one in planned}
        assert {word: one.planned for word, one in by_word.items()} == {word: sent[word] for word in by_word}
        changed = {word for word, one in by_word.items() if one.now != one.planned}
        assert {20, 22, 23, 25, 31} <= changed
        assert {one.remark for word, one in by_word.items() if word not in changed} == {Remark.UNKNOWN}

    def test_a_board_as_an_earlier_run_has_left_it_has_nothing_to_be_changed(self):
        bench = Bench("tras", [0] * 252)
        with bench.board:
            pass
        bench.plug_in()
        with bench.board.reading() as board:
            assert board.first_write() == []

    def test_a_pwm_that_is_not_the_wiring_s_own_is_reported_as_running(self):
        image = [0] * 252
        image[34] = 100
        bench = Bench("generic", image)
        with bench.board.reading() as board:
            remarks = {one.place: (one.names, one.remark) for one in board.first_write()}
        assert remarks["w34"] == (("pwm4_width",), Remark.RUNS)
        assert remarks["w41"] == (("pwm7_prescaler",), Remark.NUMBER)

    def test_bits_that_a_frame_cannot_carry_are_reported(self):
        image = [0] * 252
        image[60] = 0x8001
        bench = Bench("abs", image)
        with bench.board.reading() as board:
            (planned,) = [one for one in board.first_write() if one.place == "w60"]
        assert (planned.planned, planned.remark) == (1, Remark.CUT)


def test_the_rows_say_place_values_and_names():
    bench = Bench("abs", [0] * 252)
    with bench.board.reading() as board:
        rows = [str(one) for one in board.first_write()]
    assert "  w31  0x0000 -> 0x0003    pwm_thermal_flags" in rows
