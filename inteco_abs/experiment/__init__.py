"""One run from start to file, in virtual or real time: connects board, loop, pipeline and recorder."""

from inteco_abs.experiment.plan import Plan, RunProgress, ring_ticks, run_checks
from inteco_abs.experiment.real_time import RoundTrips, manual_checks, manual_control, measure_round_trips
from inteco_abs.experiment.run import run_stop
from inteco_abs.experiment.self_check import CHECKED_TICKS, replay_problem
from inteco_abs.experiment.user_code import time_limit

__all__ = [
    "CHECKED_TICKS",
    "Plan",
    "RoundTrips",
    "RunProgress",
    "manual_checks",
    "manual_control",
    "measure_round_trips",
    "replay_problem",
    "ring_ticks",
    "run_checks",
    "run_stop",
    "time_limit",
]
