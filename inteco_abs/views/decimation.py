"""Decimation that keeps every extreme: a peak of one tick stays visible."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
    inside = _bin(int(matters.sum()), 3 * most // 4)
    spent = int(matters.sum()) * (_POINTS_A_BIN if inside > 1 else 1) // inside
    outside = _bin(int((~matters).sum()), most - spent)
    times: list[Array] = []
    values: dict[str, list[Array]] = {name: [] for name in columns}
    for first, end in _runs(matters):
        size = inside if matters[first] else outside
        times.append(_times(time_s[first:end], size))
        for name, column in columns.items():
            values[name].append(_extremes(column[first:end], size))
    empty = np.zeros(0)
    return Decimated(
        np.concatenate([empty, *times]),
        {
            name: np.clip(np.concatenate([empty, *parts]), -_LARGEST, _LARGEST).astype(np.float32)
            for name, parts in values.items()
        },
        inside,
        outside,
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
