"""How long a law's decisions take in Python, as in the loop, and the stop that they make.

On a computer that does other work the same law takes half as long again a moment later. So all laws take turns, and
each has the least median of its turns.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from inteco_abs.benchmark.laws import Law
from inteco_abs.config import RigConfig
from inteco_abs.control import Controller, Estimator
from inteco_abs.montecarlo import ConfiguredPolicy, Experiment, StopResults, TrueState, run_all
from inteco_abs.rig import RigVariation

_BELOW_RAD_S: Final = 15.0
"""Below the start speed, as in a sweep."""
_TURNS: Final = 5


class DecisionTime(NamedTuple):
    """Time of estimate and law together in the ticks that brake, and the stops; None if none braked."""

    median_us: float | None
    stops: StopResults


class _Timed:
    """A part whose calls are timed. As it has no function of its own, its stop is not compiled."""

    def __init__(self, part: Any) -> None:
        self._part = part
        self.durations_ns: list[int] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._part, name)

    def update(self, *arguments: Any) -> Any:
        began = time.perf_counter_ns()
        found = self._part.update(*arguments)
        self.durations_ns.append(time.perf_counter_ns() - began)
        return found


def decision_times(
    laws: Iterable[Law], rigs: tuple[RigVariation, ...], controllers: Mapping[str, type[Controller]]
) -> dict[str, float | None]:
    """Time of each law in us, by its name; None if it never braked."""
    configs = {law.name: law.config(controllers) for law in laws}
    found: dict[str, list[float]] = {name: [] for name in configs}
    for _ in range(_TURNS):
        for name, config in configs.items():
            median_us = time_decisions(config, rigs, controllers).median_us
            if median_us is not None:
                found[name].append(median_us)
    return {name: min(times, default=None) for name, times in found.items()}


def time_decisions(
    config: RigConfig, rigs: tuple[RigVariation, ...], controllers: Mapping[str, type[Controller]]
) -> DecisionTime:
    """Brake each rig once in Python."""
    made: list[tuple[_Timed, _Timed]] = []
    make: Callable[..., tuple[Estimator, Controller]] = ConfiguredPolicy(config, controllers)

    def timed(variation: RigVariation, state: TrueState) -> tuple[Any, Any]:
        estimator, controller = make(variation, state)
        made.append((_Timed(estimator), _Timed(controller)))
        return made[-1]

    start = config.experiment.start_speed_rad_s - _BELOW_RAD_S
    (stops,) = run_all([Experiment(rigs, config, timed, start)])
    taken = np.concatenate([_together(*pair) for pair in made]) / 1e3
    return DecisionTime(float(np.median(taken)) if len(taken) else None, stops)


def _together(estimator: _Timed, controller: _Timed) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Of the ticks that brake: the last ones."""
    count = len(controller.durations_ns)
    estimates = estimator.durations_ns[len(estimator.durations_ns) - count :]
    return np.array(estimates, dtype=np.float64) + controller.durations_ns
