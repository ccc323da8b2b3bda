"""How even the ticks of the Pico's image are, by its own clock, while its wheels turn and its host answers."""

import time
from itertools import pairwise

import pytest
from emulated import emulated_board
from test_lets_go import Line, armed, say

from firmware_protocol.open_board import COMMAND, REPORT

pytestmark = [pytest.mark.long, pytest.mark.xdist_group("real time")]

TICKS = 4000
WATCHDOG_MS = 100
FULL = 4095
MOST_US = 20


@pytest.mark.parametrize("tick_hz", [500, 1000])
def test_the_samples_instants_are_those_of_the_timer(tick_hz, tmp_path, capsys):
    instants, arrivals = [], []
    with emulated_board(tmp_path, "rp2040") as board:
        line = Line(board.link)
        report = armed(line, WATCHDOG_MS, tick_hz)
        first = report
        while len(instants) < TICKS:
            instants.append((report["tick"], report["clock"]))
            arrivals.append(time.monotonic())
            line.send(COMMAND, report["tick"] & 0xFF, width0=FULL)
            if (report := line.receive(REPORT, within_s=1.0)) is None:
                pytest.fail("no report for a second")
    period_us = 1_000_000 // tick_hz
    late = [clock - first["clock"] - (tick - first["tick"]) * period_us for tick, clock in instants]
    turned = report["count0"] - first["count0"]
    assert turned > 1000
    assert max(late) - min(late) <= MOST_US
    gaps = sorted(1e6 * (later - earlier) for earlier, later in pairwise(arrivals))
    say(capsys, f"tick of {tick_hz} Hz, {TICKS} samples, {turned} counts: {min(late)} to {max(late)} us from even;")
    say(capsys, f"  between two arrivals at the host {gaps[len(gaps) // 2]:.0f} us, at most {gaps[-1]:.0f} us")
