"""Many virtual rigs at once: the rig's physics compiled, on arrays, and whole stops of them. Needs the extra `lab`."""

from inteco_abs.montecarlo.batch import BatchPlant
from inteco_abs.montecarlo.batch_run import Experiment
from inteco_abs.montecarlo.executors import InThisProcess, LocalProcesses, cores, count_workers, named_executor
from inteco_abs.montecarlo.factors import one_at_a_time
from inteco_abs.montecarlo.grid import MOST_COMBINATIONS, Combination, combinations, split_list
from inteco_abs.montecarlo.oracle import Oracle
from inteco_abs.montecarlo.plan import SweepPlan, Unit
from inteco_abs.montecarlo.policies import (
    ESTIMATOR_NAMES,
    IDEAL,
    ConfiguredPolicy,
    IdealPolicy,
    PolicyFactory,
    TrueState,
)
from inteco_abs.montecarlo.results import METRICS, Distribution, ResultSummary, StopResults, Trace, bootstrap_ranks
from inteco_abs.montecarlo.samples import SampleSet, parse_draws
from inteco_abs.montecarlo.stops import SHARD, Progress, run_all, run_stops
from inteco_abs.montecarlo.store import SweepFolder, SweepRow
from inteco_abs.montecarlo.work import Braked, work
from inteco_abs.rig import LONGEST_BRAKING_S

__all__ = [
    "ESTIMATOR_NAMES",
    "IDEAL",
    "LONGEST_BRAKING_S",
    "METRICS",
    "MOST_COMBINATIONS",
    "SHARD",
    "BatchPlant",
    "Braked",
    "Combination",
    "ConfiguredPolicy",
    "Distribution",
    "Experiment",
    "IdealPolicy",
    "InThisProcess",
    "LocalProcesses",
    "Oracle",
    "PolicyFactory",
    "Progress",
    "ResultSummary",
    "SampleSet",
    "StopResults",
    "SweepFolder",
    "SweepPlan",
    "SweepRow",
    "Trace",
    "TrueState",
    "Unit",
    "bootstrap_ranks",
    "combinations",
    "cores",
    "count_workers",
    "named_executor",
    "one_at_a_time",
    "parse_draws",
    "run_all",
    "run_stops",
    "split_list",
    "work",
]
