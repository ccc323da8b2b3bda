"""Stops as a figure for a paper, in the paper's three panels: speeds, slip and brake torque."""

from __future__ import annotations

import importlib.util
import math
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from inteco_abs.errors import AbsError, ConfigError, describe_disk
from inteco_abs.format import TICK, TRUTH
from inteco_abs.sessions import Session, atomic_write, check_output
from inteco_abs.views.comparison import PALETTE, changes_s, held_spans, labels, require_distinct, since_s, start_ns
from inteco_abs.views.decimation import Decimator

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS: Final = PALETTE[:3]
"""Blue, red and green of Okabe and Ito: distinct for every kind of colour vision."""
_WHEEL, _ROAD, _OTHER = COLOURS
FORMATS: Final = ("png", "svg", "pdf")
_DASHES: Final = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (5, 1.5, 1, 1.5)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)))
"""One for each colour of the palette, for prints in grey."""
_BEFORE_S: Final = 0.2
_MM_PER_INCH: Final = 25.4
_TRUETYPE: Final = 42
"""Font type in a PDF that journals accept."""
_DPI: Final = 300
_PRINTED_POINTS: Final = 1200
_DRAWN_POINTS: Final = 100_000
"""Points of each line in a file; without a limit, many stops in one session take gigabytes."""
_DRAWN: Final[Sequence[str]] = (
    "wheel_speed_rad_s", "road_speed_rad_s", "slip", "slip_reference", "torque_demand_nm", "brake", "brake_torque_nm",
)  # fmt: skip
_AT_REST_RAD_S: Final = 1.0
"""Road speed below which slip is not drawn: both speeds are a few counts."""
_ROLLING_RAD_S: Final = 10.0
"""Road speed and slip for a locked wheel, as in the result card's `lock_fraction`."""
_LOCKED: Final = 0.9
_WHOLE_SLIP: Final = 1.02
_SLIP_AIR: Final = 1.2
_SLIP_STEP: Final = 0.05
_SALT: Final = "inteco-abs"
"""Fixes names inside an SVG, which are otherwise random."""


Array = npt.NDArray[Any]


class FigureSize(NamedTuple):
    """Size of a figure, its font, and letters in a line of its labels."""

    width_mm: float
    height_mm: float
    font_pt: float
    label_letters: int


WIDTHS: Final = {"one": FigureSize(88.0, 135.0, 7.0, 56), "two": FigureSize(180.0, 165.0, 8.0, 115)}
"""Sizes by number of columns on a journal's page."""


class _DrawnSession(NamedTuple):
    """A session to draw, and the start and end of its time axis."""

    ticks: Array
    truth: Array
    label: str
    start_ns: int
    end_s: float


def check_figure(path: Path, option: str = "--figure") -> None:
    """Check that a new figure can be written to `path`, given with `option`.

    Raises ConfigError, SessionError if the folder cannot be written to, or AbsError without matplotlib.
    """
    if path.suffix.removeprefix(".") not in FORMATS:
        raise ConfigError.of(option, f"{path}: must end in .{', .'.join(FORMATS)}")
    check_output(path, option)
    require_matplotlib()


def require_matplotlib() -> None:
    """Raise AbsError without matplotlib."""
    if importlib.util.find_spec("matplotlib") is None:
        raise AbsError("figures need matplotlib: pip install 'inteco-abs[figures]'")


def new_figure(width_inch: float, height_inch: float) -> Figure:
    """An empty matplotlib figure, which a notebook shows. Raises AbsError without matplotlib."""
    require_matplotlib()
    from inteco_abs.views.inline_figure import InlineFigure  # noqa: PLC0415  heavy, and an extra

    return InlineFigure((width_inch, height_inch), layout="constrained")


def draw_stops(sessions: Sequence[Session], path: Path, width: str = "two") -> None:
    """Draw the braking part of `sessions` to `path` (.png, .svg or .pdf); `width` is one of `WIDTHS`.

    One session is drawn with all curves of each panel; of several, a legend names what differs. The same sessions give
    the same file. Raises ConfigError for too many sessions, AbsError if one never braked, or without matplotlib.
    """
    check_figure(path)
    save_figure(figure_of(sessions, width), path, _DPI)


def figure_of(sessions: Sequence[Session], width: str = "two") -> Figure:
    """The figure of `draw_stops` as a matplotlib object. Raises the same errors."""
    require_matplotlib()
    if width not in WIDTHS:
        raise ConfigError.of("width", f"{width!r}: must be one of {', '.join(WIDTHS)}")
    require_distinct(sessions)
    with _style(WIDTHS[width]):
        return _drawn(sessions, WIDTHS[width])


def svg_of(sessions: Sequence[Session]) -> bytes:
    """Return the figure as SVG, two columns wide, decimated for print. Raises AbsError."""
    require_matplotlib()
    with _style(WIDTHS["two"]):
        data = BytesIO()
        _drawn(sessions, WIDTHS["two"], _PRINTED_POINTS).savefig(data, format="svg", metadata={"Date": None})
        return data.getvalue()


def save_figure(figure: Figure, path: Path, dpi: float = 150.0) -> None:
    """Write `figure` in the format of its suffix, without date and reproducibly. Raises AbsError."""
    from matplotlib import rc_context  # noqa: PLC0415  heavy, and an extra

    undated: dict[str, dict[str, Any]] = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    try:
        with rc_context({"svg.hashsalt": _SALT, "pdf.fonttype": _TRUETYPE}):
            form, metadata = path.suffix.removeprefix("."), undated.get(path.suffix, {})
            with atomic_write(path) as part:
                figure.savefig(part, format=form, dpi=dpi, metadata=metadata)
    except OSError as error:
        raise AbsError(f"{path}: the figure cannot be written: {describe_disk(error)}") from error


@contextmanager
def _style(width: FigureSize) -> Iterator[None]:
    from matplotlib import rc_context  # noqa: PLC0415  heavy, and an extra

    with rc_context({"font.size": width.font_pt, "axes.linewidth": 0.6}):
        yield


def _drawn(sessions: Sequence[Session], width: FigureSize, most: int = _DRAWN_POINTS) -> Figure:
    """The figure, with lines of about `most` points."""
    parts = [_part(session, label, most) for session, label in zip(sessions, labels(sessions), strict=True)]
    figure = new_figure(width.width_mm / _MM_PER_INCH, width.height_mm / _MM_PER_INCH)
    axes = figure.subplots(3, sharex=True)
    if len(parts) == 1:
        _alone(axes, parts[0])
        figure.suptitle(_wrapped(parts[0].label, width), fontsize="medium", parse_math=False)
    else:
        _compared(axes, parts)
        _name_sessions(figure, axes[0], parts, width)
    _mark_changes(axes, sessions)
    axes[0].set_ylabel("speed [rad/s]")
    axes[0].set_ylim(bottom=0.0)
    axes[1].set_ylim(0.0, slip_top(highest_slip(rows) for part in parts for rows in _slip_rows(part, parts)))
    axes[2].set_ylim(-0.2, 10.0)
    axes[2].set_xlabel("time since braking began [s]")
    for panel in axes:
        panel.grid(alpha=0.3)
        if panel.get_legend_handles_labels()[0]:
            panel.legend(loc="upper right", frameon=False, fontsize="small")
        panel.set_xlim(-_BEFORE_S, max(part.end_s for part in parts))
    return figure


def _mark_changes(axes: Sequence[Axes], sessions: Sequence[Session]) -> None:
    """A line at each time at which a gain changed, in the session's colour if there are several."""
    label = "gain changed"
    for session, colour in zip(sessions, PALETTE if len(sessions) > 1 else ("black",), strict=False):
        if times_s := changes_s(session):
            looks: dict[str, Any] = {"colors": colour, "lw": 0.6, "ls": (0, (1, 2))}
            for panel in axes:
                whole = panel.get_xaxis_transform()
                panel.vlines(times_s, 0.0, 1.0, transform=whole, label=label if panel is axes[2] else "", **looks)
            label = ""


def slip_top(highest: Iterable[float]) -> float:
    """Upper end of the slip axis for stops with these highest slips.

    1.02 if a wheel locked, else a fifth above the largest, so that a stop that holds its reference is not a thin line.
    """
    most = max(highest, default=0.0)
    if not 0.0 < most <= _LOCKED:
        return _WHOLE_SLIP
    return min(_SLIP_STEP * math.ceil(_SLIP_AIR * most / _SLIP_STEP), _WHOLE_SLIP)


def highest_slip(rows: Array) -> float:
    """Largest slip and reference of ticks or truths above 10 rad/s of road speed; near standstill slip is noise."""
    rolling, highest = rows[rows["road_speed_rad_s"] > _ROLLING_RAD_S], 0.0
    for name in ("slip", "slip_reference"):
        if name in (rows.dtype.names or ()):
            highest = float(np.fmax.reduce(rolling[name], initial=highest))
    return highest


def _slip_rows(part: _DrawnSession, parts: Sequence[_DrawnSession]) -> Iterator[Array]:
    """Rows shown in the slip panel: estimated and true of one session; of several, one of the two."""
    drawn = [part.ticks]
    if len(parts) == 1:
        drawn.append(part.truth)
    elif _true(parts):
        drawn = [part.truth, part.ticks[["time_ns", "road_speed_rad_s", "slip_reference"]]]
    for rows in drawn:
        yield rows[_shown(rows, part.start_ns, part.end_s)]


def _true(parts: Sequence[_DrawnSession]) -> bool:
    """Whether true slip and torque are known for all sessions."""
    return all(len(part.truth) for part in parts)


def _slip(rows: Array) -> Array:
    """Slip; NaN where the road wheel is about at rest."""
    return np.where(rows["road_speed_rad_s"] >= _AT_REST_RAD_S, rows["slip"], np.nan)


def _part(session: Session, label: str, most: int) -> _DrawnSession:
    held = held_spans(session)
    if not held:
        raise AbsError(f"{session.path}: the run ended before braking; there is nothing to draw")
    start = start_ns(session)
    end_s = float((held[-1].last_ns - start) * 1e-9)
    if max(session.tick_count, session.truth_count) <= most:
        return _DrawnSession(session.ticks, session.truth, label, start, end_s)
    numbers = [0, 0]
    for block in session.blocks():
        for at, rows in enumerate(block):
            numbers[at] += int(_shown(rows, start, end_s).sum())
    names = [[name for name in _DRAWN if name in (message.dtype.names or ())] for message in (TICK, TRUTH)]
    thinned = [Decimator(of, 0, number, most) for of, number in zip(names, numbers, strict=True)]
    for block in session.blocks():
        for rows, of, decimator in zip(block, names, thinned, strict=True):
            shown = rows[_shown(rows, start, end_s)]
            decimator.add({name: shown[name] for name in of}, since_s(shown, start), np.zeros(len(shown), bool))
    ticks, truth = (
        _few(message.dtype, decimator, start) for message, decimator in zip((TICK, TRUTH), thinned, strict=True)
    )
    return _DrawnSession(ticks, truth, label, start, end_s)


def _shown(rows: Array, start: int, end_s: float) -> Array:
    time_s = since_s(rows, start)
    shown: Array = (time_s >= -_BEFORE_S) & (time_s <= end_s)
    return shown


def _few(dtype: np.dtype[np.void], decimator: Decimator, start: int) -> Array:
    """The points as rows."""
    thinned = decimator.decimated()
    few = np.zeros(len(thinned.time_s), dtype)
    few["time_ns"] = np.rint(thinned.time_s * 1e9).astype(np.int64) + start
    for name, values in thinned.columns.items():
        few[name] = values
    return few


def _wrapped(label: str, width: FigureSize) -> str:
    return textwrap.fill(label, width.label_letters, max_lines=2, placeholder=" ...")


def _alone(axes: Sequence[Axes], part: _DrawnSession) -> None:
    ticks, truth = part.ticks, part.truth
    time_s, truth_s = since_s(ticks, part.start_ns), since_s(truth, part.start_ns)
    speeds, slip, torque = axes
    speeds.plot(time_s, ticks["road_speed_rad_s"], color=_ROAD, lw=1.2, label="road wheel (car)")
    speeds.plot(time_s, ticks["wheel_speed_rad_s"], color=_WHEEL, lw=1.2, ls="--", label="braked wheel")
    slip.plot(time_s, _slip(ticks), color=_WHEEL, lw=0.8, alpha=0.6, label="slip, estimated")
    torque.plot(time_s, ticks["torque_demand_nm"], color=_WHEEL, lw=0.8, alpha=0.6, label="torque, asked")
    if len(truth):
        slip.plot(truth_s, _slip(truth), color=_ROAD, lw=1.2, label="slip, true")
        torque.plot(truth_s, truth["brake_torque_nm"], color=_ROAD, lw=1.2, label="torque, true")
    slip.plot(time_s, ticks["slip_reference"], color="black", lw=1.0, ls="--", label="reference")
    slip.set_ylabel("slip [1]")
    torque.set_ylabel("brake torque [N m]")
    duty = torque.twinx()
    looks: dict[str, Any] = {"color": _OTHER, "lw": 0.8, "ls": ":"}
    duty.plot(time_s, ticks["brake"], label="brake duty", **looks)
    torque.plot([], [], label="brake duty, right axis", **looks)
    duty.set_ylabel("brake duty [1]", color=_OTHER)
    duty.set_ylim(-0.02, 1.0)


def _compared(axes: Sequence[Axes], parts: Sequence[_DrawnSession]) -> None:
    true = _true(parts)
    speeds, slip, torque = axes
    for part, colour, dash in zip(parts, PALETTE, _DASHES, strict=False):
        ticks = part.ticks
        time_s = since_s(ticks, part.start_ns)
        looks: dict[str, Any] = {"color": colour, "ls": dash}
        speeds.plot(time_s, ticks["road_speed_rad_s"], lw=1.4, **looks)
        speeds.plot(time_s, ticks["wheel_speed_rad_s"], lw=0.7, **looks)
        rows = part.truth if true else ticks
        rows_s = since_s(rows, part.start_ns)
        slip.plot(rows_s, _slip(rows), lw=1.0, **looks)
        torque.plot(rows_s, rows["brake_torque_nm" if true else "torque_demand_nm"], lw=1.0, **looks)
        slip.plot(time_s, ticks["slip_reference"], color="black", lw=0.8, ls=":")
    slip.get_lines()[-1].set_label("reference")
    slip.set_ylabel("slip, true [1]" if true else "slip, estimated [1]")
    torque.set_ylabel("brake torque, true [N m]" if true else "brake torque, asked [N m]")


def _name_sessions(figure: Figure, speeds: Axes, parts: Sequence[_DrawnSession], width: FigureSize) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415  heavy, and an extra

    looks = zip(parts, PALETTE, _DASHES, strict=False)
    lines = [Line2D([], [], color=colour, ls=dash, lw=1.4) for _, colour, dash in looks]
    names = [_wrapped(part.label, width) for part in parts]
    legend = figure.legend(lines, names, loc="outside upper center", frameon=False, fontsize="small", handlelength=4.0)
    for text in legend.get_texts():
        text.set_parse_math(False)  # a name is not a formula
    speeds.plot([], [], color="black", lw=1.4, label="road wheel (car)")
    speeds.plot([], [], color="black", lw=0.7, label="braked wheel")
