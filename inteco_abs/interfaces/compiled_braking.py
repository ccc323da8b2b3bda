"""Stops that wait for actions, compiled: those of `PythonStops`, with the same bits. Needs the extra `lab`."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inteco_abs.config import GuardConfig, RigConfig
from inteco_abs.control import Function, config_of_stop
from inteco_abs.interfaces.braking import Clock, Parts, act, make_path, make_rig, observe, run_up
from inteco_abs.machine_code import compiled
from inteco_abs.records import record
from inteco_abs.rig import RigVariation
from inteco_abs.rig_rows import rig_rows, state_rows

Places = NDArray[np.int64]
Floats = NDArray[np.float64]


class CompiledStops:
    """As `PythonStops`, for an estimator that is the function `estimate`."""

    def __init__(self, config: RigConfig, clock: Clock, count: int, rolling_rad_s: float, estimate: Function) -> None:
        self._config, self._clock, self._rolling_rad_s = config, clock, rolling_rad_s
        self._paths: dict[GuardConfig, list[Any]] = {}
        read = partial(observe, estimate=estimate, word=_unsigned)
        self._begin, self._act = (compiled(partial(_at_each, do=partial(do, observe=read))) for do in (run_up, act))
        self._rows = Parts(*(np.repeat(row, count).view(np.recarray) for row in self._row(RigVariation())))

    def begin(self, place: int, rig: RigVariation) -> None:
        """Drive this rig until its first decision is due."""
        for rows, row in zip(self._rows, self._row(rig), strict=True):
            rows[place] = row[0]
        self._begin(self._rows, np.array([place]), np.zeros(1))

    def _row(self, rig: RigVariation) -> list[Any]:
        """A row of each part, before the first tick."""
        k, state = make_rig(rig, self._rolling_rad_s)
        speeds = np.array([[state.wheel_speed], [state.road_speed]])
        config = config_of_stop(self._config, rig)
        if config.guard not in self._paths:  # the rest of the configuration is the same for all rigs
            self._paths[config.guard] = [np.array([record(part)]) for part in make_path(config, self._clock)]
        return [rig_rows([k]), state_rows([k], *speeds), *self._paths[config.guard]]

    def act(self, places: list[int], brakes: list[float]) -> None:
        """Demand these duties of the rigs at these places for the ticks of an action, or until a stop is over."""
        self._act(self._rows, np.array(places, np.int64), np.array(brakes))

    def column(self, part: str, name: str) -> NDArray[Any]:
        """One field of a part of each stop."""
        column: NDArray[Any] = getattr(self._rows, part)[name]
        return column


def _at_each(rows: Parts, places: Places, brakes: Floats, do: Function) -> None:
    for i in range(places.size):
        j = places[i]
        path = (
            rows.estimator_k[j],
            rows.estimator[j],
            rows.machine_k[j],
            rows.machine[j],
            rows.guard_k[j],
            rows.guard[j],
        )
        do(Parts(rows.rig_k[j], rows.rig[j], *path, rows.clock[j], rows.stop[j]), brakes[i])


def _unsigned(number: int) -> int:
    return np.uint64(number)  # type: ignore[return-value]  # compiled, it is an integer as any other
