"""The full signed model of the two wheels, equations (1) to (7), with stiction at standstill."""

from __future__ import annotations

import math
from typing import NamedTuple

from inteco_abs.rig.adhesion_curve import road_adhesion, road_adhesion_slope
from inteco_abs.rig.friction import formula, formula_slope
from inteco_abs.rig.parameters import RigParameters
from inteco_abs.rig.state import Constants, State
from inteco_abs.rig.variation import RigVariation


def wheel_slip(wheel_speed: float, road_speed: float, parameters: RigParameters) -> float:
    """Slip in 0..1 of the wheel on the road, equation (7) in every regime; speeds in rad/s.

    0 is rolling, 1 a locked or counter-rotating wheel; two wheels at rest have slip 0 by definition.
    """
    return rim_slip(parameters.r1 * wheel_speed, parameters.r2 * road_speed)


def rim_slip(rim1: float, rim2: float) -> float:
    """`wheel_slip` of rim speeds in m/s."""
    if rim2 > rim1 > 0.0:
        return (rim2 - rim1) / rim2
    if rim1 > rim2 > 0.0:
        return (rim1 - rim2) / rim1
    if rim1 == rim2:
        return 0.0
    if rim1 * rim2 <= 0.0:
        return 1.0
    return (rim2 - rim1) / rim2 if rim2 < rim1 else (rim1 - rim2) / rim1  # both turn backwards


def true_slip(k: Constants, s: State) -> float:
    """Slip of the rig now."""
    return rim_slip(s.wheel_radius * s.wheel_speed, k.r2 * s.road_speed)


class Motion(NamedTuple):
    """Accelerations and contact of one instant."""

    wheel_acceleration: float
    """Upper wheel, rad/s2."""
    road_acceleration: float
    """Lower wheel, rad/s2."""
    normal_force: float
    """Between the wheels, N."""
    traction: float
    """Signed adhesion s*mu: positive when the road drives the wheel."""
    slip: float
    """Equation (7), 0..1."""


def rates(
    k: Constants, s: State, wheel_speed: float, road_speed: float, brake_torque: float, drive_torque: float
) -> tuple[float, float, float, float, float]:
    """The fields of `Motion` as a plain tuple, for speed: this is the inner loop of every simulation."""
    r1 = s.wheel_radius
    rim1, rim2 = r1 * wheel_speed, k.r2 * road_speed
    slip = rim_slip(rim1, rim2)
    mu = formula(k, slip) if k.plain_curve else road_adhesion(k, s, slip)
    traction = s.grip * mu
    if rim2 < rim1:
        traction = -traction
    lever = s.L_sin - s.L_cos * traction
    held = brake_torque + k.M10
    moves = True
    if wheel_speed > 0.0:
        resisting = k.d1 * wheel_speed + held
    elif wheel_speed < 0.0:
        resisting = k.d1 * wheel_speed - held
    else:
        # the brake takes the road's torque, up to what it can hold; that enters the lever's balance
        reaction = k.Mg / (lever - r1 * traction) * r1 * traction
        moves = abs(reaction) > held
        resisting = math.copysign(held, reaction) if moves else reaction
    normal = (k.Mg + resisting) / lever  # (5)
    push = normal * traction
    wheel = (push * r1 - resisting) / k.J1 if moves else 0.0  # (2)
    load = drive_torque - push * k.r2 - k.d2 * road_speed
    if road_speed > 0.0:
        load -= k.M20
    elif road_speed < 0.0:
        load += k.M20
    else:
        load -= max(-k.M20, min(k.M20, load))
    return wheel, load / k.J2, normal, traction, slip  # (3)


def contact_stiffness(
    k: Constants, s: State, wheel_speed: float, road_speed: float, normal: float, traction: float, slip: float
) -> tuple[float, float, float, float]:
    """Jacobian of the contact as column times row: d(accelerations)/d(traction) and d(traction)/d(speeds).

    All zero where a wheel stands or turns backwards and at exactly zero slip: there the contact is not stiff
    or not differentiable.
    """
    if wheel_speed <= 0.0 or road_speed <= 0.0 or slip == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    r1 = s.wheel_radius
    mu_slope = formula_slope(k, slip) if k.plain_curve else road_adhesion_slope(k, s, slip)
    slope = s.grip * mu_slope
    force = normal * s.L_sin / (s.L_sin - s.L_cos * traction)
    slower = 1.0 - slip
    if k.r2 * road_speed > r1 * wheel_speed:
        unit = slope / (k.r2 * road_speed)
        row1, row2 = -unit * r1, unit * k.r2 * slower
    else:
        unit = slope / (r1 * wheel_speed)
        row1, row2 = -unit * r1 * slower, unit * k.r2
    return force * r1 / k.J1, -force * k.r2 / k.J2, row1, row2


def accelerations(
    wheel_speed: float, road_speed: float, brake_torque: float, drive_torque: float, parameters: RigParameters
) -> Motion:
    """Accelerations of both wheels, equations (2) to (6), and the stiction hold where a wheel stands still.

    Speeds in rad/s; `brake_torque` >= 0 is what the brake can hold, in N m; `drive_torque` in N m acts on the
    lower wheel (the paper's model has none: its drive is off while braking).
    """
    k = Constants.of(RigVariation(parameters))
    state = State.at_speeds(k, wheel_speed, road_speed)
    return Motion(*rates(k, state, wheel_speed, road_speed, brake_torque, drive_torque))


def kinetic_energy(wheel_speed: float, road_speed: float, parameters: RigParameters) -> float:
    """Kinetic energy of both wheels in J; speeds in rad/s."""
    return 0.5 * (parameters.J1 * wheel_speed * wheel_speed + parameters.J2 * road_speed * road_speed)
