"""Many configurations on many rigs, each scored on the same draws."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, Final

from inteco_abs.montecarlo.batch_run import Experiment
from inteco_abs.montecarlo.grid import Combination
from inteco_abs.montecarlo.policies import ConfiguredPolicy
from inteco_abs.montecarlo.results import METRICS, StopResults
from inteco_abs.montecarlo.samples import SampleSet
from inteco_abs.montecarlo.stops import SHARD, Progress, run_all
from inteco_abs.quantities import finite

RUN_UP_RAD_S: Final = 15.0
"""Below the start speed: nearly a second of driving, in which estimators settle and learn."""


@dataclass(frozen=True, slots=True)
class SweepRow:
    """One configuration on one range of draws."""

    draws: SampleSet
    combination: Combination
    stops: StopResults

    def facts(self) -> dict[str, Any]:
        """As JSON has it: None for what is infinite, because a stop has no such thing."""
        summary, config = self.stops.summary(), self.combination.config
        metrics = {
            name: {
                "median": finite(spread.median),
                "p99": finite(spread.p99),
                "max": finite(spread.largest),
                "worst_seed": self.draws.seeds[spread.worst],
            }
            for name, spread in summary.spreads.items()
        }
        return {
            "rigs": self.draws.name,
            "left_out": list(self.draws.left_out),
            "controller": config.controller.name,
            "estimator": config.estimator.name,
            "settings": dict(self.combination.varied),
            "stops": summary.stops,
            "failed": summary.failed,
            "locked_share": summary.locked,
            "never_in_band_share": summary.never_entered,
            "metrics": metrics,
        }

    def records(self) -> Iterator[dict[str, Any]]:
        """One for each stop; None where it has no such metric."""
        config = self.combination.config
        for seed, values, error in zip(self.draws.seeds, self.stops.metrics.tolist(), self.stops.errors, strict=True):
            yield {
                "population": self.draws.population,
                "seed": seed,
                "controller": config.controller.name,
                "estimator": config.estimator.name,
                **self.combination.varied,
                **dict(zip(METRICS, map(finite, values), strict=True)),
                "error": error,
            }


def sweep(
    grid: Sequence[Combination],
    draws: Sequence[SampleSet],
    *,
    sources: Mapping[str, bytes] | None = None,
    run_up: bool = True,
    executor: Executor | None = None,
    shard: int = SHARD,
    progress: Progress | None = None,
) -> list[SweepRow]:
    """Every configuration on every range of draws, range by range; executor, shard and progress as for `run_all`.

    `sources` has the source of each controller of the user's own, by its name. Raises ConfigError if a controller
    cannot be made.
    """
    pairs = [(rigs, combination) for rigs in draws for combination in grid]
    experiments = []
    for rigs, combination in pairs:
        config = combination.config
        maker = ConfiguredPolicy(config, source=(sources or {}).get(config.controller.name, b""))
        start = max(0.0, config.experiment.start_speed_rad_s - RUN_UP_RAD_S) if run_up else None
        experiments.append(Experiment(rigs.rigs, config, maker, start))
    outcomes = run_all(experiments, executor=executor, shard=shard, progress=progress)
    return [SweepRow(*pair, stops) for pair, stops in zip(pairs, outcomes, strict=True)]
