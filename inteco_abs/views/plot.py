"""Plots over time in characters: braille with eight dots a cell, or one mark a cell in ASCII.

A cell has one colour: where curves meet, that of the first one. So curves also differ in being solid or dashed. numpy
makes all dots in a fifth of a millisecond, a plotting library in five (docs/facts/sessions.md#cost-of-a-screen).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from inteco_abs.views.text_lines import Line, runs

Array = npt.NDArray[Any]

_DOTS: Final = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
"""Bits of Unicode's braille patterns by row and column of the cell."""
_BRAILLE: Final = 0x2800
_DASH_DOTS: Final = 6
"""Dots from one dash to the next, along the curve."""
_DASH_MARKS: Final = 2
"""Characters from one dash to the next, in ASCII."""
MARGIN: Final = 6
"""Cells left of the dots, for a number and the axis."""


class Curve(NamedTuple):
    """Values over ascending times."""

    times_s: Array
    values: Array
    style: str
    mark: str
    """Character in ASCII plots."""
    dashed: bool = False


class PlotAxes(NamedTuple):
    """Ends of both axes, which begin at zero."""

    span_s: float
    top: float


def plot(curves: Sequence[Curve], axes: PlotAxes, width: int, rows: int, *, plain: bool) -> list[Line]:
    """Lines of a plot: `rows` of dots and the axis below, `width` cells wide; `plain` is ASCII."""
    columns = width - MARGIN
    cells = _marks(curves, axes, columns, rows) if plain else _dots(curves, axes, columns, rows)
    labels = {0: axes.top, (rows - 1) // 2: axes.top / 2 if rows % 2 else None, rows - 1: 0.0}
    corner, edge = ("|", "|") if plain else ("┤", "│")
    lines: list[Line] = []
    for row, cell_line in enumerate(cells):
        label = labels.get(row)
        head = f"{'' if label is None else f'{label:g}':>{MARGIN - 2}} {edge if label is None else corner}"
        lines.append([(head, "dim"), *cell_line])
    lines.append([(_time_axis(axes.span_s, columns, plain=plain), "dim")])
    return lines


def _time_axis(span_s: float, columns: int, *, plain: bool) -> str:
    """Axis with the times of the first, middle and last column."""
    line = "-" if plain else "─"
    first, middle, last = " 0 ", f" {span_s / 2:g} ", f" {span_s:g} s"
    left = max(0, columns // 2 - len(middle) // 2 - len(first))
    right = max(0, columns - len(first) - left - len(middle) - len(last))
    return f"{'+' if plain else '└':>{MARGIN}}{first}{line * left}{middle}{line * right}{last}"


def _dots(curves: Sequence[Curve], axes: PlotAxes, columns: int, rows: int) -> list[Line]:
    bits = np.zeros((rows, columns), int)
    owner = np.full((rows, columns), len(curves))
    for number, curve in reversed(list(enumerate(curves))):
        drawn = _raster(curve, axes, 2 * columns, 4 * rows, _DASH_DOTS)
        if not curve.dashed:  # two dots thick, to be visible
            drawn[1:] |= drawn[:-1]
        cells = drawn.reshape(rows, 4, columns, 2)
        bits |= (cells * _DOTS[None, :, None, :]).sum(axis=(1, 3))
        owner[cells.any(axis=(1, 3))] = number
    styles = [*(curve.style for curve in curves), ""]
    texts = ("".join(chr(_BRAILLE + bit) if bit else " " for bit in row) for row in bits.tolist())
    return [runs(text, [styles[who] for who in row]) for text, row in zip(texts, owner.tolist(), strict=True)]


def _marks(curves: Sequence[Curve], axes: PlotAxes, columns: int, rows: int) -> list[Line]:
    owner = np.full((rows, columns), len(curves))
    for number, curve in reversed(list(enumerate(curves))):
        drawn = _raster(curve, axes, columns, rows, _DASH_MARKS)
        owner[drawn] = number
    styles, marks = [*(curve.style for curve in curves), ""], [*(curve.mark for curve in curves), " "]
    return [runs("".join(marks[who] for who in row), [styles[who] for who in row]) for row in owner.tolist()]


def _raster(curve: Curve, axes: PlotAxes, width: int, height: int, dash: int) -> Array:
    """Grid points on the curve; row 0 is at the top."""
    known = np.isfinite(curve.values)
    times, values = curve.times_s[known], curve.values[known]
    grid = np.zeros((height, width), bool)
    if not len(times):
        return grid
    first, last = (min(max(round(end / axes.span_s * (width - 1)), 0), width - 1) for end in (times[0], times[-1]))
    columns = np.arange(first, last + 1)
    values = np.interp(columns * axes.span_s / (width - 1), times, values)
    levels = np.rint((1.0 - np.clip(values / axes.top, 0.0, 1.0)) * (height - 1)).astype(int)
    before = np.concatenate([levels[:1], levels[:-1]])
    begin = before + np.sign(levels - before)  # next to the point before, so that steep parts are connected
    low, high = np.minimum(begin, levels), np.maximum(begin, levels)
    rows = np.arange(height)[:, None]
    path = np.cumsum(high - low + 1)
    drawn = (path % dash < dash // 2) | (not curve.dashed)
    grid[:, columns] = (rows >= low) & (rows <= high) & drawn
    return grid
