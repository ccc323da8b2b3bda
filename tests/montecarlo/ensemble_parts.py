"""Parts for ensembles that other processes can find: makers, estimators and controllers."""

import math
from dataclasses import dataclass

import numpy as np

from inteco_abs.control import advance_and_admit
from inteco_abs.montecarlo import ConfiguredPolicy, IdealPolicy
from inteco_abs.signals import BrakeDemand, Command, Estimate, Sample


class Constant:
    """Brakes with one duty at any slip."""

    gains = ()
    internals = ()

    def __init__(self, _setup=None, duty=0.7):
        self.duty = duty

    def update(self, _estimate, _dt_s):
        return BrakeDemand(self.duty)


class CommandLog:
    """Estimator that logs the commands it gets, with the number of the sample."""

    def __init__(self, log):
        self.log = log

    def update(self, sample, command=Command.SAFE):
        self.log.append((sample.tick, command))
        return Estimate(0.0, 0.0, 0.0, valid=True)


class Counting:
    """Brakes with a little more at each tick."""

    def __init__(self):
        self.ticks = 0

    def update(self, _estimate, _dt_s):
        self.ticks += 1
        return BrakeDemand(0.5 + 1e-4 * self.ticks)


class LockedAt:
    """Oracle that holds the brake's true torque near a value."""

    def __init__(self, state, torque_nm):
        self.state, self.torque_nm = state, torque_nm

    def update(self, _estimate, _dt_s):
        return BrakeDemand(1.0 if self.state.brake_torque < self.torque_nm else 0.0)


def torque_oracle(variation, state):
    """Knows of each rig what it is and what it does."""
    return IdealPolicy(state), LockedAt(state, 2.0 * variation.adhesion_scale)


@dataclass(frozen=True)
class OneDuty:
    """PolicyFactory of controllers that ask for nothing else."""

    duty: object

    def __call__(self, _variation, state):
        return IdealPolicy(state), Constant(duty=self.duty)


def failing(variation, state):
    """A controller that fails on one rig of three."""

    class Failing(Constant):
        def update(self, estimate, dt_s):
            if variation.seed == 1 and state.road_speed < 150.0:
                raise ZeroDivisionError("speed of nothing")
            return super().update(estimate, dt_s)

    return IdealPolicy(state), Failing()


class Refusing:
    """A controller that cannot be made, picklable."""

    gains = ()
    internals = ()

    def __init__(self, _setup):
        raise ValueError("not today")


class Shell:
    """A part without its function."""

    def __init__(self, part):
        self.update = part.update


@dataclass(frozen=True)
class Shells:
    """Makes what the configuration names, in Python."""

    config: object

    def __call__(self, variation, state):
        return map(Shell, ConfiguredPolicy(self.config)(variation, state))


@dataclass(frozen=True)
class ShellOfController:
    """Makes what the configuration names, with the controller's update in Python."""

    config: object
    kind: type = Shell

    def __call__(self, variation, state):
        estimator, controller = ConfiguredPolicy(self.config)(variation, state)
        return estimator, self.kind(controller)


class Failing(Shell):
    """Answers in ways that differ from a number, one after the other, and fails at last."""

    def __init__(self, part):
        self._part, self._ticks = part, 0

    def update(self, estimate, dt_s):
        self._ticks += 1
        demand = self._part.update(estimate, dt_s)
        if self._ticks < 500:
            return demand._replace(brake=np.float64(demand.brake), switching=1, internals=(math.nan,) * 4)
        return self.fail(demand)

    def fail(self, _demand):
        raise RuntimeError("after 500 ticks")


class NotANumber(Failing):
    def fail(self, demand):
        return demand._replace(brake=math.nan)


class NotADemand(Failing):
    def fail(self, demand):
        return demand.brake


@dataclass(frozen=True, slots=True)
class DividingConstants:
    duty: float


@dataclass(slots=True)
class DividingState:
    ticks: float = 200.0


def divided(k, s, _estimate, _dt_s):
    s.ticks -= 1.0
    return BrakeDemand(k.duty, k.duty / s.ticks, 0.0, (0.0, 0.0, 0.0, 0.0))


class Dividing(DividingState):
    """Divides by zero at its 200th tick."""

    gains = ()
    internals = ()
    function = staticmethod(divided)

    def __init__(self, _setup=None):
        super().__init__()
        self.k = DividingConstants(0.6)

    def update(self, estimate, dt_s):
        return divided(self.k, self, estimate, dt_s)


def uncompilable(_k, s, _estimate, _dt_s):
    return BrakeDemand(no_such_name(s.ticks), 0.0, 0.0, (0.0, 0.0, 0.0, 0.0))  # noqa: F821  that is the point


class Unknown(Dividing):
    """Calls what does not exist."""

    function = staticmethod(uncompilable)


def decisions(machine_k, machine, guard_k, guard, given):
    """What machine and guard make of a sample, a reason to stop, and the controller's duty."""
    tick, time_ns, dt_s, wheel_count, road_count, flags, stop, brake = given
    sample = Sample(tick, time_ns, dt_s, wheel_count, road_count, flags)
    advance_and_admit((machine_k, guard_k), (machine, guard), sample, brake, stop)
    requested = machine.drive_request, machine.brake_request, 0.0 + machine.held, 0.0 + machine.reason
    return *requested, guard.drive, guard.brake, 0.0 + machine.phase, 0.0 + guard.reason
