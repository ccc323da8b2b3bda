"""The benchmark as a table for a terminal, as Markdown, as figures, and as a page."""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from inteco_abs.benchmark.results import POPULATIONS
from inteco_abs.sessions import atomic_write
from inteco_abs.views.figure import COLOURS, new_figure, save_figure

_HEADINGS: Final = (
    *("law", "slip RMS, median (95 %)", "99 % (95 %)", "worst, seed", "arrival, 99 % [s]", "distance [m]"),
    *("locked", "failed", "duty [1/s]", "chatter [N m/s]", "decision [us]"),
)
_NOTE: Final = (
    "Slip RMS: of the true slip's deviation from 0.2, from 0.25 s after braking began down to 10 rad/s. Arrival: first "
    "slip within 0.01 of it. Distance, duty (its variation) and chatter (variation of the requested torque): medians. "
    "Locked, failed: stops. In brackets: bootstrap interval of 95 %. never: a stop had none."
)
_LEAST: Final = 1e-4
_MOST: Final = 1.0
"""Slip RMS of a stop that failed, in figures."""


def render_benchmark(found: Mapping[str, Any]) -> RenderableType:
    """A table for each population, best law first."""
    tables: list[RenderableType] = []
    for name, rows in _by_range(found):
        if name not in POPULATIONS:
            continue
        table = Table(title=f"{_title(rows)}: slip RMS from 0.25 s on", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        table.add_column("law", overflow="fold")
        for heading in ("median", "p99", "max", "worst\nseed", "arrival\np99 s", "locked", "failed", "decision\nus"):
            table.add_column(heading, justify="right", no_wrap=True)
        for law, facts, row in rows:
            worst = row["slip_rms"]["median"], row["slip_rms"]["p99"], row["worst_slip_rms"]
            slips = [_number(value, ".4f") for value in worst]
            counts = f"{row['locked']}", f"{row['failed']}", _number(facts["decision_us"], ".1f")
            table.add_row(Text(law), *slips, str(row["worst_seed"]), _number(row["arrival_s"]["p99"], ".3f"), *counts)
        tables.append(table)
    return Group(*tables, Text("locked, failed: stops; never: a stop has no such figure", style="dim"))


def write_page(found: Mapping[str, Any], folder: Path) -> list[str]:
    """Write table.md, figures and index.html into the folder; their names."""
    names = ["table.md", "index.html", "populations.svg"]
    _write(folder / "table.md", "\n".join(_markdown(found)))
    _draw_populations(found, folder / "populations.svg")
    if factors := [name for name, _ in _by_range(found) if name not in POPULATIONS]:
        names.append("factors.svg")
        _draw_factors(found, factors, folder / "factors.svg")
    _write(folder / "index.html", "\n".join(_page(found, names[2:])))
    return names


def _write(path: Path, text: str) -> None:
    with atomic_write(path) as part:
        part.write_text(text + "\n", encoding="utf-8", newline="\n")


_Row = tuple[str, Mapping[str, Any], Mapping[str, Any]]


def _by_range(found: Mapping[str, Any]) -> Iterator[tuple[str, list[_Row]]]:
    """Each range with the laws that have it: name, facts, figures; by the median of the slip RMS, then the 99 %."""
    laws = found["laws"]
    for name in dict.fromkeys(name for law in laws.values() for name in law["ranges"]):
        rows = [(law, facts, facts["ranges"][name]) for law, facts in laws.items() if name in facts["ranges"]]
        yield name, sorted(rows, key=lambda row: [_value(row[2]["slip_rms"][which]) for which in ("median", "p99")])


def _value(number: float | None) -> float:
    return math.inf if number is None else number


def _title(rows: Sequence[_Row]) -> str:
    figures = rows[0][2]
    return f"{figures['draws']}: {figures['stops']} {'rigs' if figures['stops'] > 1 else 'rig'}"


def _number(number: float | None, form: str) -> str:
    return "never" if number is None else format(number, form)


def _cells(law: str, facts: Mapping[str, Any], row: Mapping[str, Any]) -> list[str]:
    slip = row["slip_rms"]

    def with_interval(which: str) -> str:
        low, high = (_number(each, ".4f") for each in slip[f"{which}_interval"])
        return f"{_number(slip[which], '.4f')} ({low} to {high})"

    return [
        f"{law} [{facts['gains_from']}]",
        with_interval("median"),
        with_interval("p99"),
        f"{_number(row['worst_slip_rms'], '.4f')}, {row['worst_seed']}",
        _number(row["arrival_s"]["p99"], ".3f"),
        _number(row["distance_m"]["median"], ".2f"),
        str(row["locked"]),
        str(row["failed"]),
        _number(row["duty_variation_per_s"]["median"], ".0f"),
        _number(row["chatter_nm_per_s"]["median"], ".0f"),
        _number(facts["decision_us"], ".1f"),
    ]


def _markdown(found: Mapping[str, Any]) -> Iterator[str]:
    yield f"inteco-abs {found['version']}, sources {found['source_sha256'][:12]}. {_NOTE}"
    for name, rows in _by_range(found):
        if name in POPULATIONS:
            yield f"\n## {_title(rows)}\n"
            yield from _lines(_HEADINGS, [_cells(*row) for row in rows])
    if factors := _factor_table(found):
        yield "\n## One factor of `hard` changed: slip RMS, median / 99 %\n"
        yield from _lines(*factors)


def _lines(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield from (f"| {' | '.join(line)} |" for line in (headings, ["---"] * len(headings), *rows))


def _factor_table(found: Mapping[str, Any]) -> tuple[list[str], list[list[str]]] | None:
    """A line for each changed factor, a column for each law."""
    laws, rows = list(found["laws"]), []
    for name, figures in _by_range(found):
        if name not in POPULATIONS:
            slips = {law: each["slip_rms"] for law, _, each in figures}
            cells = [[_number(slips[law][which], ".4f") for which in ("median", "p99")] for law in laws]
            rows.append([name.removeprefix("hard-"), *(" / ".join(cell) for cell in cells)])
    return (["factor", *laws], rows) if rows else None


def _draw_populations(found: Mapping[str, Any], path: Path) -> None:
    """A panel for each population, a line for each law from the median of the slip RMS to its 99 %."""
    groups = [(name, rows) for name, rows in _by_range(found) if name in POPULATIONS]
    count = len(found["laws"])
    figure = new_figure(13.0, 1.2 + math.ceil(len(groups) / 2) * (0.6 + 0.2 * count))
    panels = np.ravel(figure.subplots(math.ceil(len(groups) / 2), 2, squeeze=False))
    for panel in panels[len(groups) :]:
        panel.set_axis_off()
    for panel, (_, rows) in zip(panels, groups, strict=False):
        for place, (_, _, row) in enumerate(rows):
            median, p99 = (_drawn(row["slip_rms"][which]) for which in ("median", "p99"))
            low, high = map(_drawn, row["slip_rms"]["median_interval"])
            panel.plot([median, p99], [place, place], color=COLOURS[0], lw=1.2)
            panel.plot([low, high], [place, place], color=COLOURS[1], lw=4.0, solid_capstyle="butt")
            panel.plot([median], [place], "o", color=COLOURS[0], ms=3.5)
        panel.set_yticks(range(len(rows)), [row[0] for row in rows], fontsize="x-small")
        panel.set_ylim(len(rows) - 0.5, -0.5)
        panel.set_xscale("log")
        panel.set_xlim(_LEAST, _MOST * 1.1)
        panel.set_title(_title(rows), fontsize="medium")
        panel.grid(alpha=0.3, axis="x")
    figure.supxlabel("slip RMS from 0.25 s on: median (dot, its interval of 95 % thick) to 99 %; 1 where stops failed")
    save_figure(figure, path)


def _drawn(number: float | None) -> float:
    return min(max(_value(number), _LEAST), _MOST)


def _draw_factors(found: Mapping[str, Any], factors: Sequence[str], path: Path) -> None:
    """A field for each factor and law: the median of the slip RMS, on a logarithmic scale."""
    from matplotlib.colors import LogNorm  # noqa: PLC0415  heavy, and an extra

    laws = found["laws"]
    values = [[_drawn(facts["ranges"][name]["slip_rms"]["median"]) for facts in laws.values()] for name in factors]
    figure = new_figure(3.2 + 0.34 * len(laws), 2.6 + 0.17 * len(factors))
    panel = figure.subplots()
    image = panel.imshow(values, norm=LogNorm(_LEAST, _MOST), cmap="cividis_r", aspect="auto")
    panel.set_xticks(range(len(laws)), list(laws), rotation=90, fontsize="x-small")
    panel.set_yticks(range(len(factors)), [name.removeprefix("hard-") for name in factors], fontsize="x-small")
    figure.colorbar(image, ax=panel, label="slip RMS from 0.25 s on, median; 1 where most stops failed", shrink=0.6)
    save_figure(figure, path)


_STYLE: Final = (
    "body{font:15px/1.5 sans-serif;max-width:1300px;margin:2em auto;padding:0 1em}table{border-collapse:collapse;"
    "font-size:13px;display:block;overflow-x:auto}td,th{padding:3px 6px;border-bottom:1px solid #ccc;text-align:right;"
    "white-space:nowrap}th{white-space:normal;vertical-align:bottom}td:first-child,th:first-child{text-align:left}"
    "img{max-width:100%}"
)


def _page(found: Mapping[str, Any], figures: Sequence[str]) -> Iterator[str]:
    yield (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>inteco-abs benchmark</title><style>{_STYLE}'
        f"</style><h1>Benchmark of slip controllers</h1><p>inteco-abs {html.escape(found['version'])}, sources "
        f"{found['source_sha256'][:12]}. {html.escape(_NOTE)}</p>"
    )
    yield from (f'<p><img src="{name}" alt="slip RMS of the laws: {name[:-4]}"></p>' for name in figures)
    for name, rows in _by_range(found):
        if name in POPULATIONS:
            yield f"<h2>{html.escape(_title(rows))}</h2>"
            yield from _html_table(_HEADINGS, [_cells(*row) for row in rows])
    if factors := _factor_table(found):
        yield "<h2>One factor of hard changed: slip RMS, median / 99 %</h2>"
        yield from _html_table(*factors)
    yield "<h2>Gains</h2>"
    keys = ("controller", "estimator", "gains_from")
    gains = [[name, *(law[key] for key in keys), _gains(law)] for name, law in found["laws"].items()]
    yield from _html_table(["law", "controller", "estimator", "gains from", "numbers"], gains)
    yield "</html>"


def _gains(law: Mapping[str, Any]) -> str:
    return ", ".join(f"{key.rpartition('.')[2]} {value:g}" for key, value in law["numbers"].items())


def _html_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield f"<table><tr>{''.join(f'<th>{html.escape(each)}</th>' for each in headings)}</tr>"
    yield from (f"<tr>{''.join(f'<td>{html.escape(each)}</td>' for each in row)}</tr>" for row in rows)
    yield "</table>"
