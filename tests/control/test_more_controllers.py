"""Controllers besides the paper's: each against its own equation, and all against what every controller must do."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.control import CONTROLLERS, BrakingModel, Setup
from inteco_abs.control.controllers import (
    BoundaryLayer,
    ConstantRate,
    ExponentialRate,
    PowerRate,
    ProportionalIntegral,
    SmithRelay,
    Steps,
    SuperTwisting,
)
from inteco_abs.rig import RigParameters
from inteco_abs.signals import Estimate

MASK = RigParameters.named("mask")
MODEL = BrakingModel(MASK)
SETUP = Setup(reference_slip=0.2, parameters=MASK, hold_below_rad_s=5.0)
PERIOD_S = 0.0005
SLIPS = st.floats(0.0, 1.0)
SPEEDS = st.floats(5.1, 245.0)


def seen(slip: float, road_speed: float = 100.0, *, valid: bool = True) -> Estimate:
    return Estimate((1.0 - slip) * road_speed * MASK.r2 / MASK.r1, road_speed, slip, valid)


def slip_rate(controller, slip, speed) -> float:
    """What the demanded torque would do to the slip of the model's own rig, equation (15)."""
    f, g = MODEL.terms(slip, speed)
    return f + g * controller.update(seen(slip, speed), PERIOD_S).torque_nm


def sgn(value: float) -> int:
    return (value > 0.0) - (value < 0.0)


@given(SLIPS, SPEEDS, st.floats(0.0, 50.0))
def test_constant_rate_reaches_with_the_same_speed_from_everywhere(slip, speed, Mq):
    rate = slip_rate(ConstantRate(SETUP, Mq), slip, speed)
    assert rate == pytest.approx(-Mq * sgn(slip - 0.2), rel=1e-9, abs=1e-9)


@given(SLIPS, SPEEDS, st.floats(0.0, 50.0), st.floats(0.01, 1.0))
def test_power_rate_slows_down_with_a_power_of_the_error(slip, speed, K, alpha):
    error = slip - 0.2
    rate = slip_rate(PowerRate(SETUP, K, alpha), slip, speed)
    assert rate == pytest.approx(-K * abs(error) ** alpha * sgn(error), rel=1e-9, abs=1e-9)


@given(SLIPS, SPEEDS, st.floats(0.01, 5.0), st.floats(0.01, 1.0), st.floats(0.0, 100.0), st.floats(0.1, 3.0))
def test_exponential_rate_is_k_on_the_surface_and_k_over_d_far_away(slip, speed, K, d, a, p):
    rate = slip_rate(ExponentialRate(SETUP, K, d, a, p), slip, speed)
    assert abs(rate) <= K / d * (1.0 + 1e-9)
    assert abs(rate) >= K * (1.0 - 1e-9) or slip == 0.2
    assert sgn(round(rate, 12)) == -sgn(slip - 0.2)


@given(SLIPS, SPEEDS)
def test_a_boundary_layer_without_width_and_integral_is_the_papers_law(slip, speed):
    ours = BoundaryLayer(SETUP, Mk=2.0, Mq=1.0, v=0.0, width=1e-6, Ki=0.0)
    error = slip - 0.2
    expected = -2.0 * error - max(-1.0, min(1.0, error / 1e-6))
    assert slip_rate(ours, slip, speed) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("speed", "factor"), [(200.0, 1.0), (100.0, 1.0), (50.0, 2.0), (10.0, 10.0)])
def test_the_switching_rate_grows_as_the_road_slows(speed, factor):
    law = BoundaryLayer(SETUP, Mk=0.0, Mq=1.0, v=100.0, width=1e-6, Ki=0.0)
    assert slip_rate(law, 0.3, speed) == pytest.approx(-factor)


def test_the_integral_takes_what_remains_and_rests_at_the_brakes_limits():
    law = BoundaryLayer(SETUP, Mk=0.0, Mq=0.0, v=0.0, width=0.02, Ki=10.0)
    law.update(seen(0.21), PERIOD_S)  # the first demand was none: nothing is added yet
    for step in range(1, 100):
        assert slip_rate(law, 0.21, 100.0) == pytest.approx(-10.0 * 0.01 * step * PERIOD_S)
    before = slip_rate(law, 0.21, 100.0)
    law = BoundaryLayer(SETUP, Mk=1000.0, Mq=0.0, v=0.0, width=0.02, Ki=10.0)
    for _ in range(100):
        assert law.update(seen(0.9), PERIOD_S).brake == 0.0  # released: more is not possible
    assert before == pytest.approx(-10.0 * 0.01 * 100 * PERIOD_S)
    assert slip_rate(law, 0.2, 100.0) == pytest.approx(0.0, abs=1e-9)


def test_super_twisting_has_a_root_and_the_integral_of_the_sign():
    law = SuperTwisting(SETUP, k1=2.0, k2=4.0)
    law.update(seen(0.21), PERIOD_S)
    for step in range(1, 50):
        expected = -2.0 * math.sqrt(0.01) - 4.0 * step * PERIOD_S
        assert slip_rate(law, 0.21, 100.0) == pytest.approx(expected)


class TestSmithRelay:
    def make(self, dead_time_s=0.027):
        return SmithRelay(SETUP, 1.0, 0.0, dead_time_s, 11.0, 1.74)

    def test_without_dead_time_it_is_a_relay(self):
        relay = self.make(dead_time_s=0.0)
        for slip in (0.0, 0.1, 0.19, 0.21, 0.5, 0.1):
            demand = relay.update(seen(slip), PERIOD_S)
            assert demand.brake == (1.0 if slip < 0.2 else 0.0)
            assert demand.internals[0] == pytest.approx(slip)

    def test_it_expects_what_was_commanded_and_has_not_acted(self):
        relay = self.make()
        relay.update(seen(0.0), 0.001)
        slips = [relay.update(seen(0.0), 0.001).internals[0] for _ in range(16)]
        assert slips == pytest.approx([11.0 * 0.001 * n for n in range(1, 17)], abs=0.0128)
        assert slips[0] > 0.0

    def test_it_releases_before_the_slip_is_there(self):
        relay = self.make()
        released = next(n for n in range(1000) if relay.update(seen(0.0), 0.001).brake == 0.0)
        assert released == pytest.approx(0.2 / 0.011, abs=2)

    def test_oldest_of_ticks_faster_than_any_board_samples_are_dropped(self):
        relay = self.make(dead_time_s=0.0)
        demands = [relay.update(seen(1.0), 0.0) for _ in range(20)]
        assert {demand.internals[0] for demand in demands} == {1.0}
        late = self.make(dead_time_s=0.001)
        expected = [late.update(seen(1.0), 1e-6).internals[0] for _ in range(1000)]
        assert expected[-1] == pytest.approx(1.0 - 1.74 * 18e-6)

    @pytest.mark.untraced
    @given(st.lists(st.floats(0.0, 0.4), min_size=60, max_size=200))
    def test_a_command_is_forgotten_once_it_has_acted(self, slips):
        relay = self.make()
        for slip in slips:
            relay.update(seen(slip), 0.001)
        expected = [relay.update(seen(1.0), 0.001).internals[0] for _ in range(60)][-1]
        assert expected == pytest.approx(1.0 - 1.74 * 0.027, abs=2 * 0.00174)


class TestProportionalIntegral:
    def test_at_no_error_it_is_the_bias(self):
        assert ProportionalIntegral(SETUP, 1.0, 5.0, 0.6).update(seen(0.2), PERIOD_S).brake == pytest.approx(0.6)

    @given(st.lists(SLIPS, max_size=100))
    def test_the_duty_is_never_beyond_the_brakes_limits(self, slips):
        controller = ProportionalIntegral(SETUP, 5.0, 100.0, 0.6)
        for slip in slips:
            assert 0.0 <= controller.update(seen(slip), 0.01).brake <= 1.0

    def test_it_does_not_wind_up(self):
        controller = ProportionalIntegral(SETUP, 1.0, 100.0, 0.6)
        for _ in range(10_000):
            controller.update(seen(0.0), 0.01)
        assert controller.update(seen(0.9), 0.01).brake < 1.0


def test_steps_climb_at_any_slip():
    steps = Steps(SETUP, first=0.4, rise=0.1, length_s=0.01)
    duties = [steps.update(seen(0.9), 0.001).brake for _ in range(100)]
    assert duties[0] == duties[9] == pytest.approx(0.4)
    assert duties[11] == pytest.approx(0.5)
    assert duties[-1] == 1.0


@pytest.mark.parametrize("name", CONTROLLERS)
class TestEveryController:
    def make(self, name):
        kind = CONTROLLERS[name]
        return kind(SETUP, **{gain.name: gain.default for gain in kind.gains})

    def test_it_describes_itself_in_one_line(self, name):
        assert len((CONTROLLERS[name].__doc__ or "").splitlines()[0]) > 20

    def test_it_asks_for_a_duty_that_is_a_number_in_every_situation(self, name):
        controller = self.make(name)
        for speed in (245.0, 100.0, 20.0, 5.0, 1.0, 0.0):
            for slip in (0.0, 0.1, 0.2, 0.5, 1.0):
                for valid in (True, False):
                    demand = controller.update(seen(slip, speed, valid=valid), PERIOD_S)
                    assert 0.0 <= demand.brake <= 1.0
                    assert all(map(math.isfinite, (demand.torque_nm, demand.switching, *demand.internals)))

    def test_the_same_samples_give_the_same_demands(self, name):
        slips = [0.001 * n % 0.4 for n in range(500)]
        first, second = self.make(name), self.make(name)
        assert [first.update(seen(slip), PERIOD_S) for slip in slips] == [
            second.update(seen(slip), PERIOD_S) for slip in slips
        ]
