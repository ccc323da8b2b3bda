"""The guard: the last word on every command, and a trip that is permanent for the run."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.count_speed import MovingAverageSpeeds
from inteco_abs.control.run_up import RunUp
from inteco_abs.rig import nominal_parameters
from inteco_abs.signals import BoardFlags, Command, Estimate, Reason, Sample

_NONE: Final = Reason.NONE  # an enum's look-up, a dozen times a tick, takes a tenth of it
_SPEED_WINDOW_S: Final = 0.005
_LEAST_PERIODS: Final = 5
"""Of a speed window, in slow loops too: a good sample's time stamp may be late by one of them."""
_HISTORY_S: Final = 0.020
_FASTEST_RAD_S: Final = 300.0
"""No wheel of this rig is faster; well above the over-speed limit."""
_DRIVING_DUTY: Final = 0.2
"""Duty from which the drive must turn the road wheel; the configuration allows no less."""
_DRIVING_GRACE_NS: Final = 300_000_000
_ROAD_STILL_NS: Final = 50_000_000
_HARDEST_STOP_RAD_S2: Final = 400.0
"""No brake slows the road wheel so fast: the highest published deceleration is 167 rad/s2."""
_TIMING_SHARE: Final = 0.2
"""Error of the difference of two such speeds by late time stamps, as a share of the speed: each is late by at most one
of ten periods. In a shorter window it is larger."""
_OWED_COUNTS: Final = 6.0
_RUNNING_RAD_S: Final = 21.0
"""200 rpm: a road wheel this fast cannot come to rest within a few counts, whatever the brake does."""
_ROLLING_RAD_S: Final = 31.4
"""300 rpm: above, the wheels' speeds are compared at once."""
_ROLLING_SHARE: Final = 0.1
"""A wheel that rolls freely follows the road more closely than this."""
_LOST_SHARE: Final = 3.0
"""Ahead of the road by more than this share of its counted speed: lost counts, as no scale error is so large."""
_BACKWARDS_RAD_S: Final = -5.0
_MISS_COST: Final = 3
_RELEASED_DUTY: Final = 0.01
_RELEASE_GRACE_NS: Final = 300_000_000


class Guard:
    """Admits a command unchanged or clamped; once tripped, only SAFE.

    It checks raw counts, so that a wrong estimator cannot blind it; the limits are in
    docs/facts/hazards.md#quantities-behind-the-guard.
    """

    def __init__(self, config: RigConfig) -> None:
        self.reason: Reason = _NONE
        limits, counts = config.guard, config.encoders.counts_per_turn
        self._brake_limit = limits.brake_limit
        self._drive_limit = limits.drive_limit
        self._over_speed = limits.over_speed_rad_s
        self._most_in_a_row = limits.missed_in_a_row
        self._bucket_limit = limits.bucket_limit
        self._period_s = 1.0 / config.loop.rate_hz
        self._period_ns = config.period_ns  # how late a good sample's time stamp may be
        length = max(_LEAST_PERIODS, round(_SPEED_WINDOW_S * config.loop.rate_hz))
        self._speeds = MovingAverageSpeeds(counts, length)
        # until a window is full a count more or less, as of a wheel that rests on an edge, is many rad/s in it
        self._filling = length
        history = max(length, round(_HISTORY_S * config.loop.rate_hz))
        self._road_speeds: deque[tuple[int, float]] = deque(maxlen=history)
        self._counts_per_rad = counts / (2.0 * math.pi)
        self._timing_share = max(_TIMING_SHARE, 2.0 / length)
        self._slack = 2.0 / (self._counts_per_rad * length * self._period_s)  # two counts in a window, as a speed
        parameters = nominal_parameters(config.model)
        self._rim_ratio = parameters.r1 / parameters.r2
        self._fastest_per_ns = _FASTEST_RAD_S * self._counts_per_rad * 1e-9
        self._late_s = 1.5 * self._period_s
        self._before: Sample | None = None
        self._bucket = 0
        self._in_a_row = 0
        self._driving = False
        self._drive_changed_ns = 0
        self._released = True
        self._brake_changed_ns = -_RELEASE_GRACE_NS
        self._not_ahead_ns = 0
        self._road_moved_ns = 0
        self._road_speed_when_moved = 0.0
        self._applied = Command.SAFE
        factor = limits.run_up_factor
        self._run_up = None if factor is None else RunUp(config, factor)

    def trip(self, reason: Reason) -> None:
        """Switch the outputs off for the rest of the run; the first `reason` stays."""
        if self.reason is _NONE:
            self.reason = reason

    def admit(self, request: Command, sample: Sample, estimate: Estimate) -> Command:  # noqa: ARG002  part of the interface
        """Command that may go to the board, given `request` and the newest sample."""
        reason = self._judge_sample(sample)
        if reason is not _NONE:
            self.trip(reason)
        command = self._within_limits(request)
        if self.reason is not _NONE:
            command = Command.SAFE
        self._applied = command
        drive, brake = command
        if (drive >= _DRIVING_DUTY) is not self._driving:
            self._driving, self._drive_changed_ns = not self._driving, sample.time_ns
        if (brake < _RELEASED_DUTY) is not self._released:
            self._released, self._brake_changed_ns = not self._released, sample.time_ns
        return command

    def _within_limits(self, request: Command) -> Command:
        drive, brake = request
        if type(drive) is float and type(brake) is float:
            if 0.0 <= drive <= self._drive_limit and 0.0 <= brake <= self._brake_limit:
                return request
            if math.isfinite(drive) and math.isfinite(brake):
                return Command(
                    min(max(drive, 0.0), self._drive_limit),
                    min(max(brake, 0.0), self._brake_limit),
                )
        self.trip(Reason.BAD_OUTPUT)  # NaN, infinity, or not a float
        return Command.SAFE

    def _judge_sample(self, sample: Sample) -> Reason:
        _, now_ns, dt_s, wheel_count, road_count, flags = sample
        if flags or dt_s >= self._late_s or self._bucket or self._in_a_row:
            missed = self._count_misses(sample)
            if missed is not _NONE or flags:
                return missed  # a stale or slow sample has no known instant
        before = self._before
        self._before = sample
        _, then_ns, _, wheel_before, road_before, _ = before or sample
        wheel_step, road_step = wheel_count - wheel_before, road_count - road_before
        possible = (now_ns - then_ns + self._period_ns) * self._fastest_per_ns
        if not (-possible <= wheel_step <= possible and -possible <= road_step <= possible):
            return Reason.COUNT_JUMP
        wheel, road = self._speeds.update(now_ns, wheel_count, road_count)
        if self._filling:
            self._filling -= 1
            wheel = road = 0.0
        if road_step or not before:
            self._road_moved_ns = now_ns
            self._road_speed_when_moved = road
        limit = self._over_speed
        if not (-limit <= wheel <= limit and -limit <= road <= limit):
            return Reason.OVER_SPEED
        found = self._judge_road(now_ns, road) or self._judge_wheel(now_ns, wheel, road)
        run_up = self._run_up
        if run_up is None or run_up.plausible(now_ns, road_count, self._applied):
            return found
        return found or Reason.RUN_UP_IMPLAUSIBLE

    def _count_misses(self, sample: Sample) -> Reason:
        """One leaky bucket for failed exchanges and skipped periods alike."""
        skipped = int(sample.dt_s / self._period_s - 0.5)
        # periods that a slow exchange overran belong to it
        bad = skipped + 1 if sample.board_flags & BoardFlags.STALE else max(skipped, 1 if sample.board_flags else 0)
        if bad > 0:
            self._in_a_row += bad
            self._bucket += _MISS_COST * bad
        else:
            self._in_a_row = 0
            self._bucket = max(0, self._bucket - 1)
        full = self._in_a_row >= self._most_in_a_row or self._bucket >= self._bucket_limit
        return Reason.MISSED_EXCHANGES if full else _NONE

    def _judge_road(self, now_ns: int, road: float) -> Reason:
        """The road wheel's encoder, the reference of everything else."""
        if road < _BACKWARDS_RAD_S - self._slack:
            return Reason.ROAD_BACKWARDS
        still_ns = now_ns - self._road_moved_ns
        driven = self._driving and now_ns - self._drive_changed_ns > _DRIVING_GRACE_NS + _ROAD_STILL_NS
        before = self._road_speed_when_moved
        owed = before * still_ns * 1e-9 * self._counts_per_rad
        if (before > _RUNNING_RAD_S and owed > _OWED_COUNTS) or (driven and still_ns > _ROAD_STILL_NS):
            return Reason.ROAD_ENCODER_FROZEN
        # counts that come and go, as from a single channel, are movement, but no braking road
        then_ns, earlier = self._road_speeds[0] if self._road_speeds else (now_ns, road)
        self._road_speeds.append((now_ns, road))
        elapsed_s = max(_HISTORY_S, (now_ns - then_ns) * 1e-9)
        lost = _HARDEST_STOP_RAD_S2 * elapsed_s + self._timing_share * earlier + self._slack
        return Reason.ROAD_ENCODER_FROZEN if earlier - road > lost else _NONE

    def _judge_wheel(self, now_ns: int, wheel: float, road: float) -> Reason:
        """The braked wheel's encoder against the road's: the wheel may lock, but never run ahead or backwards."""
        if wheel < _BACKWARDS_RAD_S - self._slack:
            return Reason.ENCODERS_DISAGREE
        ahead = self._rim_ratio * wheel - road
        if road < _ROLLING_RAD_S:
            return self._judge_slow_road(now_ns, road, ahead)
        self._not_ahead_ns = now_ns  # on a fast road the check is immediate
        most = _ROLLING_SHARE * road + self._slack
        rolling = self._released and now_ns - self._brake_changed_ns > _RELEASE_GRACE_NS
        return Reason.ENCODERS_DISAGREE if ahead > most or (rolling and ahead < -most) else _NONE

    def _judge_slow_road(self, now_ns: int, road: float, ahead: float) -> Reason:
        """Under drive no wheel keeps ahead of a slow road; if one does, the road's encoder may be the cause.

        Without drive a hand may turn the wheel, with the lever up.
        """
        if not self._driving or road < -self._slack or ahead <= _ROLLING_SHARE * _ROLLING_RAD_S + self._slack:
            self._not_ahead_ns = now_ns
        if now_ns - self._not_ahead_ns <= _ROAD_STILL_NS:
            return _NONE
        return Reason.ROAD_ENCODER_FROZEN if ahead > _LOST_SHARE * road else Reason.ENCODERS_DISAGREE
