"""The guard: the last word on every command, and a trip that is permanent for the run."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.count_speed import Window, WindowConstants, empty_window, mean_speeds, window_constants
from inteco_abs.control.run_up import RunUpConstants, RunUpState, plausible, run_up_constants
from inteco_abs.rig import nominal_parameters
from inteco_abs.signals import BoardFlags, Command, Estimate, Reason, Sample

_NONE: Final = Reason.NONE  # an enum's look-up, a dozen times a tick, takes a tenth of it
_STALE: Final = int(BoardFlags.STALE)
_SPEED_WINDOW_S: Final = 0.005
_LEAST_PERIODS: Final = 5
"""Fewest periods in a speed window, in slow loops too: a good sample's time stamp may be late by one of them."""
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


@dataclass(frozen=True, slots=True)
class GuardConstants:
    """Limits, and what follows from the rig and the loop's rate."""

    brake_limit: float
    drive_limit: float
    over_speed: float
    """Largest speed of either wheel, rad/s."""
    most_in_a_row: int
    bucket_limit: int
    period_s: float
    period_ns: int
    """How late a good sample's time stamp may be."""
    late_s: float
    speeds: WindowConstants
    history: int
    """Samples of the road's speed that are kept."""
    counts_per_rad: float
    timing_share: float
    slack: float
    """Two counts in a window, as a speed in rad/s."""
    rim_ratio: float
    """r1/r2"""
    fastest_per_ns: float
    """Counts per ns of the fastest wheel."""
    judges_run_up: bool
    run_up: RunUpConstants


@dataclass(slots=True)
class GuardState:
    """What the guard remembers; `reason` is why the outputs were switched off, or NONE."""

    speeds: Window
    filling: int
    """Samples until the window is full: till then a count more or less, as of a wheel that rests on an edge, is many
    rad/s in it."""
    road_times_ns: list[int]
    road_speeds: list[float]
    oldest: int = 0
    """Place of the oldest of these, as in `Window`; a speed of 0 before the first allows any."""
    run_up: RunUpState = field(default_factory=RunUpState)
    reason: Reason = _NONE
    begun: bool = False
    before_ns: int = 0
    wheel_before: int = 0
    road_before: int = 0
    bucket: int = 0
    in_a_row: int = 0
    driving: bool = False
    drive_changed_ns: int = 0
    released: bool = True
    brake_changed_ns: int = -_RELEASE_GRACE_NS
    not_ahead_ns: int = 0
    road_moved_ns: int = 0
    road_speed_when_moved: float = 0.0
    drive: float = 0.0
    """Admitted last, as is `brake`."""
    brake: float = 0.0


def guard_constants(config: RigConfig) -> GuardConstants:
    """The guard's constants for a configuration."""
    limits, counts, rate_hz = config.guard, config.encoders.counts_per_turn, config.loop.rate_hz
    period_s, counts_per_rad = 1.0 / rate_hz, counts / (2.0 * math.pi)
    length = max(_LEAST_PERIODS, round(_SPEED_WINDOW_S * rate_hz))
    parameters = nominal_parameters(config.model)
    return GuardConstants(
        brake_limit=limits.brake_limit,
        drive_limit=limits.drive_limit,
        over_speed=limits.over_speed_rad_s,
        most_in_a_row=limits.missed_in_a_row,
        bucket_limit=limits.bucket_limit,
        period_s=period_s,
        period_ns=config.period_ns,
        late_s=1.5 * period_s,
        speeds=window_constants(counts, length),
        history=max(length, round(_HISTORY_S * rate_hz)),
        counts_per_rad=counts_per_rad,
        timing_share=max(_TIMING_SHARE, 2.0 / length),
        slack=2.0 / (counts_per_rad * length * period_s),
        rim_ratio=parameters.r1 / parameters.r2,
        fastest_per_ns=_FASTEST_RAD_S * counts_per_rad * 1e-9,
        judges_run_up=limits.run_up_factor is not None,
        run_up=run_up_constants(config, limits.run_up_factor or 1.0),
    )


class Guard(GuardState):
    """Admits a command unchanged or clamped; once tripped, only SAFE.

    It checks raw counts, so that a wrong estimator cannot blind it; the limits are in
    docs/facts/hazards.md#quantities-behind-the-guard.
    """

    def __init__(self, config: RigConfig) -> None:
        self.k = k = guard_constants(config)
        length = k.speeds.length
        super().__init__(empty_window(length), length, [0] * k.history, [0.0] * k.history)

    def trip(self, reason: Reason) -> None:
        """Switch the outputs off for the rest of the run; the first `reason` stays."""
        trip(self, reason)

    def admit(self, request: Command, sample: Sample, estimate: Estimate) -> Command:  # noqa: ARG002  part of the interface
        """Command that may go to the board, given `request` and the newest sample."""
        drive, brake = request
        numbers = type(drive) is float and type(brake) is float
        admit(self.k, self, sample, drive if numbers else math.nan, brake if numbers else math.nan)
        return Command(self.drive, self.brake)


def trip(s: GuardState, reason: Reason) -> None:
    """Switch the outputs off for the rest of the run; the first `reason` stays."""
    if s.reason == _NONE:
        s.reason = reason


def admit(k: GuardConstants, s: GuardState, sample: Sample, drive: float, brake: float) -> None:
    """Leave in `s` what may go to the board, given the newest sample and the requested duties."""
    _, now_ns, dt_s, wheel_count, road_count, flags = sample
    found = _NONE
    if flags or dt_s >= k.late_s or s.bucket or s.in_a_row:
        found = _count_misses(k, s, dt_s, flags)
    if found == _NONE and not flags:  # else a stale or slow sample has no known instant
        found = _judge(k, s, now_ns, wheel_count, road_count)
    if found != _NONE:
        trip(s, found)
    if not (0.0 <= drive <= k.drive_limit and 0.0 <= brake <= k.brake_limit):
        if math.isfinite(drive) and math.isfinite(brake):
            drive, brake = min(max(drive, 0.0), k.drive_limit), min(max(brake, 0.0), k.brake_limit)
        else:
            trip(s, Reason.BAD_OUTPUT)  # NaN, infinity, or not a float
    if s.reason != _NONE:
        drive = brake = 0.0
    s.drive = drive
    s.brake = brake
    _note_changes(s, now_ns, drive, brake)


def _note_changes(s: GuardState, now_ns: int, drive: float, brake: float) -> None:
    if drive >= _DRIVING_DUTY:
        if not s.driving:
            s.driving, s.drive_changed_ns = True, now_ns
    elif s.driving:
        s.driving, s.drive_changed_ns = False, now_ns
    if brake < _RELEASED_DUTY:
        if not s.released:
            s.released, s.brake_changed_ns = True, now_ns
    elif s.released:
        s.released, s.brake_changed_ns = False, now_ns


def _judge(k: GuardConstants, s: GuardState, now_ns: int, wheel_count: int, road_count: int) -> Reason:
    """The counts of a sample whose instant is known."""
    first = not s.begun
    if first:
        s.begun, s.before_ns, s.wheel_before, s.road_before = True, now_ns, wheel_count, road_count
    wheel_step, road_step = wheel_count - s.wheel_before, road_count - s.road_before
    possible = (now_ns - s.before_ns + k.period_ns) * k.fastest_per_ns
    s.before_ns, s.wheel_before, s.road_before = now_ns, wheel_count, road_count
    if not (-possible <= wheel_step <= possible and -possible <= road_step <= possible):
        return Reason.COUNT_JUMP
    wheel, road = mean_speeds(k.speeds, s.speeds, now_ns, wheel_count, road_count)
    if s.filling:
        s.filling -= 1
        wheel = road = 0.0
    if first or road_step:
        s.road_moved_ns, s.road_speed_when_moved = now_ns, road
    limit = k.over_speed
    if not (-limit <= wheel <= limit and -limit <= road <= limit):
        return Reason.OVER_SPEED
    found = _judge_road(k, s, now_ns, road)
    if found == _NONE:
        found = _judge_wheel(k, s, now_ns, wheel, road)
    if k.judges_run_up and not plausible(k.run_up, s.run_up, now_ns, road_count, s.drive, s.brake) and found == _NONE:
        return Reason.RUN_UP_IMPLAUSIBLE
    return found


def _count_misses(k: GuardConstants, s: GuardState, dt_s: float, flags: int) -> Reason:
    """One leaky bucket for failed exchanges and skipped periods alike."""
    skipped = int(dt_s / k.period_s - 0.5)
    # periods that a slow exchange overran belong to it
    bad = skipped + 1 if flags & _STALE else max(skipped, 1 if flags else 0)
    if bad > 0:
        s.in_a_row += bad
        s.bucket += _MISS_COST * bad
    else:
        s.in_a_row = 0
        s.bucket = max(0, s.bucket - 1)
    full = s.in_a_row >= k.most_in_a_row or s.bucket >= k.bucket_limit
    return Reason.MISSED_EXCHANGES if full else _NONE


def _judge_road(k: GuardConstants, s: GuardState, now_ns: int, road: float) -> Reason:
    """The road wheel's encoder, the reference of everything else."""
    if road < _BACKWARDS_RAD_S - k.slack:
        return Reason.ROAD_BACKWARDS
    still_ns = now_ns - s.road_moved_ns
    driven = s.driving and now_ns - s.drive_changed_ns > _DRIVING_GRACE_NS + _ROAD_STILL_NS
    before = s.road_speed_when_moved
    owed = before * still_ns * 1e-9 * k.counts_per_rad
    if (before > _RUNNING_RAD_S and owed > _OWED_COUNTS) or (driven and still_ns > _ROAD_STILL_NS):
        return Reason.ROAD_ENCODER_FROZEN
    # counts that come and go, as from a single channel, are movement, but no braking road
    i = s.oldest
    earlier = s.road_speeds[i]
    elapsed_s = (now_ns - s.road_times_ns[i]) * 1e-9
    if elapsed_s < _HISTORY_S:  # noqa: PLR1730  max() takes longer than the other checks of this function
        elapsed_s = _HISTORY_S
    s.road_times_ns[i] = now_ns
    s.road_speeds[i] = road
    i += 1
    s.oldest = i if i < k.history else 0
    lost = _HARDEST_STOP_RAD_S2 * elapsed_s + k.timing_share * earlier + k.slack
    return Reason.ROAD_ENCODER_FROZEN if earlier - road > lost else _NONE


def _judge_wheel(k: GuardConstants, s: GuardState, now_ns: int, wheel: float, road: float) -> Reason:
    """The braked wheel's encoder against the road's: the wheel may lock, but never run ahead or backwards."""
    if wheel < _BACKWARDS_RAD_S - k.slack:
        return Reason.ENCODERS_DISAGREE
    ahead = k.rim_ratio * wheel - road
    if road < _ROLLING_RAD_S:
        return _judge_slow_road(k, s, now_ns, road, ahead)
    s.not_ahead_ns = now_ns  # on a fast road the check is immediate
    most = _ROLLING_SHARE * road + k.slack
    rolling = s.released and now_ns - s.brake_changed_ns > _RELEASE_GRACE_NS
    return Reason.ENCODERS_DISAGREE if ahead > most or (rolling and ahead < -most) else _NONE


def _judge_slow_road(k: GuardConstants, s: GuardState, now_ns: int, road: float, ahead: float) -> Reason:
    """Under drive no wheel keeps ahead of a slow road; if one does, the road's encoder may be the cause.

    Without drive a hand may turn the wheel, with the lever up.
    """
    if not s.driving or road < -k.slack or ahead <= _ROLLING_SHARE * _ROLLING_RAD_S + k.slack:
        s.not_ahead_ns = now_ns
    if now_ns - s.not_ahead_ns <= _ROAD_STILL_NS:
        return _NONE
    return Reason.ROAD_ENCODER_FROZEN if ahead > _LOST_SHARE * road else Reason.ENCODERS_DISAGREE
