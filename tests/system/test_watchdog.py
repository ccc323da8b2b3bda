"""The one-shot in the emergency chain: the motors lose their power even if the computer fails."""

import os
import signal
import time

import pytest
from live import QUICK

from inteco_abs.sessions import TRUTH

pytestmark = [pytest.mark.xdist_group("real time"), pytest.mark.untraced]

WATCHED = (
    "board.watchdog_pin=17",
    "board.watchdog_contact_pin=9",
    "board.timer=0",
    "board.numbering_pwm=-1",
    "board.verified_by=the simulation",
    "board.verified_on=2026-01-01",
    "board.verified_logic=0x0103",
    "simulation.watchdog_pin=17",
    "simulation.watchdog_contact_pin=9",
)
EVERYBODY = ("supervisor", "guardian", "loop", "recorder")
HOLD_NS = 50_000_000
MARGIN_NS = 300_000_000
"""Until the last of four processes is really dead, on a computer under load."""
TURNING = 400


@pytest.mark.parametrize("number", [pytest.param(signal.SIGKILL, marks=pytest.mark.long), signal.SIGSTOP])
def test_with_every_process_of_the_run_gone_the_motors_lose_their_power_in_50_ms(live, number):
    run = live(settings=(*QUICK, *WATCHED))
    truths = run.memory.truth_reader()
    run.until_tick(TURNING)
    pids = [run.pid(role) for role in EVERYBODY]
    killed_ns = time.monotonic_ns()
    for pid in pids:
        os.kill(pid, number)
    time.sleep(0.6)  # the board continues for a second without a host
    rows = TRUTH.array(truths.take())
    on = rows[(rows["drive"] > 0.0) | (rows["brake"] > 0.0)]
    off = rows[rows["time_ns"] > on["time_ns"][-1]]
    assert len(off), "the board was left with an output on"
    # the width stays where it was: it is the power that is gone
    assert 0 < int(off["time_ns"][0]) - killed_ns < HOLD_NS + MARGIN_NS
    assert int(off["time_ns"][0]) - int(on["time_ns"][-1]) > HOLD_NS // 2


@pytest.mark.long
def test_a_whole_stop_feeds_it_and_reports_how_soon_it_opened(live):
    run = live(settings=(*QUICK, *WATCHED))
    code, card, message = run.end()
    assert code in {0, 3}, message  # 3: a period was late, on a computer under load
    assert card["outcome"] == "completed"
    opened_ms = float(run.session().metadata["rig"]["watchdog_opened_ms"])
    assert 49.0 <= opened_ms < 300.0
