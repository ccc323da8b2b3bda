"""A session beside what others would have asked for on its counts, and what simulation makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from inteco_abs.sessions import Session
from inteco_abs.sessions.closed_loop import Continuation
from inteco_abs.sessions.what_if import WhatIf, braking_row, since_braking_s
from inteco_abs.signals import Phase
from inteco_abs.views.figure import check_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST: Final = 7
"""Alternatives that can be told apart."""
_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442")
"""Okabe and Ito: distinct for every kind of colour vision."""
_PANELS: Final = (
    ("slip", "slip [1]", (0.0, 1.02)),
    ("torque_demand_nm", "torque asked for [N m]", (-0.5, 12.0)),
    ("brake_wish", "brake duty asked for [1]", (-0.02, 1.05)),
)
_MARGIN_S: Final = 0.1


@dataclass(frozen=True, slots=True)
class Course:
    """One alternative to draw."""

    name: str
    open_loop: WhatIf
    closed_loop: Continuation | None


def draw_what_if(session: Session, courses: Sequence[Course], path: Path) -> None:
    """Draw log and alternatives to `path` (.png, .svg or .pdf).

    An open loop is faint from where it has left the log: there it is no longer what the rig would have seen. A
    closed loop, dashed, is a simulation.
    """
    check_figure(path)
    from matplotlib.figure import Figure  # noqa: PLC0415  heavy, and an extra

    since_s = since_braking_s(session)
    figure = Figure(figsize=(7.0, 7.6), layout="constrained")
    axes: Sequence[Axes] = figure.subplots(len(_PANELS), sharex=True)
    for panel, (field, label, limits) in zip(axes, _PANELS, strict=True):
        panel.plot(since_s, session.ticks[field], color="black", lw=1.4, label="log")
        for course, colour in zip(courses, _COLOURS, strict=False):
            _open_loop(panel, course, field, since_s, colour)
            if course.closed_loop is not None:
                _closed_loop(panel, session, course.closed_loop, field, colour)
        panel.set_ylabel(label)
        panel.set_ylim(*limits)
        panel.grid(alpha=0.3)
    braking_s = since_s[session.ticks["phase"] == Phase.BRAKING]
    axes[-1].set_xlim(-_MARGIN_S, float(braking_s[-1]) + _MARGIN_S)  # beyond, a slip is the encoders' trembling
    axes[-1].set_xlabel("time since braking began [s]")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False, fontsize="small")
    save_figure(figure, path)


def _open_loop(panel: Axes, course: Course, field: str, since_s: Any, colour: str) -> None:
    horizon_s, values = course.open_loop.horizon_s, course.open_loop.wishes[field]
    left = since_s >= (np.inf if horizon_s is None else horizon_s)
    panel.plot(since_s[~left], values[~left], color=colour, lw=0.9)
    name = f"{course.name}, on the logged counts"
    panel.plot(since_s[left], values[left], color=colour, lw=0.7, alpha=0.35, label=name)


def _closed_loop(panel: Axes, session: Session, closed: Continuation, field: str, colour: str) -> None:
    start_ns = int(session.ticks["time_ns"][braking_row(session)])
    ticks = closed.ticks[closed.row :]
    time_s = (ticks["time_ns"].astype(np.int64) - start_ns) * 1e-9
    panel.plot(time_s, ticks[field], color=colour, lw=1.1, ls="--", label="the same, simulated")
