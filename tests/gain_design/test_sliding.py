"""What (25) promises, tried on the plant: an ideal loop on a rig that is not the one the law believes in."""

import math
from dataclasses import replace

import numpy as np
import pytest

from inteco_abs.control import BrakingModel, reaching_law_torque
from inteco_abs.gain_design import Box, ParameterRange
from inteco_abs.gain_design.advice import where_lost
from inteco_abs.gain_design.bounds import AtSlip
from inteco_abs.rig import Plant, RigParameters, RigVariation, brake_duty

MASK = RigParameters.named("mask")
REFERENCE = 0.2
PERIOD_S = 0.0005
START_RAD_S, END_RAD_S = 110.0, 12.0


def box(mu):
    return AtSlip(Box(MASK, (ParameterRange("mu", min(mu, 1.0), max(mu, 1.0)),)), REFERENCE)


def needed(at, speed):
    return float(at.bounds(np.array([speed])).mq_25[0])


def slide(mu, gain):
    """Road speeds and slip errors of a stop that begins on the surface, with Mq = gain(road speed) and no Mk."""
    model = BrakingModel(MASK)
    rig = RigVariation(replace(MASK, c31=math.inf), adhesion_scale=mu)
    plant = Plant(rig, (1.0 - REFERENCE) * MASK.r2 / MASK.r1 * START_RAD_S, START_RAD_S)
    rows = []
    while plant.road_speed > END_RAD_S:
        rows.append((plant.road_speed, plant.slip - REFERENCE))
        torque = reaching_law_torque(plant.slip, plant.road_speed, REFERENCE, 0.0, gain(plant.road_speed), model)
        plant.advance(0.0, min(1.0, brake_duty(torque, MASK)), PERIOD_S)
    return rows


def ripple(Mq):
    """Ripple of a sampled law whose plant is pushed by Mq one way and hardly the other."""
    return 2.5 * Mq * PERIOD_S


@pytest.mark.parametrize("mu", [0.9, 1.1])
def test_gain_just_above_eq25_keeps_sliding_down_to_the_end(mu):
    at = box(mu)

    def enough(speed):
        return 1.05 * needed(at, speed)

    for speed, error in slide(mu, enough):
        assert abs(error) < ripple(enough(speed))


@pytest.mark.parametrize("mu", [0.9, 1.1])
def test_gain_just_below_eq25_lets_the_slip_run_away(mu):
    at = box(mu)
    *_, (_, error) = slide(mu, lambda speed: 0.95 * needed(at, speed))
    assert abs(error) > 0.03


@pytest.mark.parametrize("mu", [0.9, 1.1])
@pytest.mark.parametrize("Mq", [1.0, 4.0])
def test_constant_gain_loses_sliding_where_eq25_fails(mu, Mq):
    at = box(mu)
    ((_, predicted),) = where_lost(lambda speeds: Mq - at.bounds(speeds).mq_25, np.linspace(10.0, 180.0, 171))
    lost = next(speed for speed, error in slide(mu, lambda _: Mq) if abs(error) > ripple(Mq))
    assert 0.85 * predicted < lost < predicted + 1.0  # the slip needs time to leave


@pytest.mark.parametrize("mu", [0.9, 1.1])
def test_gain_growing_as_1_over_the_speed_holds_where_a_constant_one_fails(mu):
    def grown(speed):
        return 72.0 / speed

    for speed, error in slide(mu, grown):
        assert abs(error) < ripple(grown(speed))
