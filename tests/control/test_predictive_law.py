"""The predictive law on outlooks as an observer may have them, without an observer."""

import math
from itertools import cycle

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from inteco_abs.control import FallBack, PredictiveReaching, Setup
from inteco_abs.control.wheel_dynamics import WheelDynamics
from inteco_abs.rig import RigParameters, adhesion, measured_torque
from inteco_abs.signals import BrakeDemand, Estimate, Prediction

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

MASK = RigParameters.named("mask")
CONTACT = WheelDynamics(MASK)
SETUP = Setup(0.2, MASK, 5.0)
GAINS = {gain.name: gain.default for gain in PredictiveReaching.gains}
K, A, A_MOST = GAINS["k"], GAINS["a"], GAINS["a_most"]
PERIOD_S = 0.0005
SLIPS = st.floats(0.04, 0.95)
SPEEDS = st.floats(6.0, 245.0)
LAGS = st.floats(0.025, 0.09)

OUTLOOKS = st.builds(
    Prediction,
    wheel_angle_rad=st.floats(-1e6, 1e6),
    wheel_speed_rad_s=st.floats(-50.0, 300.0),
    road_speed_rad_s=st.floats(-50.0, 300.0),
    lagged_torque_nm=st.floats(-1.0, 12.0),
    excess_torque_nm=st.floats(-15.0, 15.0),
    adhesion_factor=st.floats(-0.5, 2.0),
    ripple_cosine=st.floats(-0.3, 0.3),
    ripple_sine=st.floats(-0.3, 0.3),
    brake_dead_time_s=st.floats(0.002, 0.03),
    brake_release_ratio=st.floats(0.3, 4.0),
    brake_lag_s=LAGS,
)


def law(**gains):
    return PredictiveReaching(SETUP, **{**GAINS, **gains})


def outlook(slip, road_speed, lagged=3.0, **other):
    """Prediction for the published rig, except for the named values."""
    wheel_speed = (1.0 - slip) * MASK.r2 / MASK.r1 * road_speed
    nothing = Prediction(0.0, wheel_speed, road_speed, lagged, 0.0, 1.0, 0.0, 0.0, 0.01, 0.05)
    return nothing._replace(**other)


def seen(expected):
    """Estimate of an observer that expects no change."""
    speeds = (0.0, 100.0) if expected is None else (expected.wheel_speed_rad_s, expected.road_speed_rad_s)
    return Estimate(*speeds, 0.2, valid=True, outlook=expected)


def demand_at(expected, **gains):
    return law(**gains).update(seen(expected), PERIOD_S)


def slip_rate(slip, road_speed, torque, factor=1.0):
    """For the nominal rig with that brake torque."""
    moving = CONTACT.accelerations(
        (1.0 - slip) * MASK.r2 / MASK.r1 * road_speed, road_speed, torque, factor * adhesion(slip, MASK)
    )
    return ((1.0 - slip) * moving.road - MASK.r1 / MASK.r2 * moving.wheel) / road_speed


def deceleration(road_speed):
    return min(A * 180.0 / road_speed, A_MOST)


@given(SLIPS, SPEEDS)
def test_the_slip_is_asked_to_move_by_the_law(slip, road_speed):
    error, a = slip - 0.2, deceleration(road_speed)
    rate = slip_rate(slip, road_speed, demand_at(outlook(slip, road_speed)).torque_nm)
    near = abs(error) <= a / K**2
    expected = -K * error if near else -math.copysign(math.sqrt(2.0 * a * (abs(error) - a / (2.0 * K**2))), error)
    assert rate == pytest.approx(expected, rel=1e-6, abs=1e-6)


@given(st.floats(0.04, 0.12), st.floats(20.0, 245.0), st.floats(1.1, 4.0))
def test_slip_slows_at_most_half_as_hard_as_a_slow_release_allows(slip, road_speed, slowest):
    held, by_rate, _ = CONTACT.torque(
        slip, 0.0, (1.0 - slip) * MASK.r2 / MASK.r1 * road_speed, road_speed, adhesion(slip, MASK)
    )
    a = min(0.5 * held / (0.1 * slowest * by_rate), deceleration(road_speed))
    expected = outlook(slip, road_speed, brake_lag_s=0.1, slowest_release_ratio=slowest)
    rate = slip_rate(slip, road_speed, demand_at(expected).torque_nm)
    assert rate == pytest.approx(math.sqrt(2.0 * a * (0.2 - slip - a / (2.0 * K**2))), rel=1e-6)
    unlimited = demand_at(expected, release_share=0.0)
    assert unlimited == demand_at(expected._replace(slowest_release_ratio=1.0))


@given(st.floats(0.04, 0.12), st.floats(20.0, 245.0), st.floats(1.1, 4.0))
def test_slip_slows_the_less_hard_the_slower_the_brake_releases(slip, road_speed, ratio):
    a = deceleration(road_speed) / ratio
    rate = slip_rate(slip, road_speed, demand_at(outlook(slip, road_speed, brake_release_ratio=ratio)).torque_nm)
    error = 0.2 - slip
    far = math.sqrt(2.0 * a * max(error - a / (2.0 * K**2), 0.0))
    assert rate == pytest.approx(K * error if error <= a / K**2 else far, rel=1e-6)


@given(SPEEDS, st.sampled_from([-1.0, 1.0]))
def test_the_branches_of_the_law_meet_in_value_and_slope(road_speed, side):
    edge = deceleration(road_speed) / K**2

    def rate_at(share):
        slip = 0.2 + side * edge * share
        return slip_rate(slip, road_speed, demand_at(outlook(slip, road_speed)).torque_nm)

    rates = [rate_at(share) for share in (0.998, 0.999, 1.001, 1.002)]
    if 0.04 < 0.2 + side * edge < 0.95:
        assert rates[2] - rates[1] == pytest.approx(-side * K * edge * 0.002, rel=1e-3)
        assert rates[3] - rates[2] == pytest.approx(rates[1] - rates[0], rel=0.01)


@given(SLIPS, st.floats(20.0, 245.0), st.floats(0.7, 1.3), st.floats(-1.0, 1.0))
def test_torque_uses_what_the_observer_learnt_of_adhesion_and_brake(slip, road_speed, factor, excess):
    plain = demand_at(outlook(slip, road_speed, adhesion_factor=factor))
    demand = demand_at(outlook(slip, road_speed, adhesion_factor=factor, excess_torque_nm=excess))
    assert demand.torque_nm == pytest.approx(plain.torque_nm - excess, rel=1e-9, abs=1e-9)
    rate = slip_rate(slip, road_speed, demand.torque_nm + excess, factor)
    assert rate == pytest.approx(slip_rate(slip, road_speed, demand_at(outlook(slip, road_speed)).torque_nm), abs=1e-6)


@given(st.floats(20.0, 200.0), st.floats(0.0, 6.28), st.floats(-0.03, 0.03), st.floats(-0.03, 0.03))
def test_the_known_ripple_of_the_turn_is_a_factor_of_its_own(road_speed, angle, cosine, sine):
    rippled = outlook(0.2, road_speed, wheel_angle_rad=angle, ripple_cosine=cosine, ripple_sine=sine)
    factor = 1.0 + cosine * math.cos(angle) + sine * math.sin(angle)
    flat = outlook(0.2, road_speed, adhesion_factor=factor)
    assert demand_at(rippled).torque_nm == pytest.approx(demand_at(flat).torque_nm, rel=1e-9)


@given(LAGS, st.floats(-0.001, 0.001), st.floats(-0.02, 0.02))
def test_the_demand_makes_the_lagging_torque_approach_that_of_the_law(lag, away, error):
    """On the way the law's own torque moves, as the slip does: a rig that follows it shows how much."""
    slip, road_speed, T = 0.2 + error, 100.0, 1e-6
    target = demand_at(outlook(slip, road_speed)).torque_nm
    lagged = target + away
    brake = demand_at(outlook(slip, road_speed, lagged, brake_lag_s=lag)).brake
    torque_rate = (measured_torque(brake) - lagged) / lag
    slipped = slip + T * slip_rate(slip, road_speed, lagged)
    law_rate = (demand_at(outlook(slipped, road_speed)).torque_nm - target) / T
    # the law's torque moves with the curve of the adhesion as well, which it leaves to the rate at which it closes in
    assert torque_rate == pytest.approx(GAINS["kM"] * -away + law_rate, abs=0.15 * abs(law_rate) + 1e-3)


@given(st.floats(50.0, 150.0), st.floats(0.0, 6.28), st.floats(0.01, 0.03))
def test_the_demand_includes_the_ripple_of_the_next_turn(road_speed, angle, sine):
    def rippled(turned, lagged):
        return demand_at(outlook(0.2, road_speed, lagged, wheel_angle_rad=turned, ripple_sine=sine))

    target, T = rippled(angle, 3.0).torque_nm, 1e-5
    demand = rippled(angle, target)
    wheel_speed = 0.8 * MASK.r2 / MASK.r1 * road_speed
    law_rate = (rippled(angle + T * wheel_speed, target).torque_nm - target) / T
    if 0.45 < demand.brake < 1.0:
        assert (measured_torque(demand.brake) - target) / 0.05 == pytest.approx(law_rate, rel=0.01, abs=0.05)


def test_all_is_given_far_below_and_nothing_far_above_the_reference():
    assert demand_at(outlook(0.0, 180.0, 0.0)).brake == 1.0
    assert demand_at(outlook(0.6, 180.0, 6.0)).brake == 0.0


@pytest.mark.parametrize("slip", [0.0, 0.01, 0.02, 0.034])
def test_reaching_from_rolling_wheels_asks_for_a_torque_that_holds_some_slip(slip):
    """The adhesion of next to no slip would ask for next to no torque."""
    steep = -math.sqrt(2.0 * A * (0.2 - slip - A / (2.0 * K**2)))
    demanded = demand_at(outlook(slip, 180.0)).torque_nm
    wheel_speed = (1.0 - slip) * MASK.r2 / MASK.r1 * 180.0
    assert demanded == pytest.approx(CONTACT.torque(slip, -steep, wheel_speed, 180.0, adhesion(0.035, MASK))[0])


@given(OUTLOOKS, st.lists(OUTLOOKS, max_size=3))
@example(outlook(1.0, 6.0, slowest_release_ratio=math.inf), [])
def test_the_demand_is_a_duty_and_finite_numbers_for_any_prediction(first, more):
    controller = law()
    for expected in (first, *more):
        demand = controller.update(seen(expected), PERIOD_S)
        assert 0.0 <= demand.brake <= 1.0
        assert all(map(math.isfinite, (demand.torque_nm, demand.switching, *demand.internals)))


@given(OUTLOOKS, st.sampled_from(["none", "expected", "now"]))
def test_the_last_demand_is_held_without_outlook_and_as_the_road_stops(expected, why):
    controller = law()
    held = controller.update(seen(outlook(0.15, 50.0)), PERIOD_S)
    slow = expected._replace(road_speed_rad_s=min(expected.road_speed_rad_s, 5.0))
    estimate = {
        "none": Estimate(10.0, 50.0, 0.8, valid=True),
        "expected": seen(slow)._replace(road_speed_rad_s=50.0),
        "now": seen(expected)._replace(road_speed_rad_s=5.0),
    }[why]
    assert held.brake > 0.0
    assert controller.update(estimate, PERIOD_S) == held


def slip_rates(controller, slips, periods=1):
    """Slip rate that the law asks for at 180 rad/s, in the last of so many periods at each slip."""
    rates = []
    for slip in slips:
        for _ in range(periods):
            demand = controller.update(seen(outlook(slip, 180.0)), PERIOD_S)
        rates.append(slip_rate(slip, 180.0, demand.torque_nm))
    return rates


def test_gain_halves_with_each_swing_and_recovers_in_steps_when_calm():
    controller, swings = law(), [0.1, 0.26, 0.14, 0.26, 0.14, 0.26, 0.14, 0.26]
    slip_rates(controller, swings[:1])
    for steps, slip in enumerate(swings[1:], 1):
        slip_rates(controller, [slip, slip], 50)
        assert slip_rates(controller, [0.201]) == pytest.approx([-0.001 * K / 2 ** min(steps, 5)], rel=1e-6)
    for steps in (4, 3, 2, 1, 0, 0):
        assert slip_rates(controller, [0.201], 401) == pytest.approx([-0.001 * K / 2**steps], rel=1e-6)


def test_only_crossings_of_the_whole_band_count_as_swings():
    controller = law()
    slip_rates(controller, [0.1, 0.16, 0.1, 0.22, 0.18, 0.22], 100)
    assert slip_rates(controller, [0.201]) == pytest.approx([-0.001 * K], rel=1e-6)
    controller.reference = 0.15
    slip_rates(controller, [0.201])
    controller.reference = 0.2
    assert slip_rates(controller, [0.201]) == pytest.approx([-0.001 * K], rel=1e-6)
    never = law(swing_band=0.0)
    assert slip_rates(never, [0.1, 0.3, 0.1, 0.3, 0.201])[-1] == pytest.approx(-0.001 * K, rel=1e-6)


@example([(0.1, 1, 0), (0.26, 1, 0), (0.19, 117, 0), (0.19, 283, 0)])
@given(
    st.lists(
        st.tuples(st.sampled_from([0.1, 0.14, 0.19, 0.201, 0.26]), st.integers(0, 450), st.integers(0, 2)), max_size=8
    )
)
def test_its_steps_follow_from_the_errors_that_are_recorded_of_it(course):
    controller, recorded, demand = law(), FallBack(GAINS["swing_band"]), BrakeDemand(0.0)
    noise = cycle((0.0, 1e-9))  # an error stays the same to the bit only where the demand is held
    for slip, periods, reference in course:
        controller.reference = 0.2 + 0.01 * reference
        for _ in range(periods):
            demand = controller.update(seen(outlook(slip + next(noise), 180.0)), PERIOD_S)
            assert recorded.follow(demand.switching, controller.reference, PERIOD_S) == controller.steps
        demand = controller.update(seen(None), PERIOD_S)  # held
        assert recorded.follow(demand.switching, controller.reference, PERIOD_S) == controller.steps


def test_the_first_demand_is_zero():
    assert demand_at(None) == BrakeDemand(0.0)


def test_what_the_observer_estimates_is_logged():
    expected = outlook(0.2, 50.0, excess_torque_nm=0.3, adhesion_factor=0.9, brake_dead_time_s=0.012, brake_lag_s=0.04)
    demand = demand_at(expected)
    assert demand.internals == (0.3, 0.9, 0.012, 0.04)
    assert len(PredictiveReaching.internals) == 4
    assert demand.switching == pytest.approx(0.0, abs=1e-12)
