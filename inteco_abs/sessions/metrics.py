"""Metrics of one stop, for result cards and Monte Carlo runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from inteco_abs.control import FallBack
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
FALL_BACKS: Final = ("swing_share", "fall_backs", "fall_back_from_s", "fall_back_s")
"""Metrics of a law that falls back while the slip swings; others have none."""
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


@dataclass(frozen=True, slots=True)
class SlipErrors:
    """The slip errors by which a law falls back, one entry per tick of a stop."""

    band: float
    """Error to both sides of which the slip swings when the law falls back, above 0."""
    error: Array
    """As the law had it in its newest demand."""
    reference: Array
    dt_s: Array

    def before(self, end: int) -> SlipErrors:
        """Those of the first ticks."""
        return SlipErrors(self.band, self.error[:end], self.reference[:end], self.dt_s[:end])

    def metrics(self, since_ns: Array) -> dict[str, float | None]:
        """Largest swing as a share of the band, times that the law fell back, when first, and for how long."""
        steps = self._steps() if (swing := self._largest_swing()) > self.band else np.zeros(len(self.error), int)
        falls = np.flatnonzero(np.diff(steps, prepend=0) > 0)
        return {
            "swing_share": swing / self.band,
            "fall_backs": float(len(falls)),
            "fall_back_from_s": float(since_ns[falls[0]] * 1e-9) if len(falls) else None,
            "fall_back_s": float(self.dt_s[steps > 0].sum()),
        }

    def _largest_swing(self) -> float:
        """The largest error that was passed on one side and then on the other, while the reference stayed."""
        parts = np.split(self.error, np.flatnonzero(np.diff(self.reference)) + 1)
        return max((_largest_swing(part) for part in parts if len(part) > 1), default=0.0)

    def _steps(self) -> Array:
        follow, columns = FallBack(self.band).follow, (self.error, self.reference, self.dt_s)
        return np.array([follow(*row) for row in zip(*(column.tolist() for column in columns), strict=True)], int)


def _largest_swing(error: Array) -> float:
    sides = error, -error
    return max(float(np.minimum(np.maximum.accumulate(one), -one).max()) for one in sides)


def stop_metrics(
    trace: StopTrace, reference: float | Array, parameters: RigParameters, errors: SlipErrors | None = None
) -> dict[str, float | None]:
    """Metrics of a stop of at least one tick; None for those that it does not have.

    `reference` is the slip to hold, one for all ticks or one for each; `errors` are those of a law that falls back.

    Reaching is the first crossing of the reference, band entry the first slip within 0.01 of it. Slip RMS is that of
    slip minus reference from 20 ms after band entry until the road wheel is below 10 rad/s; `fixed` begins 0.25 s after
    braking instead, `low_speed` is for 10 to 60 rad/s, `above_60` for faster. Overshoot is the largest slip minus
    reference after band entry, locked a slip above 0.9, both above 10 rad/s. The stop is the road wheel below
    0.5 rad/s. A swing is the largest error of the law that it passed on one side and then on the other, above 10 rad/s
    as all of falling back. Variations of the duty, and of its torque by `parameters`, are per second above 10 rad/s.
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
        **(dict.fromkeys(FALL_BACKS) if errors is None else errors.before(int(fast.sum())).metrics(trace.since_ns)),
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
