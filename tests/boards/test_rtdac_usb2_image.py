import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb2 import READ_REQUEST, SEND
from inteco_abs.errors import BoardError
from inteco_abs.signals import BoardFlags

WIDTH_BYTES = {44, 45, 50, 51}
NUMBER_BYTES = {82, 83}
SETTINGS = {name: st.integers(*field.range(layout)) for name, (field, layout) in SEND.fields.items()}


def owned_by_default(earlier):
    """What the wiring of the shipped profile decides, and all that it decides."""
    return {
        **{f"pwm{channel}_width": 0 for channel in (0, 1, 7)},
        "pwm0_mode": 0,
        "pwm0_prescaler": 44,
        "pwm1_mode": 0,
        "pwm1_prescaler": 44,
        "pin_mode": earlier["pin_mode"] | 0b100100,
        "pin_direction": earlier["pin_direction"] & ~0b100100,
        "encoder_reset": earlier["encoder_reset"] & ~0b11,
    }


@pytest.mark.untraced
@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(earlier=st.fixed_dictionaries(SETTINGS))
def test_settings_that_the_wiring_does_not_own_stay_as_the_board_has_them(new_usb2_bench, earlier):
    bench = new_usb2_bench(earlier=earlier)
    with bench.board:
        bench.exchange(0.4, 0.6)
        (first, second) = bench.settings_sent
        number = first["pwm7_prescaler"]
        assert number == earlier["pwm7_prescaler"] // 0x8000 * 0x8000 + 1
        assert first == {**earlier, **owned_by_default(earlier), "pwm7_prescaler": number}
        assert second == {**first, "pwm0_width": 102, "pwm1_width": 153, "pwm7_prescaler": number + 1}
        assert bench.device.settings == second
    assert bench.device.settings == {**first, "pwm7_prescaler": number + 2}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pin_output", 0x3FFFFFF),
        ("da0_output", 8192),
        ("da3_output", 0x3FFF),
        ("ad0_gain", 4),
        ("ad15_gain", 2),
        ("encoder_reset", 0b11111100),
        ("pin_mode", 0x3FFFFDB),
        ("pin_direction", 0x3FFFFDB),
        ("pwm2_mode", 1),
        ("pwm6_prescaler", 0x8001),
        ("chronometer3_divider", 0x3FFFFFFF),
        ("timer_mode", 0b11),
    ],
)
def test_each_of_these_is_preserved(new_usb2_bench, name, value):
    bench = new_usb2_bench(earlier={name: value})
    with bench.board:
        bench.exchange(0.5, 0.5)
    extra = {"pin_mode": 0b100100}.get(name, 0)
    assert {sent[name] for sent in bench.settings_sent} == {value | extra}


def test_only_the_wiring_s_own_widths_are_zero_in_the_first_frame_sent(new_usb2_bench):
    bench = new_usb2_bench(earlier={f"pwm{channel}_width": 4095 - channel for channel in range(8)})
    with bench.board:
        first = bench.settings_sent[0]
    assert [first[f"pwm{channel}_width"] for channel in range(8)] == [0, 0, 4093, 4092, 4091, 4090, 4089, 0]


def test_another_wiring_owns_other_channels(new_usb2_bench):
    bench = new_usb2_bench(
        "board.drive_pwm=3",
        "board.brake_pwm=6",
        "board.pwm_pins=[11, 20]",
        "board.pwm_mode=12-bit",
        "board.pwm_prescaler=2",
        "board.road_encoder=4",
        "board.wheel_encoder=7",
        earlier={"encoder_reset": 0xFF, "pin_direction": 0x3FFFFFF, "pwm0_prescaler": 9, "pwm1_mode": 1},
    )
    with bench.board:
        bench.exchange(1.0, 0.0)
        sent = bench.settings_sent[-1]
    expected = {"pwm3_width": 4095, "pwm6_width": 0, "pwm3_mode": 1, "pwm6_mode": 1}
    expected |= {"pwm3_prescaler": 2, "pwm6_prescaler": 2, "pwm0_prescaler": 9, "pwm1_mode": 1, "pwm0_width": 0}
    expected |= {"encoder_reset": 0xFF & ~(1 << 4 | 1 << 7)}
    expected |= {"pin_mode": 1 << 11 | 1 << 20, "pin_direction": 0x3FFFFFF & ~(1 << 11 | 1 << 20)}
    assert {name: sent[name] for name in expected} == expected


@pytest.mark.untraced
@given(commands=st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)), min_size=1, max_size=20))
def test_in_a_run_only_the_two_widths_and_the_number_change_and_it_ends_as_it_began(new_usb2_bench, commands):
    bench = new_usb2_bench(earlier={"pin_output": 0x155, "da1_output": 77})
    with bench.board:
        for drive, brake in commands:
            bench.exchange(drive, brake)
    frames = bench.frames_sent
    assert len(frames) == len(commands) + 2
    assert changed(frames[0], frames[-1]) == NUMBER_BYTES & changed(frames[0], frames[-1])
    for frame in frames:
        assert changed(frames[0], frame) <= WIDTH_BYTES | NUMBER_BYTES
    assert len({frame[82:84] for frame in frames}) == len(frames)


def test_every_exchange_is_one_frame_and_one_request(new_usb2_bench):
    bench = new_usb2_bench()
    with bench.board:
        opened = len(bench.link.written)
        for _ in range(5):
            bench.exchange(0.5)
        assert bench.link.written[opened + 1 :: 2] == [READ_REQUEST] * 5
        assert bench.link.written[opened::2] == bench.frames_sent[-5:]


def changed(frame, other):
    return {at for at in range(504) if frame[at] != other[at]}


def set_bytes(changes):
    def change(answer):
        image = bytearray(answer)
        for at, value in changes.items():
            image[at] = value
        return bytes(image)

    return change


def test_settings_that_cannot_be_restored_are_refused_before_any_write(new_usb2_bench):
    bench = new_usb2_bench()
    bench.link.change_answer = set_bytes({183: 0x80})  # top bit of the gate time of frequency meter 0
    with pytest.raises(BoardError, match="frequency_meter0_timer"):
        bench.board.__enter__()
    assert bench.only_read
    assert bench.link.closed


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({20: 0}, "pin_mode"),
        ({24: 0xFF}, "pin_direction"),
        ({40: 43}, "pwm0_prescaler"),
        ({48: 1}, "pwm1_mode"),
        ({100: 1}, "encoder_reset"),
        ({86: 1}, "pwm7_width"),
    ],
)
def test_a_board_that_does_not_take_its_settings_is_not_opened(new_usb2_bench, changes, name):
    bench = new_usb2_bench()
    bench.link.change_answer = set_bytes(changes)
    with pytest.raises(BoardError, match=name):
        bench.board.__enter__()
    assert all(changed(bench.frames_sent[0], frame) <= NUMBER_BYTES for frame in bench.frames_sent)
    assert bench.device.duties == (0.0, 0.0)
    assert bench.link.closed


def test_channel_0_may_carry_the_number_where_it_drives_nothing(new_usb2_bench):
    bench = new_usb2_bench("board.drive_pwm=2", "board.numbering_pwm=0", earlier={"pwm0_width": 9})
    with bench.board:
        bench.exchange()
        bench.exchange()
    sent = [(settings["pwm0_prescaler"], settings["pwm0_width"]) for settings in bench.settings_sent]
    assert sent == [(1, 0), (2, 0), (3, 0), (4, 0)]


def test_any_timer_may_date_the_samples_and_begins_at_zero(new_usb2_bench):
    bench = new_usb2_bench("board.numbering_pwm=-1", "board.timer=1", earlier={"timer_reset": 0b11, "timer_mode": 0b01})
    with bench.board:
        bench.clock.advance(500_000)
        assert bench.exchange(0.5).board_flags is BoardFlags.NONE
    assert [settings["timer_reset"] for settings in bench.settings_sent[:3]] == [0b11, 0b01, 0b01]
    assert {settings["timer_mode"] for settings in bench.settings_sent} == {0b11}
