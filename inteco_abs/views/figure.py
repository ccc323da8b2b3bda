"""A stop as a figure: speeds, slip, torque and duty, as in the paper's three panels."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from inteco_abs.errors import AbsError, ConfigError, Mistake
from inteco_abs.sessions import Session
from inteco_abs.signals import Phase

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73")
"""Blue, red and green of Okabe and Ito: distinct for every kind of colour vision."""
_WHEEL, _ROAD, _OTHER = COLOURS
FORMATS: Final = ("png", "svg", "pdf")
_BEFORE_S: Final = 0.2


def check_figure(path: Path) -> None:
    """Refuse a path whose figure cannot be drawn; raises ConfigError, or AbsError without matplotlib."""
    if path.suffix.removeprefix(".") not in FORMATS:
        raise ConfigError([Mistake("--figure", f"{path}: must end in .{', .'.join(FORMATS)}")])
    if not path.parent.is_dir():
        raise ConfigError([Mistake("--figure", f"{path}: the folder {path.parent} does not exist; create it first")])
    insist_on_matplotlib()


def insist_on_matplotlib() -> None:
    """Raise AbsError if there is none."""
    if importlib.util.find_spec("matplotlib") is None:
        raise AbsError("figures need matplotlib: pip install 'inteco-abs[figures]'")


def draw_stop(session: Session, path: Path) -> None:
    """Draw the braking part of `session` to `path` (.png, .svg or .pdf); raises AbsError if it has none."""
    check_figure(path)
    from matplotlib.figure import Figure  # noqa: PLC0415  heavy, and an extra

    ticks = session.ticks
    phases = np.flatnonzero((ticks["phase"] == Phase.BRAKING) | (ticks["phase"] == Phase.STOPPED))
    if not len(phases):
        raise AbsError(f"{session.path}: the run ended before braking; there is nothing to draw")
    start_ns = int(ticks["time_ns"][phases[0]])
    end_s = float((int(ticks["time_ns"][phases[-1]]) - start_ns) * 1e-9)
    figure = Figure(figsize=(7.0, 7.2), layout="constrained")
    axes = figure.subplots(3, sharex=True)
    _speeds(axes[0], session, start_ns)
    _slip(axes[1], session, start_ns)
    _brake(axes[2], session, start_ns)
    for panel in axes:
        panel.grid(alpha=0.3)
        panel.legend(loc="upper right", frameon=False, fontsize="small")
        panel.set_xlim(-_BEFORE_S, end_s)
    axes[2].set_xlabel("time since braking began [s]")
    controller = session.metadata.get("controller", {})
    figure.suptitle(f"{controller.get('name', '')} on {controller.get('estimator', '')}", fontsize="medium")
    save_figure(figure, path)


def save_figure(figure: Figure, path: Path) -> None:
    """Write `figure` in the format of its name, undated as PNG or PDF; raises AbsError if that fails."""
    undated: dict[str, Any] = {"CreationDate": None} if path.suffix == ".pdf" else {}
    try:
        figure.savefig(path, dpi=150, metadata=undated)
    except OSError as error:
        raise AbsError(f"{path}: the figure cannot be written: {error.strerror}") from error


def _seconds(rows: Any, start_ns: int) -> Any:
    return (rows["time_ns"].astype(np.int64) - start_ns) * 1e-9


def _speeds(panel: Axes, session: Session, start_ns: int) -> None:
    time_s = _seconds(session.ticks, start_ns)
    panel.plot(time_s, session.ticks["road_speed_rad_s"], color=_ROAD, lw=1.2, label="road wheel (car)")
    panel.plot(time_s, session.ticks["wheel_speed_rad_s"], color=_WHEEL, lw=1.2, label="braked wheel")
    panel.set_ylabel("speed [rad/s]")
    panel.set_ylim(bottom=0.0)


def _slip(panel: Axes, session: Session, start_ns: int) -> None:
    ticks = session.ticks
    time_s = _seconds(ticks, start_ns)
    panel.plot(time_s, ticks["slip"], color=_WHEEL, lw=0.8, alpha=0.6, label="slip, estimated")
    if len(session.truth):
        panel.plot(_seconds(session.truth, start_ns), session.truth["slip"], color=_ROAD, lw=1.2, label="slip, true")
    panel.plot(time_s, ticks["slip_reference"], color="black", lw=1.0, ls="--", label="reference")
    panel.set_ylabel("slip [1]")
    panel.set_ylim(0.0, 1.02)


def _brake(panel: Axes, session: Session, start_ns: int) -> None:
    time_s = _seconds(session.ticks, start_ns)
    panel.plot(time_s, session.ticks["torque_demand_nm"], color=_WHEEL, lw=0.8, alpha=0.6, label="torque, asked")
    if len(session.truth):
        truth = session.truth
        panel.plot(_seconds(truth, start_ns), truth["brake_torque_nm"], color=_ROAD, lw=1.2, label="torque, true")
    panel.set_ylabel("brake torque [N m]")
    panel.set_ylim(-0.2, 10.0)
    duty = panel.twinx()
    duty.plot(time_s, session.ticks["brake"], color=_OTHER, lw=0.8, label="brake duty")
    duty.set_ylabel("brake duty [1]", color=_OTHER)
    duty.set_ylim(-0.02, 1.0)
