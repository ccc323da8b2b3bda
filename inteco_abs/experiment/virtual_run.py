"""A run in this process, in virtual time, on the mock board."""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from typing import Any, Final

from inteco_abs.boards import Board, InProcessLink, board_behind
from inteco_abs.config import RigConfig
from inteco_abs.control import OVER, Controller, GainChange, Pipeline, gains_in_force, gains_to_change
from inteco_abs.errors import SessionError, UnsafeError, describe_error
from inteco_abs.experiment.plan import Plan, RunProgress, facts_of, job_of, ring_ticks
from inteco_abs.mock_board import Device, FaultyDevice, FaultyFrontEnd, FaultyHost, FrontEnd, Schedule, front_end_of
from inteco_abs.quantities import quantities
from inteco_abs.realtime import (
    GainChanges,
    Histogram,
    Loop,
    Screen,
    SnapshotSource,
    StartCheck,
    StopFlag,
    TickRing,
    VirtualClock,
    Window,
    detail_of,
    prove_watchdog,
)
from inteco_abs.realtime.spool import spool_run
from inteco_abs.sessions import (
    EXIT_CODES,
    LOSSES,
    TICK,
    TRUTH,
    FailoverWriter,
    FileWriter,
    Frames,
    Opener,
    RunEnd,
    RunHeader,
    RunResult,
    current_environment,
    pack_tick,
    profile_source,
    spill_path,
)
from inteco_abs.signals import EXPLANATIONS, Phase, Reason
from inteco_abs.warm_up import CompiledLoops, paying_loops
from inteco_abs.wire import Recording, record_wire

_SLICE_TICKS: Final = 1000
_COMPILED_TICKS: Final = 4000
"""Ticks of a slice that is compiled, in 5 ms."""
_LONGEST_RING_S: Final = 10.0
"""Virtual time that the ring holds at most, more than a stop, should no disk take it: it waits for the disk."""
_PATIENCE_S: Final = 1.0
_REPLAYS: Final = 4
"""Ticks that a replay decides on in Python in the time of one tick here."""


class VirtualRun:
    """An experiment in this process, in virtual time, on the mock board."""

    def __init__(self, config: RigConfig, plan: Plan, pipeline: Pipeline, interrupts: Interrupts) -> None:
        self._config = config
        self._plan = plan
        self._interrupts = interrupts
        self._clock = VirtualClock(config.period_ns)
        self._schedule = Schedule(plan.faults, self._clock.now_ns, plan.seed)
        self._host = FaultyHost(self._schedule, plan.out, lambda name: os.getpid() if name == "recorder" else 0)
        self._pipeline = pipeline
        self._session_id = str(uuid.uuid4())
        longest = round(_LONGEST_RING_S * config.loop.rate_hz)
        capacity = min(ring_ticks(config), longest) + 2 * _SLICE_TICKS
        self._ring = TickRing(pack_tick, TICK.size, capacity)
        self._truths = TickRing(TRUTH.pack_into, TRUTH.size, capacity)
        self._window = Window(self._ring.reader(), self._truths.reader())
        self._made: list[GainChange] = []
        """Changes of gains that are not in the file yet."""
        gains = gains_to_change(pipeline, config, plan.controllers)
        self._changes = GainChanges(config, pipeline, gains, self._made.append)
        self._compile: Callable[[CompiledLoops], Any] | None = None
        self._compiled: Any = None  # the CompiledRun that has the state of board, rig and pipeline now
        self._tried: CompiledLoops | None = None  # not once more: their code is missing until making it pays

    def run(self, progress: RunProgress | None, screen: Screen) -> RunResult:
        plan = self._plan
        with self._host, record_wire(plan.wire, self._config, self._clock.now_ns, keep=plan.frames) as around:
            return self._run(progress, screen, around)

    def _run(self, progress: RunProgress | None, screen: Screen, around: Recording) -> RunResult:
        plan, config = self._plan, self._config
        front_end = self._front_end()
        board = board_behind(around(InProcessLink(front_end)), config, self._clock.now_ns)
        plain = not (plan.faults or plan.frames or plan.wire)  # else frames are looked at, or changed
        plain = plain and config.loop.pace == "computer"  # else the loop's order is another
        self._compile = partial(self._compiled_run, board, front_end) if plain else None
        controller = plan.controllers[config.controller.name]
        spill = spill_path(plan.out, config, self._session_id)
        with FailoverWriter(plan.out, self._opener(controller), self._window.held, spill) as writer:
            try:
                with board:
                    screen.passed(StartCheck.BOARD, f"{plan.board} {board.require_writable()}")
                    watchdog = prove_watchdog(board, config.period_ns, self._wait)
                    writer.write_header(config, self._introduction(board, watchdog), plan.out)
                    screen.passed(StartCheck.RECORDER, str(plan.out))
                    self._drive(writer, board, progress, screen)
            except BaseException as error:
                unsafe = isinstance(error, UnsafeError) and self._ring.written > 0
                if unsafe:
                    screen.warn(str(error))  # before all other messages
                words = str(error) if unsafe else describe_error(error)
                result = self._given_up(writer, replace(self._end(board, words), frames=self._frames(around)), error)
                if result is None or not unsafe:
                    raise
                return result  # as in real time
            return self._conclude(writer, replace(self._end(board), frames=self._frames(around)))

    def _front_end(self) -> FrontEnd:
        arguments = self._config, self._clock.now_ns, self._plan.seed, self._truths.append
        if not self._plan.faults:
            return front_end_of(Device(*arguments))
        return FaultyFrontEnd(
            front_end_of,
            FaultyDevice(*arguments, schedule=self._schedule),
            wait=self._wait,
            pause=lambda seconds: self._clock.oversleep_ns(round(seconds * 1e9)),
            on_exchange=self._host.act,
        )

    def _wait(self, seconds: float) -> None:
        self._clock.pass_ns(round(seconds * 1e9))

    def _opener(self, controller: type[Controller]) -> Opener:
        now_ns = self._clock.now_ns()
        return partial(
            FileWriter,
            start_ns=now_ns,
            internals=quantities(controller.internals),
            gains=[gain.quantity for gain in controller.gains],
            session_id=self._session_id,
            epoch_ns=time.time_ns() - now_ns,
        )

    def _drive(self, writer: FailoverWriter, board: Board, progress: RunProgress | None, screen: Screen) -> None:
        snapshots = SnapshotSource(self._ring.reader(), Histogram(), self._config.loop.rate_hz)
        arguments = board, self._pipeline, self._clock, self._ring, self._interrupts.stop, self._changes
        loop = Loop(*arguments, paced_by_board=self._config.loop.pace == "board")
        self._window.skip_truths()  # truths from opening the board belong to no tick
        try:
            over = False
            while not over:
                with self._interrupts.breaking():
                    over = self._run_slice(loop)
                snapshot = snapshots.look()
                if snapshot is not None:
                    screen.show(snapshot)
                if not over:
                    self._record(writer, last=False)
                    if progress is not None:
                        progress(self._pipeline.phase, self._ring.written)
        finally:
            try:
                try:
                    self._go_on_in_python()
                finally:
                    board.make_safe()  # before anything that takes time or can fail
            finally:
                self._record(writer, last=True)

    def _run_slice(self, loop: Loop) -> bool:
        """Run some ticks; True once the experiment is over. Many of a program are compiled, if no gain changes."""
        if not self._changes.over:
            return loop.run(_SLICE_TICKS)
        loops = self._paying_loops() if self._compiled is None and self._compile is not None else None
        if loops not in {None, self._tried}:
            if not self._ring.written and loop.run(1):  # compiled ticks follow a good exchange
                return True
            self._compiled = self._compile and self._compile(loops)
            if self._compiled is not None:
                self._tried = loops
        if self._compiled is not None and not self._interrupts.stop.requested:
            ticks, truths = self._compiled.run(min(_COMPILED_TICKS, self._window.room - _SLICE_TICKS))
            if ticks:
                return self._take(ticks, truths)
        self._go_on_in_python()
        return loop.run(_SLICE_TICKS)

    def _paying_loops(self) -> CompiledLoops | None:
        key = "run", type(self._pipeline.estimator), type(self._pipeline.machine.controller)
        return paying_loops("inteco_abs.experiment.compiled_run", key, _REPLAYS * _SLICE_TICKS)

    def _compiled_run(self, board: Board, front_end: FrontEnd, loops: CompiledLoops) -> Any:
        """Compiled ticks of this run, or None where they cannot be."""
        try:
            if self._clock.on_time:
                arguments = board, front_end, self._pipeline, self._config.period_ns, loops.may_compile
                return loops.module.CompiledRun(*arguments)
        except ValueError:
            self._compile = None
        return None

    def _take(self, ticks: bytes, truths: bytes) -> bool:
        """Put compiled ticks where the loop puts its own; True once the experiment is over."""
        self._clock.pass_beats(len(ticks) // TICK.size)
        self._ring.extend(ticks)
        self._truths.extend(truths)
        phase = Phase(int(TICK.array(ticks)["phase"][-1]))
        self._pipeline.machine.phase = phase
        return phase in OVER

    def _go_on_in_python(self) -> None:
        compiled, self._compiled = self._compiled, None
        if compiled is not None:
            compiled.resume()

    def _record(self, writer: FailoverWriter, *, last: bool) -> None:
        rows = self._window.more(last=last)
        writer.change(self._made)
        self._made.clear()
        writer.add(*rows)
        if self._window.waiting > self._window.room:
            writer.flush()
            if writer.writing:
                self._window.release(self._window.end)
        if self._window.room < 2 * _SLICE_TICKS:  # a disk that takes nothing ends the run while there is room
            self._interrupts.stop.request(Reason.RECORDER_LOST)

    def _introduction(self, board: Board, watchdog: Mapping[str, str]) -> RunHeader:
        config, plan = self._config, self._plan
        controller = plan.controllers[config.controller.name]
        return RunHeader(
            board=plan.board,
            identity={**board.require_writable().facts(), **watchdog},
            virtual=True,
            gains=gains_in_force(config, plan.controllers),
            internals=quantities(controller.internals),
            declared=[gain.quantity for gain in controller.gains],
            controller_source=plan.controller_source,
            controller_package=plan.controller_package,
            facts=facts_of(config, plan),
            profile=profile_source(config.profile),
            environment=current_environment(),
        )

    def _end(self, board: Board, aborted: str = "") -> RunEnd:
        facts = {"injected": self._schedule.acted()} if self._plan.faults else {}
        return RunEnd(self._pipeline.reason, self._ring.written, detail_of(self._pipeline, board), aborted, facts)

    def _frames(self, around: Recording) -> Frames | None:
        capture = around.capture() if self._plan.frames else None
        return None if capture is None else lambda: nullcontext((capture, capture.records))

    def _given_up(self, writer: FailoverWriter, end: RunEnd, error: BaseException) -> RunResult | None:
        """Save what was recorded until `error`, with notes on it; None if nothing was, or no disk takes it."""
        result = None
        try:
            if self._ring.written:
                result = self._conclude(writer, end)
                error.add_note(f"the session is in {writer.path}")
            else:
                writer.discard()
        except SessionError as second:
            error.add_note(str(second))  # the first error matters
        if self._pipeline.reason is not Reason.NONE:
            error.add_note(f"the run had been stopped: {EXPLANATIONS[self._pipeline.reason]}")
        for fault, times in self._schedule.acted().items():
            error.add_note(f"injected {fault}: acted {times} times")
        return result

    def _conclude(self, writer: FailoverWriter, end: RunEnd) -> RunResult:
        """Finish the file. Raises SessionError naming the shared memory with the ticks if no disk takes them."""
        try:
            return writer.finish(end)
        except SessionError as error:
            raise self._stowed(writer, end, error) from error

    def _stowed(self, writer: FailoverWriter, end: RunEnd, error: SessionError) -> SessionError:
        job = replace(job_of(self._config, self._plan), session_id=self._session_id, virtual=True)
        try:
            ring = spool_run(job, writer.header, end, self._window, writer.path, writer.changes)
        except SessionError as second:
            out, seed = self._plan.out, self._plan.seed
            return SessionError(
                f"{error}; nor can it be kept in memory ({second}). "
                f"The run is lost; --seed {seed} gives the same again once {out}, if it is there, is removed"
            )
        trouble = SessionError(
            f"the run has ended, but {error}. Its ticks are kept in {ring}: inteco-abs recover {ring} --out FILE"
        )
        trouble.exit_code = EXIT_CODES.get(end.outcome, LOSSES)
        return trouble


class Interrupts:
    """Signals only set the stop word, which the loop reads at each tick.

    For a controller that never returns, a signal more than a second after the first one breaks into the loop, but only
    inside `breaking`, so never into switching the outputs off.
    """

    def __init__(self) -> None:
        self.stop = StopFlag()
        self._may_break = False
        self._asked_s = 0.0

    @contextmanager
    def breaking(self) -> Iterator[None]:
        """Allow a second signal to break into the loop."""
        self._may_break = True
        try:
            yield
        finally:
            self._may_break = False

    def handle(self) -> None:
        """Handle one signal."""
        now_s = time.monotonic()
        if not self.stop.requested:
            self._asked_s = now_s
            self.stop.request()
        elif self._may_break and now_s - self._asked_s > _PATIENCE_S:
            raise KeyboardInterrupt("a second signal")
