"""Figure of an assessment over the road speed: required gain, torque of the brake, uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from inteco_abs.views.figure import COLOURS, new_figure, require_matplotlib

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BLUE, _RED, _GREEN = COLOURS


def figure_of_design(report: Mapping[str, Any]) -> Figure:
    """The report of an assessment, readable in grey, without infinite values. Raises AbsError without matplotlib."""
    require_matplotlib()
    from matplotlib.ticker import LogLocator  # noqa: PLC0415  heavy, and an extra

    curves = {name: np.array(values, float) for name, values in report["curves"].items()}
    figure = new_figure(8.4, 7.2)
    axes = figure.subplots(3, sharex=True)
    _gain(axes[0], curves)
    _torque(axes[1], curves, report["largest_torque_nm"])
    _uncertainty(axes[2], curves)
    speeds = curves["road_speed_rad_s"]
    for panel in axes:
        panel.grid(alpha=0.3)
        panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize="small")
        panel.set_xlim(speeds[0], speeds[-1])
    for panel in (axes[0], axes[2]):
        if not panel.dataLim.y1 > 0.0:
            continue  # without uncertainty and gain, a logarithmic axis has no range
        panel.set_yscale("log")
        panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.yaxis.set_major_formatter("{x:g}")
        panel.yaxis.set_minor_formatter("")
    axes[2].set_xlabel("road speed [rad/s]")
    gains = ", ".join(f"{name} = {value:g}" for name, value in report["gains"].items())
    figure.suptitle(f"{report['controller']}, {gains}", fontsize="medium")
    return figure


def _gain(panel: Axes, curves: Mapping[str, Any]) -> None:
    x = curves["road_speed_rad_s"]
    panel.plot(x, curves["mq_26_per_s"], color=_BLUE, lw=1.2, ls="--", label="minimum by (26)")
    panel.plot(x, curves["mq_25_per_s"], color=_BLUE, lw=1.2, label="minimum by (25)")
    panel.plot(x, curves["mq_per_s"], color=_RED, lw=2.0, ls="-.", label="given")
    panel.set_ylabel("Mq [1/s]")


def _torque(panel: Axes, curves: Mapping[str, Any], limit_nm: float) -> None:
    x, held, swing = curves["road_speed_rad_s"], curves["torque_eq_nm"], curves["torque_swing_nm"]
    least, most = curves["torque_eq_least_nm"], curves["torque_eq_most_nm"]
    panel.fill_between(x, least, most, color=_GREEN, alpha=0.3, lw=0.0, label="holds the slip, whole set")
    panel.plot(x, held, color=_GREEN, lw=1.2, label="M1eq, nominal")
    panel.plot(x, held + swing, color=_RED, lw=1.2, ls="-.", label="M1eq ± Mq/g")
    panel.plot(x, held - swing, color=_RED, lw=1.2, ls="-.")
    panel.axhline(limit_nm, color="black", lw=1.0, ls="--", label="brake at its duty limit")
    panel.axhline(0.0, color="black", lw=1.0)
    panel.set_ylabel("brake torque [N m]")


def _uncertainty(panel: Axes, curves: Mapping[str, Any]) -> None:
    x = curves["road_speed_rad_s"]
    panel.plot(x, curves["F_per_s"], color=_BLUE, lw=1.2, ls="--", label="F [1/s]")
    panel.plot(x, curves["eps_f_per_s"], color=_BLUE, lw=1.2, label="eps_f [1/s]")
    panel.plot(x, curves["eps_g"], color=_RED, lw=1.2, ls="-.", label="eps_g [1]")
    panel.set_ylabel("largest |f_hat|, errors")
