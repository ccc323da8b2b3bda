"""The result card: what a stop was worth, in numbers."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from inteco_abs.config import RigConfig
from inteco_abs.rig import RigParameters, brake_torque
from inteco_abs.signals import Phase

_BAND: Final = 0.01
"""Slip error that counts as having arrived."""
_SETTLE_S: Final = 0.020
_FIXED_START_S: Final = 0.25
_LOWEST_RAD_S: Final = 10.0
_LOW_SPEED_RAD_S: Final = 60.0
_LOCKED_SLIP: Final = 0.9
_STANDSTILL_RAD_S: Final = 0.5
_NEVER: Final = np.iinfo(np.int64).max

Array = npt.NDArray[Any]


def result_card(config: RigConfig, ticks: Array, truth: Array) -> dict[str, Any]:
    """Metrics of one stop. `truth` has no rows on a real rig; what rests on it is then None.

    Braking starts at the first tick of the braking phase. Reaching is the first crossing of the reference slip,
    band entry the first slip within 0.01 of it. Slip RMS is that of slip minus reference from 20 ms after band
    entry until the road wheel is below 10 rad/s; `fixed` the same from 0.25 s after braking began, `low_speed`
    the same for 10 to 60 rad/s. The stop is the road wheel below 0.5 rad/s with the brake still held. Speed and
    slip are the true ones where there are any, else the estimated ones. Of several stops in one session, each metric
    is the median of those that have it.
    """
    stops = _stops(ticks)
    card: dict[str, Any] = {
        "controller": config.controller.name,
        "estimator": config.estimator.name,
        "ticks": len(ticks),
        "overruns": int(ticks["skipped"].sum()),
        "stops": len(stops),
        "start_speed_rad_s": None,
        "reference_slip": config.controller.reference_slip,
        **dict.fromkeys(_STOP_METRICS),
        "lateness_us": _lateness(ticks),
    }
    cards = [_stop_card(config, stop, truth) for stop in stops]
    for name in ("start_speed_rad_s", *_STOP_METRICS):
        values = [each[name] for each in cards if each.get(name) is not None]
        card[name] = float(np.median(values)) if values else None
    return card


def _stops(ticks: Array) -> list[Array]:
    """The braking and stopped ticks of each stop."""
    braking = (ticks["phase"] == Phase.BRAKING) | (ticks["phase"] == Phase.STOPPED)
    edges = np.flatnonzero(np.diff(braking.astype(np.int8), prepend=0, append=0))
    return [ticks[first:end] for first, end in zip(edges[::2], edges[1::2], strict=True)]


def _stop_card(config: RigConfig, stop: Array, truth: Array) -> dict[str, Any]:
    true = _aligned(truth, stop["time_ns"])
    source = stop if true is None else true
    metrics = _stop_metrics(config, stop, source["slip"], source["road_speed_rad_s"], true)
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


def _stop_metrics(config: RigConfig, stop: Array, slip: Array, speed: Array, true: Array | None) -> dict[str, Any]:
    reference = config.controller.reference_slip
    since_ns = stop["time_ns"].astype(np.int64) - int(stop["time_ns"][0])
    time_s = since_ns * 1e-9
    entry = _first(time_s, np.abs(slip - reference) < _BAND)
    slow = np.flatnonzero(speed < _LOWEST_RAD_S)
    fast = np.arange(len(stop)) < (slow[0] if len(slow) else len(stop))
    end = float(time_s[slow[0]]) if len(slow) else None
    settled = fast & (since_ns >= (_NEVER if entry is None else round((entry + _SETTLE_S) * 1e9)))
    standing = np.flatnonzero(speed < _STANDSTILL_RAD_S)
    parameters = RigParameters.named(config.model.parameters)
    metrics: dict[str, Any] = {
        "reaching_time_s": _first(time_s, slip >= reference),
        "band_entry_s": entry,
        "slip_rms_estimated": _rms(stop["slip"] - reference, settled),
        "lock_fraction": float(np.mean(slip[fast] > _LOCKED_SLIP)) if fast.any() else None,
    }
    if len(standing):
        counts = int(stop["road_count"][standing[0]]) - int(stop["road_count"][0])
        metrics["stop_time_s"] = float(time_s[standing[0]])
        metrics["stop_distance_m"] = counts * 2.0 * math.pi / config.encoders.counts_per_turn * parameters.r2
    if end:
        duties = stop["brake"][fast]
        torques = np.array([brake_torque(duty, parameters) for duty in duties.tolist()])
        metrics["torque_variation_nm_per_s"] = float(np.abs(np.diff(torques)).sum() / end)
        metrics["duty_variation_per_s"] = float(np.abs(np.diff(duties)).sum() / end)
    if true is not None:
        error = true["slip"] - reference
        metrics["slip_rms_true"] = _rms(error, settled)
        metrics["slip_rms_low_speed_true"] = _rms(error, settled & (speed <= _LOW_SPEED_RAD_S))
        metrics["slip_rms_fixed_true"] = _rms(error, fast & (since_ns >= round(_FIXED_START_S * 1e9)))
    return metrics


def _aligned(truth: Array, time_ns: Array) -> Array | None:
    """Newest truth at or before each tick, or None where there is none."""
    if not len(truth) or not len(time_ns):
        return None
    newest = np.searchsorted(truth["time_ns"], time_ns, side="right") - 1
    aligned: Array = truth[np.maximum(newest, 0)]
    for name in aligned.dtype.names or ():
        if name != "time_ns":
            aligned[name][newest < 0] = math.nan  # before the first of them nothing is known
    return aligned


def _first(time_s: Array, condition: Array) -> float | None:
    found = np.flatnonzero(condition)
    return float(time_s[found[0]]) if len(found) else None


def _rms(error: Array, where: Array) -> float | None:
    return float(np.sqrt(np.mean(error[where] ** 2))) if where.any() else None


def _lateness(ticks: Array) -> dict[str, float | None]:
    names, shares = ("p50", "p99", "p999", "max"), (50.0, 99.0, 99.9, 100.0)
    if not len(ticks):
        return dict.fromkeys(names)
    values = np.percentile(ticks["late_us"].astype(float), shares)
    return dict(zip(names, map(float, values), strict=True))
