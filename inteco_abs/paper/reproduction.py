"""Reproduces the paper: runs all conditions, and reports rows, verdicts and the traces for the figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from inteco_abs.control import reaching_time_bound
from inteco_abs.montecarlo import IDEAL, METRICS, Progress, StopResults, run_all
from inteco_abs.paper.cases import REFERENCE, Law, PaperCondition, paper_conditions
from inteco_abs.paper.comparison import ACCURACY, Comparison, Similarity, compare, compare_with_simulation, verdict
from inteco_abs.quantities import finite

SHOWN: Final = (
    "reaching_time_s",
    "slip_rms_true",
    "slip_rms_fixed_true",
    "slip_rms_low_speed_true",
    "slip_rms_above_60",
    "overshoot",
    "lock_fraction",
    "torque_variation_nm_per_s",
    "stop_time_s",
    "stop_distance_m",
)
"""Metrics of the table, out of METRICS."""
_SIMULATION: Final = "simulation"
_EXPERIMENTS: Final = ("experiment-window", "experiment-euler")
_SHARD: Final = 5
"""Rigs in a shard: a stop takes some 0.05 s, so the progress bar moves steadily."""
_SLOWEST_RAD_S: Final = 10.0


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One law under one condition."""

    condition: PaperCondition
    law: Law
    stops: StopResults
    comparison: Comparison | None
    """Comparison with the paper's law under this condition; None for that law."""

    def facts(self) -> dict[str, Any]:
        """Values for JSON; None for metrics that a stop does not have."""
        condition, law, compared = self.condition, self.law, self.comparison
        spreads = self.stops.summary().spreads
        return {
            "condition": condition.name,
            "title": condition.title,
            "controller": law.controller,
            "pairing": law.pairing,
            "Mk_per_s": law.Mk,
            "Mq_per_s": law.Mq,
            "estimator": condition.estimator,
            "rigs": condition.draws.name,
            "left_out": list(condition.draws.left_out),
            "stops": len(self.stops),
            "median": {name: finite(spreads[name].median) for name in SHOWN},
            "largest": {name: finite(spreads[name].largest) for name in SHOWN},
            "comparison": compared and compared._asdict(),
        }

    def records(self) -> Iterator[dict[str, Any]]:
        """A record for each stop; None for metrics that it does not have."""
        condition, law = self.condition, self.law
        stops = zip(condition.draws.seeds, self.stops.metrics.tolist(), self.stops.errors, strict=True)
        for seed, values, error in stops:
            yield {
                "condition": condition.name,
                "controller": law.controller,
                "pairing": law.pairing,
                "Mk_per_s": law.Mk,
                "Mq_per_s": law.Mq,
                "estimator": condition.estimator,
                "population": condition.draws.population,
                "seed": seed,
                **dict(zip(METRICS, map(finite, values), strict=True)),
                "error": error,
            }


@dataclass(frozen=True, slots=True)
class PaperTrace:
    """One stop for a figure."""

    name: str
    title: str
    columns: dict[str, NDArray[np.float64]]
    """An entry per tick from the first of braking; names end with units, slip and duty have none."""


@dataclass(frozen=True, slots=True)
class Reproduction:
    """Results of all conditions."""

    rows: tuple[PaperRow, ...]
    traces: tuple[PaperTrace, ...]

    def report(self) -> dict[str, Any]:
        """Return what was found, for JSON, tables and figures."""
        return {
            "schema_version": 1,
            "reference_slip": REFERENCE,
            "simulation": _simulation(self.rows[0], self.traces[0]),
            "rows": [row.facts() for row in self.rows],
            "verdicts": {name: verdict(rivals) for name, rivals in self._comparisons().items()},
            "similarity": {name: one._asdict() for name, one in self._similarities().items()},
            "figures": {trace.name: trace.title for trace in self.traces},
        }

    def _comparisons(self) -> dict[str, dict[str, Comparison]]:
        """Comparisons by condition and pairing."""
        found: dict[str, dict[str, Comparison]] = {}
        for row in self.rows:
            if row.comparison is not None:
                found.setdefault(row.condition.name, {})[row.law.pairing] = row.comparison
        return found

    def _similarities(self) -> dict[str, Similarity]:
        """The paper's law in each experiment against its simulation."""
        ours = {row.condition.name: row.stops for row in self.rows if row.comparison is None}
        simulation = ours[_SIMULATION]
        return {name: compare_with_simulation(ours[name], simulation) for name in _EXPERIMENTS}

    def records(self) -> list[dict[str, Any]]:
        """Every stop of every row."""
        return [record for row in self.rows for record in row.records()]


def reproduce(draws: int, progress: Progress | None = None) -> Reproduction:
    """Run all conditions, those of the experiment on `draws` >= 1 rigs; deterministic."""
    pairs = [(condition, law) for condition in paper_conditions(draws) for law in condition.laws]
    outcomes = run_all([condition.experiment(law) for condition, law in pairs], shard=_SHARD, progress=progress)
    rows = tuple(_rows(pairs, outcomes))
    drawn = {row.condition.name: row for row in rows if row.comparison is None}
    return Reproduction(rows, tuple(_trace(drawn[name]) for name in (_SIMULATION, *_EXPERIMENTS)))


def _rows(pairs: Sequence[tuple[PaperCondition, Law]], outcomes: Sequence[StopResults]) -> Iterator[PaperRow]:
    ours = outcomes[0]
    for (condition, law), stops in zip(pairs, outcomes, strict=True):
        ours = ours if law.pairing else stops
        yield PaperRow(condition, law, stops, compare(ours, stops) if law.pairing else None)


def _trace(row: PaperRow) -> PaperTrace:
    """Trace of the stop with the median slip RMS of a row; it is simulated again, with the same result."""
    order = np.argsort(row.stops[ACCURACY], kind="stable")
    place = int(order[(len(order) - 1) // 2])
    draws, law = row.condition.draws, row.law
    alone = replace(row.condition.experiment(law), rigs=(draws.rigs[place],), traced=(0,))
    trace = run_all([alone])[0].traces[0]
    rig = f"{draws.population}:{draws.seeds[place]}"
    title = f"{row.condition.title}\nMk = {law.Mk:g}, Mq = {law.Mq:g}, rig {rig}"
    columns = {
        "time_s": trace.time_s,
        "wheel_speed_rad_s": trace.wheel_speed_rad_s,
        "road_speed_rad_s": trace.road_speed_rad_s,
        "slip": trace.slip,
        **({} if row.condition.estimator == IDEAL else {"slip_estimated": trace.slip_estimated}),
        "slip_reference": np.full(len(trace.slip), REFERENCE),
        "brake_torque_nm": trace.brake_torque_nm,
        "brake_duty": trace.brake,
    }
    return PaperTrace(row.condition.name, title, columns)


def _simulation(row: PaperRow, trace: PaperTrace) -> dict[str, Any]:
    """Simulated values of an ideal loop and their theoretical ones."""
    law, (stop,) = row.law, row.records()
    fast = trace.columns["road_speed_rad_s"][:-1] > _SLOWEST_RAD_S
    torques = trace.columns["brake_torque_nm"][1:][fast]  # the decision of a tick acts until the next
    return {
        "reaching_time_bound_s": reaching_time_bound(0.0, REFERENCE, law.Mk, law.Mq),
        "reaching_time_s": stop["reaching_time_s"],
        "chattering_rms_expected": law.Mq * law.config(row.condition.estimator).period_ns * 1e-9 / 2.0,
        "chattering_rms": stop["slip_rms_true"],
        "torque_least_nm": float(torques.min()),
        "torque_most_nm": float(torques.max()),
        "stop_time_s": stop["stop_time_s"],
        "stop_distance_m": stop["stop_distance_m"],
    }
