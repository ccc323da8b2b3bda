"""What an RT-DAC/USB is sent: the settings as it had them, the wiring's own, two widths and a number."""

import pytest
from benches import Usb0111Bench, Usb0112Bench
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb import logic_of
from inteco_abs.errors import BoardError, ConfigError
from inteco_abs.signals import BoardFlags

pytestmark = pytest.mark.untraced  # other tests reach these lines, too


def changed(frame, other):
    return {at for at in range(150) if frame[at] != other[at]}


@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(data=st.data())
def test_settings_that_the_wiring_does_not_own_stay_as_the_board_has_them(new_usb_bench, data):
    fields = logic_of(new_usb_bench.identity[0]).send.fields
    ranges = {name: st.integers(*field.range(layout)) for name, (field, layout) in fields.items()}
    earlier = data.draw(st.fixed_dictionaries(ranges))
    bench = new_usb_bench(earlier=earlier)
    with bench.board:
        bench.exchange(0.4, 0.6)
        first, second = (bench.unnumbered(sent) for sent in bench.settings_sent)
    owned = {f"pwm{channel}_width": 0 for channel in {0, 1, bench.channels - 1}}
    owned |= {f"pwm{channel}_mode": 0 for channel in range(2)} | {f"pwm{channel}_prescaler": 44 for channel in range(2)}
    owned |= {"pin_mode": earlier["pin_mode"] | 0b11, "encoder_reset": earlier["encoder_reset"] & ~0b11}
    assert first == {**bench.unnumbered(earlier), **owned}
    assert second == {**first, "pwm0_width": 102, "pwm1_width": 153}


def test_the_number_is_the_low_part_of_an_unused_prescaler_and_goes_round():
    bench = Usb0111Bench(earlier={"pwm3_prescaler": 0xABCD})
    with bench.board:
        flags = {bench.exchange(0.5).board_flags for _ in range(300)}
    assert flags == {BoardFlags.NONE}
    assert {sent["pwm3_prescaler"] & ~0x7F for sent in bench.settings_sent} == {0xABCD & ~0x7F}
    numbers = [sent["pwm3_prescaler"] & 0x7F for sent in bench.settings_sent]
    assert numbers == [(1 + i) % 128 for i in range(302)]


def test_in_a_run_only_two_widths_and_the_number_change():
    bench = Usb0111Bench(earlier={"pin_output": 0x155, "da1_output": 77})
    with bench.board:
        for i in range(60):
            bench.exchange(i / 60, 1 - i / 60)
    frames = bench.frames_sent
    assert set().union(*(changed(frames[0], frame) for frame in frames)) == {25, 26, 30, 31, 37}


def test_every_data_byte_has_seven_bits(new_usb_bench):
    bench = new_usb_bench("board.pwm_mode=12-bit", "board.pwm_prescaler=65535")
    with bench.board:
        for _ in range(130):
            bench.exchange(1.0, 1.0)
    assert all(frame[0] == 0x81 and max(frame[1:]) < 0x80 for frame in bench.frames_sent)


def test_an_answer_with_a_flipped_bit_of_header_or_widths_is_a_failed_exchange(new_usb_bench):
    bench = new_usb_bench()
    with bench.board:
        for bit in [*range(8 * 8), *range(24 * 8, 25 * 8 + 4), *range(29 * 8, 30 * 8 + 4)]:
            bench.link.change_next_answer = lambda answer, bit=bit: (
                answer[: bit // 8] + bytes([answer[bit // 8] ^ 1 << bit % 8]) + answer[bit // 8 + 1 :]
            )
            assert bench.exchange(0.4, 0.6).board_flags is BoardFlags.STALE, bit
        assert bench.exchange(0.4, 0.6).board_flags is BoardFlags.NONE


@pytest.mark.parametrize("mood", ["after its time", "twice", "after the next request"])
def test_no_answer_is_mistaken_for_the_one_to_a_later_request(mood):
    bench = Usb0111Bench()
    road_start, wheel_start = bench.device.counts()
    with bench.board:
        bench.roll()
        bench.front_end.next_answer = mood
        for _ in range(20):
            sample = bench.exchange(1.0)
            road, wheel = bench.device.counts()
            if sample.board_flags is BoardFlags.NONE:
                assert (sample.wheel_count, sample.road_count) == (wheel - wheel_start, road - road_start)
    assert sample.board_flags is BoardFlags.NONE


@pytest.mark.parametrize(
    ("changes", "name"), [({8: 0}, "pin_mode"), ({21: 43}, "pwm0_prescaler"), ({28: 1}, "pwm1_mode")]
)
def test_a_board_that_does_not_take_its_settings_is_not_opened(changes, name):
    bench = Usb0111Bench()
    bench.link.change_answer = lambda answer: bytes(changes.get(at, byte) for at, byte in enumerate(answer))
    with pytest.raises(BoardError, match=name):
        bench.board.__enter__()
    assert bench.device.duties == (0.0, 0.0)
    assert bench.link.closed


@pytest.mark.parametrize(
    ("key", "value"), [("drive_pwm", 4), ("numbering_pwm", 5), ("wheel_encoder", 4), ("road_encoder", 11)]
)
def test_a_wiring_without_its_channels_is_a_mistake_in_the_configuration(key, value):
    with pytest.raises(ConfigError, match=f"board.{key}"):
        Usb0111Bench(f"board.{key}={value}")


def test_a_logic_without_timers_cannot_date_samples():
    with pytest.raises(ConfigError, match=r"board\.timer: 0: .* has no such channel"):
        Usb0112Bench("board.timer=0")


def test_a_logic_without_tables_is_a_mistake_in_the_configuration():
    with pytest.raises(ConfigError, match=r"0x0999.*0x0111, 0x0112"):
        Usb0111Bench("board.logic_version=0x0999")


def test_an_answer_that_has_come_too_late_is_not_mistaken_for_the_next_one(new_usb_bench):
    bench = new_usb_bench()
    bench.device.show(1000, 2000)
    with bench.board:
        bench.exchange(0.5)
        bench.front_end.next_answer = "after the deadline"
        assert bench.exchange(0.5).board_flags is BoardFlags.STALE
        bench.device.show(1070, 2030)
        sample = bench.exchange(0.5)
    assert sample.board_flags is BoardFlags.NONE
    assert (sample.wheel_count, sample.road_count) == (70, 30)


def test_only_after_a_failed_exchange_are_late_answers_looked_for(new_usb_bench):
    def operations():
        before = bench.link.operations
        bench.exchange(0.5)
        return bench.link.operations - before

    bench = new_usb_bench()
    with bench.board:
        assert [operations() for _ in range(3)] == [3] * 3  # settings, request, answer
        bench.fail_next("no answer")
        assert [operations(), operations() > 3, operations()] == [3, True, 3]
