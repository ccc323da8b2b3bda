"""Errors of the filters along an ideal stop, offline: the table in docs/facts/rig.md#speed-estimators.

On a rig that the tuning tool does not draw, and two positions of the encoders' lines. Windows have their own test.
"""

import math
import statistics
from itertools import pairwise

import pytest

from inteco_abs.control import EdgeTime, HeldDifference, KalmanFilter, TrackingLoop
from inteco_abs.rig import RigParameters

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

MASK = RigParameters.named("mask")
PERIOD_S, PERIOD_NS = 0.0005, 500_000
COAST_TICKS = 400
STAMP_NS = 25
COUNTS = 2048
OFFSETS = ((0.0, 0.0), (0.37, 0.81))

TABLE = {
    "tracking 100": (lambda: TrackingLoop(COUNTS, 100.0), 2.42, 0.01, 0.0003, 0.0005),
    "tracking 200": (lambda: TrackingLoop(COUNTS, 200.0), 1.19, 0.03, 0.0004, 0.0012),
    "tracking 400": (lambda: TrackingLoop(COUNTS, 400.0), 0.58, 0.09, 0.0011, 0.0035),
    "kalman 3e4": (lambda: KalmanFilter(COUNTS, 3e4), 0.0, 0.06, 0.0008, 0.0029),
    "kalman 3e5": (lambda: KalmanFilter(COUNTS, 3e5), 0.0, 0.11, 0.0014, 0.0048),
    "kalman 3e6": (lambda: KalmanFilter(COUNTS, 3e6), 0.0, 0.22, 0.0025, 0.0081),
}


def track(angles: list[float], offset: float) -> list[tuple[int, int, int]]:
    """Time, count and instant of the newest edge at every sample; a 40 MHz clock stamps it."""
    lines = [angle * COUNTS / (2.0 * math.pi) + offset for angle in angles]
    seen = [(0, math.floor(lines[0]), 0)]
    for tick, (before, now) in enumerate(pairwise(lines), start=1):
        count, since = math.floor(now), seen[-1][2]
        if count != seen[-1][1]:
            since = round((tick - (now - count) / (now - before)) * PERIOD_NS) // STAMP_NS * STAMP_NS
        seen.append((tick * PERIOD_NS, count, since))
    return seen


def errors(stop, speeds: tuple[list[float], list[float]]) -> tuple[float, float, float, float]:
    """Bias and deviation of the road speed, slip rms fast and slow, as the table defines them."""
    fast, slow = [], []
    for row, wheel, road in zip(stop.rows, *speeds, strict=True):
        slip = max(0.0, min(1.0, 1.0 - MASK.r1 * wheel / (MASK.r2 * road))) if road > 0.0 else 0.0
        if row.road_speed > 100.0 and row.time_s > 0.25:
            fast.append((road - row.road_speed, slip - row.slip))
        elif 20.0 < row.road_speed < 60.0:
            slow.append(slip - row.slip)
    return (
        statistics.fmean(speed for speed, _ in fast),
        statistics.pstdev(speed for speed, _ in fast),
        math.sqrt(statistics.fmean(slip**2 for _, slip in fast)),
        math.sqrt(statistics.fmean(slip**2 for slip in slow)),
    )


def both(stop, offsets, speeds_of) -> tuple[list[float], list[float]]:
    """Speeds of wheel and road; the filters have settled on the speed before the stop begins."""
    start = stop.rows[0].road_speed
    wheel = [(tick - COAST_TICKS) * PERIOD_S * start * MASK.r2 / MASK.r1 for tick in range(COAST_TICKS)]
    road = [(tick - COAST_TICKS) * PERIOD_S * start for tick in range(COAST_TICKS)]
    wheel += [row.wheel_angle for row in stop.rows]
    road += [row.road_angle for row in stop.rows]
    return tuple(speeds_of(track(*each))[COAST_TICKS:] for each in zip((wheel, road), offsets, strict=True))


@pytest.mark.parametrize("offsets", OFFSETS)
@pytest.mark.parametrize("name", TABLE)
def test_filters_along_an_ideal_stop_have_the_published_errors(ideal_stop, name, offsets):
    make, bias, std, fast, slow = TABLE[name]

    def speeds(seen) -> list[float]:
        filtered = make()
        return [filtered.update(time_ns, count) for time_ns, count, _ in seen]

    found = errors(ideal_stop(), both(ideal_stop(), offsets, speeds))
    assert found[0] == pytest.approx(bias, abs=0.01 + 0.05 * std)
    assert found[1] == pytest.approx(std, rel=0.3, abs=0.005)  # slow filters have few independent errors in a stop
    assert found[2] == pytest.approx(fast, rel=0.15, abs=0.0001)
    assert found[3] == pytest.approx(slow, rel=0.2, abs=0.0002)


@pytest.mark.parametrize("offsets", OFFSETS)
def test_stamped_edges_along_an_ideal_stop_have_the_published_errors(ideal_stop, offsets):
    def speeds(seen) -> list[float]:
        edges = EdgeTime(COUNTS, 0.0)
        return [edges.update(*each) for each in seen]

    found = errors(ideal_stop(), both(ideal_stop(), offsets, speeds))
    assert found[0] == pytest.approx(0.04, abs=0.01)
    assert found[1] < 0.01
    assert found[2] == pytest.approx(0.0003, abs=0.0001)
    assert found[3] == pytest.approx(0.0003, abs=0.0001)


@pytest.mark.parametrize("offsets", OFFSETS)
def test_held_differences_along_an_ideal_stop_cancel_their_lag_in_the_slip(ideal_stop, offsets):
    def speeds(seen) -> list[float]:
        held = HeldDifference(COUNTS, MASK.r2, 0.010, 0.0005)
        return [held.update(time_ns, count) for time_ns, count, _ in seen]

    found = errors(ideal_stop(), both(ideal_stop(), offsets, speeds))
    assert found[0] == pytest.approx(136.2 * 0.00975 - 0.05 / MASK.r2, abs=0.03)
    assert found[2] < 0.1 * found[0] / 130.0 + 0.0015
