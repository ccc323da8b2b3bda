import math

import numpy as np
import pytest

from inteco_abs.analysis.open_loop import COMPARED, alternative, braking_start, what_if
from inteco_abs.config import load_config
from inteco_abs.control import CONTROLLERS
from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.sessions import read_session
from inteco_abs.signals import BrakeDemand, Phase


def asked(session, *settings, controllers=CONTROLLERS, **options):
    return what_if(session, alternative(session, settings, controllers), controllers, **options)


def of(found, field):
    return next(each for each in found.divergences if each.field == field)


def as_logged(session, found):
    return all(np.array_equal(found.requests[name], session.ticks[name], equal_nan=True) for name in COMPARED)


@pytest.mark.parametrize(
    "settings",
    [
        ("controller.name=boundary-layer", "estimator.name=kalman"),
        ("controller.name=boundary-layer", "experiment.stops=2"),
        ("controller.name=predictive-reaching", "estimator.name=observer"),
        ("simulation.rig=hard:17",),
    ],
    ids=["states", "stops", "observer", "drawn"],
)
def test_what_the_run_itself_had_is_the_log_to_the_last_bit(run, settings):
    session = run(*settings).session
    found = asked(session)
    assert as_logged(session, found)
    assert (found.horizon_s, of(found, "brake_request").largest) == (None, 0.0)


def test_other_gains_leave_the_log_where_the_controller_is_first_asked(quick):
    session = quick.session
    found = asked(session, "controller.gains.Mk=20.0")
    first = braking_start(session)[0] + 1
    assert (of(found, "torque_demand_nm").tick, found.horizon_s) == (first, pytest.approx(0.0005))
    assert of(found, "slip").largest == 0.0
    assert np.array_equal(found.requests["brake_request"][:first], session.ticks["brake_request"][:first])
    assert of(found, "brake_request").rms["BRAKING"] > of(found, "brake_request").rms["SPIN_UP"] == 0.0


def test_the_difference_is_what_the_law_makes_of_it(quick):
    """s' = -Mk*s: with 1/s more of Mk, the torque is s/g more."""
    session = quick.session
    found = asked(session, "controller.gains.Mk=3.0")
    row = braking_start(session)[0] + 1
    logged = session.ticks[row]
    expected = logged["torque_demand_nm"] - logged["switching"] / logged["c1"]
    assert found.requests["torque_demand_nm"][row] == pytest.approx(expected, rel=1e-12)
    assert of(found, "torque_demand_nm").largest == pytest.approx(
        np.abs(found.requests["torque_demand_nm"] - session.ticks["torque_demand_nm"]).max()
    )


@pytest.mark.parametrize("at_s", [9.0, math.inf])
def test_a_switch_behind_the_end_asks_nothing_and_is_refused(quick, at_s):
    with pytest.raises(SessionError, match=r"the run was over; choose at most \d+\.\d{3} s"):
        asked(quick.session, "controller.name=relay", at_s=at_s)


@pytest.mark.parametrize("section", ["controller", "estimator", "model"])
def test_a_section_is_not_a_key(quick, section):
    with pytest.raises(ConfigError, match=f"{section}: 5: is a section; name a key in it"):
        alternative(quick.session, [f"{section}=5"], CONTROLLERS)


@pytest.mark.parametrize("at_s", [-0.1, 0.0, 0.05])
def test_before_the_switch_it_is_the_log(quick, at_s):
    session = quick.session
    found = asked(session, "controller.name=relay", at_s=at_s)
    start = braking_start(session)[0] + round(at_s * 2000)
    for name in COMPARED:
        assert np.array_equal(found.requests[name][:start], session.ticks[name][:start])
    always = asked(session, "controller.name=relay")
    assert np.array_equal(found.requests[start:], always.requests[start:])
    assert found.horizon_s == pytest.approx(max(at_s, 0.0005))


def test_the_horizon_is_where_the_threshold_is_passed(quick):
    session = quick.session
    apart = np.abs(
        asked(session, "controller.gains.Mk=3.0").requests["torque_demand_nm"] - session.ticks["torque_demand_nm"]
    )
    most = float(apart.max())
    near = asked(session, "controller.gains.Mk=3.0", duty=math.inf, torque_nm=0.99 * most)
    assert of(near, "torque_demand_nm").tick == int(np.flatnonzero(apart > 0.99 * most)[0])
    assert asked(session, "controller.gains.Mk=3.0", duty=math.inf, torque_nm=most).horizon_s is None


def test_the_root_of_the_mean_square_is_that_of_each_phase(quick):
    session = quick.session
    found = asked(session, "estimator.name=euler")
    apart = found.requests["slip"] - session.ticks["slip"]
    rms = of(found, "slip").rms
    assert list(rms) == ["SPIN_UP", "BRAKING", "STOPPED"]
    for phase, value in rms.items():
        rows = session.ticks["phase"] == Phase[phase]
        assert value == pytest.approx(math.sqrt(np.mean(apart[rows] ** 2)))


def test_a_sample_that_the_run_did_not_believe_changes_nothing(quick, retouched):
    session = quick.session
    row = braking_start(session)[0] + 40
    found = asked(retouched(session, row, board_flags=1), "controller.gains.Mk=3.0")
    assert found.requests[row] == found.requests[row - 1]


class Refusing:
    """Controller that raises at its tenth update."""

    gains = ()
    internals = ()

    def __init__(self, _setup) -> None:
        self.calls = 0

    def update(self, _estimate, _dt_s):
        self.calls += 1
        if self.calls == 10:
            raise ArithmeticError("enough")
        return BrakeDemand(1 if self.calls < 5 else math.nan)


def test_a_controller_that_raises_is_reported_with_the_tick(quick):
    session = quick.session
    tick = braking_start(session)[0] + 10
    with pytest.raises(SessionError, match=rf"asked at tick {tick}, it raised ArithmeticError: enough"):
        asked(session, "controller.name=refusing", controllers={**CONTROLLERS, "refusing": Refusing})


def test_a_run_that_never_braked_is_refused(run):
    session = run("experiment.spin_up_timeout_s=0.1").session
    with pytest.raises(SessionError, match="ended before braking"):
        asked(session, "controller.name=relay")


def test_another_controller_has_its_own_gains_and_the_estimator_that_it_needs(quick):
    session = read_session(quick.path)
    assert alternative(session, ["controller.name=relay"], CONTROLLERS).controller.gains == {}
    assert alternative(session, ["controller.name=predictive-reaching"], CONTROLLERS).estimator.name == "observer"
    kept = alternative(session, ["controller.gains.Mk=3.0", "estimator.name=kalman"], CONTROLLERS)
    assert (kept.controller.name, kept.controller.gains, kept.estimator.name) == ("reaching-law", {"Mk": 3.0}, "kalman")
    both = alternative(session, ["controller.name=constant-rate", "controller.gains.Mq=3.0"], CONTROLLERS)
    assert both.controller.gains == {"Mq": 3.0}


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["loop.rate_hz=1000.0"], "loop: cannot be changed here"),
        (["controller.gains.Mx=1.0"], "controller.gains.Mx: unknown gain"),
        (["controller.gains.Mk=-1.0"], r"must be a number in 0\.\.1000"),
        (["controller.name=rely"], "no controller 'rely'; did you mean relay"),
        (["Mk"], "must look like"),
    ],
)
def test_a_setting_that_cannot_be_varied_is_reported(quick, settings, words):
    with pytest.raises(ConfigError, match=words):
        alternative(quick.session, settings, CONTROLLERS)


def test_the_sessions_own_settings_stay(run):
    session = run("guard.brake_limit=0.6", "controller.reference_slip=0.15").session
    config = alternative(session, ["controller.gains.Mk=3.0"], CONTROLLERS)
    assert (config.guard.brake_limit, config.controller.reference_slip) == (0.6, 0.15)
    assert config.board == load_config().board
