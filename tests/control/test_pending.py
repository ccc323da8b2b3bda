"""Commands under way to a late and lagging brake: against integrals of the staircase that they are."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.control.estimators.prediction import DelayLine, ahead, arrived

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

PERIOD_S = 0.0005
LONGEST_DEAD_TIME_S = 0.03
SEEDS = st.integers(0, 2**32 - 1)
DEAD_TIMES = st.floats(0.002, LONGEST_DEAD_TIME_S)
WHOLE = st.integers(4, 59).map(lambda ticks: (ticks + 1e-6) * PERIOD_S)  # not a rounding error less than a tick
LAGS = st.floats(0.025, 0.09)
FULL_NM = 9.37
several_rates = pytest.mark.parametrize("period_s", [0.0001, 0.0005, 0.004, 0.02])


class History:
    """Random commands of a loop with missed exchanges, and the staircase that they make."""

    def __init__(self, seed, period_s=PERIOD_S, last=None):
        random = np.random.default_rng(seed)
        torques, ticks = random.uniform(0.0, FULL_NM, 120).tolist(), random.integers(1, 6, 120).tolist()
        torques[-1] = torques[-1] if last is None else last
        self.pending, self.period_s, self.newest = DelayLine(period_s, LONGEST_DEAD_TIME_S), period_s, torques[-1]
        for torque, count in zip(torques, ticks, strict=True):
            self.pending.tell(torque, count)
        held = [before for before, count in zip([0.0, *torques], ticks, strict=False) for _ in range(count)]
        goes_on = [self.newest] * 400
        self._integral = np.concatenate([[0.0], np.cumsum([*[0.0] * 400, *held, *goes_on])])
        self._now = 400 + len(held)

    def mean(self, dead_time, end=0):
        """Mean of the delayed torque over the tick that ends `end` ticks from now."""
        at = self._now + end - dead_time / self.period_s
        until, since = np.interp([at, at - 1.0], np.arange(len(self._integral)), self._integral)
        return float(until - since)


@several_rates
@given(seed=SEEDS, dead_time=DEAD_TIMES)
def test_the_acting_duty_is_the_mean_one_dead_time_earlier(period_s, seed, dead_time):
    written = History(seed, period_s)
    mean, slope = arrived(written.pending.k, written.pending, dead_time, 0)
    assert mean == pytest.approx(written.mean(dead_time), abs=1e-9)
    share = dead_time / period_s % 1.0
    step_s = 0.5 * period_s * min(share, 1.0 - share)  # within which the mean is a straight line
    if step_s > 1e-3 * period_s:
        difference = written.mean(dead_time + step_s) - written.mean(dead_time - step_s)
        assert slope == pytest.approx(difference / (2.0 * step_s), rel=1e-6, abs=1e-6 / period_s)


@given(SEEDS, DEAD_TIMES, st.integers(0, 50))
def test_earlier_arrivals_are_known_as_far_back_as_the_longest_dead_time(seed, dead_time, ago):
    written = History(seed)
    back = min(ago, round(LONGEST_DEAD_TIME_S / PERIOD_S) + 1 - int(dead_time / PERIOD_S))
    assert arrived(written.pending.k, written.pending, dead_time, ago)[0] == pytest.approx(
        written.mean(dead_time, -back), abs=1e-9
    )


def lagged(torque, means, lag_s, release_ratio):
    """Torque at the end of so many ticks with a first-order lag, and its mean over them."""
    total = 0.0
    for settled in means:
        lag = lag_s if settled >= torque else lag_s * release_ratio
        left = math.exp(-PERIOD_S / lag)
        total += settled + (torque - settled) * (1.0 - left) * lag / PERIOD_S
        torque = settled + (torque - settled) * left
    return torque, total / len(means)


@given(SEEDS, st.one_of(DEAD_TIMES, WHOLE), LAGS, st.floats(0.5, 3.0), st.floats(0.0, FULL_NM))
def test_looking_ahead_is_the_lag_of_all_that_is_under_way(seed, dead_time, lag, release_ratio, torque):
    written, ticks = History(seed), int(dead_time / PERIOD_S) + 1
    horizon, then, mean = ahead(written.pending.k, written.pending, torque, dead_time, lag, release_ratio)
    means = [written.mean(dead_time, 1 + tick) for tick in range(ticks)]
    exact_then, exact_mean = lagged(torque, means, lag, release_ratio)
    assert horizon == pytest.approx(ticks * PERIOD_S, rel=1e-12)
    assert then == pytest.approx(exact_then, abs=1e-9)
    assert mean == pytest.approx(exact_mean, abs=1e-3)  # it takes the lag within a tick for a straight line


@given(SEEDS, DEAD_TIMES, LAGS)
def test_the_newest_command_takes_effect_at_the_horizon(seed, dead_time, lag):
    (_, then, _), (_, later, _) = (
        ahead(line.k, line, 1.0, dead_time, lag, 1.0)
        for line in (History(seed, last=each).pending for each in (2.0, 3.0))
    )
    share = 1.0 - dead_time / PERIOD_S % 1.0
    assert later - then == pytest.approx(share * (1.0 - math.exp(-PERIOD_S / lag)), abs=1e-9)


@given(SEEDS, DEAD_TIMES, st.integers(64, 10**6))
def test_a_gap_of_any_length_keeps_the_commands_before_it(seed, dead_time, ticks):
    written = History(seed)
    written.pending.tell(5.0, ticks)
    assert arrived(written.pending.k, written.pending, dead_time, 0) == pytest.approx((written.newest, 0.0), abs=1e-9)
