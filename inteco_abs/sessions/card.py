"""The result card: the metrics of a run."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any, Final

import numpy as np

from inteco_abs.config import RigConfig
from inteco_abs.control import swing_band
from inteco_abs.errors import SessionError
from inteco_abs.format import TICK, TRUTH
from inteco_abs.quantities import finite
from inteco_abs.rig import nominal_parameters
from inteco_abs.sessions.metrics import FALL_BACKS, Array, SlipErrors, StopTrace, stop_metrics
from inteco_abs.sessions.reader import Session, session_config
from inteco_abs.sessions.rows import in_step
from inteco_abs.signals import BoardFlags, Phase

_MOST_DIGITS: Final = 18
"""Most digits of an integer in a card; the counts of a run have fewer."""


def result_card(config: RigConfig | None, ticks: Array, truth: Array) -> dict[str, Any]:
    """The card of a complete run, without a configuration only its timing; `truth` has no rows on a real rig."""
    return _card_of_blocks(config, in_step([(ticks, truth)]))


def _card_of_blocks(config: RigConfig | None, blocks: Iterable[tuple[Array, Array]]) -> dict[str, Any]:
    card = RunningCard(config)
    for rows, states in blocks:
        card.add(rows, states)
    return card.card()


def link_errors(ticks: Array) -> int:
    """Ticks whose exchange with the board failed."""
    return int(((ticks["board_flags"] & BoardFlags.STALE) != 0).sum())


class RunningCard:
    """Metrics of a run, block by block; it keeps the rows of at most one stop.

    The metrics are those of `stop_metrics`, the median over several stops. Speed and slip are the true ones if known,
    else the estimated ones; the distance is that of the road wheel's encoder. Without a configuration there is only the
    timing.
    """

    def __init__(self, config: RigConfig | None) -> None:
        self.ticks = 0
        self.last_tick = -1
        """Number of the newest tick; -1 before the first."""
        self.link_errors = 0
        """Ticks whose exchange with the board failed."""
        self._config = config
        self._overruns = 0
        self._lateness = _Lateness()
        self._stops: list[dict[str, Any]] = []
        self._stop, self._truth = bytearray(), bytearray()
        self._references = set[float]()
        """Reference slips so far, of each stop the two smallest."""

    def add(self, ticks: Array, truth: Array) -> None:
        """Add ticks, and the states of the simulated rig up to at least the last of them."""
        if self._config is not None:
            self._truth += truth.tobytes()
        if not len(ticks):
            return
        self.ticks += len(ticks)
        self.last_tick = int(ticks["tick"][-1])
        self._overruns += int(ticks["skipped"].sum())
        self.link_errors += link_errors(ticks)
        self._lateness.add(ticks["late_us"])
        if self._config is not None:
            self._follow(ticks, self._config)

    def card(self) -> dict[str, Any]:
        """The card so far, including an unfinished stop."""
        config = self._config
        cards = [*self._stops, *([self._stop_card(config)] if config is not None and self._stop else [])]
        constant = None if config is None or len(self._references) > 1 else config.controller.constant_slip
        card = {
            "controller": None if config is None else config.controller.name,
            "estimator": None if config is None else config.estimator.name,
            "ticks": self.ticks,
            "overruns": self._overruns,
            "stops": None if config is None else len(cards),
            "start_speed_rad_s": None,
            "reference_slip": constant,
            **dict.fromkeys(_STOP_METRICS),
            "lateness_us": self._lateness.percentiles(),
        }
        for name in ("start_speed_rad_s", *_STOP_METRICS):
            values = [each[name] for each in cards if each.get(name) is not None]
            card[name] = float(np.median(values)) if values else None
        return card

    def _follow(self, ticks: Array, config: RigConfig) -> None:
        """Collect the braking and stopped ticks of each stop."""
        braking = (ticks["phase"] == Phase.BRAKING) | (ticks["phase"] == Phase.STOPPED)
        edges = [0, *(np.flatnonzero(np.diff(braking)) + 1).tolist(), len(ticks)]
        for first, end in pairwise(edges):
            if braking[first]:
                self._stop += ticks[first:end].tobytes()
            elif self._stop:
                self._stops.append(self._stop_card(config))
                self._stop.clear()
        if not self._stop:  # keep the newest state for the first tick of the next stop
            states = TRUTH.array(bytes(self._truth))
            seen = int(np.searchsorted(states["time_ns"], ticks["time_ns"][-1], side="right"))
            del self._truth[: max(seen - 1, 0) * TRUTH.size]

    def _stop_card(self, config: RigConfig) -> dict[str, Any]:
        stop = TICK.array(bytes(self._stop))
        true = aligned_truth(TRUTH.array(bytes(self._truth)), stop["time_ns"])
        source = stop if true is None else true
        counts = stop["road_count"].astype(np.int64) - int(stop["road_count"][0])
        trace = StopTrace(
            since_ns=stop["time_ns"].astype(np.int64) - int(stop["time_ns"][0]),
            slip=source["slip"],
            slip_estimated=stop["slip"],
            road_speed_rad_s=source["road_speed_rad_s"],
            road_angle_rad=counts * 2.0 * math.pi / config.encoders.counts_per_turn,
            brake=stop["brake"],
        )
        recorded = stop["slip_reference"]
        known = recorded > 0.0  # NaN once stopped
        self._references.update(np.unique(recorded[known]).tolist()[:2])
        reference = np.where(known, recorded, config.controller.reference_slip)
        band = swing_band(config)
        errors = SlipErrors(band, stop["switching"], reference, stop["dt_s"]) if band > 0.0 else None
        metrics = stop_metrics(trace, reference, nominal_parameters(config.model), errors)
        if true is not None:
            metrics |= {name: metrics[name.removesuffix("_true")] for name in _STOP_METRICS if name.endswith("_true")}
        return {"start_speed_rad_s": float(source["road_speed_rad_s"][0]), **metrics}


class _Lateness:
    """Counts of each value of the ticks' lateness; values repeat, as clocks count nanoseconds."""

    _SHARES: Final = {"p50": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}
    _MOST_NEW: Final = 1 << 16

    def __init__(self) -> None:
        self._values, self._numbers = np.zeros(0, np.float32), np.zeros(0, np.int64)
        self._new: list[Array] = []
        self._new_number = 0

    def add(self, late_us: Array) -> None:
        self._new.append(late_us.copy())
        self._new_number += len(late_us)
        if self._new_number > self._MOST_NEW:
            self._count()

    def _count(self) -> None:
        values, numbers = np.unique(np.concatenate([self._values[:0], *self._new]), return_counts=True)
        self._new, self._new_number = [], 0
        at = np.searchsorted(self._values, values)
        known = np.append(self._values, math.nan)[at] == values
        self._numbers[at[known]] += numbers[known]
        self._values = np.insert(self._values, at[~known], values[~known])
        self._numbers = np.insert(self._numbers, at[~known], numbers[~known])

    def percentiles(self) -> dict[str, float | None]:
        """Return the percentiles, equal to `np.percentile` of all values."""
        self._count()
        if not len(self._values):
            return dict.fromkeys(self._SHARES)
        ends = np.cumsum(self._numbers)
        at = np.array(list(self._SHARES.values())) / 100.0 * (ends[-1] - 1)
        below, part = np.floor(at), at - np.floor(at)
        low, high = (
            self._values[np.searchsorted(ends, np.minimum(place, ends[-1] - 1), side="right")].astype(float)
            for place in (below, below + 1)
        )
        # from the nearer end, as numpy interpolates
        found = np.where(part < 0.5, low + (high - low) * part, high - (high - low) * (1.0 - part))
        if np.isnan(self._values[-1]):
            found[:] = math.nan
        return dict(zip(self._SHARES, map(float, found), strict=True))


def stored_card(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, Any] | None:
    """The result card in a session's metadata, with finite numbers only; None without a valid one."""
    try:
        card = json.loads(
            metadata.get("result", {}).get("card", ""),
            parse_int=_count,
            parse_float=lambda text: finite(float(text)),
            parse_constant=lambda _name: None,
        )
    except (ValueError, RecursionError):
        return None
    return card if isinstance(card, dict) else None


def card_of(session: Session) -> dict[str, Any] | None:
    """The session's card, computed from the ticks if the file lacks it; None without a usable configuration."""
    stored = stored_card(session.metadata)
    if stored is not None:
        return stored
    try:
        return computed_card(session)
    except SessionError:
        return None


def computed_card(session: Session) -> dict[str, Any]:
    """The session's card, computed from its ticks. Raises SessionError without a usable configuration."""
    return _card_of_blocks(session_config(session, ()), session.blocks())


def _count(text: str) -> int | None:
    return int(text) if len(text) <= _MOST_DIGITS else None


_STOP_METRICS: Final = (
    "reaching_time_s",
    "band_entry_s",
    "stop_time_s",
    "stop_distance_m",
    "slip_rms_true",
    "slip_rms_estimated",
    "slip_rms_low_speed_true",
    "slip_rms_fixed_true",
    "lock_fraction",
    "torque_variation_nm_per_s",
    "duty_variation_per_s",
    *FALL_BACKS,
)


def aligned_truth(truth: Array, time_ns: Array) -> Array | None:
    """Newest truth at or before each tick, NaN before the first; None without truth or ticks."""
    if not len(truth) or not len(time_ns):
        return None
    newest = np.searchsorted(truth["time_ns"], time_ns, side="right") - 1
    aligned: Array = truth[np.maximum(newest, 0)]
    for name in aligned.dtype.names or ():
        if name != "time_ns":
            aligned[name][newest < 0] = math.nan
    return aligned
