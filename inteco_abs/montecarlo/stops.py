"""Whole stops of many rigs, in shards that may run anywhere."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control import Controller
from inteco_abs.montecarlo.batch_run import Experiment, run_shard
from inteco_abs.montecarlo.policies import ConfiguredPolicy, PolicyFactory
from inteco_abs.montecarlo.results import StopResults
from inteco_abs.rig import RigVariation

SHARD: Final = 50
"""Rigs that share a batch: what a tick costs besides the decisions is then below a twentieth."""

Progress = Callable[[int, int], None]
"""Gets the number of finished stops, and of all."""


def run_stops(
    rigs: Sequence[RigVariation],
    config: RigConfig,
    *,
    controllers: Mapping[str, type[Controller]] | None = None,
    maker: PolicyFactory | None = None,
    run_up_from_rad_s: float | None = 165.0,
    traced: Collection[int] = (),
    executor: Executor | None = None,
    shard: int = SHARD,
    progress: Progress | None = None,
) -> StopResults:
    """One stop of each rig with the configured estimator and controller, or with what `maker` makes.

    The rest is as in `Experiment` and `run_all`.
    """
    made = ConfiguredPolicy(config, controllers) if maker is None else maker
    experiment = Experiment(tuple(rigs), config, made, run_up_from_rad_s, traced)
    return run_all([experiment], executor=executor, shard=shard, progress=progress)[0]


def run_all(
    experiments: Sequence[Experiment],
    *,
    executor: Executor | None = None,
    shard: int = SHARD,
    progress: Progress | None = None,
) -> list[StopResults]:
    """The stops of each experiment, the same to the last digit on any executor and in shards of any size.

    Without an executor they run here. On one, all shards are handed over at once, and what is not yet begun is taken
    back when something raises. Raises what a shard raises, and ValueError for a shard below one rig.
    """
    if shard < 1:
        raise ValueError(f"shard = {shard!r}: must be at least 1 rig")
    parts = [list(_shards(experiment, shard)) for experiment in experiments]
    results = _results([part for every in parts for part in every], executor)
    total, done = sum(len(experiment.rigs) for experiment in experiments), 0
    outcomes = []
    for every in parts:
        stops = []
        for _ in every:
            stops.append(next(results))
            done += len(stops[-1])
            if progress is not None:
                progress(done, total)
        outcomes.append(StopResults.joined(stops))
    return outcomes


def _shards(experiment: Experiment, size: int) -> Iterator[Experiment]:
    if not experiment.rigs:
        raise ValueError("no rigs: an experiment needs at least one")
    for start in range(0, len(experiment.rigs), size):
        rigs = experiment.rigs[start : start + size]
        traced = [place - start for place in experiment.traced if 0 <= place - start < len(rigs)]
        yield replace(experiment, rigs=rigs, traced=traced)


def _results(shards: Sequence[Experiment], executor: Executor | None) -> Iterator[StopResults]:
    """In order."""
    if executor is None:
        yield from map(run_shard, shards)
        return
    futures: list[Future[StopResults]] = [executor.submit(run_shard, shard) for shard in shards]
    try:
        for future in futures:
            yield future.result()
    finally:
        for future in futures:
            future.cancel()
