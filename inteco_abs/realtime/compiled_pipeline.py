"""Decisions of the loop in machine code, with the bits of Python's."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import numpy as np

from inteco_abs.analysis.compiled_replay import (
    changed_records,
    decide_rows,
    function_of_pipeline,
    ordinary_sample,
    pipeline_records,
    resume_pipeline,
)
from inteco_abs.bound_function import is_own
from inteco_abs.config import RigConfig
from inteco_abs.control import Pipeline
from inteco_abs.errors import AbsError
from inteco_abs.format import TICK
from inteco_abs.kept_loop import KeptLoop
from inteco_abs.signals import UNTIMED, Command, Phase, Reason, Sample, Tick, Timing

_NONE: Final = Reason.NONE
_PHASES: Final = tuple(Phase)
_REASONS: Final = tuple(Reason)
_UNDECIDED: Final = (0,) * (len(Tick._fields) - len(Sample._fields) - len(Timing._fields) - 1)
"""What a row has for the decision before it is made."""


class CompiledPipeline(Pipeline):
    """A pipeline that takes estimator and controller of a new one, and decides in machine code.

    What machine code leaves to Python, Python decides, and all that follows. Raises AbsError where there is none;
    `may_make` says whether it is made if it is not on disk.
    """

    def __init__(self, config: RigConfig, new: Pipeline, *, may_make: bool = False) -> None:
        super().__init__(config, new.estimator, new.machine.controller)
        self._row = TICK.blank(1)
        self._newest_ns = 0
        self._decide: Callable[[], bool] | None = None
        self._records: Any = pipeline_records(self)
        self._states: list[tuple[memoryview, bytearray]] = []
        decide = function_of_pipeline(self)
        if self._records is not None and is_own(decide):  # else not with the bits of a replay
            self._loop = KeptLoop(partial(decide_rows, decide=decide), may_make=may_make)
            self._prepare()
        if self._decide is None:
            parts = f"{config.controller.name} with {config.estimator.name}"
            problem = f"machine code of {parts} cannot be made, or not be kept, on this computer"
            raise AbsError(f"loop.compiled = true: {problem}; set it to false")

    @property
    def decides_in(self) -> str:
        """What decides on the next sample: Python, once machine code has left one to it."""
        return super().decides_in if self._decide is None else "machine code"

    def step(self, sample: Sample, stop_request: Reason = _NONE, timing: Timing = UNTIMED) -> Tick:
        """As that of a pipeline."""
        decide, row, states = self._decide, self._row, self._states
        if decide is None or not ordinary_sample(sample, self._newest_ns):
            self._leave()
            return super().step(sample, stop_request, timing)
        number, time_ns, *inputs = sample
        TICK.pack_into(row, 0, (time_ns, number, *inputs, stop_request, *_UNDECIDED, *timing))
        for now, before in states:
            before[:] = now
        if not decide():
            for now, before in states:
                now[:] = before
            self._leave()
            return super().step(sample, stop_request, timing)
        self._newest_ns = time_ns
        tick = Tick(*TICK.unpack(row))
        self.machine.phase, self.guard.reason = _PHASES[tick.phase], _REASONS[tick.reason]
        self.command = Command(tick.drive, tick.brake)
        return tick

    def change(self, name: str, value: float) -> None:
        """As that of a pipeline."""
        super().change(name, value)
        if self._decide is None:
            return
        changed = None if self.error else changed_records(self._records, self.machine.controller, name, value)
        if changed is None:
            self.error = None
            self._leave()
            super().change(name, value)  # once more, now with the state of the newest tick
        else:
            self._records = changed
            self._prepare()

    def _prepare(self) -> None:
        """Decide in machine code from now on, if there is any."""
        parts, sequence = self._records
        self._decide = self._loop.prepared(parts, sequence, TICK.array(self._row))
        changing = (parts.estimator, parts.controllers, sequence.machine, sequence.guard, sequence.decided)
        self._states = []
        for found in (np.frombuffer(each, np.uint8) for each in changing):  # of a record, numpy does not let it write
            own = (ctypes.c_char * found.size).from_address(found.ctypes.data)
            self._states.append((memoryview(own).cast("B"), bytearray(own)))

    def _leave(self) -> None:
        """Take the state back from machine code, if it has it."""
        if self._decide is not None:
            resume_pipeline(self, self._records)
            self._decide = None
