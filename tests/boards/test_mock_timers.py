import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb2 import decode_read


def timers(mock):
    values = decode_read(mock.read())
    return values["timer0_value"], values["timer1_value"]


def started(mock, mode=0b11):
    mock.send(timer_mode=mode, timer_reset=0b11)
    mock.send(timer_mode=mode, timer_reset=0)
    return mock


@pytest.mark.parametrize(("elapsed_ns", "ticks"), [(0, 0), (49, 0), (50, 1), (500_000, 10_000), (10**9, 20_000_000)])
def test_a_timer_counts_at_20_mhz(mock, elapsed_ns, ticks):
    started(mock)
    mock.clock.advance(elapsed_ns)
    assert timers(mock) == (ticks, ticks)


@pytest.mark.untraced
@given(elapsed_ns=st.integers(0, 10**13))
def test_a_timer_wraps_at_32_bits(new_mock, elapsed_ns):
    mock = started(new_mock())
    mock.clock.advance(elapsed_ns)
    assert timers(mock) == (elapsed_ns // 50 % 2**32,) * 2


def test_a_reset_bit_holds_its_timer_at_zero(mock):
    started(mock)
    mock.clock.advance(5_000)
    mock.send(timer_mode=0b11, timer_reset=0b01)
    mock.clock.advance(5_000)
    assert timers(mock) == (0, 200)


def test_a_released_timer_counts_from_zero(mock):
    started(mock)
    mock.clock.advance(5_000)
    mock.send(timer_mode=0b11, timer_reset=0b01)
    mock.clock.advance(5_000)
    mock.send(timer_mode=0b11, timer_reset=0)
    mock.clock.advance(1_000)
    assert timers(mock) == (20, 220)


def test_in_counter_mode_nothing_is_counted(mock):
    started(mock, mode=0b10)
    mock.clock.advance(5_000)
    assert timers(mock) == (0, 100)


def test_after_power_up_timers_stand_still(mock):
    mock.clock.advance(5_000)
    assert timers(mock) == (0, 0)


def test_timers_continue_while_only_the_duties_change(mock):
    started(mock)
    for width in range(1, 6):
        mock.send(timer_mode=0b11, pwm0_width=width)
        mock.clock.advance(1_000)
        assert timers(mock) == (20 * width, 20 * width)
