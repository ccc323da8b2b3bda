"""The result card: what a stop was worth, in numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from inteco_abs.config import RigConfig
from inteco_abs.errors import SessionError
from inteco_abs.rig import nominal_parameters
from inteco_abs.sessions.metrics import StopTrace, stop_metrics
from inteco_abs.sessions.reader import Session
from inteco_abs.sessions.recorded_config import session_config
from inteco_abs.signals import BoardFlags, Phase

_MOST_DIGITS: Final = 18
"""Of a whole number in a card; counts that a run can reach have fewer."""

Array = npt.NDArray[Any]


def result_card(config: RigConfig, ticks: Array, truth: Array) -> dict[str, Any]:
    """Metrics of one stop. `truth` has no rows on a real rig; what rests on it is then None.

    They are those of `stop_metrics`, from the first tick of the braking phase on and with the brake still held. Speed
    and slip are the true ones where there are any, else the estimated ones; distance is what the road wheel's encoder
    counted. Of several stops in one session, each metric is the median of those that have it.
    """
    stops = _stops(ticks)
    card = timing_card(ticks) | {
        "controller": config.controller.name,
        "estimator": config.estimator.name,
        "stops": len(stops),
        "reference_slip": config.controller.reference_slip,
    }
    cards = [_stop_card(config, stop, truth) for stop in stops]
    for name in ("start_speed_rad_s", *_STOP_METRICS):
        values = [each[name] for each in cards if each.get(name) is not None]
        card[name] = float(np.median(values)) if values else None
    return card


def stored_card(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, Any] | None:
    """The result card in a session's metadata; None if there is none that can be read.

    No number in it is infinite, and none too large for a double.
    """
    try:
        card = json.loads(
            metadata.get("result", {}).get("card", ""),
            parse_int=_count,
            parse_float=_finite,
            parse_constant=lambda _name: None,
        )
    except (ValueError, RecursionError):
        return None
    return card if isinstance(card, dict) else None


def card_of(session: Session) -> dict[str, Any] | None:
    """The card that a session holds, or, where it was cut, one made of what it has; None if that cannot be."""
    stored = stored_card(session.metadata)
    if stored is not None:
        return stored
    try:
        return result_card(session_config(session, ()), session.ticks, session.truth)
    except SessionError:
        return None


def _count(text: str) -> int | None:
    return int(text) if len(text) <= _MOST_DIGITS else None


def _finite(text: str) -> float | None:
    value = float(text)
    return value if math.isfinite(value) else None


def timing_card(ticks: Array) -> dict[str, Any]:
    """The card of which nothing is known but how punctual the ticks were."""
    return {
        "controller": None,
        "estimator": None,
        "ticks": len(ticks),
        "overruns": int(ticks["skipped"].sum()),
        "stops": None,
        "start_speed_rad_s": None,
        "reference_slip": None,
        **dict.fromkeys(_STOP_METRICS),
        "lateness_us": _lateness(ticks),
    }


def link_errors(ticks: Array) -> int:
    """Ticks whose exchange with the board failed."""
    return int(((ticks["board_flags"] & BoardFlags.STALE) != 0).sum())


def _stops(ticks: Array) -> list[Array]:
    """The braking and stopped ticks of each stop."""
    braking = (ticks["phase"] == Phase.BRAKING) | (ticks["phase"] == Phase.STOPPED)
    edges = np.flatnonzero(np.diff(braking.astype(np.int8), prepend=0, append=0))
    return [ticks[first:end] for first, end in zip(edges[::2], edges[1::2], strict=True)]


def _stop_card(config: RigConfig, stop: Array, truth: Array) -> dict[str, Any]:
    true = aligned_truth(truth, stop["time_ns"])
    source = stop if true is None else true
    counts = stop["road_count"].astype(np.int64) - int(stop["road_count"][0])
    course = StopTrace(
        since_ns=stop["time_ns"].astype(np.int64) - int(stop["time_ns"][0]),
        slip=source["slip"],
        slip_estimated=stop["slip"],
        road_speed_rad_s=source["road_speed_rad_s"],
        road_angle_rad=counts * 2.0 * math.pi / config.encoders.counts_per_turn,
        brake=stop["brake"],
    )
    metrics = stop_metrics(course, config.controller.reference_slip, nominal_parameters(config.model))
    if true is not None:
        metrics |= {name: metrics[name.removesuffix("_true")] for name in _STOP_METRICS if name.endswith("_true")}
    return {"start_speed_rad_s": float(source["road_speed_rad_s"][0]), **metrics}


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
)


def aligned_truth(truth: Array, time_ns: Array) -> Array | None:
    """Newest truth at or before each tick, or None where there is none."""
    if not len(truth) or not len(time_ns):
        return None
    newest = np.searchsorted(truth["time_ns"], time_ns, side="right") - 1
    aligned: Array = truth[np.maximum(newest, 0)]
    for name in aligned.dtype.names or ():
        if name != "time_ns":
            aligned[name][newest < 0] = math.nan  # before the first of them nothing is known
    return aligned


def _lateness(ticks: Array) -> dict[str, float | None]:
    names, shares = ("p50", "p99", "p999", "max"), (50.0, 99.0, 99.9, 100.0)
    if not len(ticks):
        return dict.fromkeys(names)
    values = np.percentile(ticks["late_us"].astype(float), shares)
    return dict(zip(names, map(float, values), strict=True))
