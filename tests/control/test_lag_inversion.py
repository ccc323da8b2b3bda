"""`lag_s`: the duty that makes a lagging brake reach the demanded torque within a period."""

import math

import pytest

from inteco_abs.control import CONTROLLERS, Setup
from inteco_abs.rig import RigParameters, brake_torque
from inteco_abs.signals import Estimate

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

MASK = RigParameters.named("mask")
SETUP = Setup(0.2, MASK, 5.0)
PERIOD_S = 0.0005
LAG_S = 0.05
LAWS = sorted(name for name, kind in CONTROLLERS.items() if any(gain.name == "lag_s" for gain in kind.gains))
SLOWLY = [0.201 + 0.0005 * math.sin(0.002 * tick) for tick in range(2000)]


class LaggingBrake:
    def __init__(self, lag_s=LAG_S):
        self.torque_nm = 0.0
        self._left = math.exp(-PERIOD_S / lag_s)

    def move(self, duty):
        settled = brake_torque(duty, MASK)
        self.torque_nm = settled + (self.torque_nm - settled) * self._left


def law(name, **gains):
    kind = CONTROLLERS[name]
    return kind(SETUP, **{**{gain.name: gain.default for gain in kind.gains}, **gains})


def braked(controller, slips, lag_s=LAG_S):
    """Demand and torque of the brake a period later, slip by slip."""
    brake = LaggingBrake(lag_s)
    for slip in slips:
        demand = controller.update(Estimate((1.0 - slip) * 100.0, 100.0, slip, valid=True), PERIOD_S)
        brake.move(demand.brake)
        yield demand, brake.torque_nm


def test_all_laws_of_the_model_have_it():
    assert LAWS == [
        "boundary-layer",
        "constant-rate",
        "exponential-rate",
        "power-rate",
        "reaching-law",
        "super-twisting",
    ]


@pytest.mark.parametrize("name", LAWS)
def test_the_torque_is_there_within_a_period_where_the_brake_can(name):
    moments = list(braked(law(name, lag_s=LAG_S), SLOWLY))
    free = [(demand.torque_nm, torque) for demand, torque in moments if MASK.u0 < demand.brake < 1.0]
    assert len(free) > 1800
    for wanted, torque in free:
        assert torque == pytest.approx(wanted, rel=1e-9)


def test_torque_demands_at_the_limits_give_full_or_no_duty():
    controller = law("reaching-law", lag_s=LAG_S)
    rising = list(braked(controller, [0.1] * 300))
    arrived = next(i for i, (demand, torque) in enumerate(rising) if torque == pytest.approx(demand.torque_nm))
    assert {demand.brake for demand, _ in rising[:arrived]} == {1.0}
    assert len({demand.torque_nm for demand, _ in rising}) == 1
    # a lag towards full brake: 1 - exp(-t/lag) of it
    wanted, full = rising[0][0].torque_nm, brake_torque(1.0, MASK)
    assert arrived * PERIOD_S == pytest.approx(-LAG_S * math.log(1.0 - wanted / full), abs=2 * PERIOD_S)
    assert controller.update(Estimate(10.0, 100.0, 0.9, valid=True), PERIOD_S).brake == 0.0


def test_after_a_release_it_starts_from_the_brakes_torque():
    slips = [*SLOWLY[:200], *[0.9] * 40, *SLOWLY]
    moments = list(braked(law("reaching-law", lag_s=LAG_S), slips))
    assert {demand.brake for demand, _ in moments[200:240]} == {0.0}
    after = [(demand.torque_nm, torque) for demand, torque in moments[240:] if MASK.u0 < demand.brake < 1.0]
    assert len(after) > 1800
    for wanted, torque in after:
        assert torque == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("name", LAWS)
def test_without_it_the_brake_gets_the_torque_itself(name):
    for (demand, _), (ahead, _) in zip(braked(law(name), SLOWLY), braked(law(name, lag_s=LAG_S), SLOWLY), strict=True):
        assert brake_torque(demand.brake, MASK) == pytest.approx(demand.torque_nm, rel=1e-9)
        if name not in {"boundary-layer", "super-twisting"}:  # their integrals rest at the brake's limits
            assert ahead.torque_nm == demand.torque_nm
