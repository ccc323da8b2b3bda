import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.control import BrakingModel, reaching_law_torque, reaching_time_bound
from inteco_abs.rig import RigParameters

MODEL = BrakingModel(RigParameters.named("mask"))

gains = st.floats(0.01, 100.0)
slips = st.floats(0.0, 1.0)
road_speeds = st.floats(2.0, 185.0)


@pytest.mark.parametrize(("Mk", "Mq", "expected_s"), [(2.0, 1.0, 0.1682), (10.0, 4.0, 0.0405), (1.0, 2.0, 0.0953)])
def test_reaching_time_bound_has_its_published_values(Mk, Mq, expected_s):
    assert reaching_time_bound(0.0, 0.2, Mk, Mq) == pytest.approx(expected_s, abs=5e-5)


@given(st.floats(-0.9, 0.9), gains, gains)
def test_the_exact_solution_of_the_reaching_law_is_zero_at_the_bound(error, Mk, Mq):
    time_s = reaching_time_bound(0.0, -error, Mk, Mq)
    left = (abs(error) + Mq / Mk) * math.exp(-Mk * time_s) - Mq / Mk
    assert left == pytest.approx(0.0, abs=1e-12 * (1.0 + Mq / Mk))


@given(st.floats(0.001, 0.5), gains, gains)
def test_the_bound_depends_only_on_the_distance_to_the_reference(distance, Mk, Mq):
    below = reaching_time_bound(0.5 - distance, 0.5, Mk, Mq)
    above = reaching_time_bound(0.5 + distance, 0.5, Mk, Mq)
    assert below == pytest.approx(above, rel=1e-9, abs=1e-15)


@given(slips, road_speeds, st.floats(0.05, 0.95), gains, gains)
def test_the_torque_makes_the_model_follow_the_reaching_law(slip, road_speed, reference, Mk, Mq):
    torque = reaching_law_torque(slip, road_speed, reference, Mk, Mq, MODEL)
    f, g = MODEL.terms(slip, road_speed)
    error = slip - reference
    wanted = -Mk * error - (math.copysign(Mq, error) if error else 0.0)
    assert f + g * torque == pytest.approx(wanted, rel=1e-9, abs=1e-9 * abs(f))


@given(road_speeds, gains, gains)
def test_on_the_surface_itself_the_torque_is_the_holding_torque(road_speed, Mk, Mq):
    f, g = MODEL.terms(0.2, road_speed)
    assert reaching_law_torque(0.2, road_speed, 0.2, Mk, Mq, MODEL) == -f / g


def test_the_torque_jumps_by_twice_Mq_over_g_across_the_surface():
    below = reaching_law_torque(math.nextafter(0.2, 0.0), 100.0, 0.2, 2.0, 1.0, MODEL)
    above = reaching_law_torque(math.nextafter(0.2, 1.0), 100.0, 0.2, 2.0, 1.0, MODEL)
    assert below - above == pytest.approx(2.0 / MODEL.g(0.2, 100.0), rel=1e-12)


@pytest.mark.parametrize(("slip", "road_speed"), [(0.2, 0.0), (0.2, math.nan), (-0.1, 100.0), (math.nan, 100.0)])
def test_states_outside_the_model_are_refused(slip, road_speed):
    with pytest.raises(ValueError, match="must be"):
        reaching_law_torque(slip, road_speed, 0.2, 2.0, 1.0, MODEL)
