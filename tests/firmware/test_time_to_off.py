"""From the last frame to outputs off: at most the watchdog's time and one tick, by the board's clock."""

import random
from collections import Counter

import pytest
from open_host import OpenHost

from firmware_protocol.open_board import VENDOR_WATCHDOG_MS, WATCHDOG_MS
from firmware_protocol.rtdac_usb import encode_send

RATES_HZ = [rate for rate in range(100, 4001) if 1_000_000 % rate == 0]
TRIALS = 1000


def trials():
    """Watchdogs, rates and phases: each watchdog time ten times and more."""
    drawn = random.Random(22)
    for trial in range(TRIALS):
        watchdog_ms = WATCHDOG_MS[0] + trial % (WATCHDOG_MS[1] - WATCHDOG_MS[0] + 1)
        tick_hz = drawn.choice([0, 0, *(rate for rate in RATES_HZ if rate * watchdog_ms >= 2000)])
        yield watchdog_ms, tick_hz, drawn.randrange(10_000), drawn.randrange(1, 4096)


def test_a_host_that_falls_silent(board):
    host, times_us = OpenHost(board), Counter()
    for watchdog_ms, tick_hz, phase_us, width in trials():
        board.reset()
        board.clock_us = (2**32 - 20_000 * width) % 2**32  # some trials cross the clock's wrap
        board.advance(phase_us)
        host.armed(watchdog_ms=watchdog_ms, tick_hz=tick_hz)
        period_us = 1_000_000 // tick_hz if tick_hz else 1000
        board.advance(period_us + phase_us % period_us)
        host.command(width, 0, sequence=0)
        last_us = board.clock_us
        board.advance(period_us)
        assert board.widths == (width, 0) or watchdog_ms * 1000 == period_us
        board.advance(1000 * watchdog_ms)
        assert board.widths == (0, 0)
        beyond_us = (board.off_us - last_us) % 2**32 - 1000 * watchdog_ms
        assert 0 <= beyond_us < period_us
        times_us[beyond_us * 4 // period_us] += 1
    assert sorted(times_us) == [0, 1, 2, 3]  # all phases of a tick occurred


@pytest.mark.parametrize("phase_us", range(0, 1000, 100))
def test_a_program_of_the_vendors_board_that_falls_silent(board, phase_us):
    board.advance(phase_us)
    board.write(encode_send({"pin_mode": 3, "pwm1_width": 9}, logic=0x0111))
    last_us = board.clock_us
    board.advance(1000 * VENDOR_WATCHDOG_MS - 1)
    assert board.widths == (0, 9)
    board.advance(1001)
    assert board.widths == (0, 0)
    assert 0 <= board.off_us - last_us - 1000 * VENDOR_WATCHDOG_MS < 1000
