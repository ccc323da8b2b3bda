"""Metrics of one stop, for result cards and Monte Carlo runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from inteco_abs.rig import RigParameters, brake_torque

BAND: Final = 0.01
"""Slip error that counts as having arrived."""
STANDSTILL_RAD_S: Final = 0.5
_SETTLE_S: Final = 0.020
_FIXED_START_S: Final = 0.25
LOWEST_RAD_S: Final = 10.0
"""Below, no metric judges the slip."""
_LOW_SPEED_RAD_S: Final = 60.0
LOCKED_SLIP: Final = 0.9
"""A wheel with more slip counts as locked."""
_NEVER: Final = np.iinfo(np.int64).max

Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class StopTrace:
    """One stop, from the first tick of braking to the last one with the brake held; one entry per tick."""

    since_ns: Array
    """Time since braking began, ns."""
    slip: Array
    """True slip if known, else estimated, in 0..1."""
    slip_estimated: Array
    road_speed_rad_s: Array
    """True speed if known, else estimated."""
    road_angle_rad: Array
    """Angle since braking began."""
    brake: Array
    """Duty decided by each tick, in 0..1."""


def stop_metrics(trace: StopTrace, reference: float | Array, parameters: RigParameters) -> dict[str, float | None]:
    """Metrics of a stop of at least one tick; None for those that it does not have.

    `reference` is the slip to hold, one for all ticks or one for each.

    Reaching is the first crossing of the reference, band entry the first slip within 0.01 of it. Slip RMS is that of
    slip minus reference from 20 ms after band entry until the road wheel is below 10 rad/s; `fixed` begins 0.25 s after
    braking instead, `low_speed` is for 10 to 60 rad/s, `above_60` for faster. Overshoot is the largest slip minus
    reference after band entry, locked a slip above 0.9, both above 10 rad/s. The stop is the road wheel below
    0.5 rad/s. Variations of the duty, and of its torque by `parameters`, are per second above 10 rad/s.
    """
    slip, speed = trace.slip, trace.road_speed_rad_s
    error = slip - reference
    time_s = trace.since_ns * 1e-9
    entry = _first(time_s, np.abs(error) < BAND)
    slow = np.flatnonzero(speed < LOWEST_RAD_S)
    fast = np.arange(len(slip)) < (slow[0] if len(slow) else len(slip))
    settled = fast & (trace.since_ns >= (_NEVER if entry is None else round((entry + _SETTLE_S) * 1e9)))
    standing = np.flatnonzero(speed < STANDSTILL_RAD_S)
    arrived = fast & (time_s >= (np.inf if entry is None else entry))
    return {
        "reaching_time_s": _first(time_s, slip >= reference),
        "band_entry_s": entry,
        "stop_time_s": float(time_s[standing[0]]) if len(standing) else None,
        "stop_distance_m": float(trace.road_angle_rad[standing[0]] * parameters.r2) if len(standing) else None,
        "slip_rms": _rms(error, settled),
        "slip_rms_estimated": _rms(trace.slip_estimated - reference, settled),
        "slip_rms_low_speed": _rms(error, settled & (speed <= _LOW_SPEED_RAD_S)),
        "slip_rms_above_60": _rms(error, settled & (speed > _LOW_SPEED_RAD_S)),
        "slip_rms_fixed": _rms(error, fast & (trace.since_ns >= round(_FIXED_START_S * 1e9))),
        "overshoot": float(error[arrived].max()) if arrived.any() else None,
        "lock_fraction": float(np.mean(slip[fast] > LOCKED_SLIP)) if fast.any() else None,
        **_variations(trace.brake[fast], float(time_s[slow[0]]) if len(slow) else 0.0, parameters),
    }


def _variations(duties: Array, end_s: float, parameters: RigParameters) -> dict[str, float | None]:
    if not end_s:
        return dict.fromkeys(("torque_variation_nm_per_s", "duty_variation_per_s"))
    torques = np.array([brake_torque(duty, parameters) for duty in duties.tolist()])
    return {
        "torque_variation_nm_per_s": float(np.abs(np.diff(torques)).sum() / end_s),
        "duty_variation_per_s": float(np.abs(np.diff(duties)).sum() / end_s),
    }


def _first(time_s: Array, condition: Array) -> float | None:
    found = np.flatnonzero(condition)
    return float(time_s[found[0]]) if len(found) else None


def _rms(error: Array, where: Array) -> float | None:
    return float(np.sqrt(np.mean(error[where] ** 2))) if where.any() else None
