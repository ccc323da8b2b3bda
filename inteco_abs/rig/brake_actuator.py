"""A rig's brake actuator, from the command at its terminals to the settled torque."""

from __future__ import annotations

import math
from typing import Final

from inteco_abs.rig.actuators import brake_torque
from inteco_abs.rig.brake_map import BrakeMap, interpolated
from inteco_abs.rig.state import Constants, State
from inteco_abs.rig.variation import LONGEST_DEAD_TIME_S, RigVariation
from inteco_abs.signals import pwm_steps

MEASURED_TORQUE: Final = (
    (0.415, 0.0),  # ASSUMED: the measured points begin above the published end of the dead zone
    (0.45, 0.17),
    (0.50, 0.26),
    (0.526, 1.40),
    (0.55, 1.87),
    (0.58, 2.84),
    (0.63, 3.72),
    (0.65, 4.28),
    (0.70, 4.83),
    (0.75, 5.62),
    (0.80, 5.91),
    (0.85, 5.97),
    (0.90, 6.47),
    (0.95, 7.85),
    (1.00, 9.37),
)
"""Duty and settled torque in N m, read off the manual's figure 5.6b; straight lines between, constant beyond."""
MEASURED_MAP: Final = BrakeMap(MEASURED_TORQUE)
SAME_TIME_S: Final = 1e-9
"""Times closer than this are equal: the sum of many ticks is not exact."""


def measured_torque(duty: float) -> float:
    """Measured torque in N m at `duty`; 0 below the first point, the last point's value above it."""
    return MEASURED_MAP.torque(duty)


def measured_duty(torque: float) -> float:
    """Inverse of `measured_torque`: 0 for no torque, 1 above the largest one, NaN for NaN."""
    return MEASURED_MAP.duty(torque)


def settled_torque(duty: float, variation: RigVariation) -> float:
    """Settled torque in N m with `duty` (0..1) at the terminals: cap, PWM steps, static map."""
    return settled(Constants.of(variation), duty)


def settled(k: Constants, duty: float) -> float:
    """`settled_torque` of the rig `k`."""
    duty = min(duty, k.brake_duty_cap)
    if k.brake_pwm_steps > 0:
        duty = pwm_steps(duty, k.brake_pwm_steps) / k.brake_pwm_steps
    if k.supply_sag > 0.0:
        duty -= k.supply_sag * duty * duty
    duty -= k.brake_duty_offset
    return k.brake_gain * (interpolated(MEASURED_TORQUE, duty) if k.measured_map else brake_torque(duty, k))


def command(k: Constants, s: State, due_s: list[float], torques: list[float], duty: float) -> None:
    """Put `duty` (0..1) at the terminals; it acts a dead time later, that of a rise or that of a release."""
    s.newest_duty, torque = duty, settled(k, duty)
    if k.brake_hysteresis_nm > 0.0 and torque > 0.0:
        play = 0.5 * k.brake_hysteresis_nm
        torque = max(0.0, min(max(s.newest_torque, torque - play), torque + play))
    if torque != s.newest_torque:
        delay_s = k.brake_dead_time_s
        if torque < s.newest_torque:
            delay_s = min(max(0.0, delay_s + k.brake_release_delay_s), LONGEST_DEAD_TIME_S)
        s.newest_torque = torque
        if delay_s == 0.0:
            s.arrived = s.sent
            aim(k, s, torque)
            return
        acts_s = s.time_s + delay_s
        while s.arrived < s.sent and due_s[(s.sent - 1) % len(due_s)] > acts_s:
            s.sent -= 1  # overtaken
        i = s.sent % len(due_s)
        due_s[i], torques[i] = acts_s, torque
        s.sent += 1


def aim(k: Constants, s: State, torque: float) -> None:
    """Let the brake approach what it is now of `torque` in N m of a cold one."""
    s.cold_torque = torque
    s.settled_torque = torque * s.fade
    if k.brake_release_ratio != 1.0:
        s.lag_step_s = math.nan  # rise and release differ


def heat(k: Constants, s: State, duration_s: float) -> None:
    """Let the work in the brake over the last `duration_s` fade it, and wear the wheel."""
    s.brake_work_kj += 0.001 * abs(s.brake_torque * s.wheel_speed) * duration_s
    s.fade = 1.0 / (1.0 + k.brake_fade_per_kj * s.brake_work_kj)
    s.wheel_radius = k.r1 * max(0.5, 1.0 - k.wheel_wear_per_kj * s.brake_work_kj)
    aim(k, s, s.cold_torque)


def act_on_arrived(k: Constants, s: State, due_s: list[float], torques: list[float]) -> float:
    """Apply the commands that act by now; return the time in s of the next one, or infinity."""
    while s.arrived < s.sent:
        i = s.arrived % len(due_s)
        if due_s[i] > s.time_s + SAME_TIME_S:
            return due_s[i]
        aim(k, s, torques[i])
        s.arrived += 1
    return math.inf
