"""The same rigs as scalar plants, one by one, beside a batch. As a script, it compares a few for a part of a stop."""

import random
import sys
from dataclasses import replace

import numpy as np

from inteco_abs.montecarlo import BatchPlant
from inteco_abs.rig import POPULATIONS, DriveMotor, Encoder, EncoderVariation, Plant, RigParameters, RigVariation, draw

TICK_S = 0.0005
STATE = ("wheel_speed", "road_speed", "brake_torque", "wheel_angle", "road_angle", "slip")
DUTIES = (0.0, 0.45, 0.5, 0.55, 0.6, 0.63, 0.66, 0.7, 0.85, 1.0)


class Scalars:
    """Plants and encoders of the rigs of a new batch, behind a loop with the rigs' ticks of delay."""

    def __init__(self, batch, variations, motor=None, **settings):
        starts = zip(variations, batch.wheel_speed, batch.road_speed, strict=True)
        self.plants = [Plant(rig, float(wheel), float(road), motor, **settings) for rig, wheel, road in starts]
        self.encoders = [(Encoder(rig, wheel=True), Encoder(rig, wheel=False)) for rig in variations]
        self._sent = [[(0.0, 0.0)] * rig.command_delay_ticks for rig in variations]

    def advance(self, drives, brakes, duration_s):
        every = np.broadcast_arrays(drives, brakes, [0.0] * len(self.plants))
        for plant, sent, drive, brake in zip(self.plants, self._sent, *every[:2], strict=True):
            sent.append((float(drive), float(brake)))
            plant.advance(*sent.pop(0), duration_s)

    def read_encoders(self):
        pairs = zip(self.plants, self.encoders, strict=True)
        counts = [
            (wheel.read(plant.wheel_angle, plant.wheel_speed), road.read(plant.road_angle, plant.road_speed))
            for plant, (wheel, road) in pairs
        ]
        return np.array(counts).T

    def state(self, name):
        return np.array([getattr(plant, name) for plant in self.plants])


class RandomDuties:
    """Brake duties that change every few ticks, for each rig by itself; reproducible."""

    def __init__(self, rigs, seed, every):
        self._random = random.Random(seed)
        self._brakes = np.zeros(rigs)
        self._every = every

    def at(self, tick):
        for i in range(len(self._brakes)):
            if (tick + i) % self._every == 0:
                self._brakes[i] = self._random.choice(DUTIES)
        return self._brakes.copy()


def assert_same(batch, scalars):
    """Every number, bit for bit."""
    for name in STATE:
        mine, own = getattr(batch, name), scalars.state(name)
        assert mine.tobytes() == own.tobytes(), f"{name}: {mine} is not {own}"


def rigs_of_all_kinds():
    k = RigVariation().parameters
    disc = EncoderVariation(4096, 0.3, 2.0, 1.0, 0.0)
    return [
        RigVariation(),
        RigVariation(RigParameters.named("table"), wheel_encoder=disc),
        RigVariation(replace(k, w4=0.45, p=2.0), adhesion_blend=0.5),
        RigVariation(replace(k, u0=0.3, c31=5.0), brake_duty_offset=-0.1, brake_gain=1.5),
        RigVariation(brake_map="measured", brake_duty_cap=0.6, brake_pwm_steps=4095),
        RigVariation(brake_dead_time_s=0.1, brake_release_delay_s=-0.05, command_delay_ticks=3),
        RigVariation(load_ripple=0.3, load_ripple_phase_rad=2.0, road_encoder=disc),
        RigVariation(adhesion_scale=0.6, grip_step=0.8, grip_step_after_s=0.05),
        RigVariation(
            grip_step=-0.3,
            second_grip_step=0.4,
            second_grip_step_after_s=0.1,
            third_grip_step=-0.5,
            third_grip_step_after_s=0.2,
            adhesion_tilt=0.5,
            drive_residual_nm=0.05,
        ),
        RigVariation(
            brake_release_ratio=3.0,
            brake_hysteresis_nm=0.5,
            brake_fade_per_kj=2.0,
            wheel_wear_per_kj=0.05,
            supply_sag=0.1,
            latch_jitter_s=0.0002,
            wheel_encoder=EncoderVariation(2048, 0.3, 0.5, 1.0, 0.3, 0.4, 2.0, 4.0, 1.0, 0.02),
        ),
        RigVariation(road="ice", later_road="wet-asphalt", later_road_after_s=0.15, adhesion_tilt=-0.3),
    ]


def compare(variations, ticks, every, full_from, road_speed=180.0, look_every=8):
    """Brake batch and scalars together from rolling, at last with all there is; the batch in its last state."""
    batch = BatchPlant(variations, road_speed)
    scalars, duties = Scalars(batch, variations), RandomDuties(len(variations), 1, every)
    for tick in range(ticks):
        brakes = duties.at(tick) if tick < full_from else 1.0
        for rigs in (batch, scalars):
            rigs.advance(0.0, brakes, TICK_S)
        if tick % look_every == 0:
            assert_same(batch, scalars)
            np.testing.assert_array_equal(batch.read_encoders(), scalars.read_encoders())
    assert_same(batch, scalars)
    return batch


REGIMES = [
    # wheel and road speed, duties of drive and brake
    (0.0, 0.0, 0.0, 1.0),
    (0.0, 0.0, 1.0, 0.0),
    (0.0, 0.0, 0.07, 0.0),
    (3.0, 3.0, 0.0, 0.6),
    (-50.0, 80.0, 0.3, 1.0),
    (80.0, -50.0, 0.0, 0.7),
    (-80.0, -50.0, 0.0, 0.7),
    (-50.0, -80.0, 1.0, 0.5),
    (100.0, 0.0, 0.0, 0.0),
    (-100.0, 0.0, 0.0, 0.0),
    (0.0, 100.0, 0.0, 0.0),
    (0.004, 0.004, 0.2, 0.0),
]


def compare_regime(wheel, road, drive, brake, tick_s, ticks):
    """Start batch and scalars anywhere and drive and brake them on and off together."""
    rigs = [RigVariation(), draw("hard", 1), draw("rough", 2), draw("slow", 3)]
    motor = DriveMotor(stall_torque_nm=2.5)
    batch = BatchPlant(rigs, road, wheel, motor)
    scalars = Scalars(batch, rigs, motor)
    for tick in range(ticks):
        on = tick % 40 < 25
        for each in (batch, scalars):
            each.advance(drive if on else 0.0, brake if on else 0.45, tick_s)
        assert_same(batch, scalars)


if __name__ == "__main__":
    part = int(sys.argv[1])
    drawn = [draw(population, 7) for population in POPULATIONS]
    compare([*drawn, *rigs_of_all_kinds()], ticks=130 // part, every=7, full_from=80 // part)
    compare([RigVariation(), drawn[2]], ticks=160, every=7, full_from=10, road_speed=10.0, look_every=50)
    for wheel, road, drive, brake in REGIMES:
        ticks = (28 if abs(wheel) + abs(road) > 1.0 else 6) // part  # from rest the first take hundreds of steps each
        compare_regime(wheel, road, drive, brake, tick_s=0.0021, ticks=ticks)
    sys.exit("the same")
