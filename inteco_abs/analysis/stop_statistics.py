"""Statistics of each metric over the result cards of several stops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean, stdev
from typing import Any, Final, NamedTuple

UNITS: Final = {
    "start_speed_rad_s": "rad/s",
    "reaching_time_s": "s",
    "band_entry_s": "s",
    "stop_time_s": "s",
    "stop_distance_m": "m",
    "slip_rms_true": "1",
    "slip_rms_estimated": "1",
    "lock_fraction": "1",
    "torque_variation_nm_per_s": "N m/s",
    "duty_variation_per_s": "1/s",
}
"""Units of the metrics; a share has the unit 1."""
METRICS: Final = tuple(UNITS)


class MetricStatistics(NamedTuple):
    """Statistics of one metric over the stops that have it."""

    stops: int
    mean: float
    deviation: float | None
    """Standard deviation of a stop, n - 1 in the denominator; None for a single one."""
    smallest: float
    largest: float
    drift: float | None
    """Slope of the least squares line over the number of the stop, per stop; None for fewer than three."""


def metric_statistics(cards: Sequence[Mapping[str, Any]]) -> dict[str, MetricStatistics]:
    """Statistics by metric; metrics that no stop has are left out."""
    found = {}
    for name in METRICS:
        points = [(number, card[name]) for number, card in enumerate(cards) if card.get(name) is not None]
        if points:
            found[name] = _spread(points)
    return found


def _spread(points: Sequence[tuple[int, float]]) -> MetricStatistics:
    values = [value for _, value in points]
    deviation = stdev(values) if len(values) > 1 else None
    return MetricStatistics(len(values), fmean(values), deviation, min(values), max(values), _slope(points))


def _slope(points: Sequence[tuple[int, float]]) -> float | None:
    if len(points) < 3:
        return None
    middle, mean = fmean(number for number, _ in points), fmean(value for _, value in points)
    moments = sum((number - middle) * (value - mean) for number, value in points)
    return moments / sum((number - middle) ** 2 for number, _ in points)
