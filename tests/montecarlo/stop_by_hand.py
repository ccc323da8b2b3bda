"""One stop of one rig as a loop makes it: scalar plant, its encoders, an estimator, a controller."""

from typing import NamedTuple

from inteco_abs.control import MovingAverageSpeed, make_controller, make_estimator
from inteco_abs.rig import Encoder, Plant
from inteco_abs.signals import Command, Sample


class Tick(NamedTuple):
    """Named as in a trace."""

    wheel_speed_rad_s: float
    road_speed_rad_s: float
    slip: float
    slip_estimated: float
    brake_torque_nm: float
    road_angle_rad: float
    brake: float


class Loop:
    """Output first: what a tick decides is at the terminals `command_delay_ticks` later, reported one later."""

    def __init__(self, rig, config, rolling_from):
        ratio = rig.parameters.r2 / rig.parameters.r1
        self.plant = Plant(rig, ratio * rolling_from, rolling_from)
        self._encoders = Encoder(rig, wheel=True), Encoder(rig, wheel=False)
        self._period_ns = config.period_ns
        self._under_way = [Command.SAFE] * rig.command_delay_ticks
        self._number = 0
        self.written = Command.SAFE

    def sample(self):
        plant, (wheel, road) = self.plant, self._encoders
        counts = wheel.read(plant.wheel_angle, plant.wheel_speed), road.read(plant.road_angle, plant.road_speed)
        return Sample(self._number, self._number * self._period_ns, self._period_ns / 1e9, *counts)

    def go_on(self, command):
        self.written = command
        self._under_way.append(command)
        self.plant.advance(*self._under_way.pop(0), self._period_ns / 1e9)
        self._number += 1


def stop_by_hand(rig, config, run_up_from_rad_s=165.0):
    """Ticks from the first of braking to the first below 0.5 rad/s, and how many decisions were taken in all."""
    start = config.experiment.start_speed_rad_s
    loop = Loop(rig, config, start if run_up_from_rad_s is None else run_up_from_rad_s)
    plant = loop.plant
    estimator, controller, window = make_estimator(config), make_controller(config), MovingAverageSpeed(2048, 40)
    ticks, braking, decisions = [], run_up_from_rad_s is None, 0
    while plant.road_speed >= 0.5:
        sample = loop.sample()
        estimate = estimator.update(sample, loop.written)
        decisions += 1
        if braking:
            command = Command(0.0, controller.update(estimate, sample.dt_s).brake)
        elif sample.tick and window.update(sample.time_ns, sample.road_count) >= start and sample.tick >= 40:
            command, braking = Command.SAFE, True
        else:
            command = Command(config.experiment.drive_duty, 0.0)
        if braking:
            ticks.append(_tick(plant, estimate.slip, command.brake))
        loop.go_on(command)
    ticks.append(_tick(plant, ticks[-1].slip_estimated, ticks[-1].brake))
    return ticks, decisions


def _tick(plant, slip_estimated, brake):
    return Tick(
        plant.wheel_speed,
        plant.road_speed,
        plant.slip,
        slip_estimated,
        plant.brake_torque,
        plant.road_angle,
        brake,
    )
