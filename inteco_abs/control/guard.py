"""The guard: last word on every command, and a latch that only ever closes."""

from __future__ import annotations

import math
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.windows import SpeedWindow
from inteco_abs.signals import Command, Estimate, Reason, Sample

_SPEED_WINDOW_S: Final = 0.005
_FASTEST_RAD_S: Final = 500.0
"""No wheel of this rig turns faster: twice the over-speed limit."""
_DRIVING_DUTY: Final = 0.2
"""Duty from which the drive must turn the road wheel."""
_DRIVING_GRACE_NS: Final = 300_000_000
_ROAD_STILL_NS: Final = 50_000_000
_RUNNING_RAD_S: Final = 21.0
"""200 rpm: a road wheel this fast cannot come to rest within a few counts, whatever the brake does."""
_OWED_COUNTS: Final = 6.0
_ROLLING_RAD_S: Final = 31.4
"""300 rpm: with the brake off, a wheel on a road this fast turns with it."""
_WHEEL_STILL_NS: Final = 20_000_000
_RELEASE_GRACE_NS: Final = 300_000_000
_BACKWARDS_RAD_S: Final = -5.0
_MISS_COST: Final = 3
_JUMP_SLACK: Final = 4
_BRAKING_DUTY: Final = 0.01


class Guard:
    """Admits a command as it is, clamped, or not at all; once tripped, only SAFE.

    Limits of sample checks follow the project's hazard sheet. Judged on raw counts: a wrong estimator cannot blind it.
    """

    def __init__(self, config: RigConfig) -> None:
        self.reason = Reason.NONE
        limits, counts = config.guard, config.encoders.counts_per_turn
        self._brake_limit = limits.brake_limit
        self._drive_limit = limits.drive_limit
        self._over_speed = limits.over_speed_rad_s
        self._most_in_a_row = limits.missed_in_a_row
        self._bucket_limit = limits.bucket_limit
        self._period_s = 1.0 / config.loop.rate_hz
        length = max(1, round(_SPEED_WINDOW_S * config.loop.rate_hz))
        self._wheel_speed = SpeedWindow(counts, length)
        self._road_speed = SpeedWindow(counts, length)
        self._counts_per_rad = counts / (2.0 * math.pi)
        self._before: Sample | None = None
        self._in_force = Command.SAFE
        self._bucket = 0
        self._in_a_row = 0
        self._drive_on_ns = 0
        self._brake_off_ns = _RELEASE_GRACE_NS
        self._wheel_still_ns = 0
        self._road_still_ns = 0
        self._road_speed_when_counting = 0.0

    def trip(self, reason: Reason) -> None:
        """Take the outputs away for `reason`, for good; the first reason stays."""
        if self.reason is Reason.NONE:
            self.reason = reason

    def admit(self, wish: Command, sample: Sample, estimate: Estimate) -> Command:  # noqa: ARG002  part of the interface
        """Command that may go to the board, given `wish` and the newest sample."""
        self.trip(self._judge_sample(sample))
        drive, brake = wish
        # written so that NaN and anything that is no number fails
        if not (
            type(drive) is float and type(brake) is float and math.isfinite(drive) and math.isfinite(brake)
        ):
            self.trip(Reason.BAD_OUTPUT)
        if self.reason is not Reason.NONE:
            self._in_force = Command.SAFE
            return self._in_force
        if not (0.0 <= drive <= self._drive_limit and 0.0 <= brake <= self._brake_limit):
            drive = min(max(drive, 0.0), self._drive_limit)
            brake = min(max(brake, 0.0), self._brake_limit)
        self._in_force = Command(drive, brake)
        return self._in_force

    def _judge_sample(self, sample: Sample) -> Reason:
        missed = self._count_misses(sample)
        if missed is not Reason.NONE or sample.board_flags:
            return missed  # a stale sample says nothing about the wheels
        before, self._before = self._before or sample, sample
        wheel_step = sample.wheel_count - before.wheel_count
        road_step = sample.road_count - before.road_count
        dt_ns = sample.time_ns - before.time_ns
        possible = _FASTEST_RAD_S * dt_ns * 1e-9 * self._counts_per_rad + _JUMP_SLACK
        if abs(wheel_step) > possible or abs(road_step) > possible:
            return Reason.COUNT_JUMP
        wheel = self._wheel_speed.update(sample.time_ns, sample.wheel_count)
        road = self._road_speed.update(sample.time_ns, sample.road_count)
        if max(abs(wheel), abs(road)) > self._over_speed:
            return Reason.OVER_SPEED
        if self._in_force.drive >= _DRIVING_DUTY and road < _BACKWARDS_RAD_S:
            return Reason.ROAD_BACKWARDS
        return self._judge_encoders(dt_ns, wheel_step, road_step, road)

    def _count_misses(self, sample: Sample) -> Reason:
        """One leaky bucket for failed exchanges and skipped periods alike."""
        skipped = int(sample.dt_s / self._period_s - 0.5)
        bad = skipped + (1 if sample.board_flags else 0)
        if bad:
            self._in_a_row += bad
            self._bucket += _MISS_COST * bad
        else:
            self._in_a_row = 0
            self._bucket = max(0, self._bucket - 1)
        full = self._in_a_row >= self._most_in_a_row or self._bucket >= self._bucket_limit
        return Reason.MISSED_EXCHANGES if full else Reason.NONE

    def _judge_encoders(self, dt_ns: int, wheel_step: int, road_step: int, road: float) -> Reason:
        """An encoder that stands still while its wheel must turn. A locked wheel under braking is legal."""
        self._drive_on_ns = self._drive_on_ns + dt_ns if self._in_force.drive >= _DRIVING_DUTY else 0
        self._brake_off_ns = self._brake_off_ns + dt_ns if self._in_force.brake < _BRAKING_DUTY else 0
        self._wheel_still_ns = 0 if wheel_step else self._wheel_still_ns + dt_ns
        if road_step:
            self._road_still_ns = 0
            self._road_speed_when_counting = road
        else:
            self._road_still_ns += dt_ns
            owed = self._road_speed_when_counting * self._road_still_ns * 1e-9 * self._counts_per_rad
            if self._road_speed_when_counting > _RUNNING_RAD_S and owed > _OWED_COUNTS:
                return Reason.ROAD_ENCODER_FROZEN
        if self._drive_on_ns > _DRIVING_GRACE_NS and self._road_still_ns > _ROAD_STILL_NS:
            return Reason.ROAD_ENCODER_FROZEN
        rolling = road > _ROLLING_RAD_S and self._brake_off_ns > _RELEASE_GRACE_NS
        if rolling and self._wheel_still_ns > _WHEEL_STILL_NS:
            return Reason.WHEEL_ENCODER_FROZEN
        return Reason.NONE
