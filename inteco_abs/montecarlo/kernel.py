"""The scalar plant's steps, compiled: `Plant`, its model and its encoders once more, rig by rig, on rows of arrays.

Every function is that of the same name in `inteco_abs.rig`, operation by operation, which is where it is explained;
a test holds the two together. All that is compiled lies in this file, and whatever comes from elsewhere comes as an
argument: the machine code is kept on disk and renewed only when this file changes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from inteco_abs.errors import AbsError

try:
    from numba import njit
except ImportError as error:
    raise AbsError("many rigs at once need numba: pip install 'inteco-abs[lab]'") from error

Floats = NDArray[np.float64]
Formula = tuple[float, float, float, float, float, float]
"""w1, w2, w3, w4, a, p of equation (8)."""
Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """`function` as machine code, beside which other threads run."""
    return cast(Function, njit(cache=True, nogil=True, error_model="numpy")(function))


# contact


@compiled
def _formula(w: Formula, slip: float) -> float:
    w1, w2, w3, w4, a, p = w
    power = slip**p
    return w4 * power / (a + power) + ((w3 * slip + w2) * slip + w1) * slip


@compiled
def _formula_slope(w: Formula, slip: float) -> float:
    w1, w2, w3, w4, a, p = w
    saturating = 0.0 if slip == 0.0 else w4 * a * p * slip ** (p - 1.0) / (a + slip**p) ** 2
    return saturating + (3.0 * w3 * slip + 2.0 * w2) * slip + w1


@compiled
def _measured_piece(fixed: Any, slip: float) -> int:
    found = 0
    for i in range(1, fixed.cubics.shape[0]):
        if slip < fixed.cubics[i, 0]:
            break
        found = i
    return found


@compiled
def _adhesion(fixed: Any, k: Any, grip: float, slip: float) -> float:
    formula = _formula((k.w1, k.w2, k.w3, k.w4, k.a, k.p), slip)
    mu, blend = formula, k.adhesion_blend
    if blend != 0.0:
        if slip >= fixed.rise_end:
            c, i = fixed.cubics, _measured_piece(fixed, slip)
            t = slip - c[i, 0]
            measured = ((c[i, 4] * t + c[i, 3]) * t + c[i, 2]) * t + c[i, 1]
        else:
            measured = fixed.rise * (
                formula
                if k.published_formula
                else _formula((fixed.w1, fixed.w2, fixed.w3, fixed.w4, fixed.a, fixed.p), slip)
            )
        mu = (1.0 - blend) * mu + blend * measured
    return k.adhesion_scale * grip * mu


@compiled
def _adhesion_slope(fixed: Any, k: Any, grip: float, slip: float) -> float:
    formula = _formula_slope((k.w1, k.w2, k.w3, k.w4, k.a, k.p), slip)
    mu_slope, blend = formula, k.adhesion_blend
    if blend != 0.0:
        if slip >= fixed.rise_end:
            c, i = fixed.cubics, _measured_piece(fixed, slip)
            t = slip - c[i, 0]
            measured = (3.0 * c[i, 4] * t + 2.0 * c[i, 3]) * t + c[i, 2]
        else:
            measured = fixed.rise * (
                formula
                if k.published_formula
                else _formula_slope((fixed.w1, fixed.w2, fixed.w3, fixed.w4, fixed.a, fixed.p), slip)
            )
        mu_slope = (1.0 - blend) * mu_slope + blend * measured
    return k.adhesion_scale * grip * mu_slope


@compiled
def wheel_slip(rim1: float, rim2: float) -> float:
    """Slip in 0..1 of rim speeds in m/s."""
    if rim1 < 0.0 and rim2 < 0.0:
        rim1, rim2 = -rim1, -rim2
    if rim2 > rim1 > 0.0:
        return (rim2 - rim1) / rim2
    if rim1 > rim2 > 0.0:
        return (rim1 - rim2) / rim1
    return 0.0 if rim1 == rim2 else 1.0


# wheels


@compiled
def _rates(
    fixed: Any, k: Any, s: Any, wheel_speed: float, road_speed: float, brake_torque: float, drive_torque: float
) -> tuple[float, float, float, float, float]:
    slip = wheel_slip(k.r1 * wheel_speed, k.r2 * road_speed)
    traction = _adhesion(fixed, k, s.grip, slip)
    if k.r2 * road_speed < k.r1 * wheel_speed:
        traction = -traction
    lever = s.L_sin - s.L_cos * traction
    held = brake_torque + k.M10
    moves = True
    if wheel_speed > 0.0:
        resisting = k.d1 * wheel_speed + held
    elif wheel_speed < 0.0:
        resisting = k.d1 * wheel_speed - held
    else:
        reaction = k.Mg / (lever - k.r1 * traction) * k.r1 * traction
        moves = abs(reaction) > held
        resisting = math.copysign(held, reaction) if moves else reaction
    normal = (k.Mg + resisting) / lever
    push = normal * traction
    wheel = (push * k.r1 - resisting) / k.J1 if moves else 0.0
    load = drive_torque - push * k.r2 - k.d2 * road_speed
    if road_speed > 0.0:
        load -= k.M20
    elif road_speed < 0.0:
        load += k.M20
    else:
        load -= max(-k.M20, min(k.M20, load))
    return wheel, load / k.J2, normal, traction, slip


@compiled
def _contact_stiffness(
    fixed: Any, k: Any, s: Any, wheel_speed: float, road_speed: float, normal: float, traction: float, slip: float
) -> tuple[float, float, float, float]:
    if wheel_speed <= 0.0 or road_speed <= 0.0 or slip == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    slope = _adhesion_slope(fixed, k, s.grip, slip)
    force = normal * s.L_sin / (s.L_sin - s.L_cos * traction)
    slower = 1.0 - slip
    if k.r2 * road_speed > k.r1 * wheel_speed:
        unit = slope / (k.r2 * road_speed)
        row1, row2 = -unit * k.r1, unit * k.r2 * slower
    else:
        unit = slope / (k.r1 * wheel_speed)
        row1, row2 = -unit * k.r1 * slower, unit * k.r2
    return force * k.r1 / k.J1, -force * k.r2 / k.J2, row1, row2


@compiled
def _drive_torque(k: Any, duty: float, road_speed: float) -> float:
    if duty <= 0.0:
        return 0.0
    return max(0.0, k.stall_torque_nm * (duty - road_speed / k.no_load_speed_rad_s))


# steps


@compiled
def _brake_lag(k: Any, s: Any, h: float) -> None:
    if h != s.lag_step_s:
        rate = k.c31 * h if h > 0.0 else 0.0
        s.lag_step_s = h
        s.lag_left = math.exp(-rate)
        s.lag_mean = (1.0 - s.lag_left) / rate if rate > 0.0 else 1.0


@compiled
def _press(k: Any, s: Any, h: float) -> None:
    angle = s.wheel_angle + 0.5 * h * s.wheel_speed
    load = 1.0 + k.load_ripple * math.sin(angle + k.load_ripple_phase_rad)
    s.L_sin, s.L_cos = k.L_sin / load, k.L_cos / load


@compiled
def _next_speeds(fixed: Any, k: Any, s: Any, drive: float, h: float) -> tuple[float, float]:
    if k.load_ripple != 0.0:
        _press(k, s, h)
    x1, x2 = s.wheel_speed, s.road_speed
    torque, target = s.brake_torque, s.settled_torque
    if torque != target:
        _brake_lag(k, s, h)
        torque = target + (torque - target) * s.lag_mean
    k1, k2, normal, traction, slip = _rates(fixed, k, s, x1, x2, torque, _drive_torque(k, drive, x2))
    stiff = h * fixed.contact_rate > fixed.stiff * max(x2, x1)
    column1 = column2 = row1 = row2 = damping = 0.0
    if stiff:
        column1, column2, row1, row2 = _contact_stiffness(fixed, k, s, x1, x2, normal, traction, slip)
        damping = fixed.gamma * h / (1.0 - fixed.gamma * h * min(0.0, row1 * column1 + row2 * column2))
        along = damping * (row1 * k1 + row2 * k2)
        k1, k2 = k1 + along * column1, k2 + along * column2
    end1, end2 = x1 + h * k1, x2 + h * k2
    end1 = end1 if x1 * end1 >= 0.0 else x1 * fixed.almost_at_rest
    end2 = end2 if x2 * end2 >= 0.0 else x2 * fixed.almost_at_rest
    a1, a2, normal, traction, slip = _rates(fixed, k, s, end1, end2, torque, _drive_torque(k, drive, end2))
    a1 -= 2.0 * k1
    a2 -= 2.0 * k2
    if stiff:
        along = damping * (row1 * a1 + row2 * a2)
        a1, a2 = a1 + along * column1, a2 + along * column2
    return x1 + h * (1.5 * k1 + 0.5 * a1), x2 + h * (1.5 * k2 + 0.5 * a2)


@compiled
def _take(k: Any, s: Any, h: float, next1: float, next2: float) -> None:
    s.wheel_angle += 0.5 * h * (s.wheel_speed + next1)
    s.road_angle += 0.5 * h * (s.road_speed + next2)
    if s.brake_torque != s.settled_torque:
        _brake_lag(k, s, h)
        s.brake_torque = s.settled_torque + (s.brake_torque - s.settled_torque) * s.lag_left
    s.wheel_speed, s.road_speed = next1, next2


@compiled
def _crawl(k: Any, s: Any, drive: float, h: float) -> None:
    ratio = k.r2 / k.r1
    torque = _drive_torque(k, drive, 0.0) - k.M20 - ratio * (k.M10 + s.brake_torque)
    next2 = s.road_speed + h * torque / (k.J2 + ratio**2 * k.J1) if torque > 0.0 else 0.0
    _take(k, s, h, ratio * next2, next2)


@compiled
def _rest_share(speed: float, following: float) -> float:
    return speed / (speed - following) if speed * following < 0.0 else 1.0


@compiled
def _step(fixed: Any, k: Any, s: Any, drive: float, h: float) -> None:
    x1, x2, crawl = s.wheel_speed, s.road_speed, fixed.crawl_rad_s
    if -crawl < x2 < crawl and -crawl < x1 < crawl:
        _crawl(k, s, drive, h)
        return
    next1, next2 = _next_speeds(fixed, k, s, drive, h)
    if x1 * next1 < 0.0 or x2 * next2 < 0.0:
        share1, share2 = _rest_share(x1, next1), _rest_share(x2, next2)
        crossed = h * min(share1, share2)
        next1, next2 = _next_speeds(fixed, k, s, drive, crossed)
        _take(k, s, crossed, 0.0 if share1 <= share2 else next1, next2 if share1 <= share2 else 0.0)
        h -= crossed
        x1, x2 = s.wheel_speed, s.road_speed
        next1, next2 = _next_speeds(fixed, k, s, drive, h)
        next1 = next1 if x1 * next1 >= 0.0 else 0.0
        next2 = next2 if x2 * next2 >= 0.0 else 0.0
    _take(k, s, h, next1, next2)


@compiled
def _move(fixed: Any, k: Any, s: Any, drive: float, duration_s: float) -> None:
    if s.wheel_speed == 0.0 and s.road_speed == 0.0 and _drive_torque(k, drive, 0.0) <= k.M20:
        _take(k, s, duration_s, 0.0, 0.0)
        return
    if duration_s <= fixed.max_step_s and s.road_speed > duration_s * fixed.contact_rate / fixed.followed:
        _step(fixed, k, s, drive, duration_s)
        return
    blocks = math.ceil(duration_s / fixed.max_step_s - 1e-9)
    for _ in range(blocks):
        block_s = duration_s / blocks
        fastest = max(abs(s.wheel_speed), abs(s.road_speed))
        wanted = block_s * fixed.contact_rate / fixed.followed
        cuts = int(fixed.most_cuts) if wanted >= fixed.most_cuts * fastest else math.ceil(wanted / fastest)
        for _ in range(cuts):
            _step(fixed, k, s, drive, block_s / cuts)


# brake


@compiled
def _static_torque(fixed: Any, k: Any, duty: float) -> float:
    if not k.measured_map:
        return 0.0 if duty < k.u0 else max(0.0, k.b1 * duty + k.b2)
    points = fixed.torques
    left, low = points[0, 0], points[0, 1]
    if duty <= left:
        return low
    for i in range(1, points.shape[0]):
        right, high = points[i, 0], points[i, 1]
        if duty < right:
            return low + (high - low) * ((duty - left) / (right - left))
        left, low = right, high
    return low


@compiled
def _settled_torque(fixed: Any, k: Any, duty: float) -> float:
    duty = min(duty, k.brake_duty_cap)
    if k.brake_pwm_steps > 0.0:
        duty = math.floor(duty * k.brake_pwm_steps + fixed.exact) / k.brake_pwm_steps
    return k.brake_gain * _static_torque(fixed, k, duty - k.brake_duty_offset)


@compiled
def _command(fixed: Any, k: Any, s: Any, coming: Floats, i: int, duty: float) -> None:
    settled = _settled_torque(fixed, k, duty)
    if settled != s.newest_torque:
        s.newest_torque = settled
        coming[i, s.coming, 0] = s.time_s + k.brake_dead_time_s
        coming[i, s.coming, 1] = settled
        s.coming += 1


@compiled
def _act_on_arrived(fixed: Any, s: Any, coming: Floats, i: int) -> float:
    arrived = 0
    while arrived < s.coming and coming[i, arrived, 0] <= s.time_s + fixed.same_time_s:
        s.settled_torque = coming[i, arrived, 1]
        arrived += 1
    if arrived > 0:
        s.coming -= arrived
        for j in range(s.coming):
            coming[i, j, 0] = coming[i, j + arrived, 0]
            coming[i, j, 1] = coming[i, j + arrived, 1]
    return coming[i, 0, 0] if s.coming > 0 else math.inf


# entries


@compiled
def _move_in_parts(
    fixed: Any, k: Any, s: Any, coming: Floats, i: int, drive: float, brake: float, duration_s: float
) -> None:
    _command(fixed, k, s, coming, i, brake)
    if drive > 0.0:
        s.braking_since_s = math.inf
    elif brake > 0.0:
        s.braking_since_s = min(s.braking_since_s, s.time_s)
    step_s = s.braking_since_s + k.grip_step_after_s
    left_s = duration_s
    while True:
        arrival_s = _act_on_arrived(fixed, s, coming, i)
        stepped = s.time_s >= step_s - fixed.same_time_s
        s.grip = 1.0 + k.grip_step if stepped else 1.0
        part_s = min(left_s, (arrival_s if stepped else min(arrival_s, step_s)) - s.time_s)
        _move(fixed, k, s, drive, part_s)
        s.time_s += part_s
        if part_s == left_s:
            break
        left_s -= part_s


@compiled
def first_outside(duties: Floats) -> int:
    """Place of the first duty that is not in 0..1, or -1."""
    for i in range(duties.size):
        if not 0.0 <= duties[i] <= 1.0:
            return i
    return -1


@compiled
def advance(
    same: Any, rigs: Any, states: Any, coming: Floats, drives: Floats, brakes: Floats, tick: int, duration_s: float
) -> int:
    """Move all rigs on; the largest number of commands on their way to a brake.

    `drives` and `brakes` hold the duties of the newest ticks, a row each, those of `tick` in row `tick` modulo
    the number of rows.
    """
    most, fixed = 0, same[0]
    for i in range(rigs.size):
        k, s = rigs[i], states[i]
        row = (tick - k.command_delay_ticks) % drives.shape[0]
        _move_in_parts(fixed, k, s, coming, i, drives[row, i], brakes[row, i], duration_s)
        most = max(most, s.coming)
    return most


@compiled
def slips(rigs: Any, states: Any, found: Floats) -> None:
    """Write every rig's slip to `found`."""
    for i in range(rigs.size):
        found[i] = wheel_slip(rigs[i].r1 * states[i].wheel_speed, rigs[i].r2 * states[i].road_speed)


# encoders


@compiled
def _mixed(word: np.uint64) -> np.uint64:
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return word ^ (word >> np.uint64(31))


@compiled
def _normal_pair(seed: np.uint64, index: np.uint64) -> tuple[float, float]:
    word = _mixed(seed + (index + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15))
    radius = math.sqrt(-2.0 * math.log(float((word >> np.uint64(32)) + np.uint64(1)) * 2.0**-32))
    angle = float(word & np.uint64(0xFFFFFFFF)) * (2.0 * math.pi * 2.0**-32)
    return radius * math.cos(angle), radius * math.sin(angle)


@compiled
def _count(angle: float, counts: float, edge: float, eccentricity: float, phase: float, noise: float) -> int:
    position = angle * (counts / (2.0 * math.pi)) + edge
    if eccentricity > 0.0:
        position += eccentricity * math.sin(angle + phase)
    return math.floor(position + noise)


@compiled
def read_encoders(
    rigs: Any, states: Any, reading: np.uint64, wheel: NDArray[np.int64], road: NDArray[np.int64]
) -> None:
    """Write every rig's counts to `wheel` and `road`, with the noise of that number of reading."""
    for i in range(rigs.size):
        k, s = rigs[i], states[i]
        noise1 = noise2 = 0.0
        if k.wheel_jitter_counts > 0.0 or k.road_jitter_counts > 0.0:
            noise1, noise2 = _normal_pair(k.noise_seed, reading)
        wheel[i] = _count(
            s.wheel_angle,
            k.wheel_counts_per_turn,
            k.wheel_edge_counts,
            k.wheel_eccentricity_counts,
            k.wheel_eccentricity_phase_rad,
            k.wheel_jitter_counts * noise1,
        )
        road[i] = _count(
            s.road_angle,
            k.road_counts_per_turn,
            k.road_edge_counts,
            k.road_eccentricity_counts,
            k.road_eccentricity_phase_rad,
            k.road_jitter_counts * noise2,
        )
