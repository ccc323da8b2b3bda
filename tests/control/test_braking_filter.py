"""What the observer learns of a rig while it brakes: on rigs that are known, without noise, with its own controller."""

import math
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from inteco_abs.control import PredictiveReaching, Setup
from inteco_abs.control.estimators.braking_ekf import EkfConstants, EkfState, EkfTuning, correct, predict
from inteco_abs.control.estimators.prediction import DelayLine, ahead, outlook
from inteco_abs.control.wheel_dynamics import WheelDynamics
from inteco_abs.rig import MEASURED_MAP, AdhesionCurve, EncoderVariation, RigParameters, RigVariation, adhesion
from inteco_abs.signals import Command, Estimate

MASK = RigParameters.named("mask")
LEARNT_S = 0.3
COUNT_RAD = 2.0 * math.pi / 2048
PERIOD_S = 0.0005


class Moment(NamedTuple):
    """The truth at a sample, and what was made of it."""

    time_s: float
    wheel_speed: float
    road_speed: float
    slip: float
    brake_torque: float
    estimate: Estimate
    covariance: np.ndarray

    @property
    def outlook(self):
        return self.estimate.outlook


def quiet(lag_s=0.05, **variation):
    """The published rig with a measured brake that lags, and ideal encoders."""
    disc = EncoderVariation(2048)
    plain = {"brake_map": "measured", "brake_dead_time_s": 0.01, "wheel_encoder": disc, "road_encoder": disc}
    return RigVariation(replace(MASK, c31=1.0 / lag_s), **{**plain, **variation})


@pytest.fixture(scope="module")
def stop(rolling):
    """Moments of a stop from 180 rad/s until the road is slow."""

    @cache
    def brake(rig):
        run = rolling(rig, 180.0)
        gains = {gain.name: gain.default for gain in PredictiveReaching.gains}
        law = PredictiveReaching(Setup(0.2, MASK, 5.0), **gains)
        for _ in range(400):
            run.tick()
        moments = []
        while run.plant.road_speed > 8.0:
            plant = run.plant
            truth = plant.wheel_speed, plant.road_speed, plant.slip, plant.brake_torque
            estimate = run.tick(lambda seen: Command(0.0, law.update(seen, PERIOD_S).brake))
            covariance = np.array(run.observer.ekf.P)
            moments.append(Moment(len(moments) * PERIOD_S, *truth, estimate, covariance))
        return moments

    return brake


def learnt(moments, since_s=LEARNT_S):
    return [moment for moment in moments if moment.time_s >= since_s]


BRAKES = [(0.006, 0.040), (0.010, 0.050), (0.015, 0.060)]


@pytest.mark.untraced
@pytest.mark.parametrize(("dead_time_s", "lag_s"), BRAKES)
def test_dead_time_and_lag_of_a_brake_with_the_measured_map_are_found(stop, dead_time_s, lag_s):
    for moment in learnt(stop(quiet(lag_s, brake_dead_time_s=dead_time_s))):
        outlook = moment.outlook
        assert outlook.brake_dead_time_s == pytest.approx(dead_time_s, abs=0.0015)
        assert outlook.brake_lag_s == pytest.approx(lag_s, abs=0.0025)
        assert outlook.brake_dead_time_s + outlook.brake_lag_s == pytest.approx(dead_time_s + lag_s, abs=0.003)
        assert outlook.excess_torque_nm == pytest.approx(0.0, abs=0.05)


OWN = [
    {"adhesion_scale": 0.9, "brake_gain": 1.04, "brake_duty_offset": 0.015},
    {"adhesion_scale": 1.1, "brake_gain": 0.96, "brake_duty_offset": -0.015},
    {"adhesion_scale": 0.95, "adhesion_blend": 0.5},
]


@pytest.mark.untraced
@pytest.mark.parametrize("variation", OWN)
def test_the_adhesion_of_the_slip_that_is_held_is_found(stop, variation):
    surface = AdhesionCurve(variation["adhesion_scale"], variation.get("adhesion_blend", 0.0))
    factor = surface.adhesion(0.2, MASK) / adhesion(0.2, MASK)
    for moment in learnt(stop(quiet(**variation))):
        assert moment.outlook.adhesion_factor == pytest.approx(factor, rel=0.02)


@pytest.mark.untraced
@pytest.mark.parametrize("variation", OWN)
def test_the_prediction_is_right_when_the_next_command_acts(stop, variation):
    moments = stop(quiet(**variation))
    for moment in learnt(moments):
        outlook = moment.outlook
        then = round(moment.time_s / PERIOD_S) + int(outlook.brake_dead_time_s / PERIOD_S) + 1
        if then < len(moments):
            truth = moments[then]
            torque = outlook.lagged_torque_nm + outlook.excess_torque_nm
            assert torque == pytest.approx(truth.brake_torque, abs=0.08)
            assert outlook.wheel_speed_rad_s == pytest.approx(truth.wheel_speed, abs=0.3)
            assert outlook.road_speed_rad_s == pytest.approx(truth.road_speed, abs=0.15)


@pytest.mark.untraced
@pytest.mark.parametrize("variation", OWN)
def test_the_slip_is_known_to_a_thousandth_and_held(stop, variation):
    moments = [moment for moment in learnt(stop(quiet(**variation))) if moment.road_speed > 20.0]
    errors = [moment.estimate.slip - moment.slip for moment in moments]
    assert math.sqrt(np.mean(np.square(errors))) < 0.001
    assert math.sqrt(np.mean([(moment.slip - 0.2) ** 2 for moment in moments])) < 0.001


@pytest.mark.untraced
@pytest.mark.parametrize("phase", [1.0, *(pytest.param(phase, marks=pytest.mark.long) for phase in (0.0, 3.0))])
def test_a_ripple_of_the_load_over_a_turn_is_found_bit_by_bit(stop, phase):
    moments = stop(quiet(load_ripple=0.03, load_ripple_phase_rad=phase))
    parts = [(moment.outlook.ripple_cosine, moment.outlook.ripple_sine) for moment in moments]
    amplitudes = [math.hypot(*part) for part in parts]
    assert amplitudes[0] < 1e-4
    assert amplitudes[1000] > 0.010
    assert 0.016 < amplitudes[2000] < 0.03
    for cosine, sine in parts[1000:]:
        assert math.remainder(math.atan2(cosine, sine) - phase, math.tau) == pytest.approx(0.0, abs=0.25)


@pytest.mark.untraced
@pytest.mark.parametrize("step", [-0.15, 0.15])
def test_a_step_of_the_roads_grip_is_followed_within_20_ms(stop, step):
    moments = stop(quiet(grip_step=step, grip_step_after_s=0.5))
    begun_s = 0.5 + next(moment.time_s for moment in moments if moment.brake_torque > 0.0) - 0.01
    for moment in moments:
        if begun_s - 0.1 < moment.time_s < begun_s - 0.005:
            assert moment.outlook.adhesion_factor == pytest.approx(1.0, abs=0.03)
        elif begun_s + 0.020 < moment.time_s < begun_s + 0.3:
            assert moment.outlook.adhesion_factor == pytest.approx(1.0 + step, abs=0.05)
    after = [moment.slip for moment in moments if begun_s < moment.time_s < begun_s + 0.3]
    assert max(abs(slip - 0.2) for slip in after) < 0.05


@pytest.mark.untraced
@pytest.mark.parametrize("variation", [*OWN, {"grip_step": -0.2, "grip_step_after_s": 0.4, "load_ripple": 0.02}])
def test_the_covariance_is_one_all_along_a_stop(stop, variation):
    for moment in stop(quiet(**variation))[::25]:
        covariance = moment.covariance[:11, :11]  # releasing is taken to be as quick as rising
        deviations = np.sqrt(np.diag(covariance))
        correlations = covariance / np.outer(deviations, deviations)
        assert np.abs(correlations - correlations.T).max() < 1e-9
        assert np.linalg.eigvalsh(correlations).min() > -1e-9


# one step of it


STATES = {
    # state: value, step, and what the filter neglects of what it moves
    "wheel angle": (1.0, 1e-3, 0.004),  # the ripple's turn within a step
    "wheel speed": (130.0, 1e-3, 0.0),
    "road angle": (2.0, 1e-3, 0.0),
    "road speed": (164.0, 1e-3, 0.0),
    "torque": (7.0, 1e-3, 0.0),  # above what the commands ask for: the brake releases
    "excess torque": (0.2, 1e-3, 0.0),
    "adhesion factor": (0.95, 1e-4, 0.0),
    "cosine": (0.01, 1e-4, 0.0),
    "sine": (-0.005, 1e-4, 0.0),
    "dead time": (0.0102, 1e-6, 0.035),  # both move the wheels only by the torque after the step
    "lag": (0.05, 1e-5, 0.01),
    "lag's factor in releasing": (1.3, 1e-4, 0.01),
}
START, STEPS, NEGLECTED = map(np.array, zip(*STATES.values(), strict=True))


CONTACT = WheelDynamics(MASK)


def under_way():
    """Commands of rising duty."""
    pending = DelayLine(PERIOD_S, 0.03)
    for tick in range(60):
        pending.tell(MEASURED_MAP.torque(0.5 + 0.005 * tick), 1)
    return pending


def anywhere(state, covariance, jitter_s=0.0):
    """Constants, a filter in any state, and commands under way."""
    pending = under_way()
    tuning = EkfTuning()
    noise = (tuning.count_noise * COUNT_RAD) ** 2
    k = EkfConstants(CONTACT, pending.k, tuning, MASK.r1 / MASK.r2, noise, jitter_s**2)
    return k, EkfState(state.tolist(), covariance.tolist()), pending


def predicted(state, covariance):
    """States and covariance one step of 0.5 ms later."""
    k, rig, pending = anywhere(state, covariance)
    predict(k, rig, pending, PERIOD_S, 0)
    return np.array(rig.x), np.array(rig.P)


@pytest.mark.parametrize("column", range(12), ids=STATES.keys())
def test_uncertainty_is_carried_along_as_the_states_are(column):
    size = 1e6  # next to which the noise that is added is nothing
    one = np.eye(12)[column]
    covariance = predicted(START, np.outer(one, one) * size**2)[1]
    ends = [predicted(START + way * STEPS * one, np.zeros((12, 12)))[0] for way in (1.0, -1.0)]
    moved = (ends[0] - ends[1]) / (2.0 * STEPS[column])
    strongest = int(np.argmax(np.abs(moved)))
    carried = covariance[strongest] / math.sqrt(covariance[strongest, strongest]) / size
    tolerance = 1e-3 * np.abs(moved[[1, 3, 4, 5]]).max() + NEGLECTED[column] + 1e-9
    assert math.copysign(1.0, moved[strongest]) * carried == pytest.approx(moved, rel=0.02, abs=tolerance)


@pytest.mark.parametrize("jitter_s", [0.0, 0.0001])
def test_both_angles_correct_the_states_as_one_measurement(jitter_s):
    random = np.random.default_rng(1)
    root = random.normal(size=(12, 12)) * np.abs(START)[:, None] * 1e-3
    covariance, measured = root @ root.T, START[[0, 2]] + [0.002, -0.001]
    seen = np.eye(12)[[0, 2]]
    noise = (EkfTuning().count_noise * COUNT_RAD) ** 2 * np.eye(2)
    noise += jitter_s**2 * np.outer(START[[1, 3]], START[[1, 3]])
    gain = covariance @ seen.T @ np.linalg.inv(seen @ covariance @ seen.T + noise)
    k, rig, _ = anywhere(START, covariance, jitter_s)
    assert correct(k, rig, *measured)
    assert rig.x == pytest.approx(START + gain @ (measured - START[[0, 2]]), rel=1e-9)
    assert np.array(rig.P) == pytest.approx(covariance - gain @ seen @ covariance, rel=1e-6, abs=1e-15)


def test_looking_ahead_is_a_straight_line_through_the_middle_of_the_ripple():
    state = START * [1, 1, 1, 1, 1, 0, 1, 0, 0, 1, 1, 1] + [0, 0, 0, 0, 0, 0, 0, 0.03, 0.02, 0, 0, 0]
    pending, step_s = under_way(), 1e-5
    expected = outlook(CONTACT, pending.k, pending, state.tolist(), 1.0, 1.0)
    angle, wheel, _, road = state[:4]
    horizon_s, _, mean_nm = ahead(pending.k, pending, *state[[4, 9, 10, 11]])
    for _ in range(round(horizon_s / step_s)):
        scale = state[6] + 0.03 * math.cos(angle) + 0.02 * math.sin(angle)
        mu = scale * adhesion(1.0 - MASK.r1 * wheel / (MASK.r2 * road), MASK)
        moving = CONTACT.accelerations(wheel, road, mean_nm, mu)
        angle, wheel, road = angle + step_s * wheel, wheel + step_s * moving.wheel, road + step_s * moving.road
    assert expected.wheel_speed_rad_s == pytest.approx(wheel, abs=0.02)
    assert expected.road_speed_rad_s == pytest.approx(road, abs=0.006)
    assert expected.wheel_angle_rad == pytest.approx(angle, abs=0.0003)
