"""Many virtual rigs at once: the rig's physics compiled, on arrays, and whole stops of them. Needs the extra `lab`."""

from inteco_abs.ensembles.batch import BatchPlant
from inteco_abs.ensembles.minds import ESTIMATOR_NAMES, IDEAL, AsConfigured, Ideal, Maker, TrueState
from inteco_abs.ensembles.outcome import METRICS, Spread, Stops, Summary, Trace
from inteco_abs.ensembles.shard import LONGEST_BRAKING_S, Experiment
from inteco_abs.ensembles.stops import Progress, run_all, run_stops

__all__ = [
    "ESTIMATOR_NAMES",
    "IDEAL",
    "LONGEST_BRAKING_S",
    "METRICS",
    "AsConfigured",
    "BatchPlant",
    "Experiment",
    "Ideal",
    "Maker",
    "Progress",
    "Spread",
    "Stops",
    "Summary",
    "Trace",
    "TrueState",
    "run_all",
    "run_stops",
]
