"""Decimation that keeps every extreme: a peak of one tick stays visible."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
_POINTS_A_BIN: Final = 2
_LARGEST: Final = 1e30
"""A controller's demand has no limit, float32 has."""


class Decimated(NamedTuple):
    """Decimated columns."""

    time_s: Array
    columns: dict[str, Array]
    """float32, one value per time."""
    inside: int
    """Rows for each two points in the runs that matter; 1 if every row is a point."""
    outside: int
    """Rows for each two points elsewhere."""


def decimate(columns: Mapping[str, Array], time_s: Array, matters: Array, most: int) -> Decimated:
    """Decimate to about `most` points, up to three quarters of them in rows where `matters` is true.

    Each bin of neighbouring rows becomes two points: smallest and largest value in their order, at the times of its
    first and last row. NaN is left out where the bin has a number.
    """
    thinned = Decimator(columns, int(matters.sum()), int((~matters).sum()), most)
    thinned.add(columns, time_s, matters)
    return thinned.decimated()


class Decimator:
    """Decimates the columns `names` as `decimate`, of rows that come in blocks: `matter` of them and `others`."""

    def __init__(self, names: Iterable[str], matter: int, others: int, most: int) -> None:
        self._inside = _bin(matter, 3 * most // 4)
        spent = matter * (_POINTS_A_BIN if self._inside > 1 else 1) // self._inside
        self._outside = _bin(others, most - spent)
        self._times: list[Array] = []
        self._values: dict[str, list[Array]] = {name: [] for name in names}
        self._waiting: tuple[Mapping[str, Array], Array, Array] | None = None
        """Last rows of a run that do not fill a bin yet."""

    def add(self, columns: Mapping[str, Array], time_s: Array, matters: Array) -> None:
        """Add the next rows."""
        if self._waiting is not None:
            before, times, mattered = self._waiting
            columns = {name: np.concatenate([before[name], columns[name]]) for name in self._values}
            time_s, matters = np.concatenate([times, time_s]), np.concatenate([mattered, matters])
        done = 0
        for first, end in _runs(matters):
            size = self._inside if matters[first] else self._outside
            rest = (end - first) % size if end == len(matters) else 0  # the last run may go on
            done = end - rest
            self._put(columns, time_s, slice(first, done), size)
        self._waiting = {name: columns[name][done:] for name in self._values}, time_s[done:], matters[done:]

    def _put(self, columns: Mapping[str, Array], time_s: Array, rows: slice, size: int) -> None:
        if rows.start < rows.stop:
            self._times.append(_times(time_s[rows], size))
            for name, values in self._values.items():
                values.append(_extremes(columns[name][rows], size))

    def decimated(self) -> Decimated:
        """All points; nothing more is added."""
        if self._waiting is not None and len(self._waiting[1]):
            columns, time_s, matters = self._waiting
            self._put(columns, time_s, slice(0, len(time_s)), self._inside if matters[0] else self._outside)
        empty = np.zeros(0)
        return Decimated(
            np.concatenate([empty, *self._times]),
            {
                name: np.clip(np.concatenate([empty, *parts]), -_LARGEST, _LARGEST).astype(np.float32)
                for name, parts in self._values.items()
            },
            self._inside,
            self._outside,
        )


def _bin(rows: int, points: int) -> int:
    """Size of a bin for at most `points` points."""
    return 1 if rows <= points else -(-_POINTS_A_BIN * rows // max(points, _POINTS_A_BIN))


def _runs(matters: Array) -> Iterator[tuple[int, int]]:
    edges = [0, *(np.flatnonzero(np.diff(matters)) + 1).tolist(), len(matters)]
    return ((first, end) for first, end in pairwise(edges) if first < end)


def _times(time_s: Array, size: int) -> Array:
    if size == 1:
        return time_s
    starts = np.arange(0, len(time_s), size)
    ends = np.minimum(starts + size, len(time_s)) - 1
    return np.column_stack([time_s[starts], time_s[ends]]).ravel()


def _extremes(values: Array, size: int) -> Array:
    if size == 1:
        return values
    missing = -len(values) % size
    binned = np.concatenate([values.astype(float), np.repeat(values[-1:], missing)]).reshape(-1, size)
    lost = np.isnan(binned)
    lowest = np.where(lost, np.inf, binned).argmin(axis=1)
    highest = np.where(lost, -np.inf, binned).argmax(axis=1)
    order = np.sort(np.column_stack([lowest, highest]), axis=1)
    return np.take_along_axis(binned, order, axis=1).ravel()
