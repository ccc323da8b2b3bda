"""Traces of each session for the report's plots, decimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from inteco_abs.format import TRUTH
from inteco_abs.sessions import Array, PhaseSpan, Session, aligned_truth, joined_rows
from inteco_abs.signals import Phase
from inteco_abs.views.comparison import PALETTE, changes_s, held_spans, since_s, start_ns
from inteco_abs.views.decimation import Decimated, Decimator

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
    late_us: Array
    """Lateness of every tick."""
    bands: tuple[Band, ...]
    held_s: tuple[float, float]
    """First and last time of the first stop, or of a session without one."""
    whole_s: tuple[float, float]
    braked: bool
    changes_s: tuple[float, ...]
    """Times at which gains changed."""


def traces_of(sessions: Sequence[Session]) -> list[ReportTrace]:
    """Traces of all sessions with ticks."""
    most = _POINTS if len(sessions) == 1 else _POINTS_OF_EACH
    return [_trace(look_of(at), session, most) for at, session in enumerate(sessions) if session.tick_count]


def look_of(at: int) -> Look:
    """Look of the session at that index."""
    return Look(_LETTERS[at], PALETTE[at], *_MARKERS[at])


def _trace(look: Look, session: Session, most: int) -> ReportTrace:
    start, spans = start_ns(session), session.rows.phases
    ends_ns = [*(span.first_ns for span in spans[1:]), spans[-1].last_ns]
    bands = tuple(
        Band(span.phase, (span.first_ns - start) * 1e-9, (end_ns - start) * 1e-9)
        for span, end_ns in zip(spans, ends_ns, strict=True)
    )
    held = _first_run(held_spans(session))
    whole_s = (spans[0].first_ns - start) * 1e-9, (spans[-1].last_ns - start) * 1e-9
    matter = sum(int(_matters(since_s(ticks, start), bands).sum()) for ticks, _ in session.blocks())
    names = [*_TICK_COLUMNS, *(f"true_{name}" for name in _TRUTH_COLUMNS if session.truth_count)]
    points = Decimator(names, matter, session.tick_count - matter, most)
    late_us, newest = list[Array](), TRUTH.array(b"")
    for ticks, truth in session.blocks():
        known = joined_rows(newest, truth)
        newest = known[-1:]
        columns = {name: ticks[name] for name in _TICK_COLUMNS}
        aligned = aligned_truth(known, ticks["time_ns"])
        if aligned is not None:
            columns |= {f"true_{name}": aligned[name] for name in _TRUTH_COLUMNS}
        time_s = since_s(ticks, start)
        points.add(columns, time_s, _matters(time_s, bands))
        late_us.append(ticks["late_us"].copy())
    return ReportTrace(
        look,
        session,
        points.decimated(),
        np.concatenate(late_us),
        bands,
        ((held[0].first_ns - start) * 1e-9, (held[-1].last_ns - start) * 1e-9) if held else whole_s,
        whole_s,
        len(held) > 0,
        changes_s(session),
    )


def _first_run(spans: Sequence[PhaseSpan]) -> Sequence[PhaseSpan]:
    """The first phases that follow each other without a gap."""
    gaps = [at for at, (one, other) in enumerate(pairwise(spans), 1) if one.end != other.first]
    return spans[: gaps[0]] if gaps else spans


def _matters(time_s: Array, bands: Sequence[Band]) -> Array:
    """Mask of the rows while the brake is held, with a margin."""
    found = np.zeros(len(time_s), bool)
    for band in bands:
        if band.phase in {Phase.BRAKING, Phase.STOPPED}:
            first, end = np.searchsorted(time_s, (band.start_s - MARGIN_S, band.end_s + MARGIN_S), side="left")
            found[first:end] = True
    return found
