"""Layouts for viewers that open sessions: what belongs together in one plot, in the words of each viewer.

Columns come from the table of the tick, so one that was renamed cannot stay behind. Formats: Lichtblick 1.28 (layout
data, panels Plot, StateTransitions and Log, which it calls RosOut) and PlotJuggler 3.17 (layout 2.3.8, loader of MCAP,
parser of protobuf), as far as their sources tell (docs/facts/sessions.md#encodings).
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any, Final

from inteco_abs.errors import SessionError, describe_disk
from inteco_abs.format.schema import LOG_TOPIC, TICK, TRUTH, Column
from inteco_abs.sessions import atomic_write, check_output

_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73")
"""Blue, red and green of Okabe and Ito: distinct for every kind of colour vision."""
_COLUMNS: Final = {column.name: column for column in TICK.columns}


def _columns(*names: str) -> tuple[Column, ...]:
    return tuple(_COLUMNS[name] for name in names)


@dataclass(frozen=True, slots=True)
class _Plot:
    """Curves over time that share an axis."""

    name: str
    columns: tuple[Column, ...]
    limits: tuple[float, float] | None = None
    """Of the axis; None follows the data."""

    @property
    def title(self) -> str:
        """With the unit, which no viewer takes from the file; `1` is none."""
        unit = self.columns[0].unit
        return self.name if unit == "1" else f"{self.name} [{unit}]"


_DUTY: Final = (-0.02, 1.02)
_PLOTS: Final = (
    _Plot("speeds", _columns("wheel_speed_rad_s", "road_speed_rad_s")),
    _Plot("slip", _columns("slip", "slip_reference"), _DUTY),
    _Plot("switching function", _columns("switching")),
    _Plot("duties", _columns("brake", "brake_request", "drive"), _DUTY),
    _Plot("brake torque asked for", _columns("torque_demand_nm")),
    _Plot("timing", _columns("late_us", "io_us", "busy_us")),
)
_STATES: Final = _columns("phase", "reason", "stop_request")


def lichtblick() -> bytes:
    """Layout file for Lichtblick, and for Foxglove, whose layouts it shares: JSON."""
    plots = {f"Plot!{_word(plot.name)}": _lichtblick_plot(plot) for plot in _PLOTS}
    states: dict[str, Any] = {
        "isSynced": True,
        "paths": [_lichtblick_path(column) for column in _STATES],
        **_titled("phase and reasons"),
    }
    log = {"searchTerms": [], "minLogLevel": 1, "topicToRender": LOG_TOPIC, **_titled("events")}
    panels = {**plots, "StateTransitions!states": states, "RosOut!events": log}
    left, right = list(plots)[::2], list(plots)[1::2]
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _mosaic(
            "column",
            [
                _mosaic("row", [_mosaic("column", left), _mosaic("column", right)]),
                "StateTransitions!states",
                "RosOut!events",
            ],
            (60.0, 55.0),
        ),
    }
    return json.dumps(layout, indent=2).encode() + b"\n"


def _lichtblick_plot(plot: _Plot) -> dict[str, Any]:
    least, most = plot.limits or (None, None)
    limits = {} if plot.limits is None else {"minYValue": least, "maxYValue": most}
    return {
        "paths": [
            {**_lichtblick_path(column), "color": colour}
            for column, colour in zip(plot.columns, cycle(_COLOURS), strict=False)
        ],
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": False,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "sidebarDimension": 240,
        **limits,
        **_titled(plot.title),
    }


def _lichtblick_path(column: Column) -> dict[str, Any]:
    path = f"{TICK.topic}.{column.name}"
    return {"value": path, "label": column.name, "enabled": True, "timestampMethod": "receiveTime"}


def _titled(title: str) -> dict[str, str]:
    """A panel's title; the key carried Foxglove's name before."""
    return {"lichtblickPanelTitle": title, "foxglovePanelTitle": title}


def _mosaic(direction: str, children: Sequence[Any], percentages: Sequence[float] = ()) -> Any:
    """Tree of two branches each, with the children side by side (`row`) or one below the other (`column`)."""
    first, *rest = children
    if not rest:
        return first
    percentage = percentages[0] if percentages else 100.0 / len(children)
    second = _mosaic(direction, rest, percentages[1:])
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def plotjuggler() -> bytes:
    """Layout file for PlotJuggler: XML. It has no place for phases and reasons, whose names are not numbers to it."""
    root = ET.Element("root", version="2.3.8")
    widget = ET.SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    tab = ET.SubElement(widget, "Tab", tab_name="stop", containers="1")
    share = f"{1.0 / len(_PLOTS):.6f}"
    splitter = ET.SubElement(
        ET.SubElement(tab, "Container"),
        "DockSplitter",
        orientation="-",
        count=str(len(_PLOTS)),
        sizes=";".join([share] * len(_PLOTS)),
    )
    for plot in _PLOTS:
        _plotjuggler_plot(ET.SubElement(splitter, "DockArea", name=plot.title), plot)
    ET.SubElement(widget, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    # not the log: its field `timestamp` is a message, where the parser may expect a number
    topics = f"{TICK.topic};{TRUTH.topic}"
    loader = ET.SubElement(ET.SubElement(root, "Plugins"), "plugin", ID="DataLoad MCAP")
    ET.SubElement(
        loader,
        "parameters",
        selected_topics=topics,
        use_timestamp="0",
        use_mcap_log_time="0",
        clamp_large_arrays="1",
        max_array_size="500",
    )
    ET.indent(root)
    data: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return data + b"\n"


def _plotjuggler_plot(area: ET.Element, plot: _Plot) -> None:
    element = ET.SubElement(area, "plot", mode="TimeSeries", style="Lines", flip_x="false", flip_y="false")
    limits = {} if plot.limits is None else dict(zip(("min", "max"), map(str, plot.limits), strict=True))
    ET.SubElement(element, "limitY", limits)
    for column, colour in zip(plot.columns, cycle(_COLOURS), strict=False):
        ET.SubElement(element, "curve", name=f"{TICK.topic}/{column.name}", color=colour)


def _word(name: str) -> str:
    return name.replace(" ", "_")


VIEWERS: Final[Mapping[str, Callable[[], bytes]]] = {"lichtblick": lichtblick, "plotjuggler": plotjuggler}
"""Makes the layout for each viewer."""


def write_layout(viewer: str, out: Path) -> None:
    """Write the layout for one of `VIEWERS` to the new file `out`; raises ConfigError or SessionError if it cannot."""
    check_output(out)
    with atomic_write(out) as part:
        try:
            part.write_bytes(VIEWERS[viewer]())
        except OSError as error:
            raise SessionError(f"{out} cannot be written: {describe_disk(error)}") from error
