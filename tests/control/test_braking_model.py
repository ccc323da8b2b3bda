import math
from dataclasses import fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.control import BrakingModel
from inteco_abs.rig import RigParameters, accelerations, adhesion

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

SETS = {name: RigParameters.named(name) for name in ("mask", "table")}
MODELS = {name: BrakingModel(parameters) for name, parameters in SETS.items()}

names = st.sampled_from(sorted(SETS))
slips = st.floats(0.01, 0.95)
all_slips = st.floats(0.0, 1.0)
road_speeds = st.floats(2.0, 185.0)
torques = st.floats(0.0, 9.0)


def wheel_speed_at(slip: float, road_speed: float, k: RigParameters) -> float:
    return k.r2 / k.r1 * (1.0 - slip) * road_speed


@given(names, slips, road_speeds, torques)
def test_f_and_g_are_the_chain_rule_of_the_slip_along_the_full_model(name, slip, road_speed, torque):
    k, model = SETS[name], MODELS[name]
    wheel_speed = wheel_speed_at(slip, road_speed, k)
    motion = accelerations(wheel_speed, road_speed, torque, 0.0, k)
    of_wheel = -k.r1 / (k.r2 * road_speed) * motion.wheel_acceleration
    of_road = k.r1 * wheel_speed / (k.r2 * road_speed**2) * motion.road_acceleration
    f, g = model.f(slip, road_speed), model.g(slip, road_speed)
    # relative to the terms that are added: their sum passes through zero where the torque holds the slip
    scale = max(abs(of_wheel), abs(of_road), abs(f), abs(g * torque))
    assert f + g * torque == pytest.approx(of_wheel + of_road, rel=0.0, abs=1e-12 * scale)


@pytest.mark.parametrize("name", sorted(SETS))
def test_the_constants_have_the_structure_of_equation_10(name):
    k, c = SETS[name], MODELS[name]
    assert c.c11 == pytest.approx(-k.r1 * c.c13, rel=1e-15)
    assert c.c12 / c.c15 == pytest.approx(k.Mg + k.M10, rel=1e-15)
    assert c.c14 == pytest.approx(k.M10 * c.c16, rel=1e-15)
    ratio = -(k.r2 * k.J1) / (k.r1 * k.J2)
    assert [c.c21 / c.c11, c.c22 / c.c12, c.c25 / c.c15] == pytest.approx([ratio] * 3, rel=1e-15)
    assert c.c23 / c.c24 == pytest.approx(k.d2 / k.M20, rel=1e-15)


@pytest.mark.parametrize("name", sorted(SETS))
def test_the_constants_have_the_signs_of_equation_10(name):
    c = MODELS[name]
    assert min(c.c11, c.c12, c.c15) > 0.0
    assert max(c.c13, c.c14, c.c16, c.c21, c.c22, c.c23, c.c24, c.c25) < 0.0


def test_the_constants_of_the_mask_set_have_the_published_size():
    k, c = SETS["mask"], MODELS["mask"]
    assert c.c16 == -1.0 / 7.5281e-3
    assert c.c15 == pytest.approx(0.0995 / 7.5281e-3, rel=1e-15)
    assert c.c25 == pytest.approx(-0.099 / 25.603e-3, rel=1e-15)
    assert c.c12 == pytest.approx((0.003 + 19.6181) * 0.0995 / 7.5281e-3, rel=1e-15)
    assert c.parameters is k


def test_each_constant_depends_on_exactly_the_parameters_it_is_made_of():
    made_of = {
        "c11": {"r1", "d1", "J1"},
        "c12": {"M10", "Mg", "r1", "J1"},
        "c13": {"d1", "J1"},
        "c14": {"M10", "J1"},
        "c15": {"r1", "J1"},
        "c16": {"J1"},
        "c21": {"r2", "d1", "J2"},
        "c22": {"M10", "Mg", "r2", "J2"},
        "c23": {"d2", "J2"},
        "c24": {"M20", "J2"},
        "c25": {"r2", "J2"},
    }
    k, nominal = SETS["mask"], MODELS["mask"]
    moved: dict[str, set[str]] = {constant: set() for constant in made_of}
    for field in fields(k):
        changed = BrakingModel(replace(k, **{field.name: 1.1 * getattr(k, field.name)}))
        for constant, by in moved.items():
            if getattr(changed, constant) != getattr(nominal, constant):
                by.add(field.name)
    assert moved == made_of


@given(names, all_slips)
def test_S_is_what_the_normal_force_makes_of_the_adhesion(name, slip):
    k, model = SETS[name], MODELS[name]
    mu = adhesion(slip, k)
    lever = k.L * (math.sin(k.phi_rad) - mu * math.cos(k.phi_rad))
    assert model.S(slip) == pytest.approx(mu / lever, rel=1e-14)


@given(names, all_slips, road_speeds)
def test_more_brake_torque_always_raises_the_slip(name, slip, road_speed):
    assert MODELS[name].g(slip, road_speed) > 0.0


@pytest.mark.parametrize(("road_speed", "size_of_f"), [(12.0, 40.0), (46.0, 10.0), (115.0, 4.0)])
def test_f_at_the_reference_has_its_published_size(road_speed, size_of_f):
    assert MODELS["mask"].f(0.2, road_speed) == pytest.approx(-size_of_f, rel=0.05)


def test_the_rate_left_to_the_full_brake_at_133_rad_s_is_the_published_4_per_s():
    f, g = MODELS["mask"].terms(0.2, 133.0)
    assert f + g * 9.03 == pytest.approx(4.0, rel=0.02)


def test_the_brake_limit_of_the_vendor_leaves_almost_no_rate_at_180_rad_s():
    f, g = MODELS["mask"].terms(0.2, 180.0)
    assert 0.0 < f + g * 4.458 < 0.2


@given(names, all_slips, road_speeds)
def test_terms_are_f_and_g(name, slip, road_speed):
    model = MODELS[name]
    assert model.terms(slip, road_speed) == (model.f(slip, road_speed), model.g(slip, road_speed))


@pytest.mark.parametrize("road_speed", [1e-6, 0.1, 1.0, 1000.0])
def test_every_road_speed_above_zero_is_accepted(road_speed):
    f, g = MODELS["mask"].terms(0.2, road_speed)
    assert f * road_speed == pytest.approx(-461.5, rel=0.01)
    assert g * road_speed == pytest.approx(110.1, rel=0.01)


@pytest.mark.parametrize("road_speed", [0.0, -0.0, -1.0, math.nan, -math.inf])
@pytest.mark.parametrize("method", ["f", "g", "terms"])
def test_a_road_speed_that_is_not_above_zero_is_refused_with_its_value(method, road_speed):
    with pytest.raises(ValueError, match=rf"road_speed = {road_speed!r} rad/s: must be above 0"):
        getattr(MODELS["mask"], method)(0.2, road_speed)


@pytest.mark.parametrize("slip", [-1e-9, 1.0 + 1e-9, math.nan, math.inf])
@pytest.mark.parametrize("method", ["f", "g", "terms"])
def test_a_slip_outside_0_to_1_is_refused_with_its_value(method, slip):
    with pytest.raises(ValueError, match=rf"slip = {slip!r}: must be in 0\.\.1"):
        getattr(MODELS["mask"], method)(slip, 100.0)


@pytest.mark.parametrize("slip", [-0.1, 1.1, math.nan])
def test_S_refuses_a_slip_outside_0_to_1(slip):
    with pytest.raises(ValueError, match=r"must be in 0\.\.1"):
        MODELS["mask"].S(slip)
