"""The phases of the experiment: idle, armed, spin-up, braking, stopped, done."""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass
from numbers import Real
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.controllers import Controller
from inteco_abs.control.count_speed import Window, WindowConstants, empty_window, mean_speeds, window_constants
from inteco_abs.control.gain_changes import set_gain
from inteco_abs.errors import line_of
from inteco_abs.signals import BrakeDemand, Estimate, Phase, Reason, Sample

_NONE: Final = Reason.NONE
_IDLE, _ARMED, _SPIN_UP = Phase.IDLE, Phase.ARMED, Phase.SPIN_UP
_BRAKING, _STOPPED = Phase.BRAKING, Phase.STOPPED
_START_WINDOW_S: Final = 0.020
_STOP_WINDOW_S: Final = 0.050
REST_COUNTS: Final = 4
"""Counts that a resting wheel may move, as when the table is nudged."""
_FOUR_FLOATS: Final = (float, float, float, float)
_NUMBERS: Final[type] = Real
"""Types that are accepted as a duty of users' controllers."""
_NO_DEMAND: Final = BrakeDemand(0.0)


@dataclass(frozen=True, slots=True)
class MachineConstants:
    """Constants from the section [experiment]."""

    start_speed: float
    """rad/s"""
    stop_speed: float
    """rad/s"""
    drive_duty: float
    idle_s: float
    hold_s: float
    spin_up_timeout_s: float
    braking_timeout_s: float
    start: WindowConstants
    stop: WindowConstants


@dataclass(slots=True)
class MachineState:
    """Where the experiment stands."""

    start: Window
    """Speed window of the road wheel while it is driven."""
    stop: Window
    """Speed window of the road wheel while it is braked."""
    phase: Phase
    stops_left: int
    """Stops to be done after this one."""
    since_ns: int = -1
    rest_wheel: int = 0
    rest_road: int = 0
    drive_request: float = 0.0
    """Newest requests of both duties, 0..1."""
    brake_request: float = 0.0
    held: bool = False
    """Whether `brake_request` is the controller's last demand."""
    reason: Reason = _NONE
    """Reason to stop, by the newest request."""


class PhaseMachine(MachineState):
    """Advances by samples alone, so that a replay takes the same steps.

    It drives at `drive_duty` until the road wheel's mean speed over 20 ms reaches the start speed; then both outputs
    are off for one tick; the brake acts until the road wheel's mean speed over 50 ms is below the stop speed, and for
    `hold_s` longer. Start and stop do not depend on the estimator. Each of several stops begins from rest with a new
    copy of the controller. A simulated rig may begin in a later `phase`, with its wheels turning.
    """

    def __init__(self, config: RigConfig, controller: Controller, phase: Phase = Phase.IDLE) -> None:
        counts, rate, experiment = config.encoders.counts_per_turn, config.loop.rate_hz, config.experiment
        start, stop = round(_START_WINDOW_S * rate), round(_STOP_WINDOW_S * rate)
        self.k = MachineConstants(
            start_speed=experiment.start_speed_rad_s,
            stop_speed=experiment.stop_speed_rad_s,
            drive_duty=experiment.drive_duty,
            idle_s=experiment.idle_s,
            hold_s=experiment.hold_s,
            spin_up_timeout_s=experiment.spin_up_timeout_s,
            braking_timeout_s=experiment.braking_timeout_s,
            start=window_constants(counts, start),
            stop=window_constants(counts, stop),
        )
        super().__init__(empty_window(start), empty_window(stop), phase, experiment.stops - 1)
        self.controller = controller
        """Controller of this stop."""
        self.controller_as_made = deepcopy(controller) if self.stops_left else controller
        """What each further stop begins with a copy of."""
        self.last_demand = _NO_DEMAND
        """Newest demand of the controller in this stop."""

    @property
    def demand(self) -> BrakeDemand:
        """Return the demand behind the newest request."""
        return self.last_demand if self.held else _NO_DEMAND

    def fail(self) -> None:
        """Request SAFE: estimator or controller failed."""
        self.drive_request, self.brake_request, self.held = 0.0, 0.0, False
        self.reason = Reason.CONTROLLER_ERROR

    def change_gain(self, name: str, value: float) -> None:
        """Change a gain of the controllers of this stop and of those after it. Raises as `set_gain`."""
        set_gain(self.controller, name, value)
        if self.controller_as_made is not self.controller:
            set_gain(self.controller_as_made, name, value)

    def advance(self, sample: Sample, estimate: Estimate) -> None:
        """Advance by one sample; the request is in the state."""
        phase = self.phase
        if phase is _BRAKING:
            self.last_demand = demand_of(self.controller, estimate, sample.dt_s)
        advance_phase(self.k, self, sample, self.last_demand.brake)
        if phase is _STOPPED and self.phase is Phase.IDLE:
            self.last_demand, self.controller = _NO_DEMAND, deepcopy(self.controller_as_made)


def advance_phase(k: MachineConstants, s: MachineState, sample: Sample, brake: float) -> None:
    """Advance by one sample and leave the request in `s`; `brake` is the controller's last duty."""
    _, time_ns, _, wheel_count, road_count, _ = sample
    if s.since_ns < 0:
        s.since_ns, s.rest_wheel, s.rest_road = time_ns, wheel_count, road_count
    elapsed_s = (time_ns - s.since_ns) * 1e-9
    phase, s.reason, s.held = s.phase, _NONE, False
    if phase == _SPIN_UP:
        speed = mean_speeds(k.start, s.start, time_ns, 0, road_count)[1]
        s.drive_request, s.brake_request = k.drive_duty, 0.0
        if elapsed_s >= _START_WINDOW_S and speed >= k.start_speed:
            s.phase, s.since_ns, s.drive_request = _BRAKING, time_ns, 0.0
        elif elapsed_s > k.spin_up_timeout_s:
            s.reason = Reason.SPIN_UP_TIMEOUT
    elif phase == _BRAKING:
        s.drive_request, s.brake_request, s.held = 0.0, brake, True
        _brake(k, s, time_ns, road_count, elapsed_s)
    else:
        s.drive_request = s.brake_request = 0.0
        if phase == _STOPPED:
            _hold(k, s, sample, elapsed_s, brake)
        elif phase in (_IDLE, _ARMED):
            _wait(k, s, time_ns, elapsed_s, max(abs(wheel_count - s.rest_wheel), abs(road_count - s.rest_road)))


def _brake(k: MachineConstants, s: MachineState, time_ns: int, road_count: int, elapsed_s: float) -> None:
    speed = mean_speeds(k.stop, s.stop, time_ns, 0, road_count)[1]
    if elapsed_s >= _STOP_WINDOW_S and abs(speed) < k.stop_speed:
        s.phase, s.since_ns = _STOPPED, time_ns
    if elapsed_s > k.braking_timeout_s:
        s.reason = Reason.BRAKING_TIMEOUT


def _hold(k: MachineConstants, s: MachineState, sample: Sample, elapsed_s: float, brake: float) -> None:
    """Keep the brake on for a while, then go to the next stop, from rest, or to the end."""
    if elapsed_s < k.hold_s:
        s.brake_request, s.held = brake, True
        return
    s.phase, s.since_ns = Phase.DONE, sample.time_ns
    if s.stops_left > 0:
        s.phase, s.rest_wheel, s.rest_road = _IDLE, sample.wheel_count, sample.road_count
        s.stops_left -= 1
        s.start.oldest = s.stop.oldest = -1


def _wait(k: MachineConstants, s: MachineState, time_ns: int, elapsed_s: float, moved: int) -> None:
    """At rest, both wheels having `moved` by so many counts at most."""
    if moved > REST_COUNTS:
        s.reason = Reason.WHEELS_MOVING
    elif elapsed_s >= k.idle_s:
        s.phase, s.since_ns = _ARMED if s.phase == _IDLE else _SPIN_UP, time_ns


def demand_of(controller: Controller, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """What a user's controller demands, with every logged value as a float; numpy's numbers are converted.

    A duty that is not a number becomes NaN, at which the guard trips. Raises TypeError or ValueError for other values,
    with the place of the controller's `update` as a note.
    """
    demand = controller.update(estimate, dt_s)
    try:
        if type(demand) is BrakeDemand:
            brake, torque, switching, internals = demand
            if type(brake) is type(torque) is type(switching) is float and tuple(map(type, internals)) == _FOUR_FLOATS:
                return demand
        return _recordable(demand)
    except (TypeError, ValueError) as error:
        if (code := getattr(controller.update, "__code__", None)) is not None:
            error.add_note(line_of(code.co_filename, code.co_firstlineno))
        raise


def _recordable(demand: BrakeDemand) -> BrakeDemand:
    if type(demand) is not BrakeDemand:
        raise TypeError(f"update() must return a BrakeDemand, not {demand!r}")
    brake, torque, switching, internals = demand
    if type(brake) is not float:
        brake = float(brake) if isinstance(brake, _NUMBERS) and not isinstance(brake, bool) else math.nan
    c0, c1, c2, c3 = map(float, internals)
    return BrakeDemand(brake, float(torque), float(switching), (c0, c1, c2, c3))
