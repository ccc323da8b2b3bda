import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.control import CONTROLLERS, BrakingModel, ReachingLaw, Relay, Setup, reaching_law_torque
from inteco_abs.rig import RigParameters, brake_duty
from inteco_abs.signals import BrakeDemand, Estimate

MASK = RigParameters.named("mask")
MODEL = BrakingModel(MASK)
SETUP = Setup(reference_slip=0.2, parameters=MASK, hold_below_rad_s=5.0)
PERIOD_S = 0.0005


def seen(slip: float, road_speed: float, *, valid: bool = True) -> Estimate:
    return Estimate((1.0 - slip) * road_speed * MASK.r2 / MASK.r1, road_speed, slip, valid)


@given(st.floats(0.0, 1.0), st.floats(5.001, 245.0), st.floats(0.0, 50.0), st.floats(0.0, 50.0))
def test_law_demands_the_torque_of_equation_22_within_the_brakes_duty(slip, speed, Mk, Mq):
    demand = ReachingLaw(SETUP, Mk, Mq).update(seen(slip, speed), PERIOD_S)
    torque = reaching_law_torque(slip, speed, 0.2, Mk, Mq, MODEL)
    assert demand.torque_nm == pytest.approx(torque, rel=1e-9, abs=1e-9)
    wanted = 0.0 if demand.torque_nm <= 0.0 else min(1.0, brake_duty(demand.torque_nm, MASK))
    assert 0.0 <= demand.brake == wanted <= 1.0


@given(st.floats(0.0, 1.0), st.floats(5.001, 245.0))
def test_the_law_logs_its_model_terms_and_its_switching_function(slip, speed):
    demand = ReachingLaw(SETUP, 2.0, 1.0).update(seen(slip, speed), PERIOD_S)
    f, g = MODEL.terms(slip, speed)
    assert demand.switching == slip - 0.2
    assert dict(zip([each.name for each in ReachingLaw.internals], demand.internals, strict=False)) == {
        "f_per_s": f,
        "g_per_s_nm": g,
        "torque_eq_nm": -f / g,
    }


@pytest.mark.parametrize(
    ("values", "gains"),
    [((2.0,), {}), ((2.0, 1.0, 0.0, 5.0), {}), ((2.0, 1.0), {"Mk": 3.0}), ((2.0, 1.0), {"Mz": 3.0})],
)
def test_gains_that_are_missing_too_many_given_twice_or_unknown_are_refused(values, gains):
    with pytest.raises((TypeError, ValueError)):
        ReachingLaw(SETUP, *values, **gains)


@pytest.mark.parametrize("road_speed", [5.0, 1.0, 0.0, -3.0])
def test_at_and_below_the_hold_speed_the_last_demand_is_held(road_speed):
    law = ReachingLaw(SETUP, 2.0, 1.0)
    last = law.update(seen(0.15, 5.01), PERIOD_S)
    assert last.brake > 0.0
    assert law.update(seen(0.9, road_speed), PERIOD_S) == last


def test_an_estimate_that_is_not_valid_is_not_acted_on():
    law = ReachingLaw(SETUP, 2.0, 1.0)
    assert law.update(seen(0.0, 180.0, valid=False), PERIOD_S) == BrakeDemand(0.0)
    last = law.update(seen(0.1, 180.0), PERIOD_S)
    assert last.brake > 0.0
    assert law.update(seen(0.9, 180.0, valid=False), PERIOD_S) == last


def test_the_law_continues_after_a_hold():
    law = ReachingLaw(SETUP, 2.0, 1.0)
    law.update(seen(0.1, 180.0), PERIOD_S)
    law.update(seen(0.1, 1.0), PERIOD_S)
    assert law.update(seen(0.1, 100.0), PERIOD_S) == ReachingLaw(SETUP, 2.0, 1.0).update(seen(0.1, 100.0), PERIOD_S)


@pytest.mark.parametrize(("slip", "brake"), [(0.0, 0.9), (math.nextafter(0.2, 0.0), 0.9), (0.2, 0.1), (1.0, 0.1)])
def test_the_relay_brakes_below_the_reference_only(slip, brake):
    demand = Relay(SETUP, on_duty=0.9, off_duty=0.1).update(seen(slip, 100.0), PERIOD_S)
    assert (demand.brake, demand.switching, demand.torque_nm) == (brake, slip - 0.2, 0.0)


@pytest.mark.parametrize("kind", CONTROLLERS.values(), ids=CONTROLLERS)
def test_every_controller_names_its_gains_and_at_most_four_internals(kind):
    controller = kind(SETUP, **{gain.name: gain.default for gain in kind.gains})
    assert len(kind.internals) <= 4
    assert all(gain.low <= gain.default <= gain.high for gain in kind.gains)
    assert all(gain.unit and gain.meaning for gain in kind.gains)
    assert 0.0 <= controller.update(seen(0.1, 100.0), PERIOD_S).brake <= 1.0
