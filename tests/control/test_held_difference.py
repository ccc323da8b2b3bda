"""What the vendor's demonstrations feed back: difference, hold, dead zone, and their slip."""

import math
import statistics

import pytest

from inteco_abs.config import load_config
from inteco_abs.control import ESTIMATORS, HeldDifference, control_check
from inteco_abs.rig import RigParameters
from inteco_abs.signals import Sample

MASK = RigParameters.named("mask")
PER_TURN = 2048
PERIOD_S, PERIOD_NS = 0.0005, 500_000
T0_S = 0.010
ZONE_RAD_S = 0.05 / MASK.r2


def road(hold_s: float = T0_S) -> HeldDifference:
    return HeldDifference(PER_TURN, MASK.r2, hold_s, PERIOD_S)


def follow(filtered, angle_of, ticks: int, start_ns: int = 7) -> list[float]:
    counts = [math.floor(angle_of(k * PERIOD_S) * PER_TURN / (2.0 * math.pi)) for k in range(ticks)]
    return [filtered.update(start_ns + k * PERIOD_NS, count) for k, count in enumerate(counts)]


def estimator(*settings: str):
    config = load_config(settings=["estimator.name=difference", *settings], checks=[control_check()])
    return ESTIMATORS["difference"](config, MASK)


def test_the_output_changes_every_10_ms_and_is_held_between():
    speeds = follow(road(), lambda t: 200.0 * t - 68.0 * t * t, 2000)
    changes = [k for k in range(1, 2000) if speeds[k] != speeds[k - 1]]
    assert changes == list(range(20, 2000, 20))


def test_samples_that_jitter_do_not_put_a_refreshment_off_to_the_next():
    times_ns = [k * PERIOD_NS + (-1) ** (k // 20) * 40_000 for k in range(2000)]
    held = road()
    speeds = [held.update(10**9 + time_ns, k * k) for k, time_ns in enumerate(times_ns)]
    changes = [k for k in range(1, 2000) if speeds[k] != speeds[k - 1]]
    assert changes == list(range(20, 2000, 20))


@pytest.mark.parametrize("speed", [150.0, 20.0, -20.0])
def test_beyond_the_dead_zone_the_speed_is_less_by_the_zone(speed):
    late = follow(road(), lambda t: speed * t, 4000)[1000:]
    assert statistics.fmean(late) == pytest.approx(speed - math.copysign(ZONE_RAD_S, speed), abs=0.02)


def test_in_the_dead_zone_the_wheel_stands():
    assert set(follow(road(), lambda t: 0.15 * t, 4000)) == {0.0}


def test_mean_lag_in_a_stop_is_t0_and_holding_makes_most_of_the_noise():
    speeds = follow(road(), lambda t: 200.0 * t - 68.0 * t * t, 2000)
    errors = [speed - (200.0 - 136.0 * k * PERIOD_S) for k, speed in enumerate(speeds)][100:]
    assert statistics.fmean(errors) == pytest.approx(136.0 * (T0_S - 0.5 * PERIOD_S) - ZONE_RAD_S, abs=0.02)
    noise = math.hypot(2.0 * math.pi / PER_TURN / T0_S / math.sqrt(6.0), 136.0 * T0_S / math.sqrt(12.0))
    assert statistics.stdev(errors) == pytest.approx(noise, rel=0.05)


def test_the_slip_has_dead_zone_and_offset_as_in_the_demonstration():
    estimate = estimator()
    for tick in range(50):
        seen = estimate.update(Sample(tick, tick * PERIOD_NS, PERIOD_S, 4 * tick, 6 * tick))
    rad_s = 2.0 * math.pi / PER_TURN / PERIOD_S
    v1, v2 = 4 * rad_s * MASK.r1 - 0.05, 6 * rad_s * MASK.r2 - 0.05
    assert seen.wheel_speed_rad_s == pytest.approx(v1 / MASK.r1, rel=1e-12)
    assert seen.road_speed_rad_s == pytest.approx(v2 / MASK.r2, rel=1e-12)
    assert seen.slip == pytest.approx((v2 - v1) / (v2 + 0.01), rel=1e-12)


def test_a_locked_wheel_reads_less_than_1_by_the_offset():
    estimate = estimator()
    for tick in range(50):
        seen = estimate.update(Sample(tick, tick * PERIOD_NS, PERIOD_S, 0, tick))
    v2 = seen.road_speed_rad_s * MASK.r2
    assert seen.slip == pytest.approx(v2 / (v2 + 0.01), rel=1e-12)
    assert seen.slip < 0.99


def test_both_wheels_are_refreshed_by_the_same_sample():
    estimate = estimator()
    before, together = None, 0
    for tick in range(400):
        now = estimate.update(Sample(tick, tick * PERIOD_NS, PERIOD_S, tick * tick // 3, tick * tick))
        if before is not None and now.road_speed_rad_s != before.road_speed_rad_s:
            assert now.wheel_speed_rad_s != before.wheel_speed_rad_s
            together += 1
        before = now
    assert together == 19


def test_the_smith_demonstrations_5_ms_can_be_set():
    estimate = estimator("estimator.window_s=0.005")
    speeds = [estimate.update(Sample(k, k * PERIOD_NS, PERIOD_S, k * k, k * k)).road_speed_rad_s for k in range(100)]
    assert [k for k in range(1, 100) if speeds[k] != speeds[k - 1]] == list(range(10, 100, 10))


def test_a_loop_slower_than_t0_refreshes_at_every_sample():
    held = HeldDifference(PER_TURN, MASK.r2, 0.010, 0.020)
    speeds = [held.update(k * 20_000_000, k * k * 50) for k in range(10)]
    assert len(set(speeds)) == 10
