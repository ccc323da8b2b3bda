"""Many virtual rigs at once: the rig's physics compiled, on arrays, and whole stops of them. Needs the extra `lab`."""

from inteco_abs.montecarlo.batch import BatchPlant
from inteco_abs.montecarlo.batch_run import LONGEST_BRAKING_S, Experiment
from inteco_abs.montecarlo.grid import MOST_COMBINATIONS, Combination, combinations, split_list
from inteco_abs.montecarlo.oracle import Oracle
from inteco_abs.montecarlo.policies import ESTIMATOR_NAMES, IDEAL, AsConfigured, Ideal, Maker, TrueState
from inteco_abs.montecarlo.results import METRICS, Spread, Stops, Summary, Trace
from inteco_abs.montecarlo.samples import Draws, parse_draws
from inteco_abs.montecarlo.stops import SHARD, Progress, run_all, run_stops
from inteco_abs.montecarlo.sweep import Row, sweep

__all__ = [
    "ESTIMATOR_NAMES",
    "IDEAL",
    "LONGEST_BRAKING_S",
    "METRICS",
    "MOST_COMBINATIONS",
    "SHARD",
    "AsConfigured",
    "BatchPlant",
    "Combination",
    "Draws",
    "Experiment",
    "Ideal",
    "Maker",
    "Oracle",
    "Progress",
    "Row",
    "Spread",
    "Stops",
    "Summary",
    "Trace",
    "TrueState",
    "combinations",
    "parse_draws",
    "run_all",
    "run_stops",
    "split_list",
    "sweep",
]
