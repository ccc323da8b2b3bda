"""The decision path: sample in, tick out. Runs and replays use this object, Monte Carlo runs its functions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.controllers import Controller
from inteco_abs.control.estimators import Estimator
from inteco_abs.control.gain_changes import REFERENCE
from inteco_abs.control.guard import Guard, GuardConstants, GuardState, admit, trip
from inteco_abs.control.phase_machine import MachineConstants, MachineState, PhaseMachine, advance_phase
from inteco_abs.control.reference import reference_function
from inteco_abs.signals import UNTIMED, BrakeDemand, Command, Estimate, Phase, Reason, Sample, Tick, Timing

_NONE: Final = Reason.NONE
_BRAKING: Final = Phase.BRAKING
OVER: Final = (Phase.DONE, Phase.FAULT)
"""Phases after which only SAFE follows."""
_NO_ESTIMATE: Final = Estimate(0.0, 0.0, 0.0, valid=False)


@dataclass(slots=True)
class DecisionState:
    """What a pipeline has decided last, as numbers: estimate, the controller's demand, and the admitted command."""

    wheel_speed: float
    road_speed: float
    slip: float
    valid: bool
    demanded: float
    """Duty that the controller demands, as it does the following."""
    torque_nm: float
    switching: float
    c0: float
    c1: float
    c2: float
    c3: float
    drive: float
    """Duty that the guard admits, as is `brake`."""
    brake: float


class Pipeline:
    """Estimator, phase machine with its controller, and guard, in that order; the guard has the last word.

    A simulated rig whose wheels already turn may begin in a later `phase`.
    """

    def __init__(
        self, config: RigConfig, estimator: Estimator, controller: Controller, phase: Phase = Phase.IDLE
    ) -> None:
        self.error: BaseException | None = None
        """What the estimator or controller raised, if the reason is CONTROLLER_ERROR."""
        self.command = Command.SAFE
        """What the newest tick admitted, to be written at the next exchange."""
        self.estimator = estimator
        self.machine = PhaseMachine(config, controller, phase)
        self.guard = Guard(config)
        self._constant_slip, self._reference = config.controller.reference_slip, reference_function(controller)
        self._estimate = _NO_ESTIMATE

    @property
    def decides_in(self) -> str:
        """What decides on the next sample."""
        return "Python"

    @property
    def reference_slip(self) -> float:
        """Slip that the controller holds now."""
        return self._reference(self.machine.controller, self._constant_slip)

    @property
    def phase(self) -> Phase:
        """Phase of the newest tick."""
        return self.machine.phase

    @property
    def reason(self) -> Reason:
        """Why the outputs were switched off, or NONE."""
        return self.guard.reason

    @property
    def finished(self) -> bool:
        """Whether the run is over: only SAFE follows."""
        return self.machine.phase in OVER

    @property
    def decided(self) -> DecisionState:
        """What the newest tick has decided."""
        duty, torque_nm, switching, internals = self.machine.last_demand
        return DecisionState(*self._estimate[:4], duty, torque_nm, switching, *internals, *self.command)

    def resume(self, decided: DecisionState) -> None:
        """Go on after other ticks, with `estimator`, `machine` and `guard` in the state that they have left."""
        s = decided
        self.command = Command(s.drive, s.brake)
        self._estimate = Estimate(s.wheel_speed, s.road_speed, s.slip, s.valid)
        internals = s.c0, s.c1, s.c2, s.c3
        self.machine.last_demand = BrakeDemand(s.demanded, s.torque_nm, s.switching, internals)

    def change(self, name: str, value: float) -> None:
        """Give the controller, also of all further stops, another gain or `reference_slip` from the next sample on.

        As in `step`, what a user's controller raises ends the run.
        """
        if self.error is not None:
            return
        try:
            self.machine.change_gain(name, value)
        except (Exception, SystemExit) as error:  # noqa: BLE001  as in `decide`
            self.error = error
            self._estimate = _NO_ESTIMATE
            self.machine.fail()
        else:
            if name == REFERENCE:
                self._constant_slip = value

    def step(self, sample: Sample, stop_request: Reason = Reason.NONE, timing: Timing = UNTIMED) -> Tick:
        """Decide on one sample; the tick's `drive` and `brake` are the command for the next exchange."""
        wheel_speed, road_speed, slip, valid, _ = self.decide(sample, stop_request)
        machine = self.machine
        phase = machine.phase
        tick, time_ns, dt_s, wheel_count, road_count, board_flags = sample
        _, torque_nm, switching, internals = machine.demand
        late_us, io_us, busy_us, skipped = timing
        return Tick(
            time_ns,
            tick,
            dt_s,
            wheel_count,
            road_count,
            board_flags,
            stop_request,
            wheel_speed,
            road_speed,
            slip,
            valid,
            phase,
            self.reference_slip if phase is _BRAKING else math.nan,
            switching,
            torque_nm,
            machine.drive_request,
            machine.brake_request,
            *self.command,
            self.guard.reason,
            *internals,
            late_us,
            io_us,
            busy_us,
            skipped,
        )

    def decide(self, sample: Sample, stop_request: Reason = Reason.NONE) -> Estimate:
        """As `step`, but return the estimate only; `command` is what the guard admitted.

        For a sample with board flags the estimate, and what is requested, are those of the sample before.
        """
        machine, guard, command = self.machine, self.guard, self.command
        if not sample.board_flags and self.error is None:
            try:
                self._estimate = self.estimator.update(sample, command)
                machine.advance(sample, self._estimate)
            except (Exception, SystemExit) as error:  # noqa: BLE001  a user's controller may raise anything; the rig must stop all the same
                self.error = error
                self._estimate = _NO_ESTIMATE
                machine.fail()
        admit_request(guard.k, guard, machine, sample, stop_request)
        drive, brake = command
        if machine.held or guard.drive != drive or guard.brake != brake:
            self.command = Command(guard.drive, guard.brake)
        return self._estimate


def advance_and_admit(
    k: tuple[MachineConstants, GuardConstants],
    s: tuple[MachineState, GuardState],
    sample: Sample,
    brake: float,
    stop_request: Reason,
) -> None:
    """What follows estimate and demand in a tick, of which `brake` is the last: phase machine, then guard."""
    if not sample.board_flags:
        advance_phase(k[0], s[0], sample, brake)
    admit_request(k[1], s[1], s[0], sample, stop_request)


def admit_request(
    k: GuardConstants, s: GuardState, machine: MachineState, sample: Sample, stop_request: Reason
) -> None:
    """Leave in `s` what the guard admits of the machine's request; with any reason not to, the experiment is over."""
    if stop_request != _NONE:
        trip(s, stop_request)
    if machine.reason != _NONE:
        trip(s, machine.reason)
    admit(k, s, sample, machine.drive_request, machine.brake_request)
    if s.reason != _NONE:
        machine.phase = Phase.FAULT
