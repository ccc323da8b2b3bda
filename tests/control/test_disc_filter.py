"""One wheel between brakings, and what is learnt of a disc that sits off centre."""

import math
import statistics

import pytest

from inteco_abs.control.estimators.eccentricity import (
    ANY_SPEED_SD,
    disc_constants,
    follow,
    restart,
    rolling_wheel,
    straight,
)
from inteco_abs.rig import Encoder, EncoderVariation, RigVariation

COUNT_RAD = 2.0 * math.pi / 2048
PERIOD_S = 0.0005
RUN_UP_RAD_S2 = 60.0
TURN = [n * math.pi / 18.0 for n in range(36)]


DISC = disc_constants(COUNT_RAD, 1.4 * COUNT_RAD)


def fresh():
    return rolling_wheel(DISC)


def off_centre(phase_rad, counts=0.5, jitter=0.3, seed=1):
    disc = EncoderVariation(2048, 0.3, counts, phase_rad, jitter)
    return Encoder(RigVariation(wheel_encoder=disc, seed=seed), wheel=True)


def run_up(disc, encoder, until_rad_s, since_rad_s=0.0):
    """Drive the wheel at one acceleration; true speeds and errors of the filter's."""
    errors = []
    for tick in range(1, round((until_rad_s - since_rad_s) / RUN_UP_RAD_S2 / PERIOD_S) + 1):
        elapsed_s = tick * PERIOD_S
        speed = since_rad_s + RUN_UP_RAD_S2 * elapsed_s
        angle = 0.5 * (since_rad_s + speed) * elapsed_s
        follow(DISC, disc, encoder.read(angle, 0.0) * COUNT_RAD, PERIOD_S)
        errors.append((speed, disc.speed - speed))
    return errors


def wave(disc):
    """What is taken for the disc's, in counts, over a turn."""
    return [(angle - straight(disc, angle)) / COUNT_RAD for angle in TURN]


@pytest.mark.untraced
@pytest.mark.parametrize("phase", [0.0, 2.0, 4.5])
def test_a_disc_off_centre_is_learnt_in_a_run_up(phase):
    disc = fresh()
    run_up(disc, off_centre(phase), 180.0)
    assert wave(disc) == pytest.approx([0.5 * math.sin(angle + phase) for angle in TURN], abs=0.05)


@pytest.mark.untraced
def test_centred_disc_teaches_the_filter_nothing():
    disc = fresh()
    run_up(disc, off_centre(0.0, counts=0.0), 180.0)
    assert wave(disc) == pytest.approx([0.0] * len(TURN), abs=0.05)


def test_nothing_is_learnt_from_slow_turns():
    disc = fresh()
    run_up(disc, off_centre(1.0), 59.0)
    assert set(wave(disc)) == {0.0}
    run_up(disc, off_centre(1.0), 70.0, since_rad_s=59.0)
    assert max(wave(disc)) > 0.0


@pytest.mark.untraced
@pytest.mark.parametrize("phase", [0.0, 2.0])
def test_the_speed_of_a_driven_wheel_has_no_bias_and_little_noise(phase):
    errors = [error for speed, error in run_up(fresh(), off_centre(phase), 180.0) if speed > 80.0]
    assert statistics.fmean(errors) == pytest.approx(0.0, abs=0.02)
    assert max(map(abs, errors)) < 0.3


def test_what_was_learnt_survives_a_restart():
    disc = fresh()
    run_up(disc, off_centre(2.0), 180.0)
    learnt = wave(disc)
    restart(DISC, disc, 1000.0, 20.0, 2.0)
    assert wave(disc) == learnt
    assert disc.angle == straight(disc, 1000.0)
    assert disc.speed == 20.0


@pytest.mark.untraced
def test_the_next_run_up_begins_with_what_was_learnt_and_does_not_spoil_it():
    disc, encoder = fresh(), off_centre(2.0)
    run_up(disc, encoder, 180.0)
    restart(DISC, disc, 0.0, 0.0, ANY_SPEED_SD)
    run_up(disc, encoder, 70.0)
    assert wave(disc) == pytest.approx([0.5 * math.sin(angle + 2.0) for angle in TURN], abs=0.05)


def test_a_speed_that_is_handed_over_is_not_thrown_away_by_a_single_count():
    known, any_speed = fresh(), fresh()
    restart(DISC, known, 0.0, 2.0, 2.0)
    restart(DISC, any_speed, 0.0, 0.0, ANY_SPEED_SD)
    for disc in (known, any_speed):
        follow(DISC, disc, 0.0, 0.0)
        follow(DISC, disc, COUNT_RAD, 0.0001)
    assert known.speed == pytest.approx(2.0, abs=0.1)
    assert any_speed.speed > 10.0


def test_a_stall_a_gap_and_two_readings_at_once_leave_numbers():
    disc, encoder = fresh(), off_centre(0.0)
    run_up(disc, encoder, 100.0)
    angle = disc.angle
    for dt_s in [*[PERIOD_S] * 2000, 0.0, 0.0, 5.0, PERIOD_S, 3600.0, PERIOD_S]:
        follow(DISC, disc, angle, dt_s)
        assert all(map(math.isfinite, (disc.angle, disc.speed, disc.P[0][0], disc.P[1][1], disc.P[0][1])))
        assert min(disc.P[0][0], disc.P[1][1]) >= 0.0
    for _ in range(2000):
        follow(DISC, disc, angle, PERIOD_S)
    assert disc.speed == pytest.approx(0.0, abs=0.1)
