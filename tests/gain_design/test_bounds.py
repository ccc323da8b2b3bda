"""Bounds over a box of rigs: against the published figures, drawn rigs, and the physics by another way."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.control import BrakingModel
from inteco_abs.errors import ConfigError
from inteco_abs.gain_design import HARD, KNOWN, Box, ParameterRange, stated_box
from inteco_abs.gain_design.advice import Interval, describe_intervals, where_lost
from inteco_abs.gain_design.bounds import AtSlip, terms, worst
from inteco_abs.rig import RigParameters, RigVariation, brake_duty, draw, holding_torque, settled_torque, wheel_slip
from inteco_abs.rig.model import rates
from inteco_abs.rig.state import Constants, State

MASK = RigParameters.named("mask")
GRID = np.linspace(10.0, 180.0, 171)
SPEEDS = np.array([10.0, 33.0, 71.0, 180.0])
GEOMETRY = [f"{name}=3%" for name in ("r1", "r2", "L", "phi_rad", "M10", "M20", "w1", "w3", "w4", "a", "p", "b1")]
ROUNDING = 1e-9


def box_of(*statements):
    return stated_box(statements, MASK)


def drawn_from(box, shares):
    spreads = zip(box.spreads, shares, strict=True)
    return box.draw({spread.name: spread.low + share * (spread.high - spread.low) for spread, share in spreads})


def held_from(Mq, box, slip=0.2):
    """Road speed from which on (25) holds."""
    at = AtSlip(box, slip)
    ((low, high),) = where_lost(lambda speeds: Mq - at.bounds(speeds).mq_25, GRID)
    assert low == GRID[0]
    return high


@pytest.mark.parametrize(("Mq", "speed"), [(1.0, 46.0), (4.0, 12.0)])
def test_an_f_that_is_ten_percent_off_is_held_from_the_published_speed_on(Mq, speed):
    assert held_from(Mq, box_of("f=10%")) == pytest.approx(speed, abs=0.5)


@pytest.mark.parametrize(("Mq", "less", "more"), [(1.0, 65.0, 71.0), (4.0, 16.0, 18.0)])
def test_friction_that_is_ten_percent_off_is_held_from_the_published_speeds_on(Mq, less, more):
    assert held_from(Mq, Box(MASK, (ParameterRange("mu", 0.9, 1.0),))) == pytest.approx(less, abs=0.5)
    assert held_from(Mq, Box(MASK, (ParameterRange("mu", 1.0, 1.1),))) == pytest.approx(more, abs=0.5)
    assert held_from(Mq, box_of("mu=10%")) == pytest.approx(more, abs=0.5)


def test_a_rig_that_is_known_exactly_needs_no_switching():
    bounds = AtSlip(box_of(), 0.2).bounds(SPEEDS)
    for values in (bounds.eps_f, bounds.eps_g, bounds.mq_25, bounds.mq_26):
        assert np.abs(values).max() < ROUNDING
    assert pytest.approx([abs(BrakingModel(MASK).f(0.2, speed)) for speed in SPEEDS]) == bounds.F


def test_errors_of_f_and_g_that_are_stated_as_such_are_eps_f_and_eps_g():
    bounds = AtSlip(box_of("f=10%", "g=20%"), 0.2).bounds(SPEEDS)
    assert bounds.eps_f == pytest.approx(0.1 * bounds.F)
    assert bounds.eps_g == pytest.approx(np.full(4, 0.2))
    assert bounds.mq_26 == pytest.approx(bounds.F * (0.1 + 0.2) / 0.8)
    assert bounds.mq_25 == pytest.approx(bounds.F * (1.1 / 0.8 - 1.0))


STATEMENTS = st.lists(st.sampled_from(KNOWN), unique=True, min_size=1, max_size=5).flatmap(
    lambda names: st.tuples(
        *(
            st.floats(0.0, 0.05).map(lambda value, name=name: f"{name}={value}")
            if name in {"brake_duty_offset", "adhesion_blend"}
            else st.floats(0.0, 20.0).map(lambda value, name=name: f"{name}={value}%")
            for name in names
        )
    )
)


@given(STATEMENTS, st.floats(0.02, 0.98))
def test_eq26_never_asks_for_less_than_eq25(statements, slip):
    bounds = AtSlip(box_of(*statements), slip).bounds(SPEEDS)
    assert np.all(bounds.mq_25 <= bounds.mq_26 * (1.0 + ROUNDING) + ROUNDING)


def test_eq26_never_asks_for_less_than_eq25_over_a_band():
    bounds = worst([AtSlip(box_of("mu=10%", "J1=5%"), slip) for slip in (0.05, 0.2, 0.6)], SPEEDS)
    assert np.all(bounds.mq_25 <= bounds.mq_26)


BOXES = {"hard": box_of(*HARD), "geometry": box_of(*GEOMETRY)}


@cache
def box_at(name, slip):
    return AtSlip(BOXES[name], slip)


@given(
    st.tuples(st.sampled_from(list(BOXES)), st.sampled_from([0.05, 0.2, 0.9])),
    st.lists(st.floats(0.0, 1.0), min_size=12, max_size=12),
)
def test_no_rig_inside_the_box_is_worse_than_its_corners(where, shares):
    name, slip = where
    at, box = box_at(*where), BOXES[name]
    bounds, (least, most) = at.bounds(SPEEDS), at.holding_torques(SPEEDS)
    a, b, c = terms(drawn_from(box, shares[: len(box.spreads)]), slip, MASK)
    f, g, f_hat, g_hat = a / SPEEDS + b, c / SPEEDS, at.f(SPEEDS), at.g(SPEEDS)
    larger = 1.0 + ROUNDING
    assert np.all(np.abs(f - f_hat) <= bounds.eps_f * larger + ROUNDING)
    assert np.all(np.abs(1.0 - g / g_hat) <= bounds.eps_g * larger + ROUNDING)
    assert np.all(np.abs(g_hat / g * (f - f_hat) + f_hat * (g_hat / g - 1.0)) <= bounds.mq_25 * larger + ROUNDING)
    assert np.all((least - ROUNDING <= -f / g) & (-f / g <= most + ROUNDING))


def test_some_rig_on_the_edge_of_the_box_is_as_bad_as_its_bounds():
    box = BOXES["hard"]
    at = box_at("hard", 0.2)
    needs = [abs(at.nominal.c * t.a / t.c - at.nominal.a) for t in (terms(one, 0.2, MASK) for one in box.corners())]
    assert at.bounds(np.array([1e-6])).mq_25[0] * 1e-6 == pytest.approx(max(needs))


@given(st.lists(st.floats(0.0, 1.0), min_size=9, max_size=9), st.sampled_from([0.05, 0.2, 0.9]), st.floats(10.0, 180.0))
def test_f_and_g_are_the_slips_derivative_by_the_physics_of_the_drawn_rig(shares, slip, speed):
    drawn = drawn_from(BOXES["hard"], shares)
    rig, k = drawn.rig, drawn.rig.parameters
    constants = Constants.of(rig)
    state = State.at_speeds(constants, 0.0, 0.0)
    rim_ratio = (1.0 - slip) * k.r2 / k.r1
    assert wheel_slip(rim_ratio * speed, speed, k) == pytest.approx(slip)
    a, b, c = terms(drawn, slip, MASK)
    for asked_nm in (1.0, 4.0):
        torque = settled_torque(brake_duty(asked_nm, MASK), rig)
        wheel, road, *_ = rates(constants, state, rim_ratio * speed, speed, torque, 0.0)
        derivative = -k.r1 / (k.r2 * speed) * wheel + (1.0 - slip) / speed * road  # equation (13)
        if torque > 0.0:  # else the dead zone, where the line is not the brake
            assert a / speed + b + c / speed * asked_nm == pytest.approx(derivative, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("slip", [0.1, 0.2, 0.5])
def test_eq25_gain_is_g_times_the_largest_error_of_the_holding_torque(slip):
    at = AtSlip(box_of("mu=15%", "J2=5%", "Mg=5%"), slip)
    nominal = holding_torque(RigVariation(MASK), slip, 71.0)
    extremes = [holding_torque(one.rig, slip, 71.0) for one in at_corners(("mu=15%", "J2=5%", "Mg=5%"))]
    error = max(abs(torque - nominal) for torque in extremes)
    assert at.bounds(SPEEDS).mq_25[2] == pytest.approx(BrakingModel(MASK).g(slip, 71.0) * error)
    least, most = at.holding_torques(SPEEDS)
    assert (least[2], most[2]) == pytest.approx((min(extremes), max(extremes)))


def at_corners(statements):
    return list(box_of(*statements).corners())


def test_eq26_has_no_bound_if_g_errs_by_its_size_and_eq25_none_if_g_vanishes():
    wide = AtSlip(box_of("J1=70%"), 0.2).bounds(SPEEDS)
    assert wide.eps_g[0] > 1.0
    assert math.isinf(wide.mq_26[0])
    assert math.isfinite(wide.mq_25[0])
    lost = AtSlip(box_of("L=90%", "J1=90%", "J2=50%"), 0.2)
    assert not lost.g_positive
    assert math.isinf(lost.bounds(SPEEDS).mq_25[0])
    assert [values[0] for values in lost.holding_torques(SPEEDS)] == [-math.inf, math.inf]


def test_the_default_box_holds_the_population_hard_and_is_not_larger():
    box = {spread.name: spread for spread in BOXES["hard"].spreads}
    seen = {name: [] for name in box}
    for seed in range(300):
        rig = draw("hard", seed)
        for name in ("J1", "J2", "Mg", "d1", "d2"):
            seen[name].append(getattr(rig.parameters, name))
        seen["mu"].append(rig.adhesion_scale)
        for name in ("adhesion_blend", "brake_gain", "brake_duty_offset"):
            seen[name].append(getattr(rig, name))
    for name, (_, low, high) in box.items():
        assert low <= min(seen[name]) < low + 0.03 * (high - low)
        assert high - 0.03 * (high - low) < max(seen[name]) <= high


def test_a_spread_is_stated_in_percent_or_in_the_parameters_own_unit():
    box = box_of("J1=5%", "M10 = 0.001", "mu=0.1", "adhesion_blend=0.5", "brake_duty_offset=0.02")
    ranges = {name: (low, high) for name, low, high in box.spreads}
    assert ranges["J1"] == pytest.approx((0.95 * MASK.J1, 1.05 * MASK.J1))
    assert ranges["M10"] == pytest.approx((0.002, 0.004))
    assert ranges["mu"] == pytest.approx((0.9, 1.1))
    assert ranges["adhesion_blend"] == (0.0, 0.5)
    assert ranges["brake_duty_offset"] == (-0.02, 0.02)


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("brake_gian=5%", "unknown parameter 'brake_gian'; did you mean brake_gain"),
        ("J1", "must look like J1=5%"),
        ("=5%", "must look like J1=5%"),
        ("J1=-5%", "must not be negative"),
        ("J1=", "must be a number, in percent of J1"),
        ("J1=nan", "must be a number"),
        ("J1=5%%", "must be a number"),
        ("J1=95%", "at most 90 % of J1 = 0.0075281"),
        ("J1=1", "at most 90 % of J1"),
        ("c31=5%", "lag is not in the law"),
        ("u0=5%", "use b2"),
        ("brake_duty_offset=2%", "state it as a number up to 0.2"),
        ("adhesion_blend=1.5", "at most 1"),
    ],
)
def test_a_wrong_statement_is_refused_with_what_is_right(statement, words):
    with pytest.raises(ConfigError) as caught:
        box_of(statement)
    assert words in str(caught.value)
    assert f"--uncertain: {statement}: " in str(caught.value)


def test_everything_that_is_wrong_is_said_at_once():
    with pytest.raises(ConfigError) as caught:
        box_of("J1=5%", "J1=4%", "J9=1%", "mu=-1%")
    assert len(caught.value.mistakes) == 3
    assert "stated twice" in str(caught.value)


def test_too_many_names_are_refused():
    with pytest.raises(ConfigError, match="13 names: must be at most 12"):
        box_of(*GEOMETRY, "mu=1%")


def test_a_lever_that_would_jam_is_refused():
    with pytest.raises(ConfigError, match=r"adhesion of 0\.395 at slip 0\.2.*tan\(phi\)"):
        AtSlip(box_of("phi_rad=80%"), 0.2)


@pytest.mark.parametrize(
    ("margin", "expected", "words"),
    [
        (lambda x: x - 71.3, [(10.0, 71.3)], "below 71.3 rad/s"),
        (lambda x: 115.4 - x, [(115.4, 180.0)], "above 115.4 rad/s"),
        (lambda x: -x, [(10.0, 180.0)], "at every speed"),
        (lambda x: x, [], ""),
        (lambda x: np.abs(x - 50.5) - 0.7, [(49.8, 51.2)], "from 49.8 to 51.2 rad/s"),
        (lambda x: 40.0 - np.abs(x - 60.2), [(10.0, 20.2), (100.2, 180.0)], "below 20.2 rad/s and above 100.2 rad/s"),
    ],
)
def test_where_something_is_lost_is_found_between_the_speeds_looked_at(margin, expected, words):
    found = where_lost(margin, GRID)
    assert [tuple(one) for one in found] == [pytest.approx(one, abs=1e-6) for one in expected]
    assert all(type(one) is Interval for one in found)
    assert describe_intervals(found, GRID) == words
