"""Stops as a figure for a paper, in the paper's three panels: speeds, slip and brake torque."""

from __future__ import annotations

import importlib.util
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from inteco_abs.errors import AbsError, ConfigError, describe_disk
from inteco_abs.format import TICK, TRUTH
from inteco_abs.sessions import Array, Session, atomic_write, check_output
from inteco_abs.views.comparison import PALETTE, changes_s, held_spans, labels, require_distinct, since_s, start_ns
from inteco_abs.views.decimation import Decimator
from inteco_abs.views.envelope import plot_envelope
from inteco_abs.views.figure_options import FigureOptions

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS: Final = PALETTE[:3]
"""Blue, red and green of Okabe and Ito: distinct for every kind of colour vision."""
_WHEEL, _ROAD, _OTHER = COLOURS
FORMATS: Final = ("png", "svg", "pdf", "pgf")
_DASHES: Final = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (5, 1.5, 1, 1.5)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)))
"""One for each colour of the palette, for prints in grey."""
BEFORE_S: Final = 0.2
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
AT_REST_RAD_S: Final = 1.0
"""Road speed below which slip is not drawn: both speeds are a few counts."""
_ROLLING_RAD_S: Final = 10.0
"""Road speed and slip for a locked wheel, as in the result card's `lock_fraction`."""
_LOCKED: Final = 0.9
_WHOLE_SLIP: Final = 1.02
_SLIP_AIR: Final = 1.2
_SLIP_STEP: Final = 0.05
TOP_NM: Final = 10.0
_SALT: Final = "inteco-abs"
"""Fixes names inside an SVG, which are otherwise random."""
_PLAIN: Final = FigureOptions()


class _DrawnSession(NamedTuple):
    """A session to draw, and its part of the time axis."""

    ticks: Array
    truth: Array
    label: str
    start_ns: int
    begin_s: float
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


def draw_stops(sessions: Sequence[Session], path: Path, options: FigureOptions = _PLAIN) -> None:
    """Draw the braking part of `sessions` to `path`, in one of `FORMATS`.

    One session is drawn with all curves of each panel; of several, a legend names what differs. The same sessions give
    the same file. Raises ConfigError for too many sessions, AbsError if one never braked, or without matplotlib.
    """
    check_figure(path)
    save_figure(figure_of(sessions, options), path, _DPI)


def figure_of(sessions: Sequence[Session], options: FigureOptions = _PLAIN) -> Figure:
    """The figure of `draw_stops` as a matplotlib object. Raises the same errors."""
    require_matplotlib()
    from matplotlib import rc_context  # noqa: PLC0415  heavy, and an extra

    require_distinct(sessions)
    with rc_context(options.rc()):
        return _drawn(sessions, options)


def svg_of(sessions: Sequence[Session]) -> bytes:
    """Return the figure as SVG, two columns wide, decimated for print. Raises AbsError."""
    require_matplotlib()
    from matplotlib import rc_context  # noqa: PLC0415  heavy, and an extra

    with rc_context(_PLAIN.rc()):
        data = BytesIO()
        _drawn(sessions, _PLAIN, _PRINTED_POINTS).savefig(data, format="svg", metadata={"Date": None})
        return data.getvalue()


def save_figure(figure: Figure, path: Path, dpi: float = 150.0) -> None:
    """Write `figure` in the format of its suffix, without date and reproducibly. Raises AbsError.

    In an SVG text stays text, in a PDF fonts are TrueType, and PGF takes the fonts of the LaTeX document.
    """
    from matplotlib import rc_context  # noqa: PLC0415  heavy, and an extra

    undated: dict[str, dict[str, Any]] = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    try:
        with (
            rc_context({"svg.hashsalt": _SALT, "svg.fonttype": "none", "pdf.fonttype": _TRUETYPE}),
            atomic_write(path) as part,
        ):
            if path.suffix == ".pgf":
                from inteco_abs.views.pgf import pgf_of  # noqa: PLC0415  heavy, and an extra

                part.write_text(pgf_of(figure, path.name), encoding="utf-8", newline="\n")
            else:
                form, metadata = path.suffix.removeprefix("."), undated.get(path.suffix, {})
                figure.savefig(part, format=form, dpi=dpi, metadata=metadata)
    except OSError as error:
        raise AbsError(f"{path}: the figure cannot be written: {describe_disk(error)}") from error


def _drawn(sessions: Sequence[Session], options: FigureOptions, most: int = _DRAWN_POINTS) -> Figure:
    """The figure, with lines of about `most` points."""
    named = zip(sessions, labels(sessions), strict=True)
    parts = [_part(session, label, options.range_s, most) for session, label in named]
    size = options.size
    figure = new_figure(size.width_mm / _MM_PER_INCH, size.height_mm / _MM_PER_INCH)
    panels = list(figure.subplots(len(options.drawn), sharex=True, squeeze=False)[:, 0])
    axes = dict(zip(options.drawn, panels, strict=True))
    draw = _ALONE if len(parts) == 1 else _COMPARED
    for name, panel in axes.items():
        draw[name](panel, parts, options)
        panel.grid(alpha=0.3)
        panel.set_xlim(min(part.begin_s for part in parts), max(part.end_s for part in parts))
    panels[-1].set_xlabel(options.with_unit("time since braking began", "s"))
    _mark_changes(panels, sessions)
    for panel in panels:
        if named := panel.get_legend_handles_labels()[0]:  # above the panel, where no curve can be
            where: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.0}
            row: dict[str, Any] = {"ncols": len(named), "borderpad": 0.2, "handlelength": 1.6, "columnspacing": 1.2}
            panel.legend(frameon=False, fontsize=options.legend, **where, **row)
    if len(parts) > 1:
        _name_sessions(figure, parts, options)
    elif options.titled:
        figure.suptitle(_wrapped(parts[0].label, options), fontsize="medium", parse_math=False)
    return figure


def _mark_changes(axes: Sequence[Axes], sessions: Sequence[Session]) -> None:
    """A line at each time at which a gain changed, in the session's colour if there are several."""
    label = "gain changed"
    for session, colour in zip(sessions, PALETTE if len(sessions) > 1 else ("black",), strict=False):
        if times_s := changes_s(session):
            looks: dict[str, Any] = {"colors": colour, "lw": 0.6, "ls": (0, (1, 2))}
            for panel in axes:
                whole = panel.get_xaxis_transform()
                panel.vlines(times_s, 0.0, 1.0, transform=whole, label=label if panel is axes[-1] else "", **looks)
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
        yield rows[_shown(rows, part.start_ns, part.begin_s, part.end_s)]


def _true(parts: Sequence[_DrawnSession]) -> bool:
    """Whether true slip and torque are known for all sessions."""
    return all(len(part.truth) for part in parts)


def moving_slip(rows: Array) -> Array:
    """Slip; NaN where the road wheel is about at rest."""
    return np.where(rows["road_speed_rad_s"] >= AT_REST_RAD_S, rows["slip"], np.nan)


def _part(session: Session, label: str, range_s: tuple[float, float] | None, most: int) -> _DrawnSession:
    held = held_spans(session)
    if not held:
        raise AbsError(f"{session.path}: the run ended before braking; there is nothing to draw")
    start = start_ns(session)
    last_s = float((held[-1].last_ns - start) * 1e-9)
    begin_s, end_s = range_s or (-BEFORE_S, last_s)
    if begin_s >= last_s:
        problem = f"{begin_s:g} {end_s:g}: {session.path} ends {last_s:.3f} s after braking began"
        raise ConfigError.of("--range", problem)
    if max(session.tick_count, session.truth_count) <= most:
        return _DrawnSession(session.ticks, session.truth, label, start, begin_s, end_s)
    numbers = [0, 0]
    for block in session.blocks():
        for at, rows in enumerate(block):
            numbers[at] += int(_shown(rows, start, begin_s, end_s).sum())
    names = [[name for name in _DRAWN if name in (message.dtype.names or ())] for message in (TICK, TRUTH)]
    thinned = [Decimator(of, 0, number, most) for of, number in zip(names, numbers, strict=True)]
    for block in session.blocks():
        for rows, of, decimator in zip(block, names, thinned, strict=True):
            shown = rows[_shown(rows, start, begin_s, end_s)]
            decimator.add({name: shown[name] for name in of}, since_s(shown, start), np.zeros(len(shown), bool))
    ticks, truth = (
        _few(message.dtype, decimator, start) for message, decimator in zip((TICK, TRUTH), thinned, strict=True)
    )
    return _DrawnSession(ticks, truth, label, start, begin_s, end_s)


def _shown(rows: Array, start: int, begin_s: float, end_s: float) -> Array:
    time_s = since_s(rows, start)
    shown: Array = (time_s >= begin_s) & (time_s <= end_s)
    return shown


def _few(dtype: np.dtype[np.void], decimator: Decimator, start: int) -> Array:
    """The points as rows."""
    thinned = decimator.decimated()
    few = np.zeros(len(thinned.time_s), dtype)
    few["time_ns"] = np.rint(thinned.time_s * 1e9).astype(np.int64) + start
    for name, values in thinned.columns.items():
        few[name] = values
    return few


def _wrapped(label: str, options: FigureOptions) -> str:
    return textwrap.fill(label, options.size.label_letters, max_lines=2, placeholder=" ...")


def _speeds(panel: Axes, options: FigureOptions) -> None:
    panel.set_ylabel(options.with_unit("speed", "rad/s"))
    panel.set_ylim(bottom=0.0)


def _slips(panel: Axes, parts: Sequence[_DrawnSession]) -> None:
    panel.set_ylim(0.0, slip_top(highest_slip(rows) for part in parts for rows in _slip_rows(part, parts)))


def _torques(panel: Axes, part: _DrawnSession, rows: Array, name: str, options: FigureOptions, **looks: Any) -> None:
    """A curve of the torque panel, as a range where it chatters."""
    time_s = since_s(rows, part.start_ns)
    if not options.envelope:
        panel.plot(time_s, rows[name], **looks)
        return
    shown = _shown(rows, part.start_ns, part.begin_s, part.end_s)
    plot_envelope(panel, time_s[shown], rows[name][shown], top=panel.get_ylim()[1], **looks)


def _alone_speeds(panel: Axes, parts: Sequence[_DrawnSession], options: FigureOptions) -> None:
    (part,) = parts
    time_s = since_s(part.ticks, part.start_ns)
    panel.plot(time_s, part.ticks["road_speed_rad_s"], color=_ROAD, lw=1.2, label="road wheel (car)")
    panel.plot(time_s, part.ticks["wheel_speed_rad_s"], color=_WHEEL, lw=1.2, ls="--", label="braked wheel")
    _speeds(panel, options)


def _alone_slip(panel: Axes, parts: Sequence[_DrawnSession], _options: FigureOptions) -> None:
    (part,) = parts
    time_s = since_s(part.ticks, part.start_ns)
    panel.plot(time_s, moving_slip(part.ticks), color=_WHEEL, lw=0.8, alpha=0.6, label="estimated")
    if len(part.truth):
        truth_s = since_s(part.truth, part.start_ns)
        panel.plot(truth_s, moving_slip(part.truth), color=_ROAD, lw=1.2, label="true")
    panel.plot(time_s, part.ticks["slip_reference"], color="black", lw=1.0, ls="--", label="reference")
    panel.set_ylabel("slip")
    _slips(panel, parts)


def _alone_torque(panel: Axes, parts: Sequence[_DrawnSession], options: FigureOptions) -> None:
    (part,) = parts
    panel.set_ylim(-0.2, TOP_NM)
    asked: dict[str, Any] = {"color": _WHEEL, "lw": 0.8, "alpha": 0.6, "label": "asked"}
    _torques(panel, part, part.ticks, "torque_demand_nm", options, **asked)
    if len(part.truth):
        true: dict[str, Any] = {"color": _ROAD, "lw": 1.2, "label": "true"}
        _torques(panel, part, part.truth, "brake_torque_nm", options, **true)
    panel.set_ylabel(options.with_unit("brake torque", "N m"))
    duty = panel.twinx()
    looks: dict[str, Any] = {"color": _OTHER, "lw": 0.8, "ls": ":"}
    duty.set_ylim(-0.02, 1.0)
    _torques(duty, part, part.ticks, "brake", options, label="brake duty", **looks)
    panel.plot([], [], label="duty", **looks)
    duty.set_ylabel("brake duty", color=_OTHER)


def _looks(parts: Sequence[_DrawnSession]) -> Iterator[tuple[_DrawnSession, dict[str, Any]]]:
    for part, colour, dash in zip(parts, PALETTE, _DASHES, strict=False):
        yield part, {"color": colour, "ls": dash}


def _compared_speeds(panel: Axes, parts: Sequence[_DrawnSession], options: FigureOptions) -> None:
    for part, looks in _looks(parts):
        time_s = since_s(part.ticks, part.start_ns)
        panel.plot(time_s, part.ticks["road_speed_rad_s"], lw=1.4, **looks)
        panel.plot(time_s, part.ticks["wheel_speed_rad_s"], lw=0.7, **looks)
    panel.plot([], [], color="black", lw=1.4, label="road wheel (car)")
    panel.plot([], [], color="black", lw=0.7, label="braked wheel")
    _speeds(panel, options)


def _compared_slip(panel: Axes, parts: Sequence[_DrawnSession], _options: FigureOptions) -> None:
    true = _true(parts)
    references = np.concatenate([part.ticks["slip_reference"] for part in parts])
    alike = len(np.unique(references[np.isfinite(references)])) <= 1
    for part, looks in _looks(parts):
        rows = part.truth if true else part.ticks
        panel.plot(since_s(rows, part.start_ns), moving_slip(rows), lw=1.0, **looks)
        time_s = since_s(part.ticks, part.start_ns)
        own = "black" if alike else looks["color"]
        panel.plot(time_s, part.ticks["slip_reference"], color=own, lw=0.8, ls=":")
    panel.get_lines()[-1].set_label("reference" if alike else "references")
    panel.set_ylabel("slip, true" if true else "slip, estimated")
    _slips(panel, parts)


def _compared_torque(panel: Axes, parts: Sequence[_DrawnSession], options: FigureOptions) -> None:
    true = _true(parts)
    panel.set_ylim(-0.2, TOP_NM)
    for part, looks in _looks(parts):
        rows, name = (part.truth, "brake_torque_nm") if true else (part.ticks, "torque_demand_nm")
        _torques(panel, part, rows, name, options, lw=1.0, **looks)
    panel.set_ylabel(options.with_unit(f"brake torque, {'true' if true else 'asked'}", "N m"))


_Panel = Callable[[Any, Sequence[_DrawnSession], FigureOptions], None]
_ALONE: Final[Mapping[str, _Panel]] = {"speed": _alone_speeds, "slip": _alone_slip, "torque": _alone_torque}
_COMPARED: Final[Mapping[str, _Panel]] = {"speed": _compared_speeds, "slip": _compared_slip, "torque": _compared_torque}


def _name_sessions(figure: Figure, parts: Sequence[_DrawnSession], options: FigureOptions) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415  heavy, and an extra

    lines = [Line2D([], [], lw=1.4, **looks) for _, looks in _looks(parts)]
    names = [_wrapped(part.label, options) for part in parts]
    where: dict[str, Any] = {"loc": "outside upper center", "handlelength": 4.0}
    legend = figure.legend(lines, names, frameon=False, fontsize=options.legend, **where)
    for text in legend.get_texts():
        text.set_parse_math(False)  # a name is not a formula
