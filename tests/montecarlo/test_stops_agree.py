"""A stop in an ensemble is the stop of the scalar plant with the same estimator and controller, tick by tick."""

import numpy as np
import pytest
from stop_by_hand import Tick, stop_by_hand

from inteco_abs.config import load_config
from inteco_abs.control import control_check
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.montecarlo import run_stops
from inteco_abs.rig import RigVariation, draw
from inteco_abs.sessions import read_session
from inteco_abs.signals import Phase

FORMULA = "controller.reference_formula=0.2 + 0.1*sin(9*t)*exp(-t) - step(t, 0.1)*min(0.1, speed/900)"
pytestmark = pytest.mark.untraced  # other tests reach these lines, too


def configured(*settings):
    return load_config(settings=settings, checks=[control_check()])


def assert_same(trace, ticks):
    """To the last digit: the compiled plant, what its encoders count, and what is decided on that."""
    columns = Tick(*np.array(ticks).T)
    columns = columns._replace(road_angle_rad=columns.road_angle_rad - columns.road_angle_rad[0])
    for name, expected in columns._asdict().items():
        np.testing.assert_array_equal(getattr(trace, name), expected, err_msg=name)


@pytest.mark.parametrize("run_up", [165.0, None])
@pytest.mark.parametrize(
    ("population", "settings"),
    [
        ("hard", ("controller.name=boundary-layer", "estimator.name=kalman", FORMULA)),
        pytest.param(
            "rough",
            ("controller.name=smith-relay", "estimator.name=euler", "experiment.drive_duty=0.9"),
            marks=pytest.mark.long,
        ),
        pytest.param(
            "nominal",
            (
                "controller.gains.Mk=10",
                "controller.reference_points=[0.3, 0.1]",
                "controller.reference_at_rad_s=[20, 90]",
            ),
            marks=pytest.mark.long,
        ),
    ],
)
def test_whole_stops_are_those_of_the_scalar_plant_tick_by_tick(population, settings, run_up):
    config, rigs = configured(*settings), [draw(population, seed) for seed in (7, 8)]
    stops = run_stops(rigs, config, run_up_from_rad_s=run_up, traced=[0, 1])
    by_hand = [stop_by_hand(rig, config, run_up) for rig in rigs]
    assert stops.ticks == sum(decisions for _, decisions in by_hand)
    for place, (ticks, _) in enumerate(by_hand):
        assert_same(stops.traces[place], ticks)


def test_a_command_acts_at_the_same_instant_as_on_the_whole_stack(tmp_path):
    config = configured("controller.name=steps", "experiment.start_speed_rad_s=20", "experiment.hold_s=0.0")
    session = tmp_path / "stop.mcap"
    run_stop(config, Plan(session))
    recorded = read_session(session)
    braking = recorded.ticks["phase"] == Phase.BRAKING
    on_stack = recorded.ticks["brake"][braking], recorded.truth["brake_torque_nm"][: len(braking)][braking]
    trace = run_stops([RigVariation(command_delay_ticks=1)], config, run_up_from_rad_s=10.0, traced=[0]).traces[0]
    # the drive ends with what is decided at 0, the brake begins with what is decided at 1 and written at 2
    assert (first(trace.brake), first(trace.brake_torque_nm)) == tuple(map(first, on_stack)) == (1, 3)


def first(values):
    return int(np.flatnonzero(values)[0])
