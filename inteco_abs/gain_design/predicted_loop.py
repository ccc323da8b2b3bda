"""How far a brake may be from what the observer takes it for, before the loop of predictive-reaching oscillates.

At a frozen road speed the loop is linearised about the reference slip: `Observer.update` and
`PredictiveReaching.update` themselves, by central differences, with the covariance that the observer has at this speed
in a stop of the rig that it expects. Dead time, lag and ripple keep what it takes them for. The brake and the wheels
follow the same tick: a command acts a period after its sample and the dead time later, and the wheels see the mean
torque of each period. So the loop has one frequency response F at z = exp(jwT), exact at dead times of whole periods,
and closes with F = 1.

The real brake multiplies F by a gain, by exp(-jwd) for a dead time that is d longer, and by a ratio of two sampled
lags. A loop that is stable for the brake that the observer expects stays so for every brake of a connected set if none
of them makes F = 1 at any frequency (zero exclusion: J. Ackermann, *Robust Control*, Springer, 1993). A reserve of 10 %
in size and 0.1 rad (6 degrees) in phase is left, for oscillations to die out within a stop, and for what the linear
loop has not: learning the ripple, steps of the adhesion that the observer suspects, quantisation. Size and phase of
the three factors are monotone, so that their intervals over a box are exact; the box is cut along the lag. Frequencies
are a grid, whose intervals are taken three times as wide as the values at their ends are apart. The opposite does not
follow: a box that is not certified may hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from copy import deepcopy
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from inteco_abs.config import RigConfig
from inteco_abs.control import Observer, PredictiveReaching, WheelDynamics, make_controller, make_estimator
from inteco_abs.errors import ConfigError
from inteco_abs.gain_design.bounds import Floats
from inteco_abs.rig import RigParameters, adhesion, nominal_parameters
from inteco_abs.signals import BoardFlags, Command, Sample

_STATES: Final = 7
"""Of the observer: angles and speeds of wheel and road, torque, excess torque, adhesion. The others stay."""
_STEPS: Final = (1e-6, 1e-4, 1e-6, 1e-4, 1e-4, 1e-4, 1e-5)
"""Their steps for derivatives."""
_TORQUE_STEP: Final = 1e-4
_ROLLING_S: Final = 0.2
"""Time for which the wheels roll before the brake acts."""
_LONGEST_S: Final = 10.0
_REACHED: Final = 0.01
"""Slip error below which the slip has reached its reference."""
_DRIFT_PER_S: Final = 4.0
"""Slower modes are the angles, and the road's speed, which is frozen."""
_FREQUENCIES: Final = 3000
_HIGHEST: Final = 0.9
"""Of the frequencies, as a share of half the sampling rate, at which F ends in 0."""
_LAGS: Final = 12
"""Pieces into which the range of a lag is cut."""
_HALVINGS: Final = 14
_TURN: Final = 2.0 * math.pi
_RESERVE: Final = 0.1
"""Distance of F from 1, in the logarithm of its size and in its phase in rad."""
_MOST_GAIN: Final = 20.0
_LATEST_S: Final = 0.2
SHORTEST_LAG_S: Final = 0.0002
"""Less is a small part of a period, for which the loop is the same."""
_LONGEST_LAG_S: Final = 1.0

Complex = NDArray[np.complex128]
Range = tuple[float, float]


class BrakeBox(NamedTuple):
    """Real brakes."""

    gain: Range = (1.0, 1.0)
    """Times the torque that the observer expects of a command."""
    later_s: Range = (0.0, 0.0)
    """Dead time beyond the one that it expects, s."""
    lag_s: Range | None = None
    """None: the one that it expects."""


class PredictedLoop(NamedTuple):
    """The loop at one road speed, with the brake that the observer expects."""

    road_speed_rad_s: float
    dead_time_s: float
    lag_s: float
    period_s: float
    decay_per_s: float
    """Decay of its slowest mode; not above 0 if it is unstable."""
    frequencies: Floats
    """rad/s"""
    response: Complex

    def holds(self, box: BrakeBox) -> bool:
        """Whether the loop is certified for all brakes of a box, which must contain the expected one."""
        if self.decay_per_s <= 0.0:
            return False
        lags = box.lag_s or (self.lag_s, self.lag_s)
        edges = np.geomspace(*lags, _LAGS + 1) if lags[0] < lags[1] else np.array(lags)
        return all(self._excludes(box, *each) for each in pairwise(edges.tolist()))

    def _excludes(self, box: BrakeBox, shorter_s: float, longer_s: float) -> bool:
        """Whether F keeps its distance from 1 at all frequencies, with lags of this piece."""
        w, F = self.frequencies, self.response
        expected = self._lag(self.lag_s)
        quick, slow = (F * self._lag(lag_s) / expected for lag_s in (shorter_s, longer_s))
        turned = np.angle(slow / quick)  # a longer lag is smaller, and later
        size = np.log(np.abs(quick))
        phase = np.unwrap(np.angle(quick))
        late = np.multiply.outer(box.later_s, w)
        lowest = _cells(size + np.log(np.abs(slow / quick)) + math.log(box.gain[0]))[0]
        highest = _cells(size + math.log(box.gain[1]))[1]
        last, first = _cells(phase + turned - late.max(axis=0))[0], _cells(phase - late.min(axis=0))[1]
        whole_turns = np.floor((first + _RESERVE) / _TURN) >= np.ceil((last - _RESERVE) / _TURN)
        return not bool(np.any((lowest <= _RESERVE) & (highest >= -_RESERVE) & whole_turns))

    def _lag(self, lag_s: float) -> Complex:
        left = math.exp(-self.period_s / lag_s)
        found: Complex = (1.0 - left) / (np.exp(1j * self.frequencies * self.period_s) - left)
        return found


def _cells(values: Floats) -> tuple[Floats, Floats]:
    """Least and most between neighbours, three times as wide as they are apart."""
    a, b = values[:-1], values[1:]
    apart = np.abs(b - a)
    return np.minimum(a, b) - apart, np.maximum(a, b) + apart


class Margins(NamedTuple):
    """What the loop at one road speed is certified for; each range with the other two as expected."""

    road_speed_rad_s: float
    decay_per_s: float
    """Of the loop with the expected brake."""
    least_gain: float
    most_gain: float
    earlier_s: float
    """By how much the dead time may be shorter than expected."""
    later_s: float
    least_lag_s: float
    most_lag_s: float
    together: float
    """Share of all three ranges, gain and lag by their logarithms, that holds together, 0..1."""


def margins(loop: PredictedLoop) -> Margins:
    """The ranges for which the loop is certified."""
    dead_time_s, lag_s = loop.dead_time_s, loop.lag_s

    def most(box: Callable[[float], BrakeBox]) -> float:
        """Largest share in 0..1 for which a box that grows with it is certified."""
        low, high = 0.0, 1.0
        if loop.holds(box(high)):
            return high
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if loop.holds(box(middle)) else (low, middle)
        return low

    stronger = _MOST_GAIN ** most(lambda share: BrakeBox(gain=(1.0, _MOST_GAIN**share)))
    weaker = _MOST_GAIN ** most(lambda share: BrakeBox(gain=(_MOST_GAIN**-share, 1.0)))
    later = _LATEST_S * most(lambda share: BrakeBox(later_s=(0.0, share * _LATEST_S)))
    earlier = dead_time_s * most(lambda share: BrakeBox(later_s=(-share * dead_time_s, 0.0)))
    longest, shortest = _LONGEST_LAG_S / lag_s, SHORTEST_LAG_S / lag_s
    longer = longest ** most(lambda share: BrakeBox(lag_s=(lag_s, lag_s * longest**share)))
    shorter = shortest ** most(lambda share: BrakeBox(lag_s=(lag_s * shortest**share, lag_s)))

    def joint(share: float) -> BrakeBox:
        delay = -share * earlier, share * later
        return BrakeBox((weaker**-share, stronger**share), delay, (lag_s * shorter**share, lag_s * longer**share))

    ranges = 1.0 / weaker, stronger, earlier, later, lag_s * shorter, lag_s * longer
    return Margins(loop.road_speed_rad_s, loop.decay_per_s, *ranges, most(joint))


def predicted_loops(config: RigConfig, speeds: Floats) -> list[PredictedLoop]:
    """The loop at those of these rising road speeds, rad/s, at which an expected stop has reached the reference slip.

    Raises ConfigError for another estimator than the observer, and if there is none.
    """
    observer = make_estimator(config)
    if not isinstance(observer, Observer):
        problem = f"{config.estimator.name!r} has no prediction: predictive-reaching needs an observer"
        raise ConfigError.of("estimator.name", problem)
    rig = nominal_parameters(config.model)
    found = [_loop(config, rig, each, speed) for speed, each in _observers_at(config, rig, observer, speeds)]
    if not found:
        problem = f"{speeds[0]:g} {speeds[-1]:g}: the slip is not at its reference at these speeds; choose lower ones"
        raise ConfigError.of("--speeds", problem)
    return found[::-1]


def _observers_at(
    config: RigConfig, rig: RigParameters, observer: Observer, speeds: Floats
) -> Iterator[tuple[float, Observer]]:
    """The observer in a stop of the rig that it expects, as the road passes each of the speeds, from the highest."""
    law: Any = make_controller(config)
    tuning, wheels = observer.k.ekf.tuning, WheelDynamics(rig)
    period_s, per_rad = config.period_ns * 1e-9, config.encoders.counts_per_turn / (2.0 * math.pi)
    pending = [0.0] * (1 + round(tuning.dead_time_s / period_s))
    left = math.exp(-period_s / tuning.lag_s)
    x2 = max(config.experiment.start_speed_rad_s, 1.02 * float(speeds[-1]))
    th1, x1, th2, torque = 0.0, x2 * rig.r2 / rig.r1, 0.0, 0.0
    command, ahead, reached = Command(1.0, 0.0), [float(v) for v in speeds], False
    for tick in range(1, round(_LONGEST_S / period_s)):
        rolling = tick * period_s < _ROLLING_S
        wheel: Any = th1 * per_rad  # without rounding: a covariance does not depend on it
        road: Any = th2 * per_rad
        sample = Sample(tick, tick * config.period_ns, period_s, wheel, road, BoardFlags.NONE)
        estimate = observer.update(sample, command)
        reached = reached or estimate.slip > config.controller.reference_slip - _REACHED
        while ahead and x2 <= ahead[-1]:
            speed = ahead.pop()
            if reached:
                yield speed, deepcopy(observer)
        if not ahead:
            return
        pending.append(0.0 if rolling else max(0.0, _torque_of(law, command.brake)))
        settled = pending.pop(0)
        command = Command(1.0, 0.0) if rolling else Command(0.0, law.update(estimate, period_s).brake)
        before, torque = torque, settled + (torque - settled) * left
        if not rolling:
            mu = adhesion(min(max(1.0 - rig.r1 * x1 / (rig.r2 * x2), 0.0), 1.0), rig)
            a1, a2, *_ = wheels.accelerations(x1, x2, 0.5 * (before + torque), mu)
            x1, x2 = max(0.0, x1 + period_s * a1), x2 + period_s * a2
        th1, th2 = th1 + period_s * x1, th2 + period_s * x2


def _torque_of(law: Any, duty: float) -> float:
    """Torque to which the brake settles at a duty, N m."""
    points = law.k.points
    return float(np.interp(duty, [one[0] for one in points], [one[1] for one in points]))


class _Tick(NamedTuple):
    """Derivatives of a tick of observer and law."""

    state_by_state: Floats
    state_by_angles: Floats
    state_by_commands: Floats
    demand_by_state: Floats
    demand_by_angles: Floats
    demand_by_commands: Floats


def _linearised(config: RigConfig, observer: Observer, law: Any, balance: Floats) -> _Tick:
    """One tick about a balance; commands are torques in N m, the newest first."""
    wheel_speed, speed, held = balance.tolist()
    tuning, period_s = observer.k.ekf.tuning, config.period_ns * 1e-9
    dead_time_s = tuning.dead_time_s
    taps = round(dead_time_s / period_s) + 3
    base = deepcopy(observer)
    base.wheel.cosine = base.wheel.sine = base.wheel.cosine_2 = base.wheel.sine_2 = 0.0
    base.road.cosine = base.road.sine = base.road.cosine_2 = base.road.sine_2 = 0.0
    base.ekf.x = [0.0, wheel_speed, 0.0, speed, held, 0.0, 1.0, 0.0, 0.0, dead_time_s, tuning.lag_s, 1.0]
    base.ekf.radius_ratio = 1.0
    base.ekf.step_in_s, base.ekf.surprise, base.asked_s = math.inf, 0.0, math.inf
    for i in range(12):
        for j in range(_STATES, 12):
            base.ekf.P[i][j] = base.ekf.P[j][i] = 0.0
    base.wheel.origin = base.road.origin = 0
    base.wheel.before_ns = base.road.before_ns = 0

    def tick(state: Floats, angles: Floats, commands: Floats) -> tuple[Floats, float]:
        one = deepcopy(base)
        for i, off in enumerate(state):
            one.ekf.x[i] += off
        ring, newest = one.pending.torques, one.pending.newest
        for i in range(len(ring) // 2):
            place = newest - i
            torque = held + (commands[i + 1] if i + 1 < len(commands) else 0.0)
            ring[place] = torque
            length = one.k.ekf.delay.length
            ring[place + length if place < length else place - length] = torque
        wheel, road = (angles / one.k.per_count).tolist()
        sample = Sample(1, config.period_ns, period_s, wheel, road, BoardFlags.NONE)
        estimate = one.update(sample, Command(0.0, law.duty(held + commands[0])))
        law.update(estimate, period_s)
        return np.array(one.ekf.x[:_STATES]), float(law.settled_nm)

    sizes = _STATES, 2, taps
    zero = [np.zeros(size) for size in sizes]
    expected, _ = tick(*zero)
    for _ in range(3):  # until the angles are those that the observer expects
        expected, _ = tick(zero[0], expected[[0, 2]], zero[2])
    at = expected[[0, 2]]
    states, demands = [], []
    for which, size in enumerate(sizes):
        by_state, by_demand = np.zeros((_STATES, size)), np.zeros(size)
        for i in range(size):
            step = _STEPS[i] if which == 0 else _STEPS[0] if which == 1 else _TORQUE_STEP
            ends = []
            for side in (step, -step):
                off = [each.copy() for each in zero]
                off[which][i] = side
                ends.append(tick(off[0], at + off[1], off[2]))
            by_state[:, i] = (ends[0][0] - ends[1][0]) / (2.0 * step)
            by_demand[i] = (ends[0][1] - ends[1][1]) / (2.0 * step)
        states.append(by_state)
        demands.append(by_demand)
    return _Tick(*states, *demands)


def _wheels(rig: RigParameters, balance: Floats, period_s: float) -> tuple[Floats, Floats]:
    """A period of angles and speeds of wheel and road, and what a torque in N m does to them in it."""
    dynamics = WheelDynamics(rig)

    def accelerations(x1: float, x2: float, torque: float) -> Floats:
        mu = adhesion(1.0 - rig.r1 * x1 / (rig.r2 * x2), rig)
        return np.array(dynamics.accelerations(x1, x2, torque, mu)[:2])

    rates = np.zeros((5, 5))
    rates[0, 1] = rates[2, 3] = 1.0
    for column, i, step in ((1, 0, 1e-4), (3, 1, 1e-4), (4, 2, 1e-4)):
        off = np.eye(3)[i] * step
        rates[[1, 3], column] = (accelerations(*(balance + off)) - accelerations(*(balance - off))) / (2.0 * step)
    whole, term = np.eye(5), np.eye(5)
    for i in range(1, 12):  # exp(rates*T), of a short T
        term = term @ rates * (period_s / i)
        whole = whole + term
    return whole[:4, :4], whole[:4, 4]


def _loop(config: RigConfig, rig: RigParameters, observer: Observer, speed: float) -> PredictedLoop:
    law: Any = make_controller(config)
    if not isinstance(law, PredictiveReaching):
        raise ConfigError.of("controller.name", "must be predictive-reaching")
    slip, tuning, period_s = config.controller.reference_slip, observer.k.ekf.tuning, config.period_ns * 1e-9
    wheel_speed = (1.0 - slip) * speed * rig.r2 / rig.r1
    held, _, _ = WheelDynamics(rig).torque(slip, 0.0, wheel_speed, speed, adhesion(slip, rig))
    balance = np.array([wheel_speed, speed, held])  # at the reference slip: rad/s, rad/s, N m
    tick = _linearised(config, observer, law, balance)
    moved, by_torque = _wheels(rig, balance, period_s)
    late = round(tuning.dead_time_s / period_s)
    left = math.exp(-period_s / tuning.lag_s)
    w = np.geomspace(_DRIFT_PER_S, _HIGHEST * math.pi / period_s, _FREQUENCIES)
    z = np.exp(1j * w * period_s)
    response = np.array([_response(tick, moved, by_torque, each) for each in z])
    response *= 0.5 * (1.0 + z) * (1.0 - left) / (z - left) * z ** -(1 + late)
    decay = _decay(tick, moved, by_torque, left, late, period_s)
    return PredictedLoop(speed, late * period_s, tuning.lag_s, period_s, decay, w, response)


def _response(tick: _Tick, moved: Floats, by_torque: Floats, z: complex) -> complex:
    """From the mean torque of a period to the command, but for the brake."""
    angles = np.linalg.solve(z * np.eye(4) - moved, by_torque)[[0, 2]]
    commands = z ** -np.arange(1.0, 1.0 + len(tick.demand_by_commands))
    both = np.column_stack([tick.state_by_angles @ angles, tick.state_by_commands @ commands])
    states = np.linalg.solve(np.eye(_STATES) - tick.state_by_state / z, both)
    by_angles, by_commands = tick.demand_by_state @ states / z
    loop = by_angles + tick.demand_by_angles @ angles
    return complex(loop / (1.0 - by_commands - tick.demand_by_commands @ commands))


def _decay(tick: _Tick, moved: Floats, by_torque: Floats, left: float, late: int, period_s: float) -> float:
    """Decay in 1/s of the closed loop's slowest mode, by the eigenvalues of a tick."""
    taps = len(tick.demand_by_commands)
    size = 5 + _STATES + taps
    whole = np.zeros((size, size))
    wheels, torque, states, commands = slice(0, 4), 4, slice(5, 5 + _STATES), slice(5 + _STATES, size)
    arriving = 5 + _STATES + late
    angles = np.eye(4)[[0, 2]]
    whole[wheels, wheels] = moved
    whole[torque, torque], whole[torque, arriving] = left, 1.0 - left
    whole[wheels, torque] = by_torque * 0.5 * (1.0 + left)
    whole[wheels, arriving] = by_torque * 0.5 * (1.0 - left)
    for rows, by_state, by_angles, by_commands in (
        (states, tick.state_by_state, tick.state_by_angles, tick.state_by_commands),
        (commands.start, tick.demand_by_state, tick.demand_by_angles, tick.demand_by_commands),
    ):
        whole[rows, states], whole[rows, wheels], whole[rows, commands] = by_state, by_angles @ angles, by_commands
    for i in range(1, taps):
        whole[commands.start + i, commands.start + i - 1] = 1.0
    modes = np.linalg.eigvals(whole)
    moving = modes[np.abs(modes - 1.0) > _DRIFT_PER_S * period_s]
    return float(-math.log(np.abs(moving).max()) / period_s)
