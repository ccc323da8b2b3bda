"""Segments of sessions: run-ups, coast-downs and brakings, as counts over time with the duties in force."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from inteco_abs.sessions import TICK, Session
from inteco_abs.signals import Phase

Floats = npt.NDArray[np.float64]
SegmentKind = Literal["run-up", "coast-down", "braking"]

SAMPLE_S: Final[dict[SegmentKind, float]] = {"run-up": 0.020, "coast-down": 0.050, "braking": 0.004}
"""Time between two samples that are compared with the model; more samples would not help."""
_SPEED_WINDOW_S: Final = 0.020
_SLOWEST_RAD_S: Final[dict[SegmentKind, float]] = {"run-up": 0.0, "coast-down": 3.0, "braking": 3.0}
"""Road speed at which a segment ends; below, slip has no meaning and counts are too few."""
_RELEASED_S: Final = 0.5
"""Time after a release in which the brake's lag is over; then the wheels coast."""
_FEWEST_SAMPLES: Final = 50
_MOST_RUN_UPS: Final = 2
_USED: Final = ["time_ns", "wheel_count", "road_count", "drive", "brake", "phase", "board_flags"]
_ROW: Final = np.dtype([(name, TICK.dtype[name]) for name in _USED])


@dataclass(frozen=True)
class Segment:
    """One part of a session: samples, and the duties in force from each sample."""

    session: str
    kind: SegmentKind
    counts_per_turn: int
    time_s: Floats
    """Time since the first sample, s."""
    wheel_count: Floats
    road_count: Floats
    drive: Floats
    brake: Floats
    compared: npt.NDArray[np.bool_]
    """Samples that are compared with the model; at the others a duty changes."""

    @cached_property
    def levels(self) -> tuple[float, ...]:
        """Brake duties above 0."""
        return tuple(sorted({round(float(duty), 4) for duty in self.brake if duty > 0.0}))

    def start_speeds(self) -> tuple[float, float]:
        """Speeds of wheel and road, rad/s, by a straight line through the first samples; 0 at the start of a run-up."""
        if self.kind == "run-up":
            return 0.0, 0.0
        first = self.time_s <= max(_SPEED_WINDOW_S, self.time_s[min(5, len(self.time_s) - 1)])
        per_turn = 2.0 * np.pi / self.counts_per_turn
        wheel, road = (np.polyfit(self.time_s[first], c[first], 1)[0] for c in (self.wheel_count, self.road_count))
        return float(wheel * per_turn), float(road * per_turn)


def segment(
    session: str,
    kind: SegmentKind,
    counts_per_turn: int,
    time_s: Floats,
    counts: tuple[Floats, Floats],
    duties: tuple[Floats, Floats],
) -> Segment | None:
    """The segment between two changes of phase; None if it is too slow or too short.

    `counts` are those of wheel and road, `duties` those of drive and brake in force from each sample.
    """
    (wheel, road), (drive, brake) = counts, duties
    ahead = np.searchsorted(time_s, time_s + _SPEED_WINDOW_S).clip(max=len(time_s) - 1)
    elapsed = time_s[ahead] - time_s
    with np.errstate(divide="ignore", invalid="ignore"):
        speed = (road[ahead] - road) / elapsed * (2.0 * np.pi / counts_per_turn)
    slow = np.flatnonzero((speed < _SLOWEST_RAD_S[kind]) & (elapsed > 0.5 * _SPEED_WINDOW_S))
    end = int(slow[0]) if len(slow) and kind != "run-up" else len(time_s)
    if kind == "braking" and brake.any():
        end = min(end, int(np.searchsorted(time_s, time_s[np.flatnonzero(brake)[-1]] + _RELEASED_S)))
    if end < _FEWEST_SAMPLES:
        return None
    grid = np.floor((time_s[:end] - time_s[0]) / SAMPLE_S[kind] + 1e-6)
    compared = np.diff(grid, prepend=-1.0) > 0.0
    changes = (np.diff(drive[:end], prepend=drive[0]) != 0.0) | (np.diff(brake[:end], prepend=brake[0]) != 0.0)
    kept = np.flatnonzero(compared | changes)
    return Segment(
        session,
        kind,
        counts_per_turn,
        time_s[kept] - time_s[0],
        wheel[kept] - wheel[0],
        road[kept] - road[0],
        drive[kept],
        brake[kept],
        compared[kept],
    )


def segments(session: Session, counts_per_turn: int) -> Iterator[Segment]:
    """All usable segments of `session`. A tick's duties take effect at the next one."""
    for phase, found in _by_phase(session):
        good = found["board_flags"] == 0  # with a flag, the counts may be older than the tick
        if phase not in {Phase.SPIN_UP, Phase.BRAKING} or good.sum() < _FEWEST_SAMPLES:
            continue
        rows = found[good]
        kind: SegmentKind = "run-up" if phase == Phase.SPIN_UP else "braking" if rows["brake"].any() else "coast-down"
        time_s = rows["time_ns"].astype(np.int64) * 1e-9
        counts = rows["wheel_count"].astype(float), rows["road_count"].astype(float)
        usable = segment(session.path.name, kind, counts_per_turn, time_s, counts, (rows["drive"], rows["brake"]))
        if usable is not None:
            yield usable


def _by_phase(session: Session) -> Iterator[tuple[int, npt.NDArray[np.void]]]:
    """Phases one after the other with their ticks, in which `drive` and `brake` are the duties in force."""
    phase, parts, before = -1, list[npt.NDArray[np.void]](), (0.0, 0.0)
    for ticks, _ in session.blocks():
        rows = ticks[_USED].astype(_ROW)
        for at, name in enumerate(("drive", "brake")):
            rows[name][1:], rows[name][0] = ticks[name][:-1], before[at]
        before = float(ticks["drive"][-1]), float(ticks["brake"][-1])
        edges = np.flatnonzero(np.diff(ticks["phase"].astype(np.int16))) + 1
        for part in np.split(rows, edges):
            if parts and part["phase"][0] != phase:
                yield phase, np.concatenate(parts)
                parts = []
            phase = int(part["phase"][0])
            parts.append(part)
    if parts:
        yield phase, np.concatenate(parts)


def chosen(found: Iterable[Segment]) -> list[Segment]:
    """The segments to fit: all, but only the first two run-ups, as run-ups are alike."""
    kept, run_ups = [], 0
    for each in found:
        run_ups += each.kind == "run-up"
        if each.kind != "run-up" or run_ups <= _MOST_RUN_UPS:
            kept.append(each)
    return kept
