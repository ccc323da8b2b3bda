import math
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.config import load_config
from inteco_abs.control import ESTIMATORS, MovingAverageSpeed, TwoWheels, control_check
from inteco_abs.rig import RigParameters
from inteco_abs.signals import BoardFlags, Estimate, Sample

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

MASK = RigParameters.named("mask")
PERIOD_S = 0.0005
WINDOWS = ("euler", "moving-window")
FILTERS = sorted(set(ESTIMATORS) - set(WINDOWS))
LOST_COUNTS = st.integers(-(2**31), 2**31)


def estimator(*settings: str):
    config = load_config(settings=settings, checks=[control_check()])
    return ESTIMATORS[config.estimator.name](config, MASK)


def window(length: int, per_turn: int = 2048) -> TwoWheels:
    return TwoWheels(MovingAverageSpeed(per_turn, length), MovingAverageSpeed(per_turn, length), MASK)


@pytest.mark.parametrize("name", WINDOWS)
@pytest.mark.parametrize("per_turn", [2048, 4096])
def test_a_constant_speed_of_whole_counts_is_exact(name, per_turn):
    estimate = estimator(f"estimator.name={name}", f"encoders.counts_per_turn={per_turn}")
    wheel, road = (counts * 2.0 * math.pi / per_turn / PERIOD_S for counts in (20, 30))
    for tick in range(60):
        seen = estimate.update(Sample(tick, 10**9 + tick * 500_000, PERIOD_S, 20 * tick, 30 * tick))
        if tick:
            assert seen.wheel_speed_rad_s == pytest.approx(wheel, rel=1e-12)
            assert seen.road_speed_rad_s == pytest.approx(road, rel=1e-12)
            assert seen.slip == pytest.approx(1.0 - 20.0 * MASK.r1 / (30.0 * MASK.r2), rel=1e-12)


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_estimates_are_valid_from_sample_2_and_the_observers_from_sample_3(name):
    estimate, first = estimator(f"estimator.name={name}"), 2 if name.endswith("observer") else 1
    seen = [estimate.update(Sample(k, k * 500_000, PERIOD_S, 7 * k, 9 * k)) for k in range(50)]
    assert seen[0] == Estimate(0.0, 0.0, 0.0, valid=False)
    assert [each.valid for each in seen] == [False] * first + [True] * (50 - first)


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
@given(st.lists(st.tuples(st.integers(-1000, 10**7), LOST_COUNTS, LOST_COUNTS), min_size=1, max_size=40))
def test_the_slip_is_in_0_to_1_for_any_counts_and_times(name, track):
    estimate, time_ns = estimator(f"estimator.name={name}"), 0
    for tick, (step_ns, wheel, road) in enumerate(track):
        time_ns += step_ns
        seen = estimate.update(Sample(tick, time_ns, step_ns * 1e-9, wheel, road))
        assert 0.0 <= seen.slip <= 1.0
        assert math.isfinite(seen.wheel_speed_rad_s)
        assert math.isfinite(seen.road_speed_rad_s)


@pytest.mark.parametrize(
    ("wheel_step", "road_step", "slip"),
    [(0, 0, 0.0), (0, 30, 1.0), (-5, 30, 1.0), (40, 30, 0.0), (30, 0, 0.0), (-30, -30, 0.0), (5, -30, 0.0)],
)
def test_regimes_outside_braking_read_as_rolling_or_locked(wheel_step, road_step, slip):
    estimate = window(1)
    estimate.update(Sample(0, 0, PERIOD_S, 0, 0))
    assert estimate.update(Sample(1, 500_000, PERIOD_S, wheel_step, road_step)).slip == slip


def test_the_slip_of_a_slow_road_is_a_slip_all_the_same():
    estimate = window(1)
    estimate.update(Sample(0, 0, PERIOD_S, 0, 0))
    seen = estimate.update(Sample(1, 10**9, 1.0, 50, 100))
    assert seen.road_speed_rad_s == pytest.approx(0.307, abs=0.001)
    assert seen.slip == pytest.approx(1.0 - 0.5 * MASK.r1 / MASK.r2, rel=1e-12)


@pytest.mark.parametrize("name", WINDOWS)
@given(st.lists(st.integers(1, 40), min_size=1, max_size=60))
def test_uneven_sample_times_do_not_change_a_constant_speed(name, steps):
    estimate, time_ns = estimator(f"estimator.name={name}"), 0
    estimate.update(Sample(0, 0, PERIOD_S, 0, 0))
    for tick, step in enumerate(steps, start=1):
        before_ns, time_ns = time_ns, time_ns + step * 100_000
        dt_s = (time_ns - before_ns) * 1e-9
        seen = estimate.update(Sample(tick, time_ns, dt_s, 4 * time_ns // 100_000, 5 * time_ns // 100_000))
        assert seen.road_speed_rad_s == pytest.approx(5 * 2.0 * math.pi / 2048 / 1e-4, rel=1e-12)
        assert seen.slip == pytest.approx(1.0 - 4.0 * MASK.r1 / (5.0 * MASK.r2), rel=1e-12)


def test_euler_is_the_difference_of_the_last_two_samples_only():
    estimate = estimator("estimator.name=euler")
    for tick, road in enumerate([0, 100, 130]):
        seen = estimate.update(Sample(tick, tick * 500_000, PERIOD_S, 0, road))
    assert seen.road_speed_rad_s == pytest.approx(30 * 2.0 * math.pi / 2048 / PERIOD_S, rel=1e-12)


@pytest.mark.parametrize(("window_s", "rate_hz", "length"), [(0.010, 2000, 20), (0.0025, 2000, 5), (0.010, 100, 1)])
def test_the_window_length_is_its_time_in_periods(window_s, rate_hz, length):
    estimate = estimator(f"estimator.window_s={window_s}", f"loop.rate_hz={rate_hz}")
    period_ns = 10**9 // rate_hz
    for tick in range(2 * length + 5):
        road = 1000 if tick > length else 0
        seen = estimate.update(Sample(tick, tick * period_ns, 1.0 / rate_hz, 0, road))
        assert (seen.road_speed_rad_s > 0.0) == (length < tick <= 2 * length)


def test_a_failed_exchange_keeps_the_estimate_finite_and_recovers():
    estimate = window(20)
    for tick in range(40):
        estimate.update(Sample(tick, tick * 500_000, PERIOD_S, 20 * tick, 30 * tick))
    stale = estimate.update(Sample(40, 40 * 500_000, PERIOD_S, 20 * 39, 30 * 39, BoardFlags.STALE))
    good = estimate.update(Sample(41, 41 * 500_000, PERIOD_S, 20 * 41, 30 * 41))
    exact = 30 * 2.0 * math.pi / 2048 / PERIOD_S
    assert 0.9 * exact < stale.road_speed_rad_s < exact
    assert good.road_speed_rad_s == pytest.approx(exact, rel=1e-12)


def offline(stop, length: int, per_turn: int = 2048, wheel_length: int | None = None):
    """Estimates along a stop as (true road speed, true slip, time, road speed error, slip error)."""
    road_window, wheel_window = window(length, per_turn), window(wheel_length or length, per_turn)
    scale, ratio = per_turn / (2.0 * math.pi), MASK.r1 / MASK.r2
    for tick, row in enumerate(stop.rows):
        counts = math.floor(row.wheel_angle * scale), math.floor(row.road_angle * scale)
        sample = Sample(tick, tick * 500_000, PERIOD_S, *counts)
        seen, other = road_window.update(sample), wheel_window.update(sample)
        slip = seen.slip
        if wheel_length:
            slip = 1.0 - ratio * other.wheel_speed_rad_s / max(seen.road_speed_rad_s, 1.0)
        yield row, seen.road_speed_rad_s - row.road_speed, slip - row.slip


def errors(stop, length: int, per_turn: int = 2048, wheel_length: int | None = None) -> dict[str, float]:
    seen = list(offline(stop, length, per_turn, wheel_length))
    fast = [(speed, slip) for row, speed, slip in seen if row.road_speed > 100.0 and row.time_s > 0.25]
    slow = [slip for row, _, slip in seen if 20.0 < row.road_speed < 60.0]
    return {
        "bias": statistics.fmean(speed for speed, _ in fast),
        "std": statistics.pstdev(speed for speed, _ in fast),
        "fast": math.sqrt(statistics.fmean(slip**2 for _, slip in fast)),
        "slow": math.sqrt(statistics.fmean(slip**2 for slip in slow)),
    }


@pytest.mark.parametrize("per_turn", [2048, 4096])
def test_the_noise_of_the_euler_formula_is_one_count_over_root_six(ideal_stop, per_turn):
    count_rad_s = 2.0 * math.pi / (per_turn * PERIOD_S)
    assert errors(ideal_stop(), 1, per_turn)["std"] == pytest.approx(count_rad_s / math.sqrt(6.0), rel=0.04)


@pytest.mark.parametrize(
    ("length", "per_turn", "bias", "std", "fast", "slow"),
    [
        (1, 2048, 0.03, 2.53, 0.0277, 0.0976),
        (1, 4096, 0.03, 1.24, 0.0133, 0.0479),
        (4, 2048, 0.13, 0.63, 0.0069, 0.0240),
        (10, 2048, 0.34, 0.25, 0.0027, 0.0096),
        (20, 2048, 0.68, 0.12, 0.0014, 0.0045),
        (20, 4096, 0.68, 0.06, 0.0007, 0.0023),
    ],
    ids=["euler", "euler 4096", "2 ms", "5 ms", "10 ms", "10 ms 4096"],
)
def test_windows_along_an_ideal_stop_have_the_published_errors(ideal_stop, length, per_turn, bias, std, fast, slow):
    seen = errors(ideal_stop(), length, per_turn)
    assert seen["bias"] == pytest.approx(bias, abs=0.02 + 0.03 * std)
    assert seen["std"] == pytest.approx(std, rel=0.1)
    assert seen["fast"] == pytest.approx(fast, rel=0.1)
    assert seen["slow"] == pytest.approx(slow, rel=0.1)


def test_equal_lag_on_both_wheels_cancels_in_the_slip_and_unequal_lag_does_not(ideal_stop):
    lag_s, deceleration = 0.05, 136.2
    equal, unequal = errors(ideal_stop(), 200, 4096), errors(ideal_stop(), 200, 4096, wheel_length=20)
    assert equal["bias"] == pytest.approx(deceleration * lag_s, rel=0.03)
    assert equal["fast"] < 0.1 * equal["bias"] / 130.0
    assert unequal["fast"] > 10.0 * equal["fast"]
