"""Tables of the reproduction for a terminal or a file, and figures of its stops."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from inteco_abs.views.envelope import plot_envelope
from inteco_abs.views.figure import COLOURS, new_figure, save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BLUE, _RED, _ = COLOURS


class _Column(NamedTuple):
    heading: str
    metric: str
    form: str
    factor: float = 1.0
    of: str = "median"


_COLUMNS: Final = (
    _Column("reach\ns", "reaching_time_s", ".4f"),
    _Column("RMS", "slip_rms_true", ".3g", 1e3),
    _Column("RMS\n0.25 s", "slip_rms_fixed_true", ".3g", 1e3),
    _Column("RMS\nslow", "slip_rms_low_speed_true", ".3g", 1e3),
    _Column("over", "overshoot", ".3g", 1e3),
    _Column("lock\n%", "lock_fraction", ".2g", 1e2, "largest"),
    _Column("N m/s", "torque_variation_nm_per_s", ".0f"),
    _Column("stop\nm", "stop_distance_m", ".2f"),
)
_NOTE: Final = (
    "Medians over the rigs; slip is the true one, its errors in thousandths, down to 10 rad/s. RMS: from 20 ms after "
    "the slip was first within 0.01 of the reference; 0.25 s: from then on; slow: as the first, below 60 rad/s. Over: "
    "largest error after that first time. Lock: largest share of a stop with slip above 0.9. N m/s: variation of the "
    "torque asked for, within the duty's limit. Ratio: RMS from 0.25 s of the paper's law over that of this row, "
    "median of rig by rig. Equal reaching time is that of (20): where a weak brake sets it, the rival with equal Mq "
    "reaches as soon, and is the fair one. In the simulation the slip chatters with Mq*Ts/2 to Mq*Ts/sqrt(2) rms, as "
    "its first crossing happens to fall between two samples."
)


_BROKEN: Final = "the simulation again, where the recipe breaks"


def render_paper(report: Mapping[str, Any]) -> RenderableType:
    """The report of a reproduction: a table for each condition that has rivals, one for the others, and verdicts."""
    compared, alone = _grouped(report)
    parts: list[RenderableType] = []
    for title, rows in compared:
        parts.append(_table(title, [(_law(row), row) for row in rows]))
    parts.append(_table(_BROKEN, [(row["title"], row) for row in alone]))
    parts += [Text(line) for line in (_theory(report["simulation"]), *_verdicts(report))]
    return Group(*parts, Text(_NOTE, style="dim"))


def _table(title: str, rows: Sequence[tuple[str, Mapping[str, Any]]]) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", overflow="fold")
    for heading in (*(column.heading for column in _COLUMNS), "ratio"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, row in rows:
        table.add_row(Text(name), *_cells(row))
    return table


def paper_markdown(report: Mapping[str, Any], command: str) -> str:
    """Return the table as Markdown, made by `command`."""
    compared, alone = _grouped(report)
    lines = ["# The paper again", "", f"Made by `{command}`.", ""]
    for title, rows in (*compared, (_BROKEN, alone)):
        names = [row["title"] if rows is alone else _law(row) for row in rows]
        headings = ["", *(column.heading.replace("\n", " ") for column in _COLUMNS), "ratio"]
        lines += [f"## {title[0].upper()}{title[1:]}", "", _line(headings), _line(["---"] * len(headings))]
        lines += [_line([name, *_cells(row)]) for name, row in zip(names, rows, strict=True)]
        lines.append("")
    lines += [f"- {line}" for line in (_theory(report["simulation"]), *_verdicts(report))]
    return "\n".join([*lines, "", _NOTE, ""])


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _grouped(
    report: Mapping[str, Any],
) -> tuple[list[tuple[str, list[Mapping[str, Any]]]], list[Mapping[str, Any]]]:
    """Rows of the conditions with rivals, with titles, and rows of those without."""
    conditions = [list(rows) for _, rows in groupby(report["rows"], lambda row: row["condition"])]
    compared = [(_title(rows[0]), rows) for rows in conditions if len(rows) > 1]
    return compared, [rows[0] for rows in conditions if len(rows) == 1]


def _title(row: Mapping[str, Any]) -> str:
    rigs = f"{row['stops']} rigs of {row['rigs']}" if row["stops"] > 1 else f"rig {row['rigs']}"
    weak = f", without {len(row['left_out'])} that are too weak" if row["left_out"] else ""
    return f"{row['title']}; {rigs}{weak}"


def _law(row: Mapping[str, Any]) -> str:
    if row["pairing"]:
        return f"constant rate, Mq {row['Mq_per_s']:.4g}: {row['pairing']}"
    return f"the paper's law, Mk {row['Mk_per_s']:g}, Mq {row['Mq_per_s']:g}"


def _cells(row: Mapping[str, Any]) -> Iterator[str]:
    for column in _COLUMNS:
        value = row[column.of][column.metric]
        yield "never" if value is None else format(column.factor * value, column.form)
    ratio = row["comparison"] and row["comparison"]["ratios"]["slip_rms_fixed_true"]
    yield "" if ratio is None else f"{ratio:.2f}"


def _theory(found: Mapping[str, Any]) -> str:
    return (
        f"simulation: reference reached in {found['reaching_time_s']:.4f} s, by (20) in "
        f"{found['reaching_time_bound_s']:.4f} s; chattering {found['chattering_rms']:.3g} rms, Mq*Ts/2 = "
        f"{found['chattering_rms_expected']:.3g}; torque {found['torque_least_nm']:.2f}.."
        f"{found['torque_most_nm']:.2f} N m; stop in {found['stop_time_s']:.3f} s and "
        f"{found['stop_distance_m']:.2f} m"
    )


def _verdicts(report: Mapping[str, Any]) -> Iterator[str]:
    yield from (f"{condition}: {words}" for condition, words in report["verdicts"].items())
    for condition, found in report["similarity"].items():
        yield f"{condition}, similar to the simulation: {found['words']}"


def draw_trace(columns: Mapping[str, Any], title: str, path: Path) -> None:
    """Draw a stop to `path` (.png, .svg or .pdf) in the paper's three panels: speeds, slip, brake torque.

    The estimated slip is drawn if there is one; an existing file is replaced. Raises AbsError if it cannot be written,
    or without matplotlib.
    """
    time_s = columns["time_s"]
    figure = new_figure(7.0, 7.2)
    speeds, slip, torque = figure.subplots(3, sharex=True)
    speeds.plot(time_s, columns["road_speed_rad_s"], color=_RED, lw=1.2, label="vehicle (road wheel)")
    speeds.plot(time_s, columns["wheel_speed_rad_s"], color=_BLUE, lw=1.2, ls="--", label="braked wheel")
    speeds.set_ylabel("speed [rad/s]")
    speeds.set_ylim(bottom=0.0)
    _slip(slip, columns)
    highest = float(max(columns["brake_torque_nm"]))
    plot_envelope(torque, time_s, columns["brake_torque_nm"], top=highest, color=_RED, lw=1.0, label="torque")
    torque.set_ylabel("brake torque [N m]")
    torque.set_ylim(bottom=0.0)
    torque.set_xlabel("time since braking began [s]")
    for panel in (speeds, slip, torque):
        panel.grid(alpha=0.3)
        panel.set_xlim(0.0, time_s[-1])
    speeds.legend(loc="upper right", frameon=False, fontsize="small")
    slip.legend(loc="upper left", frameon=False, fontsize="small")
    torque.legend(loc="upper right", frameon=False, fontsize="small")
    figure.suptitle(title, fontsize="medium")
    save_figure(figure, path)


def _slip(panel: Axes, columns: Mapping[str, Any]) -> None:
    time_s = columns["time_s"]
    if "slip_estimated" in columns:
        panel.plot(time_s, columns["slip_estimated"], color=_BLUE, lw=0.6, alpha=0.6, label="slip, estimated")
    panel.plot(time_s, columns["slip"], color=_RED, lw=1.2, label="slip, true")
    panel.plot(time_s, columns["slip_reference"], color="black", lw=1.0, ls="--", label="reference")
    panel.set_ylabel("slip")
    panel.set_ylim(0.0, 1.02)
