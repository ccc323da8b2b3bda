"""The benchmark's figures: what each law does on each range of draws, with intervals, and what became worse."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from inteco_abs.benchmark.laws import Law
from inteco_abs.montecarlo import Distribution, SampleSet, SweepRow, bootstrap_ranks, one_at_a_time, parse_draws
from inteco_abs.quantities import finite

POPULATIONS: Final = ("nominal", "hard", "rough", "slow", "capped", "wild")
_ALL_ALIKE: Final = "nominal"
"""Population whose draws are all one rig."""
_VARIED: Final = "hard"
"""Population whose numbers are changed one at a time."""
SLIP: Final = "slip_rms_fixed_true"
METRICS: Final = {
    "slip_rms": SLIP,
    "arrival_s": "band_entry_s",
    "distance_m": "stop_distance_m",
    "duty_variation_per_s": "duty_variation_per_s",
    "chatter_nm_per_s": "torque_variation_nm_per_s",
}
"""Metric of a sweep by its name here."""
_SHARES: Final = {"median": 0.5, "p99": 0.99}
_CONFIDENCE: Final = 0.95
_WORSE: Final = 1.05
"""Ratio of slip RMS from which a law counts as worse: rounding differs by less, the next draws by more."""
_LEAST_WORSE: Final = 1e-4


def ranges(draws: int, first: int, *, factors: bool) -> list[SampleSet]:
    """The populations, and `hard` with one factor changed at a time, from the seed `first`."""
    found = []
    for name in POPULATIONS:
        last = first if name == _ALL_ALIKE else first + draws - 1
        one = parse_draws(f"{name}:{first}-{last}")
        found += list(one_at_a_time(one)) if factors and name == _VARIED else [one]
    return sorted(found, key=lambda one: one.population not in POPULATIONS)


def results_of(laws: Sequence[Law], rows: Iterable[SweepRow]) -> dict[str, dict[str, Any]]:
    """Figures by law and range of draws."""
    found: dict[str, dict[str, Any]] = {law.name: {} for law in laws}
    for row in rows:
        found[row.combination.varied["law"]][row.draws.population] = _figures(row)
    return found


def _figures(row: SweepRow) -> dict[str, Any]:
    summary = row.summary
    worst = summary.spreads[SLIP]
    return {
        "draws": row.draws.name,
        "stops": summary.stops,
        "failed": summary.failed,
        "locked": int(np.count_nonzero(row["lock_fraction"] > 0.0)),
        "never_arrived": round(summary.never_entered * summary.stops),
        "worst_seed": row.seeds.item(worst.worst),
        "worst_slip_rms": _rounded(worst.largest),
        **{name: dict(_spread(row[metric], summary.spreads[metric])) for name, metric in METRICS.items()},
    }


def _spread(values: NDArray[np.float64], known: Distribution) -> Iterator[tuple[str, Any]]:
    """Median and p99 with their intervals of 95 %; None is what a stop that has no such figure is worth."""
    ranked = np.sort(np.where(np.isnan(values), np.inf, values))
    for name, share in _SHARES.items():
        yield name, _rounded(getattr(known, name))
        yield f"{name}_interval", [_rounded(ranked[rank]) for rank in bootstrap_ranks(len(ranked), share, _CONFIDENCE)]


def _rounded(value: float) -> float | None:
    """To four digits; None for what is infinite."""
    return finite(float(f"{value:.4g}"))


def compared(found: Mapping[str, Any], kept: Mapping[str, Any]) -> Iterator[str]:
    """Each figure of `found` that is worse than the kept one of the same law, draws and numbers."""
    for law, ranges_of in kept["laws"].items():
        mine = found["laws"].get(law)
        if mine is None:
            continue
        if mine["numbers"] != ranges_of["numbers"]:
            yield f"{law}: has other gains than the kept results; replace those"
            continue
        for name, before in ranges_of["ranges"].items():
            now = mine["ranges"].get(name)
            if now is not None and now["draws"] == before["draws"]:
                yield from (f"{law} on {now['draws']}: {problem}" for problem in _worse(now, before))


def _worse(now: Mapping[str, Any], before: Mapping[str, Any]) -> Iterator[str]:
    for count in ("failed", "locked", "never_arrived"):
        if now[count] > before[count]:
            yield f"{count.replace('_', ' ')}: {now[count]} stops, before {before[count]}"
    for which in _SHARES:
        new, old = (math.inf if one["slip_rms"][which] is None else one["slip_rms"][which] for one in (now, before))
        if new > old * _WORSE + _LEAST_WORSE:
            yield f"slip RMS, {which}: {new:g}, before {old:g}"
