"""Parts for ensembles that other processes can find: makers, estimators and controllers."""

from dataclasses import dataclass

from inteco_abs.montecarlo import IdealPolicy
from inteco_abs.signals import BrakeDemand, Command, Estimate


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
