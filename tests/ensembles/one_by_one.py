"""The same rigs as scalar plants, one by one, beside a batch. Run as a script, it compares a few for a short stop."""

import random
import sys

import numpy as np

from inteco_abs.ensembles import BatchPlant
from inteco_abs.rig import POPULATIONS, Encoder, Plant, draw

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
        counts = [(wheel.read(plant.wheel_angle), road.read(plant.road_angle)) for plant, (wheel, road) in pairs]
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
    """Every number within 1e-9: relative, and below 1 rad, rad/s or N m absolute."""
    for name in STATE:
        np.testing.assert_allclose(getattr(batch, name), scalars.state(name), rtol=1e-9, atol=1e-9, err_msg=name)


def compare(variations, ticks, every, full_from=2400, look_every=8):
    """Brake batch and scalars together from 180 rad/s, at last with all there is; the batch in its last state."""
    batch = BatchPlant(variations)
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


if __name__ == "__main__":
    compare([draw(population, 7) for population in POPULATIONS], ticks=1200, every=7, full_from=300, look_every=50)
    sys.exit("the same")
