"""The decision path: sample in, tick out. Runs, replays and Monte Carlo runs use this same object."""

from __future__ import annotations

import math
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.controllers import Controller
from inteco_abs.control.estimators import Estimator
from inteco_abs.control.guard import Guard
from inteco_abs.control.phase_machine import PhaseMachine, Request
from inteco_abs.signals import UNTIMED, BrakeDemand, Command, Estimate, Phase, Reason, Sample, Tick, Timing

_NONE: Final = Reason.NONE
_BRAKING: Final = Phase.BRAKING
_OVER: Final = (Phase.DONE, Phase.FAULT)
_NO_ESTIMATE: Final = Estimate(0.0, 0.0, 0.0, valid=False)
_FAILED: Final = _NO_ESTIMATE, Request(Command.SAFE, BrakeDemand(0.0), Reason.CONTROLLER_ERROR)


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
        self._estimator = estimator
        self._machine = PhaseMachine(config, controller, phase)
        self._guard = Guard(config)
        self._decided = _NO_ESTIMATE, Request(Command.SAFE, BrakeDemand(0.0), Reason.NONE)
        self._reference_slip = config.controller.reference_slip

    @property
    def phase(self) -> Phase:
        """Phase of the newest tick."""
        return self._machine.phase

    @property
    def reason(self) -> Reason:
        """Why the outputs were switched off, or NONE."""
        return self._guard.reason

    @property
    def finished(self) -> bool:
        """Whether the run is over: only SAFE follows."""
        return self._machine.phase in _OVER

    def step(self, sample: Sample, stop_request: Reason = Reason.NONE, timing: Timing = UNTIMED) -> Tick:
        """Decide on one sample; the tick's `drive` and `brake` are the command for the next exchange."""
        estimate, (request, demand, _) = self.decide(sample, stop_request)
        phase = self._machine.phase
        tick, time_ns, dt_s, wheel_count, road_count, board_flags = sample
        wheel_speed, road_speed, slip, valid, _ = estimate
        _, torque_nm, switching, internals = demand
        drive_request, brake_request = request
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
            self._reference_slip if phase is _BRAKING else math.nan,
            switching,
            torque_nm,
            drive_request,
            brake_request if type(brake_request) is float else math.nan,
            *self.command,
            self._guard.reason,
            *internals,
            late_us,
            io_us,
            busy_us,
            skipped,
        )

    def decide(self, sample: Sample, stop_request: Reason = Reason.NONE) -> tuple[Estimate, Request]:
        """As `step`, but return estimate and request only; `command` is what the guard admitted.

        For a sample with board flags they are those of the sample before.
        """
        decided = self._decided
        if self.error is not None:
            decided = _FAILED
        elif not sample.board_flags:
            try:
                estimate = self._estimator.update(sample, self.command)
                decided = self._decided = estimate, self._machine.step(sample, estimate)
            except (Exception, SystemExit) as error:  # noqa: BLE001  a user's controller may raise anything; the rig must stop all the same
                self.error = error
                decided = _FAILED
        estimate, (request, _, request_reason) = decided
        guard = self._guard
        if stop_request is not _NONE:
            guard.trip(stop_request)
        if request_reason is not _NONE:
            guard.trip(request_reason)
        self.command = guard.admit(request, sample, estimate)
        if guard.reason is not _NONE:
            self._machine.fault()
        return decided
