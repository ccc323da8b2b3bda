"""Traces of each session for the report's plots, decimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from inteco_abs.sessions import Session, aligned_truth
from inteco_abs.signals import Phase
from inteco_abs.views.comparison import PALETTE, held_rows, phase_spans, since_s, start_ns
from inteco_abs.views.decimation import Decimated, decimate

_POINTS: Final = 9000
"""Points of a lone session: at most 0.9 MB, where bokeh's script takes 1.3 MB."""
_POINTS_OF_EACH: Final = 4000
"""Points of each of several sessions."""
MARGIN_S: Final = 0.1
"""Time shown before braking and after the brake is released."""
_TICK_COLUMNS: Final = (
    "wheel_speed_rad_s", "road_speed_rad_s", "slip", "slip_reference", "torque_demand_nm", "drive", "brake",
    "switching", "late_us", "io_us", "busy_us",
)  # fmt: skip
_TRUTH_COLUMNS: Final = ("slip", "brake_torque_nm")
_LETTERS: Final = "ABCDEF"
_MARKERS: Final = (
    ("circle", "●"), ("square", "■"), ("triangle", "▲"), ("diamond", "◆"), ("inverted_triangle", "▼"), ("star", "★"),
)  # fmt: skip

Array = npt.NDArray[Any]


class Look(NamedTuple):
    """What identifies a session in every plot and table."""

    letter: str
    colour: str
    marker: str
    sign: str
    """The marker as a character."""


@dataclass(frozen=True, slots=True)
class Band:
    """A phase; times since braking began."""

    phase: Phase
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class ReportTrace:
    """One session to draw; it has ticks."""

    look: Look
    session: Session
    points: Decimated
    """Columns of the ticks, and as `true_NAME` those of the simulated rig at the same times."""
    bands: tuple[Band, ...]
    held_s: tuple[float, float]
    """First and last time of the first stop, or of a session without one."""
    whole_s: tuple[float, float]
    braked: bool


def traces_of(sessions: Sequence[Session]) -> list[ReportTrace]:
    """Traces of all sessions with ticks."""
    most = _POINTS if len(sessions) == 1 else _POINTS_OF_EACH
    return [_trace(look_of(at), session, most) for at, session in enumerate(sessions) if len(session.ticks)]


def look_of(at: int) -> Look:
    """Look of the session at that index."""
    return Look(_LETTERS[at], PALETTE[at], *_MARKERS[at])


def _trace(look: Look, session: Session, most: int) -> ReportTrace:
    start = start_ns(session)
    time_s = since_s(session.ticks, start)
    bands = tuple(
        Band(each.phase, float(time_s[each.first]), float(time_s[min(each.end, len(time_s) - 1)]))
        for each in phase_spans(session.ticks)
    )
    held, whole_s = _first_run(held_rows(session.ticks)), (float(time_s[0]), float(time_s[-1]))
    columns = {name: session.ticks[name] for name in _TICK_COLUMNS}
    truth = aligned_truth(session.truth, session.ticks["time_ns"])
    if truth is not None:
        columns |= {f"true_{name}": truth[name] for name in _TRUTH_COLUMNS}
    return ReportTrace(
        look,
        session,
        decimate(columns, time_s, _matters(time_s, bands), most),
        bands,
        (float(time_s[held[0]]), float(time_s[held[-1]])) if len(held) else whole_s,
        whole_s,
        len(held) > 0,
    )


def _first_run(rows: Array) -> Array:
    """The first rows without a gap."""
    gaps = np.flatnonzero(np.diff(rows) > 1)
    run: Array = rows[: gaps[0] + 1] if len(gaps) else rows
    return run


def _matters(time_s: Array, bands: Sequence[Band]) -> Array:
    """Mask of the rows while the brake is held, with a margin."""
    found = np.zeros(len(time_s), bool)
    for band in bands:
        if band.phase in {Phase.BRAKING, Phase.STOPPED}:
            found |= (time_s >= band.start_s - MARGIN_S) & (time_s <= band.end_s + MARGIN_S)
    return found
