"""Slip controllers that others published for this rig or for wheels in general, each after its source, one file each.

They are known by name wherever a controller is, and imported when they are used. docs/benchmark.md compares them, and
says where a source's gains could not be had.
"""

from typing import Final

_PLACES: Final = {
    "grey-sliding": "grey_sliding:GreySliding",
    "optimal-pi": "optimal_pi:OptimalPi",
    "fuzzy-pi": "optimal_pi:FuzzyPi",
    "lqr": "lqr:Lqr",
    "lyapunov-sliding": "adaptive_sliding:LyapunovSliding",
    "reaching-sliding": "adaptive_sliding:ReachingSliding",
    "intelligent-pd": "intelligent_pd:IntelligentPd",
    "minimum-variance": "minimum_variance:MinimumVariance",
    "l1-adaptive": "l1_adaptive:L1Adaptive",
    "extremum-seeking": "extremum_seeking:ExtremumSeeking",
    "five-phase": "five_phase:FivePhase",
    "neuro-fuzzy": "neuro_fuzzy:NeuroFuzzy",
    "fitted-q": "fitted_q:FittedQ",
    "model-predictive": "predictive:ModelPredictive",
}
PUBLISHED: Final[dict[str, str]] = {name: f"{__name__}.{place}" for name, place in _PLACES.items()}
"""By name, "module:class"."""
