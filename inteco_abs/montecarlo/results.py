"""Results of the stops of many rigs: a row of metrics each, and their distribution."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from inteco_abs.rig_rows import Rows
from inteco_abs.sessions import FALL_BACKS, Array

METRICS: Final = (
    "reaching_time_s",
    "band_entry_s",
    "stop_time_s",
    "stop_distance_m",
    "slip_rms_true",
    "slip_rms_low_speed_true",
    "slip_rms_above_60",
    "slip_rms_fixed_true",
    "slip_rms_estimated",
    "overshoot",
    "lock_fraction",
    "torque_variation_nm_per_s",
    "duty_variation_per_s",
    *FALL_BACKS,
)
"""Metrics of a stop as in `sessions.metrics`, all of the true slip and speed but for `slip_rms_estimated` and
those of falling back, which are of the law's own slip."""
METRICS_ROW: Final = np.dtype([(name, np.float64) for name in METRICS])


_RESAMPLES: Final = 20_000
_CONFIDENCE: Final = 0.9


class Trace(NamedTuple):
    """True values and decisions of one stop, an entry per tick from the first of braking."""

    time_s: Array
    """Since braking began."""
    wheel_speed_rad_s: Array
    road_speed_rad_s: Array
    slip: Array
    slip_estimated: Array
    brake_torque_nm: Array
    road_angle_rad: Array
    """Since braking began."""
    brake: Array
    """Duty decided at each tick; it acts `command_delay_ticks` of the rig later."""


class Distribution(NamedTuple):
    """Distribution of one metric over stops; a stop without that metric counts as infinite."""

    median: float
    p99: float
    """Interpolated linearly between two stops."""
    largest: float
    worst: int
    """Index of the first stop with the largest value."""
    median_interval: tuple[float, float]
    """Interval of the median by bootstrap, with a confidence of 90 %."""
    p99_interval: tuple[float, float]
    """The same of the 99th percentile; of less than some 300 stops it ends at the largest value."""


@dataclass(frozen=True, slots=True)
class ResultSummary:
    """Metrics of many stops together."""

    stops: int
    failed: int
    """Stops that ended with an error."""
    locked: float
    """Share of stops with a locked wheel above 10 rad/s."""
    never_entered: float
    """Share of stops whose slip was never within 0.01 of the reference."""
    spreads: Mapping[str, Distribution]
    """By metric."""
    fell_back: float | None
    """Share of stops in which the law fell back; None of laws that do not."""


@dataclass(frozen=True, slots=True)
class StopResults:
    """One stop of each of many rigs, in their order."""

    metrics: Rows
    """A row of type METRICS_ROW for each stop; NaN for metrics that it does not have."""
    errors: tuple[str, ...]
    """Why each stop ended early; empty for complete stops."""
    ticks: int
    """Number of decisions in all stops."""
    traces: Mapping[int, Trace]
    """Requested traces by index of the rig, if it braked."""

    def __len__(self) -> int:
        return len(self.metrics)

    def __getitem__(self, metric: str) -> NDArray[np.float64]:
        """One metric of all stops."""
        values: NDArray[np.float64] = self.metrics[metric]
        return values

    def summary(self) -> ResultSummary:
        """Distribution of the metrics, and shares of stops that failed."""
        return summarize({name: self[name] for name in METRICS}.items(), sum(map(bool, self.errors)))

    @staticmethod
    def joined(parts: Sequence[StopResults]) -> StopResults:
        """The stops of all parts, one part after the other."""
        starts = np.cumsum([0, *map(len, parts)]).tolist()
        return StopResults(
            np.concatenate([part.metrics for part in parts]),
            tuple(error for part in parts for error in part.errors),
            sum(part.ticks for part in parts),
            {
                start + rig: trace
                for start, part in zip(starts, parts, strict=False)
                for rig, trace in part.traces.items()
            },
        )


def summarize(columns: Iterable[tuple[str, NDArray[np.float64]]], failed: int) -> ResultSummary:
    """Summary of stops of which `failed` ended with an error; takes one metric of METRICS with its values at a time."""
    stops, locked, never_entered, fell_back, spreads = 0, 0.0, 0.0, None, {}
    for name, values in columns:
        stops, spreads[name] = len(values), _spread(values)
        if name == "lock_fraction":
            locked = float(np.mean(values > 0.0))
        elif name == "band_entry_s":
            never_entered = float(np.mean(np.isnan(values)))
        elif name == "fall_backs" and not np.isnan(values).all():
            fell_back = float(np.mean(values > 0.0))
    return ResultSummary(stops, failed, locked, never_entered, spreads, fell_back)


def _spread(values: NDArray[np.float64]) -> Distribution:
    ranked = np.where(np.isnan(values), np.inf, values)
    worst = int(ranked.argmax())
    ranked.sort()
    return Distribution(
        _quantile(ranked, 0.5),
        _quantile(ranked, 0.99),
        ranked.item(-1),
        worst,
        _interval(ranked, 0.5),
        _interval(ranked, 0.99),
    )


def _interval(ordered: NDArray[np.float64], share: float) -> tuple[float, float]:
    low, high = bootstrap_ranks(len(ordered), share, _CONFIDENCE)
    return ordered.item(low), ordered.item(high)


@cache
def bootstrap_ranks(count: int, share: float, confidence: float) -> tuple[int, int]:
    """Places, among `count` ordered values, of the bootstrap's interval of the quantile `share`.

    Among values drawn with replacement the r-th smallest is at the place of the r-th smallest of as many uniform
    numbers, which has the distribution Beta(r, count + 1 - r): no stop need be drawn again.
    """
    rank = share * (count - 1) + 1.0
    drawn = np.random.default_rng(0).beta(rank, count + 1.0 - rank, _RESAMPLES)
    low, high = np.quantile(drawn, (0.5 - confidence / 2.0, 0.5 + confidence / 2.0)).tolist()
    return min(int(low * count), count - 1), min(int(high * count), count - 1)


def _quantile(ordered: NDArray[np.float64], share: float) -> float:
    """Quantile by linear interpolation, as numpy's, also between infinities."""
    place = share * (len(ordered) - 1)
    below = ordered.item(int(place))
    above = ordered.item(min(int(place) + 1, len(ordered) - 1))
    part = place % 1.0
    return below if part == 0.0 or above == below else below + (above - below) * part
