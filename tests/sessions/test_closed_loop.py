from dataclasses import replace

import numpy as np
import pytest

from inteco_abs.analysis.closed_loop import continued
from inteco_abs.analysis.open_loop import alternative, braking_start
from inteco_abs.control import CONTROLLERS
from inteco_abs.errors import SessionError
from inteco_abs.sessions import session_config
from inteco_abs.signals import BrakeDemand, Phase

pytestmark = pytest.mark.untraced  # other tests reach these lines, too


def gone_on(session, *settings, at_s=0.0, controllers=CONTROLLERS):
    other = alternative(session, settings, controllers)
    return continued(session, session_config(session, ()), other, controllers, at_s)


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param((), id="published"),
        pytest.param(("simulation.rig=hard:17",), id="drawn", marks=pytest.mark.untraced),
        pytest.param(
            ("simulation.rig=rough:4", "controller.name=boundary-layer", "estimator.name=kalman"),
            id="rough",
            marks=[pytest.mark.untraced, pytest.mark.long],
        ),
        pytest.param(("experiment.stops=2",), id="stops", marks=[pytest.mark.untraced, pytest.mark.long]),
    ],
)
def test_with_its_own_controller_a_virtual_run_continues_to_the_last_bit(run, settings):
    session = run(*settings, seed=3).session
    for at_s in (-0.1, 0.05):
        found = gone_on(session, at_s=at_s)
        assert (len(found.ticks), found.state_from) == (len(session.ticks), "truth")
        for name in session.ticks.dtype.names:
            assert np.array_equal(found.ticks[name], session.ticks[name], equal_nan=name == "slip_reference"), name
        assert set(found.distance.values()) == {0.0}


def test_another_controller_decides_from_then_on_and_the_rig_reacts(quick):
    session = quick.session
    found = gone_on(session, "controller.name=relay", at_s=0.05)
    row = braking_start(session)[0] + 100
    assert found.row == row
    assert np.array_equal(found.ticks["brake"][:row], session.ticks["brake"][:row])
    assert found.ticks["brake"][row] == 1.0
    assert np.array_equal(found.ticks["wheel_count"][: row + 1], session.ticks["wheel_count"][: row + 1])
    until = min(len(found.ticks), len(session.ticks))
    assert (found.ticks["wheel_count"][row + 1 : until] != session.ticks["wheel_count"][row + 1 : until]).any()
    assert found.ticks["phase"][-1] == Phase.DONE
    assert found.card["stop_time_s"] != quick.stop.card["stop_time_s"]


def test_a_command_comes_through_one_tick_after_its_sample(quick):
    found = gone_on(quick.session, "controller.name=relay", at_s=0.05)
    times = found.ticks["time_ns"][found.row + 1 :].tolist()
    first = found.truth[found.truth["time_ns"] == times[0]]
    assert first["brake"].tolist() == [1.0]


def as_if_real(session):
    """The session as a real rig would have left it: no truth."""
    rig = {**session.metadata["rig"], "simulated": "false"}
    return replace(session.with_rows(truth=session.truth[:0]), metadata={**session.metadata, "rig": rig})


def test_a_real_run_continues_from_its_estimates_on_the_published_rig(run):
    session = as_if_real(run("simulation.rig=hard:17", "controller.name=boundary-layer").session)
    found = gone_on(session)
    assert (found.state_from, found.rig) == ("estimates", "mask")
    row = found.row
    assert found.truth["road_speed_rad_s"][0] == pytest.approx(session.ticks["road_speed_rad_s"][row], rel=0.01)
    steps = np.abs(np.diff(found.ticks["road_count"][row - 5 : row + 6]))
    assert steps.max() <= 5  # the counts go on where they were
    assert found.ticks["phase"][-1] == Phase.DONE
    assert found.card["slip_rms_true"] is None


@pytest.mark.parametrize("at_s", [-9.0, 9.0])
def test_a_time_at_which_nothing_ran_is_reported_with_what_can_be_chosen(quick, at_s):
    with pytest.raises(SessionError, match=r"choose a time in -\d+\.\d+\.\.\d+\.\d+ s"):
        gone_on(quick.session, at_s=at_s)


class Refusing:
    gains = ()
    internals = ()

    def __init__(self, _setup) -> None:
        self.calls = 0

    def update(self, _estimate, _dt_s):
        self.calls += 1
        if self.calls == 150:
            raise ArithmeticError("enough")
        return BrakeDemand(0.6)


def test_a_controller_that_raises_in_simulation_is_reported(quick):
    controllers = {**CONTROLLERS, "refusing": Refusing}
    with pytest.raises(SessionError, match="in simulation, it raised ArithmeticError: enough"):
        gone_on(quick.session, "controller.name=refusing", controllers=controllers)
