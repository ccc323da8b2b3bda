import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb2 import READ_REQUEST, encode_read
from inteco_abs.errors import LinkError
from inteco_abs.signals import BoardFlags

HEADER_BITS = range(18 * 8)
WIDTH_BITS = [*range(44 * 8, 46 * 8), *range(50 * 8, 52 * 8)]


def with_bit_flipped(answer, bit):
    return answer[: bit // 8] + bytes([answer[bit // 8] ^ 1 << bit % 8]) + answer[bit // 8 + 1 :]


def next_sample(bench, change):
    bench.link.change_next_answer = change
    sample = bench.exchange(0.4, 0.6)
    assert bench.link.failed
    return sample


def test_an_answer_of_any_wrong_length_is_a_failed_exchange(new_usb2_bench):
    bench = new_usb2_bench()
    with bench.board:
        for length in [*range(504), 505, 506, 1008]:
            sample = next_sample(bench, lambda answer, length=length: (answer * 2)[:length])
            assert sample.board_flags is BoardFlags.STALE, length
        assert bench.board.link_errors == bench.link.failed == 507


def test_an_answer_with_any_bit_of_header_or_widths_flipped_is_a_failed_exchange(new_usb2_bench):
    bench = new_usb2_bench()
    with bench.board:
        for bit in (*HEADER_BITS, *WIDTH_BITS):
            sample = next_sample(bench, lambda answer, bit=bit: with_bit_flipped(answer, bit))
            assert sample.board_flags is BoardFlags.STALE, bit
        assert bench.exchange(0.4, 0.6).board_flags is BoardFlags.NONE


def test_the_answer_before_last_is_a_failed_exchange_when_the_command_has_changed(new_usb2_bench):
    bench, kept = new_usb2_bench(), []
    with bench.board:
        bench.link.change_answer = lambda answer: kept.append(answer) or answer
        bench.exchange(1.0, 0.0)
        bench.link.change_answer = lambda _answer: kept[0]
        assert bench.exchange(0.0, 0.6).board_flags is BoardFlags.STALE
        bench.link.change_answer = bytes
        assert bench.exchange(0.0, 0.6).board_flags is BoardFlags.NONE


@pytest.mark.parametrize("mood", ["after its time"])
def test_no_answer_is_mistaken_for_a_newer_one_when_it_comes(new_usb2_bench, mood):
    bench = new_usb2_bench()
    road_start, wheel_start = bench.device.counts()
    with bench.board:
        bench.roll()
        bench.front_end.next_answer = mood
        wrong = []
        for _ in range(20):
            sample = bench.exchange(1.0)
            road, wheel = bench.device.counts()
            now = (wheel - wheel_start, road - road_start)
            if sample.board_flags is BoardFlags.NONE and (sample.wheel_count, sample.road_count) != now:
                wrong.append(sample.tick)
    assert not wrong


def test_answer_too_late_for_safe_is_not_taken_for_the_next_exchanges(new_usb2_bench):
    bench = new_usb2_bench()
    road_start, wheel_start = bench.device.counts()
    with bench.board as board:
        bench.roll()
        bench.front_end.next_answer = "after its time"
        board.make_safe()
        sample = bench.exchange(0.0, 0.0, periods=50)
        road, wheel = bench.device.counts()
    assert sample.board_flags is BoardFlags.NONE
    assert (sample.wheel_count, sample.road_count) == (wheel - wheel_start, road - road_start)


@given(junk=st.binary(max_size=520))
def test_a_board_that_answers_anything_at_all_is_identified_or_a_link_error(new_usb2_bench, junk):
    bench = new_usb2_bench()
    bench.link.change_answer = lambda _answer: junk
    try:
        identity = bench.board.identify()
    except LinkError:
        assert len(junk) != 504
    else:
        assert len(junk) == 504
        assert identity.read_only_because
    assert set(bench.link.written) == {READ_REQUEST}


@given(version=st.integers(0, 0xFFFF), name=st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=6))
@example(version=0x0103, name="ABSSIM")
@example(version=0x0103, name="abssim")
@example(version=0x0103, name="ABSSI")
@example(version=0x0103, name="")
@example(version=0x0301, name="ABSSIM")
@example(version=0x0111, name="ABSSIM")
def test_only_exactly_the_logic_that_the_profile_knows_may_be_driven(new_usb2_bench, version, name):
    bench = new_usb2_bench()
    bench.link.change_answer = lambda answer: (
        encode_read({"logic_version": version, "application_name": name})[:8] + answer[8:]
    )
    with bench.board as board:
        trusted = not board.identity.read_only_because
    assert trusted == ((version, name) == (0x0103, "ABSSIM"))
    assert trusted != bench.only_read


def test_a_header_that_changes_in_a_run_is_a_failed_exchange_until_it_is_back(new_usb2_bench):
    bench = new_usb2_bench()
    with bench.board:
        bench.link.change_answer = lambda answer: b"\x11\x01" + answer[2:]
        assert bench.exchange(0.4, 0.6).board_flags is BoardFlags.STALE
        assert "header" in str(bench.board.last_error)
        bench.link.change_answer = bytes
        assert bench.exchange(0.4, 0.6).board_flags is BoardFlags.NONE


@pytest.mark.parametrize(("rate_hz", "timeout_s"), [(500.0, 0.004), (2000.0, 0.001), (4000.0, 0.001)])
def test_a_tick_waits_two_periods_for_its_answer_and_at_least_1_ms(new_usb2_bench, rate_hz, timeout_s):
    bench = new_usb2_bench(f"loop.rate_hz={rate_hz}")
    with bench.board:
        patient_s = bench.link.timeout_s
        bench.exchange(0.4, 0.6)
        assert bench.link.timeout_s == pytest.approx(timeout_s)
        bench.board.hurried = False
        bench.exchange(0.4, 0.6)
        assert bench.link.timeout_s == patient_s > timeout_s
        bench.board.hurried = True
        bench.exchange(0.4, 0.6)
    assert bench.link.timeout_s == patient_s, "leaving waits as long as opening"


@pytest.mark.parametrize(
    "settings", [(), ("board.timer=0",), ("board.numbering_pins=[7]",), ("board.numbering_pwm=-1",)], ids=str
)
def test_only_a_numbered_board_after_a_good_exchange_has_its_exchanges_compiled(new_usb2_bench, settings):
    bench = new_usb2_bench(*settings)
    assert bench.board.exchange_parts() is None
    with bench.board as board:
        bench.exchange(0.5)
        assert (board.exchange_parts() is None) == bool(settings)
        bench.fail_next("no answer")
        bench.exchange(0.5)
        assert board.exchange_parts() is None


def test_the_board_names_the_engine_of_its_link(new_usb2_bench):
    bench = new_usb2_bench()
    bench.board.engine = "usbdevfs"
    assert bench.board.engine == bench.board._link.engine == "usbdevfs"
