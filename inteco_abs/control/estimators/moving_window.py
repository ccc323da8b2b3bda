"""Mean speeds over a moving window, and the Euler formula as the window of one period."""

from __future__ import annotations

from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.estimators.base import Estimator, MovingWindow
from inteco_abs.control.estimators.registry import EstimatorSpec, parameter
from inteco_abs.rig import RigParameters


def _euler(config: RigConfig, parameters: RigParameters) -> Estimator:
    return MovingWindow(config.encoders.counts_per_turn, 1, parameters)


def _moving_window(config: RigConfig, parameters: RigParameters) -> Estimator:
    length = max(1, round(config.estimator.window_s * config.loop.rate_hz))
    return MovingWindow(config.encoders.counts_per_turn, length, parameters)


EULER: Final = EstimatorSpec("The paper's backward difference over one period", (), _euler, MovingWindow)

SPEC: Final = EstimatorSpec(
    "Mean speed over a window of samples",
    (parameter("window_s", "s", "length of the window; the speed lags by half of it"),),
    _moving_window,
    MovingWindow,
)
