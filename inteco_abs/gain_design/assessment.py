"""Assesses gains for an uncertain rig by (20), (25), (26) and the limits of the brake.

For these the loop is ideal: exact slip, a brake without lag, no delay. So they are necessary, not sufficient, on a rig;
`balances` has the loop with a brake that is late, sampling and the estimator.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from inteco_abs.config import RigConfig
from inteco_abs.control import gains_in_force
from inteco_abs.gain_design.advice import Advice, Case, Interval, advice, layer_step, where_lost
from inteco_abs.gain_design.bounds import AtSlip, Bounds, Floats
from inteco_abs.gain_design.gains import gains_of
from inteco_abs.gain_design.harmonic_balance import Balance, Brake, balances, cycle_advice
from inteco_abs.gain_design.reaching import Reaching, reaching
from inteco_abs.gain_design.uncertainty import Box
from inteco_abs.quantities import finite
from inteco_abs.views.shown import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

_SLIPS: Final = 21
"""Number of slips in a band."""
_FEWEST_SPEEDS: Final = 11


@dataclass(frozen=True, slots=True, repr=False)
class Assessment(Shown):
    """Assessment of one set of gains on one box of rigs."""

    config: RigConfig
    box: Box
    case: Case
    curves: Mapping[str, Floats]
    """Values over `road_speed_rad_s`; names end with their units."""
    fails_25: Sequence[Interval]
    """Where (25) does not hold, and so sliding is not guaranteed."""
    fails_26: Sequence[Interval]
    reaching: Sequence[Reaching]
    advice: Sequence[Advice]
    brake: Brake | None
    balances: Sequence[Balance]
    """The loop with that brake at several road speeds; none without a brake."""

    def plot(self) -> Figure:
        """Required gain, torque and uncertainty over the road speed. Raises AbsError without matplotlib."""
        from inteco_abs.gain_design.figure import figure_of_design  # noqa: PLC0415  an extra

        return figure_of_design(self.report())

    def __rich__(self) -> RenderableType:
        from inteco_abs.gain_design.table import render_design  # noqa: PLC0415  for a screen alone

        return render_design(self.report())

    def __repr__(self) -> str:
        gains = ", ".join(f"{name}={value:g}" for name, value in gains_in_force(self.config).items())
        state = f"{len(self.advice)} pieces of advice" if self.advice else "the gains hold for the whole set of rigs"
        return f"<Assessment of {self.config.controller.name}, {gains}: {state}>"

    def report(self) -> dict[str, Any]:
        """Report for JSON; None for infinite values."""
        controller, curves = self.config.controller, self.curves
        return {
            "schema_version": 1,
            "controller": controller.name,
            "gains": gains_in_force(self.config),
            "reference_slip": controller.reference_slip,
            "slips": [self.case.slips[0].slip, self.case.slips[-1].slip],
            "parameters": self.config.model.parameters,
            "uncertain": {one.name: [one.low, one.high] for one in self.box.spreads},
            "g_positive": all(one.g_positive for one in self.case.slips),
            "eps_g": finite(curves["eps_g"].max()),
            "mq_25_per_s": finite(curves["mq_25_per_s"].max()),
            "mq_26_per_s": finite(curves["mq_26_per_s"].max()),
            "mq_25_times_speed_rad_s2": finite((curves["mq_25_per_s"] * curves["road_speed_rad_s"]).max()),
            "fails_25_rad_s": [list(one) for one in self.fails_25],
            "fails_26_rad_s": [list(one) for one in self.fails_26],
            "brake_limit": self.case.brake_limit,
            "largest_torque_nm": self.case.limit_nm,
            "reaching": [{key: finite(value) for key, value in way._asdict().items()} for way in self.reaching],
            "brake": None if self.brake is None else self.brake._asdict(),
            "loop": [{key: finite(value) for key, value in row._asdict().items()} for row in self.balances],
            "advice": [one._asdict() for one in self.advice],
            "curves": {name: [finite(value) for value in values] for name, values in curves.items()},
        }


def judge_gains(
    config: RigConfig,
    box: Box,
    speeds: tuple[float, float],
    slip_band: tuple[float, float] | None = None,
    from_slips: Sequence[float] = (0.0,),
    brake: Brake | None = None,
) -> Assessment:
    """Assess the configured gains over road speeds from..to, rad/s, both above 0.

    The conditions of sliding are those at the reference slip, or at the worst slip of a band; the torques are those
    that hold the reference. With a `brake`, limit cycles of the loop are assessed, too. Raises ConfigError for a
    controller without a switching gain, a box with impossible rigs, or an estimator that models the brake itself.
    """
    gains, low, high = gains_of(config), *speeds
    reference = AtSlip(box, config.controller.reference_slip)
    band = [AtSlip(box, slip) for slip in np.linspace(*slip_band, _SLIPS).tolist()] if slip_band else [reference]
    case = Case(
        gains=gains,
        nominal=box.nominal,
        reference=reference,
        slips=tuple(band),
        speeds=np.linspace(low, high, max(_FEWEST_SPEEDS, math.ceil(high - low) + 1)),
        brake_limit=config.guard.brake_limit,
        period_s=config.period_ns * 1e-9,
    )
    ways = [reaching(config, slip, gains.width, gains.time_bound(slip, reference.slip)) for slip in from_slips]
    rows = balances(config, case, brake) if brake is not None else []
    return Assessment(
        config,
        box,
        case,
        curves=_curves(case),
        fails_25=where_lost(case.margin_25, case.speeds),
        fails_26=where_lost(case.margin_26, case.speeds),
        reaching=ways,
        advice=[*advice(case, ways), *cycle_advice(case, rows)],
        brake=brake,
        balances=rows,
    )


def _curves(case: Case) -> dict[str, Floats]:
    """Values over the road speed."""
    x2, reference = case.speeds, case.reference
    bounds: Bounds = case.bounds(x2)
    holding = reference.holding_torques(x2)
    g, torque_eq, swing_nm = reference.g(x2), case.torque_eq(x2), case.torque_swing(x2)
    chatters = layer_step(case, x2) >= 2.0 if case.gains.width > 0.0 else True
    return {
        "road_speed_rad_s": x2,
        "f_per_s": reference.f(x2),
        "g_per_s_nm": g,
        "F_per_s": bounds.F,
        "eps_f_per_s": bounds.eps_f,
        "eps_g": bounds.eps_g,
        "mq_25_per_s": bounds.mq_25,
        "mq_26_per_s": bounds.mq_26,
        "mq_per_s": case.gains.switching(x2),
        "mq_unsaturated_per_s": g * np.minimum(torque_eq, case.limit_nm - torque_eq),
        "torque_eq_nm": torque_eq,
        "torque_eq_least_nm": holding[0],
        "torque_eq_most_nm": holding[1],
        "torque_swing_nm": swing_nm,
        "torque_ripple_nm": swing_nm * chatters,
        "slip_ripple_rms": case.gains.switching(x2) * case.period_s / 2.0 * chatters,
    }
