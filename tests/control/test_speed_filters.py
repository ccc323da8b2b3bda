"""Filters with memory on one wheel: what they settle to, how they lag, how much of the counting they let through."""

import math
import statistics

import numpy as np
import pytest

from inteco_abs.config import load_config
from inteco_abs.control import KalmanFilter, MovingAverageSpeed, TrackingLoop, control_check
from inteco_abs.errors import ConfigError

PER_TURN = 2048
PERIOD_S = 0.0005
PERIOD_NS = 500_000
FILTERS = {
    "tracking 100": lambda: TrackingLoop(PER_TURN, 100.0),
    "tracking 200": lambda: TrackingLoop(PER_TURN, 200.0),
    "kalman 3e4": lambda: KalmanFilter(PER_TURN, 3e4),
    "kalman 3e5": lambda: KalmanFilter(PER_TURN, 3e5),
}


def follow(filtered, angle_of, seconds: float) -> list[float]:
    """Speeds that a filter estimates for a wheel at `angle_of(time_s)`, read through its encoder."""
    counts = [math.floor(angle_of(k * PERIOD_S) * PER_TURN / (2.0 * math.pi)) for k in range(round(seconds / PERIOD_S))]
    return [filtered.update(5 + k * PERIOD_NS, count + 10**6) for k, count in enumerate(counts)]


@pytest.mark.parametrize("name", FILTERS)
def test_a_constant_speed_is_found(name):
    speeds = follow(FILTERS[name](), lambda t: 123.4 * t, 2.0)
    assert statistics.fmean(speeds[-1000:]) == pytest.approx(123.4, abs=0.02)


@pytest.mark.parametrize("name", FILTERS)
def test_where_the_counter_stands_does_not_matter(name):
    here, there = FILTERS[name](), FILTERS[name]()
    for k in range(200):
        assert here.update(k * PERIOD_NS, 30 * k) == there.update(10**15 + k * PERIOD_NS, 30 * k - 2**40)


@pytest.mark.parametrize(("wn", "lag"), [(100.0, 2.42), (200.0, 1.19), (400.0, 0.58)])
def test_a_tracking_loop_lags_by_its_damping_over_its_frequency(wn, lag):
    """Figures of docs/facts/rig.md#speed-estimators: at the deceleration of a stop, 136 rad/s2."""
    speeds = follow(TrackingLoop(PER_TURN, wn), lambda t: 200.0 * t - 0.5 * 136.0 * t * t, 1.0)
    late = [speed - (200.0 - 136.0 * k * PERIOD_S) for k, speed in enumerate(speeds)][-500:]
    assert statistics.fmean(late) == pytest.approx((1.8 / wn - 0.5 * PERIOD_S) * 136.0, rel=0.01)
    assert statistics.fmean(late) == pytest.approx(lag, rel=0.02)


@pytest.mark.parametrize(("density", "deviation"), [(3e4, 0.06), (3e5, 0.11), (3e6, 0.22)])
def test_the_kalman_filter_does_not_lag_at_constant_deceleration(density, deviation):
    """Figures of docs/facts/rig.md#speed-estimators: bias 0.00, standard deviations as given."""
    speeds = follow(KalmanFilter(PER_TURN, density), lambda t: 200.0 * t - 0.5 * 136.0 * t * t, 0.75)
    late = [speed - (200.0 - 136.0 * k * PERIOD_S) for k, speed in enumerate(speeds)][-1000:]
    assert statistics.fmean(late) == pytest.approx(0.0, abs=0.03)
    assert statistics.stdev(late) == pytest.approx(deviation, rel=0.35)


def test_the_kalman_filter_is_the_textbooks():
    """Against matrices: predict with the discrete white-jerk model, correct with the angle."""
    density, count = 3e5, 2.0 * math.pi / PER_TURN
    ours = KalmanFilter(PER_TURN, density)
    x, P = np.zeros(3), np.diag([count**2, 25.0, 1e4])
    generator = np.random.default_rng(7)
    time_ns = total = 0
    for k in range(300):
        step_ns = int(generator.integers(1, 4)) * 250_000 if k else 0
        time_ns += step_ns
        total += int(generator.integers(0, 60)) if k else 0
        T = step_ns * 1e-9
        A = np.array([[1.0, T, T * T / 2.0], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
        Q = density * np.array(
            [
                [T**5 / 20.0, T**4 / 8.0, T**3 / 6.0],
                [T**4 / 8.0, T**3 / 3.0, T**2 / 2.0],
                [T**3 / 6.0, T**2 / 2.0, T],
            ]
        )
        x, P = A @ x, A @ P @ A.T + Q
        gain = P[:, 0] / (P[0, 0] + count**2 / 12.0)
        x = x + gain * (total * count - x[0])
        P = P - np.outer(gain, P[0])
        assert ours.update(10 + time_ns, total) == pytest.approx(x[1], rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("name", FILTERS)
def test_filters_let_less_of_the_counting_through_than_the_papers_difference(name):
    def noise(filtered) -> float:
        return statistics.stdev(follow(filtered, lambda t: 77.77 * t, 2.0)[-2000:])

    assert noise(FILTERS[name]()) < 0.1 * noise(MovingAverageSpeed(PER_TURN, 1))


def test_a_tracking_loop_too_quick_for_the_loop_is_refused_with_both_values():
    settings = ["estimator.name=tracking", "estimator.natural_frequency_rad_s=200", "loop.rate_hz=250"]
    with pytest.raises(
        ConfigError, match=r"natural_frequency_rad_s: 200: must be at most a tenth of loop.rate_hz = 250"
    ):
        load_config(settings=settings, checks=[control_check()])
