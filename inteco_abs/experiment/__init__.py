"""One run from start to file, in virtual or real time: connects board, loop, pipeline and recorder."""

from inteco_abs.experiment.plan import Plan, Progress, conditions, ring_ticks
from inteco_abs.experiment.real_time import RoundTrips, by_hand, conditions_by_hand, measure_round_trips
from inteco_abs.experiment.run import run_stop
from inteco_abs.experiment.user_code import time_limit

__all__ = [
    "Plan",
    "Progress",
    "RoundTrips",
    "by_hand",
    "conditions",
    "conditions_by_hand",
    "measure_round_trips",
    "ring_ticks",
    "run_stop",
    "time_limit",
]
