"""Curves that chatter: range and mean, where a line would fill the area between its extremes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = npt.NDArray[Any]

_WINDOWS: Final = 150
"""Of which a figure's time axis is as long: about a millimetre each, in which a printed line shows no two periods."""
_REVERSALS: Final = 4
"""In a window: two whole periods."""
_LEAST_SHARE: Final = 0.03
"""Of the axis; less is a thick line."""
_SHADE: Final = 0.3
_POINTS: Final = 4
"""Of the range, in a window."""
LABEL: Final = "chatter"


class Envelope(NamedTuple):
    """A curve's mean over a window where it chatters, its values elsewhere, and the range where it chatters."""

    values: Array
    low: Array
    high: Array
    chatters: Array
    """Whether it does, for each value."""


def envelope(values: Array, window: int, least: float) -> Envelope:
    """Return the envelope of `values`; `least` is the smallest swing that counts, `window` the number of values."""
    window = min(max(window, _REVERSALS + 2), len(values))
    calm = Envelope(values, values, values, np.zeros(len(values), bool))
    if window <= _REVERSALS:
        return calm
    reversals = _windows(_reversals(values), window).sum(axis=1)
    if reversals.max() < _REVERSALS:
        return calm
    shown = _windows(values.astype(float), window)
    # the way up and down beyond that from the first to the last value, so that a steep slope is no swing
    ways = np.abs(np.diff(shown, axis=1)).sum(axis=1) - np.abs(shown[:, -1] - shown[:, 0])
    chatters = (reversals >= _REVERSALS) & (ways > least * reversals)
    return Envelope(np.where(chatters, shown.mean(axis=1), values), shown.min(axis=1), shown.max(axis=1), chatters)


def plot_envelope(panel: Axes, time_s: Array, values: Array, *, top: float, label: str = "", **looks: Any) -> None:
    """Plot a line over rising times, and its range where it chatters; `top` is the length of the value axis."""
    if not len(time_s):
        panel.plot(time_s, values, label=label, **looks)
        return
    window = round(len(time_s) / _WINDOWS)
    found = envelope(values, window, _LEAST_SHARE * top)
    (line,) = panel.plot(time_s, found.values, label=label, **looks)
    if found.chatters.any():
        named = LABEL in panel.get_legend_handles_labels()[1]
        few = slice(None, None, max(window // _POINTS, 1))
        panel.fill_between(
            time_s[few], found.low[few], found.high[few], where=found.chatters[few].tolist(), color=line.get_color(),
            alpha=_SHADE, lw=0.0, label="" if named else LABEL,
        )  # fmt: skip


def _reversals(values: Array) -> Array:
    """1 where the direction changes, else 0; a level stretch has none."""
    steps = np.sign(np.diff(values))
    moves = np.flatnonzero(np.nan_to_num(steps))
    turns = moves[1:][steps[moves[1:]] != steps[moves[:-1]]]
    found = np.zeros(len(values), np.int64)
    found[turns] = 1
    return found


def _windows(values: Array, window: int) -> Array:
    """For each value the `window` values around it; at the ends the first and last are repeated."""
    before = window // 2
    padded = np.pad(values, (before, window - 1 - before), mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, window)
