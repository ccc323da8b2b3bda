"""A stop in an ensemble is the stop of the scalar plant with the same estimator and controller, tick by tick."""

import numpy as np
import pytest
from stop_by_hand import Tick, stop_by_hand

from inteco_abs.config import load_config
from inteco_abs.control import control_check
from inteco_abs.ensembles import run_stops
from inteco_abs.rig import draw

HELD = 40
"""Ticks of the run-up within which the start speed cannot be known."""


def configured(*settings):
    return load_config(settings=settings, checks=[control_check()])


def assert_same(trace, ticks):
    """To the last digit: the compiled plant, the counts it gives, and what is decided on them."""
    by_hand = Tick(*np.array(ticks).T)
    angle = by_hand.road_angle - by_hand.road_angle[0]
    columns = by_hand._replace(road_angle=angle)
    for name, expected in zip(Tick._fields, columns, strict=True):
        found = getattr(trace, {"wheel_speed": "wheel_speed_rad_s", "road_speed": "road_speed_rad_s"}.get(name, name), None)
        found = {"brake_torque": trace.brake_torque_nm, "road_angle": trace.road_angle_rad}.get(name, found)
        np.testing.assert_array_equal(found, expected, err_msg=name)


@pytest.mark.parametrize("run_up", [165.0, None])
@pytest.mark.parametrize(
    ("population", "settings"),
    [
        ("hard", ("controller.name=boundary-layer", "estimator.name=kalman")),
        ("rough", ("controller.name=smith-relay", "estimator.name=euler", "experiment.drive_duty=0.9")),
        ("nominal", ("controller.gains.Mk=10", "controller.gains.Mq=4")),
    ],
)
def test_whole_stops_are_those_of_the_scalar_plant_tick_by_tick(population, settings, run_up):
    config, rigs = configured(*settings), [draw(population, seed) for seed in (7, 8)]
    stops = run_stops(rigs, config, run_up_from_rad_s=run_up, traced=[0, 1])
    by_hand = [stop_by_hand(rig, config, run_up) for rig in rigs]
    assert stops.ticks == sum(decisions for _, decisions in by_hand)
    for place, (ticks, _) in enumerate(by_hand):
        assert_same(stops.traces[place], ticks)
