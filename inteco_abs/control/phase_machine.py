"""The phases of the experiment: idle, armed, spin-up, braking, stopped, done."""

from __future__ import annotations

from copy import deepcopy
from numbers import Real
from typing import Final, NamedTuple

from inteco_abs.config import RigConfig
from inteco_abs.control.controllers import Controller
from inteco_abs.control.count_speed import MovingAverageSpeed
from inteco_abs.signals import BrakeDemand, Command, Estimate, Phase, Reason, Sample

_NONE: Final = Reason.NONE
_SPIN_UP, _BRAKING, _STOPPED = Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED
_START_WINDOW_S: Final = 0.020
_STOP_WINDOW_S: Final = 0.050
REST_COUNTS: Final = 4
"""Counts that a resting wheel may move, as when the table is nudged."""
_FOUR_FLOATS: Final = (float, float, float, float)
_NUMBERS: Final[type] = Real
"""Types that are accepted as a duty of users' controllers."""
_NO_DEMAND: Final = BrakeDemand(0.0)


class Request(NamedTuple):
    """Requested outputs, the demand behind them, and a reason to stop or NONE."""

    command: Command
    demand: BrakeDemand
    reason: Reason


_NOTHING: Final = Request(Command.SAFE, _NO_DEMAND, Reason.NONE)


class PhaseMachine:
    """Advances by samples alone, so that a replay takes the same steps.

    It drives at `drive_duty` until the road wheel's mean speed over 20 ms reaches the start speed; then both outputs
    are off for one tick; the brake acts until the road wheel's mean speed over 50 ms is below the stop speed, and for
    `hold_s` longer. Start and stop do not depend on the estimator. Each of several stops begins from rest with a new
    copy of the controller. A simulated rig may begin in a later `phase`, with its wheels turning.
    """

    def __init__(self, config: RigConfig, controller: Controller, phase: Phase = Phase.IDLE) -> None:
        self.phase = phase
        self._config = config.experiment
        self._controller = controller
        self._left = self._config.stops - 1  # stops still to be done after this one
        self._as_made = deepcopy(controller) if self._left else controller
        counts, rate = config.encoders.counts_per_turn, config.loop.rate_hz
        self._start_speed = MovingAverageSpeed(counts, round(_START_WINDOW_S * rate))
        self._stop_speed = MovingAverageSpeed(counts, round(_STOP_WINDOW_S * rate))
        self._since_ns = -1
        self._rest = (0, 0)
        self._held = _NO_DEMAND
        self._drive = Request(Command(self._config.drive_duty, 0.0), _NO_DEMAND, _NONE)

    def fault(self) -> None:
        """End the run: the guard has switched the outputs off."""
        self.phase = Phase.FAULT

    def step(self, sample: Sample, estimate: Estimate) -> Request:
        """Advance by one sample."""
        since_ns, phase = self._since_ns, self.phase
        if since_ns < 0:
            since_ns = self._since_ns = sample.time_ns
            self._rest = (sample.wheel_count, sample.road_count)
        elapsed_s = (sample.time_ns - since_ns) * 1e-9
        if phase is _SPIN_UP:
            return self._spin_up(sample, elapsed_s)
        if phase is _BRAKING:
            return self._brake(sample, estimate, elapsed_s)
        if phase is _STOPPED:
            if elapsed_s < self._config.hold_s:
                return Request(Command(0.0, self._held.brake), self._held, _NONE)
            self._enter(Phase.IDLE if self._left else Phase.DONE, sample)
            self._begin_again(sample)
        elif phase in (Phase.IDLE, Phase.ARMED):
            return self._wait(sample, elapsed_s)
        return _NOTHING

    def _wait(self, sample: Sample, elapsed_s: float) -> Request:
        wheel, road = self._rest
        moved = max(abs(sample.wheel_count - wheel), abs(sample.road_count - road)) > REST_COUNTS
        if elapsed_s >= self._config.idle_s and not moved:
            self._enter(Phase.ARMED if self.phase is Phase.IDLE else Phase.SPIN_UP, sample)
        return Request(Command.SAFE, _NO_DEMAND, Reason.WHEELS_MOVING if moved else _NONE)

    def _spin_up(self, sample: Sample, elapsed_s: float) -> Request:
        speed = self._start_speed.update(sample.time_ns, sample.road_count)
        if elapsed_s >= _START_WINDOW_S and speed >= self._config.start_speed_rad_s:
            self._enter(Phase.BRAKING, sample)
            return _NOTHING
        late = elapsed_s > self._config.spin_up_timeout_s
        return self._drive._replace(reason=Reason.SPIN_UP_TIMEOUT) if late else self._drive

    def _brake(self, sample: Sample, estimate: Estimate, elapsed_s: float) -> Request:
        speed = self._stop_speed.update(sample.time_ns, sample.road_count)
        demand = self._held = recordable(self._controller.update(estimate, sample.dt_s))
        if elapsed_s >= _STOP_WINDOW_S and abs(speed) < self._config.stop_speed_rad_s:
            self._enter(Phase.STOPPED, sample)
        late = elapsed_s > self._config.braking_timeout_s
        return Request(Command(0.0, demand.brake), demand, Reason.BRAKING_TIMEOUT if late else _NONE)

    def _begin_again(self, sample: Sample) -> None:
        if not self._left:
            return
        self._left -= 1
        self._rest = (sample.wheel_count, sample.road_count)
        self._held = _NO_DEMAND
        self._controller = deepcopy(self._as_made)
        self._start_speed.clear()
        self._stop_speed.clear()

    def _enter(self, phase: Phase, sample: Sample) -> None:
        self.phase = phase
        self._since_ns = sample.time_ns


def recordable(demand: BrakeDemand) -> BrakeDemand:
    """The demand of a user's controller with every logged value as a float; numpy's numbers are converted.

    A duty that is not a number is left for the guard. Raises TypeError or ValueError for other values.
    """
    if type(demand) is not BrakeDemand:
        raise TypeError(f"update() must return a BrakeDemand, not {demand!r}")
    brake, torque, switching, internals = demand
    if type(brake) is float:
        if type(torque) is float and type(switching) is float and tuple(map(type, internals)) == _FOUR_FLOATS:
            return demand
    elif isinstance(brake, _NUMBERS) and not isinstance(brake, bool):
        brake = float(brake)
    c0, c1, c2, c3 = map(float, internals)
    return BrakeDemand(brake, float(torque), float(switching), (c0, c1, c2, c3))
