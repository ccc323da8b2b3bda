"""The page of a folder: it loads nothing else, and only its own script runs in it."""

from __future__ import annotations

import importlib.util
import secrets
from collections.abc import Mapping, Sequence
from importlib import resources
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from inteco_abs.errors import AbsError, ConfigError, SessionError
from inteco_abs.sessions import check_output, open_session, write_file
from inteco_abs.signals import Phase
from inteco_abs.version import __version__
from inteco_abs.views.decimation import decimate

_RESULTS: Final = ("slip_rms_true", "slip_rms_estimated", "band_entry_s", "stop_time_s", "stop_distance_m")
_SHOWN: Final = ("session", "started_utc", "outcome", "controller", "estimator", "board", "rig")
_SPARK_PX, _SPARK_POINTS, _MOST_BLOCKS = (120, 24), 60, 20
_AXIS_PX, _HEIGHT_PX = 150, 240


class _Axis(NamedTuple):
    """An axis of the parallel coordinates, from `least` at its bottom to `most`."""

    name: str
    x: float
    least: float
    most: float

    def y(self, value: float) -> float:
        span = self.most - self.least
        return round(_HEIGHT_PX * (1.0 - (value - self.least) / span if span else 0.5), 1)


def check_listing(path: Path) -> None:
    """Check that a new page can be written to `path`. Raises ConfigError, SessionError, or AbsError without jinja2."""
    if path.suffix != ".html":
        raise ConfigError.of("--html", f"{path}: must end in .html")
    check_output(path, "--html")
    if importlib.util.find_spec("jinja2") is None:
        raise AbsError("a page needs jinja2: pip install 'inteco-abs[report]'")


def write_listing(rows: Sequence[Mapping[str, Any]], path: Path, columns: Sequence[str] = ()) -> None:
    """Write the page about `rows` of `session_rows` to the new file `path`, with these `columns` beside the results.

    Raises the errors of `check_listing`.
    """
    check_listing(path)
    from jinja2 import Environment, StrictUndefined  # noqa: PLC0415  an extra
    from markupsafe import Markup  # noqa: PLC0415  comes with it

    axes = _axes(rows)
    shown = [*(columns or _SHOWN), *(axis.name for axis in axes if axis.name not in columns)]
    sheet = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    files = resources.files("inteco_abs.views.listing")
    page = sheet.from_string(files.joinpath("page.html").read_text(encoding="utf-8")).render(
        version=__version__,
        columns=shown,
        rows=[[row.get(name) for name in shown] for row in rows],
        sparks=[_spark(Path(row["session"])) for row in rows],
        spark_px=_SPARK_PX,
        axes=axes,
        lines=[_line(row, axes) for row in rows],
        width=_AXIS_PX * (len(axes) + 1),
        height=_HEIGHT_PX,
        script=Markup(files.joinpath("page.js").read_text(encoding="utf-8")),  # noqa: S704  ours
        nonce=secrets.token_urlsafe(16),
    )
    write_file(path, page.encode())


def _axes(rows: Sequence[Mapping[str, Any]]) -> list[_Axis]:
    """Gains and settings that differ, then results; each has two numbers at least."""
    gains = dict.fromkeys(name for row in rows for name in (row.get("gains") or "").split(", ") if name)
    found = list[_Axis]()
    for name in (*gains, "reference_slip", *_RESULTS):
        values = [row[name] for row in rows if isinstance(row.get(name), int | float)]
        if len({*values}) > 1:
            found.append(_Axis(name, (len(found) + 0.5) * _AXIS_PX, min(values), max(values)))
    return found


def _line(row: Mapping[str, Any], axes: Sequence[_Axis]) -> str:
    """Points of a row's line, where it has a number."""
    known = [axis for axis in axes if isinstance(row.get(axis.name), int | float)]
    return " ".join(f"{axis.x},{axis.y(row[axis.name])}" for axis in known)


def _spark(file: Path) -> str:
    """Points of the slip from the beginning of the first braking on, true where it is known; empty without braking."""
    times, slips = list[Any](), list[Any]()
    try:
        for ticks, truth in islice(open_session(file).blocks(), _MOST_BLOCKS):
            braking = ticks["phase"] == Phase.BRAKING
            if braking.any():
                time_ns = ticks["time_ns"][braking]
                source = truth if len(truth) else ticks
                inside = (source["time_ns"] >= time_ns[0]) & (source["time_ns"] <= time_ns[-1])
                times.append(source["time_ns"][inside].astype(float))
                slips.append(source["slip"][inside])
            if times and not braking[-1:].any():
                break
    except SessionError:
        return ""
    if not times or not len(times[0]):
        return ""
    time_s = (np.concatenate(times) - times[0][0]) * 1e-9
    columns = {"slip": np.nan_to_num(np.clip(np.concatenate(slips), 0.0, 1.0))}
    drawn = decimate(columns, time_s, np.zeros(len(time_s), bool), _SPARK_POINTS)
    width, height = _SPARK_PX
    x = drawn.time_s / max(float(time_s[-1]), 1e-9) * width
    y = height * (1.0 - drawn.columns["slip"])
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
