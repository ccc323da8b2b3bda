"""What card and log say of a law that falls back, on ticks that are made up so that the answers are known."""

import numpy as np
import pytest

from inteco_abs.config import load_config
from inteco_abs.sessions import TICK, TRUTH, StateEvents, result_card
from inteco_abs.signals import Phase

PERIOD_S = 0.0005
BAND = 0.03
KEYS = ("swing_share", "fall_backs", "fall_back_from_s", "fall_back_s")
SWINGS = ((100, -0.2), (100, 0.04), (100, -0.06), (100, 0.035), (1400, 0.01), (100, -0.01))
"""Numbers of ticks, and the law's slip error in them."""


def settings(*more):
    return load_config(settings=["controller.name=predictive-reaching", "estimator.name=observer", *more])


def stops(*courses, reference=0.2, speed=100.0):
    """Ticks of one stop after the other; a law's errors differ from tick to tick."""
    errors = [np.repeat([value for _, value in course], [count for count, _ in course]) for course in courses]
    ticks = np.zeros(10 + sum(11 + len(error) for error in errors), TICK.dtype)
    ticks["phase"] = Phase.IDLE
    first = 10
    for error in errors:
        braking = ticks[first : first + 1 + len(error)]
        braking["phase"], braking["slip_reference"], braking["road_speed_rad_s"] = Phase.BRAKING, reference, speed
        braking["switching"][1:] = error + 1e-9 * np.arange(len(error))
        first += len(braking) + 10
    ticks["tick"], ticks["dt_s"] = np.arange(len(ticks)), PERIOD_S
    ticks["time_ns"] = np.arange(len(ticks)) * round(PERIOD_S * 1e9)
    return ticks


def card_of(ticks, config):
    card = result_card(config, ticks, np.zeros(0, TRUTH.dtype))
    return [card[key] for key in KEYS]


def test_card_reports_swing_and_fall_backs():
    swing, falls, first_s, lasted_s = card_of(stops(SWINGS), settings())
    assert swing == pytest.approx(0.04 / BAND, rel=1e-4)
    assert falls == 3
    assert first_s == pytest.approx(101 * PERIOD_S)
    assert lasted_s == pytest.approx((300 + 3 * 401 - 1) * PERIOD_S, abs=3 * PERIOD_S)


def test_a_slip_that_stays_on_one_side_of_the_band_has_a_margin_and_no_fall():
    swing, falls, first_s, lasted_s = card_of(stops(((50, -0.2), (50, 0.015), (50, -0.02))), settings())
    assert swing == pytest.approx(0.5, rel=1e-4)
    assert (falls, first_s, lasted_s) == (0, None, 0)


def test_what_lies_below_10_rad_per_s_is_not_judged():
    assert card_of(stops(SWINGS, speed=9.0), settings())[:2] == [0.0, 0]


def test_a_reference_that_moves_is_no_swing():
    count = 1 + sum(number for number, _ in SWINGS)
    moving = stops(SWINGS, reference=0.2 + 1e-4 * np.arange(count))
    assert card_of(moving, settings()) == [0.0, 0, None, 0]
    stepped = stops(SWINGS, reference=np.where(np.arange(count) <= 150, 0.2, 0.3))
    assert card_of(stepped, settings())[:2] == [pytest.approx(0.04 / BAND, rel=1e-4), 3]


@pytest.mark.parametrize("other", ["controller.name=pi", "controller.gains.swing_band=0"])
def test_a_law_that_does_not_fall_back_has_none_of_it(other):
    ticks, config = stops(SWINGS), settings(other)
    assert card_of(ticks, config) == [None] * 4
    assert [index for index, _ in StateEvents(0.0).among(ticks)] == [0, 10, len(ticks) - 10]


@pytest.mark.parametrize("block", [1, 7, 450, 10_000])
def test_the_log_has_each_step_at_its_tick_and_each_stop_begins_with_all_gains(block):
    ticks, events, found = stops(SWINGS[:3], SWINGS), StateEvents(BAND), {}
    for first in range(0, len(ticks), block):
        found |= {first + index: entries for index, entries in events.among(ticks[first : first + block])}
    second = 10 + 301 + 10
    places = [index for index in found if index and ticks["phase"][index - 1] == ticks["phase"][index]]
    expected = [111, 211, *(second + at for at in (101, 201, 301, 801, 1202, 1603))]
    assert places[:5] == expected[:5]
    assert places[5:] == pytest.approx(expected[5:], abs=3)  # the rounding of 0.2 s in periods
    texts = [text for entries in found.values() for level, text in entries if "gains" in text]
    down = [f"the slip swings: the law falls back to 1/{share} of its gains" for share in (2, 4, 8)]
    back = [
        f"the slip is calm: the law takes a step back up, to {share} gains"
        for share in ("1/4 of its", "1/2 of its", "its full")
    ]
    assert texts == [*down[:2], *down, *back]
