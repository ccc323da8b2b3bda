"""One experiment from start to file: puts board, loop, pipeline and recorder together, in virtual or in real time."""

from __future__ import annotations

import os
import sys
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from inteco_abs.boards import Board, InProcessLink, board_behind, check_address, check_kind, check_limits, simulated
from inteco_abs.config import RigConfig
from inteco_abs.control import CONTROLLERS, Controller, Pipeline, build_pipeline, gains_in_force
from inteco_abs.errors import BoardError, ConfigError, ConfigIssue, SessionError, UnsafeError, in_words
from inteco_abs.host.checks import as_facts
from inteco_abs.host.doctor import examine
from inteco_abs.mock_board import (
    BY_PROCESS,
    CLOCK_STEP,
    ON_THE_HOST,
    Device,
    Fault,
    FaultyDevice,
    FaultyFrontEnd,
    FaultyHost,
    FrontEnd,
    Schedule,
    drawn_facts,
    face_of,
    require_possible,
)
from inteco_abs.realtime import Loop, StopWord, TickRing, VirtualClock
from inteco_abs.realtime.foxglove_server import require_foxglove
from inteco_abs.realtime.histogram import Histogram
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.loop import detail_of
from inteco_abs.realtime.memory import RunMemory
from inteco_abs.realtime.processes.manual import ONLY_WATCHED, ManualClient, slowed
from inteco_abs.realtime.processes.supervisor import Supervisor
from inteco_abs.realtime.screen import Check, NoScreen, SafeScreen, Screen, SnapshotSource
from inteco_abs.realtime.signal_handlers import hearing
from inteco_abs.realtime.spool import stow
from inteco_abs.realtime.watchdog import prove_watchdog
from inteco_abs.realtime.window import Window
from inteco_abs.sessions import (
    EXIT_CODES,
    LOSSES,
    TICK,
    TRUTH,
    FailoverWriter,
    FileWriter,
    Frames,
    RunEnd,
    RunHeader,
    RunResult,
    check_output,
    check_spill,
    pack_tick,
    spill_path,
)
from inteco_abs.sessions.environment import surroundings
from inteco_abs.sessions.failover_writer import Opener
from inteco_abs.sessions.provenance import host_facts, profile_source, software_facts
from inteco_abs.signals import EXPLANATIONS, Phase, Reason
from inteco_abs.wire.capture import check_target
from inteco_abs.wire.recording import Recording, check_recordable, recording

_SLICE_TICKS: Final = 1000
_SPARE_S: Final = 2.0
_PATIENCE_S: Final = 1.0
_LONGEST_RING_S: Final = 60.0
"""Memory of several stops goes round: what is older is in the file. For so long a disk may take nothing; a run without
recorder ends within a second. Every process of the run has all of it mapped: 38 MB at 2 kHz."""
_SHORTEST_RING_S: Final = 4.0
"""Long enough for the recorder to be found dead and the run to end before the ring is full."""
_PANEL_RING_S: Final = 30.0
"""A screen that takes no ticks for so long is gone."""

Progress = Callable[[Phase, int], None]
"""Told the phase and the number of ticks so far, between slices of a virtual run."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be done: everything that the configuration does not say."""

    out: Path
    board: str = "sim:"
    virtual: bool = True
    seed: int = 0
    controllers: Mapping[str, type[Controller]] = field(default_factory=lambda: CONTROLLERS)
    controller_source: bytes = b""
    """Source of a controller that does not ship, kept in the session; in real time it runs in another process."""
    wire: Path | None = None
    """Capture to write: everything that passes between host and board."""
    frames: bool = False
    """Whether all that goes into the session, too."""
    controller_package: str = ""
    """Name and version of the installed package that the controller comes from; empty if from none."""
    live_port: int | None = None
    """Where to serve a real-time run to viewers on this computer; 0 for any port that is free, None for not at all."""
    faults: tuple[Fault, ...] = ()
    """What the mock board does wrong."""


def run_stop(
    config: RigConfig, plan: Plan, progress: Progress | None = None, screen: Screen | None = None
) -> RunResult:
    """Run one experiment and record it at `plan.out`; `screen` shows it, in real time ten times a second.

    SIGINT, SIGTERM and their like end it at the next tick, with SAFE and a complete file. Raises ConfigError or
    BoardError if it cannot start, and then leaves no file. A run that ends without SAFE having been confirmed is told
    as `aborted`, with a warning on the screen; by UnsafeError only if there is no session of it.
    """
    check_output(plan.out)
    for condition in conditions(config, plan):
        condition()
    # a controller's prints must not mix with the result card
    with redirect_stdout(sys.stderr):
        pipeline = build_pipeline(config, plan.controllers)
        if not plan.virtual:
            return _run_in_real_time(config, plan, screen or NoScreen())
        interrupts, screen = _Interrupts(), SafeScreen(screen or NoScreen())
        with hearing(interrupts.handle), screen.listening(interrupts.handle):
            return _VirtualRun(config, plan, pipeline, interrupts).run(progress, screen)


def conditions(config: RigConfig, plan: Plan) -> Iterator[Callable[[], object]]:
    """What has to hold before anything is opened, besides a place for the session; each raises AbsError if not."""
    yield partial(check_address, plan.board)
    yield partial(check_kind, plan.board, config)
    yield partial(check_limits, plan.board, config)
    yield partial(_check_time, config, plan)
    if plan.faults:
        yield partial(_check_faults, config, plan)
    if plan.live_port is not None:
        yield partial(_check_live, plan.live_port, virtual=plan.virtual)
    yield partial(check_spill, config)
    if plan.frames:
        yield partial(check_recordable, "--frames", config)
    if plan.wire is not None:
        yield partial(check_target, plan.wire)


def _check_time(config: RigConfig, plan: Plan) -> None:
    """Whether the run can take place in the time that it asks for."""
    if not plan.virtual:
        _insist_on_linux()
        _insist_on_origin(config, plan)
    elif not simulated(plan.board):
        raise ConfigError(
            [ConfigIssue("--virtual", f"{plan.board} is a real board, and real boards have their own time")]
        )


def _check_faults(config: RigConfig, plan: Plan) -> None:
    _insist_on_mock_board(plan.board)
    if plan.virtual:
        impossible = dict.fromkeys(BY_PROCESS, "a run in virtual time has no such process; leave --virtual out")
    else:
        impossible = {CLOCK_STEP: "nobody's real clock is set; add --virtual"}
    impossible["alarm"] = "a run reads no such flags; inteco-abs panel --inject shows them"
    require_possible(plan.faults, config.board.kind, impossible)


def _check_faults_by_hand(config: RigConfig, board: str, faults: Sequence[Fault]) -> None:
    _insist_on_mock_board(board)
    impossible = dict.fromkeys(ON_THE_HOST, "the panel records nothing; inteco-abs run --inject has this")
    require_possible(faults, config.board.kind, impossible)


def _insist_on_mock_board(board: str) -> None:
    if not simulated(board):
        problem = f"{board} is a real board, and breaks by itself; only sim: can be told"
        raise ConfigError([ConfigIssue("--inject", problem)])


def _insist_on_origin(config: RigConfig, plan: Plan) -> None:
    if config.controller.name not in CONTROLLERS and not (plan.controller_source or plan.controller_package):
        problem = (
            f"{config.controller.name!r}: in real time a controller must come from a file, as file.py:Class, "
            "or from an installed package"
        )
        raise ConfigError([ConfigIssue("controller.name", problem)])


def _check_live(port: int, *, virtual: bool) -> None:
    if virtual:
        problem = "a run in virtual time is over before anybody could look; leave one of the two out"
        raise ConfigError([ConfigIssue("--foxglove", f"{problem}, or open the session file in the viewer")])
    require_foxglove(port)


class RoundTrips(NamedTuple):
    """How long exchanges with a board take."""

    times_us: list[float]
    """Of those that succeeded."""
    engines: dict[str, str]
    """Which of the link's engines is in use, and how long exchanges took with each; empty if there is no choice."""


def measure_round_trips(config: RigConfig, board: str) -> RoundTrips:
    """Exchange SAFE with the board in a process like the loop's; nothing is energised.

    Raises BoardError if the board cannot be opened or does not answer.
    """
    check_address(board)
    check_kind(board, config)
    _insist_on_linux()
    with _processes(config, Plan(Path(), board, virtual=False), ring_ticks=1) as (_, supervisor):
        return RoundTrips(**supervisor.ask("trips"))


def conditions_by_hand(
    config: RigConfig, board: str, faults: Sequence[Fault] = (), *, outputs: bool = True
) -> Iterator[Callable[[], object]]:
    """What has to hold before a board is opened for a screen; each raises AbsError if not."""
    yield partial(check_address, board)
    yield partial(check_kind, board, config)
    if outputs:
        yield partial(check_limits, board, config)
    if faults:
        yield partial(_check_faults_by_hand, config, board, faults)
    yield _insist_on_linux


@contextmanager
def by_hand(config: RigConfig, board: str, *, outputs: bool, faults: tuple[Fault, ...] = ()) -> Iterator[ManualClient]:
    """A board held by a process of its own, for a screen or a program: entered for output, or only to be read.

    `faults` are what the mock board does wrong. Leaving ends with SAFE, read back. Raises ReadOnlyError if outputs are
    wanted of a board that the profile does not trust, BoardError if it cannot be opened or its process has died,
    UnsafeError if SAFE was not confirmed.
    """
    for condition in conditions_by_hand(config, board, faults, outputs=outputs):
        condition()
    config = slowed(config)
    told = config if outputs else _only_read(config)
    ring_ticks = round(_PANEL_RING_S * config.loop.rate_hz)
    with (
        _processes(told, Plan(Path(), board, virtual=False, faults=faults), ring_ticks) as (memory, supervisor),
        supervisor.by_hand(drill=outputs),
    ):
        yield ManualClient(memory)


def _only_read(config: RigConfig) -> RigConfig:
    because = config.board.read_only or ONLY_WATCHED
    return replace(config, board=replace(config.board, read_only=because))


def _insist_on_linux() -> None:
    if not sys.platform.startswith("linux"):
        raise BoardError(f"real time needs Linux, and this is {sys.platform}; use --virtual")


def _run_in_real_time(config: RigConfig, plan: Plan, screen: Screen) -> RunResult:
    doctor = {"doctor": as_facts(examine(plan.out.absolute().parent))}
    with _processes(config, plan, ring_ticks(config), doctor) as (memory, supervisor):
        try:
            return supervisor.run(screen)
        except BaseException:
            if memory.tick_reader().written:
                memory.keep()  # the file may not have them all
            raise


@contextmanager
def _processes(
    config: RigConfig, plan: Plan, ring_ticks: int, facts: Mapping[str, Mapping[str, str]] | None = None
) -> Iterator[tuple[RunMemory, Supervisor]]:
    """Shared memory with the job in it, the mock board's process, and a supervisor for the rest."""
    memory = RunMemory.create(TICK.size, ring_ticks, TRUTH.size, ring_ticks)
    try:
        job = _job(config, plan, facts or {})
        if simulated(plan.board):
            job = replace(job, address=f"{plan.board}{memory.socket}")
        job.post(memory)
        supervisor = Supervisor(memory, job)
        try:
            if simulated(plan.board):
                supervisor.spawn("board", "inteco_abs.mock_board_process", str(memory.path))
            yield memory, supervisor
        finally:
            supervisor.end()  # its own work may not have begun when an interrupt comes
    finally:
        memory.remove()


def _job(config: RigConfig, plan: Plan, facts: Mapping[str, Mapping[str, str]] = MappingProxyType({})) -> Job:
    return Job(
        out=str(plan.out.absolute()),
        session=str(plan.out),
        board=plan.board,
        address=plan.board,
        seed=plan.seed,
        session_id=str(uuid.uuid4()),
        config=config,
        controller_source=plan.controller_source,
        controller_package=plan.controller_package,
        facts={**_facts(config, plan), **facts},
        wire=str(plan.wire.absolute()) if plan.wire else "",
        frames=plan.frames,
        profile=profile_source(config.profile),
        live_port=plan.live_port,
        faults=tuple(map(str, plan.faults)),
    )


class _VirtualRun:
    """An experiment in this process, in virtual time, on the mock board."""

    def __init__(self, config: RigConfig, plan: Plan, pipeline: Pipeline, interrupts: _Interrupts) -> None:
        self._config = config
        self._plan = plan
        self._interrupts = interrupts
        self._clock = VirtualClock(config.period_ns)
        self._schedule = Schedule(plan.faults, self._clock.now_ns, plan.seed)
        self._host = FaultyHost(self._schedule, plan.out, lambda name: os.getpid() if name == "recorder" else 0)
        self._pipeline = pipeline
        self._session_id = str(uuid.uuid4())
        capacity = ring_ticks(config) + 2 * _SLICE_TICKS
        self._ring = TickRing(pack_tick, TICK.size, capacity)
        self._truths = TickRing(TRUTH.pack_into, TRUTH.size, capacity)
        self._window = Window(self._ring.reader(), self._truths.reader())

    def run(self, progress: Progress | None, screen: Screen) -> RunResult:
        plan = self._plan
        with self._host, recording(plan.wire, self._config, self._clock.now_ns, keep=plan.frames) as around:
            return self._run(progress, screen, around)

    def _run(self, progress: Progress | None, screen: Screen, around: Recording) -> RunResult:
        plan, config = self._plan, self._config
        board = board_behind(around(InProcessLink(self._face())), config, self._clock.now_ns)
        controller = plan.controllers[config.controller.name]
        with FailoverWriter(plan.out, self._opener(controller), self._window.held, self._spill()) as keeper:
            try:
                with board:
                    screen.passed(Check.BOARD, f"{plan.board} {board.insist()}")
                    watchdog = prove_watchdog(board, config.period_ns, self._wait)
                    keeper.introduce(config, self._introduction(board, watchdog), plan.out)
                    screen.passed(Check.RECORDER, str(plan.out))
                    self._drive(keeper, board, progress, screen)
            except BaseException as error:
                unsafe = isinstance(error, UnsafeError) and self._ring.written > 0
                if unsafe:
                    screen.warn(str(error))  # before all else that is told
                words = str(error) if unsafe else in_words(error)
                account = self._given_up(keeper, replace(self._end(board, words), frames=self._frames(around)), error)
                if account is None or not unsafe:
                    raise
                return account  # as in real time
            return self._conclude(keeper, replace(self._end(board), frames=self._frames(around)))

    def _face(self) -> FrontEnd:
        told = self._config, self._clock.now_ns, self._plan.seed, self._truths.append
        if not self._plan.faults:
            return face_of(Device(*told))
        return FaultyFrontEnd(
            face_of,
            FaultyDevice(*told, schedule=self._schedule),
            wait=self._wait,
            pause=lambda seconds: self._clock.oversleep_ns(round(seconds * 1e9)),
            begun=self._host.act,
        )

    def _wait(self, seconds: float) -> None:
        self._clock.pass_ns(round(seconds * 1e9))

    def _opener(self, controller: type[Controller]) -> Opener:
        now_ns = self._clock.now_ns()
        return partial(
            FileWriter,
            start_ns=now_ns,
            controller_internals=controller.internals,
            session_id=self._session_id,
            epoch_ns=time.time_ns() - now_ns,
        )

    def _spill(self) -> Path | None:
        return spill_path(self._plan.out, self._config, self._session_id)

    def _drive(self, keeper: FailoverWriter, board: Board, progress: Progress | None, screen: Screen) -> None:
        onlooker = SnapshotSource(self._ring.reader(), Histogram(), self._config.loop.rate_hz)
        loop = Loop(board, self._pipeline, self._clock, self._ring, self._interrupts.stop)
        self._window.skip_truths()  # what the device saw while it was opened belongs to no tick
        try:
            over = False
            while not over:
                with self._interrupts.breaking():
                    over = loop.run(_SLICE_TICKS)
                snapshot = onlooker.look()
                if snapshot is not None:
                    screen.show(snapshot)
                if not over:
                    self._record(keeper)
                    if progress is not None:
                        progress(self._pipeline.phase, self._ring.written)
        finally:
            try:
                board.make_safe()  # before anything that takes time or can fail
            finally:
                self._record(keeper)

    def _record(self, keeper: FailoverWriter) -> None:
        keeper.add(*self._window.more())
        if self._window.waiting > self._window.room:
            keeper.flush()
            if keeper.writing:
                self._window.release()
        if self._window.room < 2 * _SLICE_TICKS:  # as in real time: what no disk takes ends the run while there is room
            self._interrupts.stop.request(Reason.RECORDER_LOST)

    def _introduction(self, board: Board, watchdog: Mapping[str, str]) -> RunHeader:
        config, plan = self._config, self._plan
        return RunHeader(
            board=plan.board,
            identity={**board.insist().facts(), **watchdog},
            virtual=True,
            gains=gains_in_force(config, plan.controllers),
            internals=plan.controllers[config.controller.name].internals,
            controller_source=plan.controller_source,
            controller_package=plan.controller_package,
            facts=_facts(config, plan),
            profile=profile_source(config.profile),
            surroundings=surroundings(),
        )

    def _end(self, board: Board, aborted: str = "") -> RunEnd:
        facts = {"injected": self._schedule.told()} if self._plan.faults else {}
        return RunEnd(self._pipeline.reason, self._ring.written, detail_of(self._pipeline, board), aborted, facts)

    def _frames(self, around: Recording) -> Frames | None:
        capture = around.capture() if self._plan.frames else None
        return None if capture is None else lambda: nullcontext((capture, capture.records))

    def _given_up(self, keeper: FailoverWriter, end: RunEnd, error: BaseException) -> RunResult | None:
        """What was recorded until `error`, which is told the rest; None if nothing was, or no disk takes it."""
        account = None
        try:
            if self._ring.written:
                account = self._conclude(keeper, end)
                error.add_note(f"the session is in {keeper.path}")
            else:
                keeper.discard()
        except SessionError as second:
            error.add_note(str(second))  # the first error is what matters
        if self._pipeline.reason is not Reason.NONE:
            error.add_note(f"the run had been stopped: {EXPLANATIONS[self._pipeline.reason]}")
        for fault, times in self._schedule.told().items():
            error.add_note(f"injected {fault}: acted {times} times")
        return account

    def _conclude(self, keeper: FailoverWriter, end: RunEnd) -> RunResult:
        """As the keeper does; what no disk takes is left in memory, and said where, as a SessionError."""
        try:
            return keeper.conclude(end)
        except SessionError as error:
            raise self._stowed(keeper, end, error) from error

    def _stowed(self, keeper: FailoverWriter, end: RunEnd, error: SessionError) -> SessionError:
        job = replace(_job(self._config, self._plan), session_id=self._session_id, virtual=True)
        try:
            ring = stow(job, keeper.introduction, end, self._window, keeper.path)
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


def _facts(config: RigConfig, plan: Plan) -> dict[str, dict[str, str]]:
    facts = {"software": {**software_facts(), "seed": str(plan.seed)}, "host": host_facts()}
    drawn = drawn_facts(config) if simulated(plan.board) else {}
    return {**facts, "drawn_rig": drawn} if drawn else facts


def ring_ticks(config: RigConfig) -> int:
    """Ticks that the ring is to hold: all of the longest possible run, up to a minute, if nothing else is asked for."""
    whole_s = min(config.experiment.longest_s + _SPARE_S, _LONGEST_RING_S)
    seconds = max(config.loop.ring_s, _SHORTEST_RING_S) if config.loop.ring_s else whole_s
    return round(seconds * config.loop.rate_hz)


class _Interrupts:
    """Signals that would end the program set the stop word, and do nothing else.

    One exception, for a controller that never returns: where the run allows it (`breaking`), a signal that comes
    a second after the first unanswered one breaks into the loop. It cannot break into what makes the outputs safe.
    """

    def __init__(self) -> None:
        self.stop = StopWord()
        self._may_break = False
        self._asked_s = 0.0

    @contextmanager
    def breaking(self) -> Iterator[None]:
        """The loop is running, and may be broken into."""
        self._may_break = True
        try:
            yield
        finally:
            self._may_break = False

    def handle(self) -> None:
        """One signal has come."""
        now_s = time.monotonic()
        if not self.stop.requested:
            self._asked_s = now_s
            self.stop.request()
        elif self._may_break and now_s - self._asked_s > _PATIENCE_S:
            raise KeyboardInterrupt("a second signal")
