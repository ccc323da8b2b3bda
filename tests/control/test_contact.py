"""The wheels while braking, for an assumed adhesion and torque: against the plant's own model."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.control.wheel_dynamics import WheelDynamics
from inteco_abs.rig import RigParameters, accelerations, adhesion

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

SETS = {name: RigParameters.named(name) for name in ("mask", "table")}
parameters = pytest.mark.parametrize("k", SETS.values(), ids=SETS.keys())
SLIPS = st.floats(0.002, 0.98)
SPEEDS = st.floats(2.0, 245.0)
TORQUES = st.floats(0.0, 12.0)
ADHESIONS = st.floats(0.05, 0.7)
RATES = st.floats(-50.0, 50.0)


def wheel_at(slip, road_speed, k) -> float:
    return (1.0 - slip) * k.r2 / k.r1 * road_speed


def slope(function, at, step):
    """Central difference of what may be several values."""
    above, below = function(at + step), function(at - step)
    return [(a - b) / (2.0 * step) for a, b in zip(above, below, strict=True)]


@parameters
@given(slip=SLIPS, road=SPEEDS, torque=TORQUES)
def test_accelerations_are_those_of_the_plants_model(k, slip, road, torque):
    wheel = wheel_at(slip, road, k)
    moving = WheelDynamics(k).accelerations(wheel, road, torque, adhesion(slip, k))
    plant = accelerations(wheel, road, torque, 0.0, k)
    assert moving.wheel == pytest.approx(plant.wheel_acceleration, rel=1e-9, abs=1e-9)
    assert moving.road == pytest.approx(plant.road_acceleration, rel=1e-9, abs=1e-9)


@parameters
@given(slip=SLIPS, road=SPEEDS, torque=TORQUES, mu=ADHESIONS)
def test_accelerations_have_their_own_slopes(k, slip, road, torque, mu):
    contact, wheel = WheelDynamics(k), wheel_at(slip, road, k)
    moving = contact.accelerations(wheel, road, torque, mu)
    by_adhesion = slope(lambda each: contact.accelerations(wheel, road, torque, each)[:2], mu, 1e-5)
    by_torque = slope(lambda each: contact.accelerations(wheel, road, each, mu)[:2], torque, 1e-3)
    assert [moving.wheel_per_adhesion, moving.road_per_adhesion] == pytest.approx(by_adhesion, rel=1e-6)
    assert [moving.wheel_per_nm, moving.road_per_nm] == pytest.approx(by_torque, rel=1e-6)


@parameters
@given(slip=SLIPS, road=SPEEDS, rate=RATES)
def test_the_torque_moves_the_plants_slip_as_was_asked(k, slip, road, rate):
    wheel = wheel_at(slip, road, k)
    torque, _, _ = WheelDynamics(k).torque(slip, rate, wheel, road, adhesion(slip, k))
    plant = accelerations(wheel, road, torque, 0.0, k)
    slip_rate = ((1.0 - slip) * plant.road_acceleration - k.r1 / k.r2 * plant.wheel_acceleration) / road
    assert slip_rate == pytest.approx(rate, rel=1e-9, abs=1e-9)


@parameters
@given(slip=SLIPS, road=SPEEDS, rate=RATES, mu=ADHESIONS)
def test_the_torque_has_its_own_slopes(k, slip, road, rate, mu):
    contact, wheel = WheelDynamics(k), wheel_at(slip, road, k)
    _, by_rate, by_adhesion = contact.torque(slip, rate, wheel, road, mu)
    over_rates = slope(lambda each: contact.torque(slip, each, wheel, road, mu)[:1], rate, 1e-2)
    over_adhesions = slope(lambda each: contact.torque(slip, rate, wheel, road, each)[:1], mu, 1e-5)
    assert [by_rate] == pytest.approx(over_rates, rel=1e-6)
    assert [by_adhesion] == pytest.approx(over_adhesions, rel=1e-6, abs=1e-6)
    assert by_rate > 0.0
