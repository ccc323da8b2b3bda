"""What predictive-reaching is certified for, at several road speeds, and for a stated set of rigs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from inteco_abs.config import RigConfig
from inteco_abs.control import gains_in_force
from inteco_abs.errors import ConfigError
from inteco_abs.gain_design.advice import Advice
from inteco_abs.gain_design.bounds import AtSlip
from inteco_abs.gain_design.harmonic_balance import Brake, frozen_speeds
from inteco_abs.gain_design.predicted_loop import (
    SHORTEST_LAG_S,
    BrakeBox,
    Margins,
    PredictedLoop,
    margins,
    predicted_loops,
)
from inteco_abs.gain_design.uncertainty import Box
from inteco_abs.views.shown import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

PREDICTED: Final = "predictive-reaching"
"""The controller that is judged by its loop."""
_PERCENT: Final = 0.01


@dataclass(frozen=True, slots=True, repr=False)
class Certificate(Shown):
    """The loop of predictive-reaching, with an observer that keeps what it takes the brake for."""

    config: RigConfig
    box: Box
    expected: Brake
    """The brake that the observer takes the rig's for before it has learnt of it."""
    brake: Brake | None
    """The brakes that are stated."""
    gain_error: float
    """Largest share by which the torque's effect on the slip is off in the stated set of rigs."""
    rows: Sequence[Margins]
    certified: Sequence[bool]
    """By road speed, whether the loop is certified for the stated brakes and rigs together."""
    advice: Sequence[Advice]

    @property
    def slip_offset(self) -> float:
        """By how much the slip is off, by (11), for radii whose ratio r1/r2 is 1 % larger than the nominal one.

        Stability does not depend on it. `adaptive-observer` learns the ratio.
        """
        return -_PERCENT * (1.0 - self.config.controller.reference_slip)

    def plot(self) -> Figure:
        """Raises ConfigError: a certificate has no figure."""
        raise no_figure()

    def __rich__(self) -> RenderableType:
        from inteco_abs.gain_design.table import render_certificate  # noqa: PLC0415  for a screen alone

        return render_certificate(self.report())

    def __repr__(self) -> str:
        state = f"{len(self.advice)} pieces of advice" if self.advice else "the loop holds for the stated set of rigs"
        return f"<Certificate of {PREDICTED}: {state}>"

    def report(self) -> dict[str, Any]:
        """Report for JSON."""
        loop = [
            {**row._asdict(), "certified": certified} for row, certified in zip(self.rows, self.certified, strict=True)
        ]
        return {
            "schema_version": 1,
            "controller": PREDICTED,
            "gains": gains_in_force(self.config),
            "reference_slip": self.config.controller.reference_slip,
            "parameters": self.config.model.parameters,
            "estimator": self.config.estimator.name,
            "expected": self.expected._asdict(),
            "uncertain": {one.name: [one.low, one.high] for one in self.box.spreads},
            "brake": None if self.brake is None else self.brake._asdict(),
            "gain_error": self.gain_error,
            "slip_offset": self.slip_offset,
            "loop": loop,
            "advice": [one._asdict() for one in self.advice],
            "curves": {name: [row[name] for row in loop] for name in loop[0]},
        }


def no_figure() -> ConfigError:
    """What a figure of a certificate is refused with."""
    return ConfigError.of("--figure", f"{PREDICTED} has a table and no figure; --csv writes its numbers")


def certify(config: RigConfig, box: Box, speeds: tuple[float, float], brake: Brake | None = None) -> Certificate:
    """Certify the loop over road speeds from..to, rad/s, for the gain of all rigs of a box, and for brakes.

    The observer has not learnt of the brake: dead times between the expected one and the stated longest, and lags of
    the stated range, are errors of its prediction. Raises ConfigError for an estimator that predicts nothing, and for
    speeds that an expected stop passes before it has reached its reference slip.
    """
    slip = config.controller.reference_slip
    loops = predicted_loops(config, frozen_speeds(box.nominal, slip, speeds))
    first = loops[0]
    expected = Brake(first.lag_s, first.lag_s, first.dead_time_s)
    gain_error = float(AtSlip(box, slip).bounds(np.array([first.road_speed_rad_s])).eps_g[0])
    stated = None if gain_error >= 1.0 else _stated(first, brake, gain_error)
    certified = [stated is not None and loop.holds(stated) for loop in loops]
    rows = [margins(loop) for loop in loops]
    found = _advice(rows, certified, brake, gain_error)
    return Certificate(config, box, expected, brake, gain_error, rows, certified, found)


def _stated(loop: PredictedLoop, brake: Brake | None, gain_error: float) -> BrakeBox:
    gain = 1.0 - gain_error, 1.0 + gain_error
    if brake is None:
        return BrakeBox(gain)
    later_s = brake.dead_time_s - loop.dead_time_s
    least, most = min(brake.least_lag_s, loop.lag_s), max(brake.most_lag_s, loop.lag_s)
    return BrakeBox(gain, (min(later_s, 0.0), max(later_s, 0.0)), (max(least, SHORTEST_LAG_S), most))


def _advice(rows: Sequence[Margins], certified: Sequence[bool], brake: Brake | None, gain_error: float) -> list[Advice]:
    lost = [row for row, holds in zip(rows, certified, strict=True) if not holds]
    if not lost:
        return []
    row = min(lost, key=lambda one: one.later_s)
    if row.decay_per_s <= 0.0:
        found = f"the loop oscillates at {row.road_speed_rad_s:.0f} rad/s even with the brake that the observer expects"
        return [Advice("loop", found, "smaller k or kM")]
    with_brake = "" if brake is None else ", with the stated brakes"
    found = (
        f"not certified for a gain that is off by up to {100.0 * gain_error:.0f} %{with_brake}: alone, the loop bears "
        f"at {row.road_speed_rad_s:.0f} rad/s a gain of {row.least_gain:.2g} to {row.most_gain:.2f} times the expected "
        f"one, a dead time {1e3 * row.earlier_s:.1f} ms shorter to {1e3 * row.later_s:.1f} ms longer, and a lag of "
        f"{1e3 * row.least_lag_s:.0f} to {1e3 * row.most_lag_s:.0f} ms"
    )
    return [Advice("loop", found, "know the brake better (identify, then --config), or smaller k and kM")]
