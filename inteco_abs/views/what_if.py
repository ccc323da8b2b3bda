"""A session compared with alternatives: their commands on its counts, and their simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from inteco_abs.analysis import Continuation, WhatIf, braking_start, since_braking_s
from inteco_abs.errors import ConfigError
from inteco_abs.quantities import shown
from inteco_abs.sessions import Session
from inteco_abs.signals import Phase
from inteco_abs.views.comparison import PALETTE
from inteco_abs.views.figure import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST: Final = 7
"""Alternatives that a figure can distinguish."""
_COLOURS: Final = (*PALETTE, "#f0e442")
_PANELS: Final = (
    ("slip", "slip", (0.0, 1.02)),
    ("torque_demand_nm", "demanded torque [N m]", (-0.5, 12.0)),
    ("brake_request", "requested brake duty", (-0.02, 1.05)),
)
_LEGEND_LETTERS: Final = 110
_HANDLE_LETTERS: Final = 6
"""Of a line of the legend, and of those what a line's sample takes."""
_MARGIN_S: Final = 0.1
_REQUESTS: Final = {"slip": "slip, 1", "torque_demand_nm": "torque, N m", "brake_request": "brake duty, 1"}
_PHASES: Final = {"spin-up": "SPIN_UP", "braking": "BRAKING", "stopped": "STOPPED"}
_CARD: Final = {
    "reaching_time_s": "reached\ns",
    "stop_time_s": "stop\ns",
    "stop_distance_m": "stop\nm",
    "slip_rms_true": "slip RMS\ntrue",
    "slip_rms_estimated": "slip RMS\nestim.",
    "lock_fraction": "locked\n1",
    "duty_variation_per_s": "duty\n1/s",
}
"""Headings with units of keys of the result card."""


@dataclass(frozen=True, slots=True)
class WhatIfTrace:
    """One alternative to draw."""

    name: str
    open_loop: WhatIf
    closed_loop: Continuation | None


def render_what_if(report: Mapping[str, Any]) -> RenderableType:
    """When and how far each alternative leaves the log, and its simulated result if there is one."""
    parts: list[RenderableType] = [_divergences(report["alternatives"])]
    if "simulation" in report:
        parts.append(_simulated(report["simulation"]["log"], report["alternatives"]))
        ends = ((each["name"], each["closed_loop"]["reason"]) for each in report["alternatives"])
        parts += [Text(f"{name}: ends in the fault {reason}", "red") for name, reason in ends if reason != "NONE"]
    return Group(*parts)


def _divergences(alternatives: Sequence[Mapping[str, Any]]) -> Table:
    table = Table(title="commands on the logged counts, compared with the log", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("alternative", overflow="fold")
    for heading in ("leaves log\nafter s", "largest\ndifference", *(f"rms\n{name}" for name in _PHASES)):
        table.add_column(heading, justify="right", no_wrap=True)
    for each in alternatives:
        table.add_row(Text(each["name"]))
        for field in each["open_loop"]:
            # slip is estimated, not commanded, and has no threshold
            never = "never" if field["time_s"] is None else f"{field['time_s']:.4f}"
            left = "" if field["threshold"] is None else never
            numbers = (field["largest"], *(field["rms"].get(phase) for phase in _PHASES.values()))
            table.add_row(f"  {_REQUESTS[field['field']]}", left, *map(shown, numbers))
    return table


def _simulated(log: Mapping[str, Any], alternatives: Sequence[Mapping[str, Any]]) -> Table:
    table = Table(title="simulated from there on", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("alternative", overflow="fold")
    for heading in _CARD.values():
        table.add_column(heading, justify="right", no_wrap=True)
    for name, card in (("log", log), *((each["name"], each["closed_loop"]["card"]) for each in alternatives)):
        table.add_row(Text(name), *(shown(card[key]) for key in _CARD))
    return table


def figure_of_what_if(session: Session, alternatives: Sequence[WhatIfTrace]) -> Figure:
    """Log and alternatives. Raises ConfigError for more than MOST, AbsError without matplotlib.

    An open loop is faint after it leaves the log, where the rig would have reacted. A closed loop, dashed, is a
    simulation.
    """
    require_few(len(alternatives))
    since_s = since_braking_s(session)
    figure = new_figure(7.0, 7.6)
    axes: Sequence[Axes] = figure.subplots(len(_PANELS), sharex=True)
    for panel, (field, label, limits) in zip(axes, _PANELS, strict=True):
        panel.plot(since_s, session.ticks[field], color="black", lw=1.4, label="log")
        for alternative, colour in zip(alternatives, _COLOURS, strict=False):
            _open_loop(panel, alternative, field, since_s, colour)
            if alternative.closed_loop is not None:
                _closed_loop(panel, session, alternative.closed_loop, field, colour)
        panel.set_ylabel(label)
        panel.set_ylim(*limits)
        panel.grid(alpha=0.3)
    braking_s = since_s[session.ticks["phase"] == Phase.BRAKING]
    axes[-1].set_xlim(-_MARGIN_S, float(braking_s[-1]) + _MARGIN_S)  # later, slip is encoder noise
    axes[-1].set_xlabel("time since braking began [s]")
    handles, labels = axes[0].get_legend_handles_labels()
    columns = min(max(_LEGEND_LETTERS // (_HANDLE_LETTERS + max(map(len, labels))), 1), 3)
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, frameon=False, fontsize="small")
    return figure


def require_few(count: int) -> None:
    """Raise ConfigError for more alternatives than a figure can distinguish."""
    if count > _MOST:
        problem = f"{count} alternatives: a figure shows at most {_MOST}; try fewer values"
        raise ConfigError.of("--figure", problem)


def _open_loop(panel: Axes, alternative: WhatIfTrace, field: str, since_s: Any, colour: str) -> None:
    requests = alternative.open_loop.requests
    if requests is None:
        raise ValueError(f"the requests of {alternative.name} were not kept: what_if(..., keep=True)")
    horizon_s, values = alternative.open_loop.horizon_s, requests[field]
    left = since_s >= (np.inf if horizon_s is None else horizon_s)
    panel.plot(since_s[~left], values[~left], color=colour, lw=0.9)
    name = f"{alternative.name}, on the logged counts"
    panel.plot(since_s[left], values[left], color=colour, lw=0.7, alpha=0.35, label=name)


def _closed_loop(panel: Axes, session: Session, closed: Continuation, field: str, colour: str) -> None:
    if closed.ticks is None:
        raise ValueError("the simulated ticks were not kept: continued(..., keep=True)")
    _, start_ns = braking_start(session)
    ticks = closed.ticks[closed.row :]
    time_s = (ticks["time_ns"].astype(np.int64) - start_ns) * 1e-9
    panel.plot(time_s, ticks[field], color=colour, lw=1.1, ls="--", label="the same, simulated")
