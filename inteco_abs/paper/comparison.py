"""Judges the paper's claims: its law is more accurate than a rival, and its experiment is similar to its simulation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from inteco_abs.montecarlo import StopResults
from inteco_abs.quantities import finite

ACCURACY: Final = "slip_rms_fixed_true"
"""Metric of the claim; every stop has it, even if its slip never reaches the reference."""
RATIOS: Final = (
    "reaching_time_s",
    "slip_rms_true",
    ACCURACY,
    "slip_rms_low_speed_true",
    "torque_variation_nm_per_s",
    "stop_distance_m",
)
_BAND_ENTRY: Final = "band_entry_s"
_ALIKE: Final = 0.01
_SIMILAR: Final = 2.0
_CHANCE: Final = 0.05


class Comparison(NamedTuple):
    """The paper's law against a rival."""

    ratios: dict[str, float | None]
    """Median over the rigs of the paper's law's metric divided by the rival's on the same rig; None if a stop lacks
    the metric."""
    stops: int
    better: int
    """Number of stops in which the paper's law is more accurate."""
    worse: int
    neither_arrived: int
    """Number of rigs on which the slip is never within 0.01 of the reference, with either law."""
    confirmed: bool
    """Whether the paper's claim of better accuracy is confirmed."""
    words: str
    """The reason with its figures."""


class Similarity(NamedTuple):
    """The experiment against the simulation."""

    ratios: dict[str, float | None]
    """Median over the rigs of the experiment's metric divided by the simulation's; None if the median rig lacks it."""
    never_arrived: int
    """Number of rigs whose slip is never within 0.01 of the reference."""
    confirmed: bool
    """Whether slip RMS and reaching time of the experiment are at most twice those of the simulation."""
    words: str
    """The verdict with its figures."""


def compare(ours: StopResults, rival: StopResults) -> Comparison:
    """Judge the claim that `ours` are more accurate than the `rival`'s, on the same rigs in the same order.

    It is confirmed by a median ratio of slip RMS below 0.99 and, for several rigs, a two-sided sign test at 5 %. It is
    not if neither law arrives on the median rig: two laws that do not hold the slip have no accuracy to compare.
    """
    ratios = {name: finite(float(np.median(ours[name] / rival[name]))) for name in RATIOS}
    better = int(np.sum(ours[ACCURACY] < rival[ACCURACY]))
    worse = int(np.sum(ours[ACCURACY] > rival[ACCURACY]))
    ratio, stops = ratios[ACCURACY], len(ours)
    neither = int(np.sum(np.isnan(ours[_BAND_ENTRY]) & np.isnan(rival[_BAND_ENTRY])))
    by_chance = stops > 1 and _chance(better, worse) >= _CHANCE
    if ratio is None:
        reason = "a stop has no slip RMS"
    elif 2 * neither >= stops:
        reason = f"neither law ever comes within 0.01 of the reference on {neither} of {stops} rigs"
    elif abs(ratio - 1.0) <= _ALIKE:
        reason = "alike within 1 %"
    elif ratio > 1.0:
        reason = "worse"
    else:
        reason = "better, as chance may have it" if by_chance else "better"
    confirmed = reason == "better"
    return Comparison(ratios, stops, better, worse, neither, confirmed, f"{reason}, {_figures(ratios, stops, better)}")


def compare_with_simulation(experiment: StopResults, simulation: StopResults) -> Similarity:
    """Judge the claim that the results of an experiment are similar to those of the simulation, which is one stop."""
    spreads = experiment.summary().spreads
    ratios = {name: finite(spreads[name].median / simulation[name].item()) for name in (ACCURACY, "reaching_time_s")}
    never = int(np.sum(np.isnan(experiment[_BAND_ENTRY])))
    confirmed = all(ratio is not None and ratio <= _SIMILAR for ratio in ratios.values())
    rms, reaching = (
        "unknown" if ratio is None else f"{ratio:.3g} times that of the simulation" for ratio in ratios.values()
    )
    words = (
        f"claim {'confirmed' if confirmed else 'not confirmed'}; slip RMS {rms}, reaching time {reaching}; "
        f"{never} of {len(experiment)} rigs never come within 0.01 of the reference"
    )
    return Similarity(ratios, never, confirmed, words)


def verdict(comparisons: Mapping[str, Comparison]) -> str:
    """The verdict on the claim from all rivals, by pairing."""
    judged = [one.confirmed for one in comparisons.values()]
    found = "confirmed" if all(judged) else "confirmed in part" if any(judged) else "not confirmed"
    against = (f"against {pairing}: {one.words}" for pairing, one in comparisons.items())
    return f"claim {found}; {'; '.join(against)}"


def _figures(ratios: dict[str, float | None], stops: int, better: int) -> str:
    of_many = f" (median of {stops} rigs; better on {better})" if stops > 1 else ""
    reaching = ratios["reaching_time_s"]
    figures = f"slip RMS {_times(ratios[ACCURACY])} that of constant rate{of_many}"
    return figures if reaching is None else f"{figures}, reaching time {_times(reaching)}"


def _times(ratio: float | None) -> str:
    return "not comparable with" if ratio is None else f"{ratio:.2f} times"


def _chance(wins: int, losses: int) -> float:
    """p-value of the two-sided sign test."""
    count = wins + losses
    tail = sum(math.comb(count, k) for k in range(max(wins, losses), count + 1))
    return min(1.0, 2.0 * tail / 2.0**count)
