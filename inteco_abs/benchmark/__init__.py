"""All laws on the same simulated rigs, judged by one ruler. Needs the extra `lab`."""

from inteco_abs.benchmark.decision_time import DecisionTime, decision_times, time_decisions
from inteco_abs.benchmark.gain_search import Budget, tune
from inteco_abs.benchmark.laws import DEFAULT_ESTIMATOR, FIXED_GAINS, Law, read_laws, shipped_laws, write_laws
from inteco_abs.benchmark.results import POPULATIONS, compared, ranges, results_of

__all__ = [
    "DEFAULT_ESTIMATOR",
    "FIXED_GAINS",
    "POPULATIONS",
    "Budget",
    "DecisionTime",
    "Law",
    "compared",
    "decision_times",
    "ranges",
    "read_laws",
    "results_of",
    "shipped_laws",
    "time_decisions",
    "tune",
    "write_laws",
]
