"""One braking stop from start to file: puts board, loop, pipeline and recorder together."""

from __future__ import annotations

import hashlib
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from inteco_abs.boards import Board, InProcessLink, RtdacUsb2, check_address
from inteco_abs.config import RigConfig
from inteco_abs.control import CONTROLLERS, Controller, build_pipeline, gains_in_force
from inteco_abs.errors import ReadOnlyError, SessionError
from inteco_abs.mock_board import Device, Truth, Usb2Face
from inteco_abs.realtime import Clock, Loop, PacedClock, StopWord, TickRing, VirtualClock
from inteco_abs.rig import RigParameters
from inteco_abs.sessions import CONFIG_NAME, TICK, TRUTH, Recorder, check_output, pack_tick, result_card
from inteco_abs.sessions.provenance import controller_facts, host_facts, software_facts
from inteco_abs.signals import EXPLANATIONS, Phase, Reason

_SLICE_TICKS: Final = 1000
_SPARE_S: Final = 2.0
_PATIENCE_S: Final = 1.0
_ENDING: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGXCPU")
"""Signals that would otherwise end or stop the program with its outputs on."""

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
    """Source of a controller that does not ship, kept in the session."""


@dataclass(frozen=True, slots=True)
class Stop:
    """How a run ended."""

    outcome: str
    """`completed`, `interrupted` or `fault`."""
    reason: Reason
    explanation: str
    card: dict[str, Any]

    @property
    def exit_code(self) -> int:
        """5 safety stop, 130 interrupted, 3 done with overruns, 0 done."""
        codes = {"fault": 5, "interrupted": 130}
        return codes.get(self.outcome, 3 if self.card["overruns"] or self.card["link_errors"] else 0)


def run_stop(config: RigConfig, plan: Plan, progress: Progress | None = None) -> Stop:
    """Run one experiment and record it at `plan.out`.

    SIGINT, SIGTERM and their like end it at the next tick, with SAFE and a complete file. Raises ConfigError or
    BoardError if it cannot start, and then leaves no file; BoardError also if SAFE could not be confirmed.
    """
    check_address(plan.board)
    check_output(plan.out)
    # a controller's prints must not mix with the result card
    with _Interrupts() as interrupts, redirect_stdout(sys.stderr):
        return _Experiment(config, plan, interrupts).run(progress)


class _Experiment:
    def __init__(self, config: RigConfig, plan: Plan, interrupts: _Interrupts) -> None:
        self._config = config
        self._plan = plan
        self._interrupts = interrupts
        self._clock: Clock = VirtualClock(config.period_ns) if plan.virtual else PacedClock(config.period_ns)
        self._truths: list[Truth] = []
        self._ticks = bytearray()
        self._truth_rows = bytearray()
        self._pipeline = build_pipeline(config, plan.controllers)
        self._ring = TickRing(pack_tick, TICK.size, _longest_run(config))

    def run(self, progress: Progress | None) -> Stop:
        face = Usb2Face(Device(self._config, self._clock.now_ns, self._plan.seed, self._truths.append))
        board = RtdacUsb2(InProcessLink(face), self._config.board, self._clock.now_ns, self._config.period_ns)
        controller = self._plan.controllers[self._config.controller.name]
        with Recorder(self._plan.out, self._clock.now_ns(), controller.internals) as recorder:
            try:
                with board:
                    self._introduce(recorder, board)
                    self._drive(recorder, board, progress)
            except BaseException as error:
                try:
                    self._give_up(recorder, board, error)
                    if self._pipeline.reason is not Reason.NONE:
                        error.add_note(f"the run had been stopped: {EXPLANATIONS[self._pipeline.reason]}")
                except SessionError as second:
                    error.add_note(str(second))  # the first error is what matters
                raise
            return self._conclude(recorder, board)

    def _drive(self, recorder: Recorder, board: Board, progress: Progress | None) -> None:
        loop = Loop(board, self._pipeline, self._clock, self._ring, self._interrupts.stop)
        self._truths.clear()  # what the device saw while it was opened belongs to no tick
        # in real time nothing may come between two ticks: the ring holds the whole run, and is read afterwards
        most = _SLICE_TICKS if self._plan.virtual else None
        try:
            over = False
            while not over:
                with self._interrupts.breaking():
                    over = loop.run(most)
                if not over:
                    self._record(recorder)
                    if progress is not None:
                        progress(self._pipeline.phase, self._ring.written)
        finally:
            try:
                board.make_safe()  # before anything that takes time or can fail
            finally:
                self._record(recorder)

    def _record(self, recorder: Recorder) -> None:
        records = self._ring.take()
        recorder.ticks(records)
        self._ticks += records
        # the write that made the outputs safe was the last one and belongs to no tick
        truths = self._truths[: len(records) // TICK.size]
        self._truths.clear()
        recorder.truths(truths)
        self._truth_rows += b"".join(map(TRUTH.pack, truths))

    def _introduce(self, recorder: Recorder, board: Board) -> None:
        """Everything that explains the run, on the disk before the first tick."""
        config, plan = self._config, self._plan
        identity = board.identity
        if identity is None or identity.read_only_because:
            raise ReadOnlyError(_refusal(board))
        gains = gains_in_force(config, plan.controllers)
        parameters = RigParameters.named(config.model.parameters)
        recorder.describe("software", {**software_facts(), "seed": str(plan.seed)})
        recorder.describe("host", host_facts())
        recorder.describe(
            "rig",
            {
                "board": plan.board,
                "logic_version": f"0x{identity.logic_version:04X}",
                "application_name": identity.application_name,
                "synthesis_date": identity.synthesis_date,
                "profile": config.profile,
                "counts_per_turn": str(config.encoders.counts_per_turn),
                "r1_m": repr(parameters.r1),
                "r2_m": repr(parameters.r2),
                "parameters": config.model.parameters,
                "simulated": "true",
                "virtual_time": str(plan.virtual).lower(),
            },
        )
        source = hashlib.sha256(plan.controller_source).hexdigest() if plan.controller_source else ""
        recorder.describe("controller", controller_facts(config, gains, source))
        recorder.attach(CONFIG_NAME, "application/toml", config.to_toml().encode())
        if plan.controller_source:
            recorder.attach("controller.py", "text/x-python", plan.controller_source)
        recorder.begin({"reference_slip": config.controller.reference_slip, **gains})

    def _conclude(self, recorder: Recorder, board: Board) -> Stop:
        reason, error = self._pipeline.reason, self._pipeline.error
        outcome = {Reason.NONE: "completed", Reason.OPERATOR_STOP: "interrupted"}.get(reason, "fault")
        explanation = EXPLANATIONS[reason]
        if error is not None:
            explanation += f": {_in_words(error)}"
        elif reason is Reason.MISSED_EXCHANGES and board.last_error is not None:
            explanation += f": {board.last_error}"
        card = self._card(outcome, recorder, board)
        recorder.finish(outcome, explanation, card)
        return Stop(outcome, reason, explanation, card)

    def _give_up(self, recorder: Recorder, board: Board, error: BaseException) -> None:
        if not self._ring.written:
            recorder.discard()
            return
        recorder.finish("aborted", _in_words(error), self._card("aborted", recorder, board))

    def _card(self, outcome: str, recorder: Recorder, board: Board) -> dict[str, Any]:
        metrics = result_card(
            self._config, TICK.array(bytes(self._ticks)), np.frombuffer(bytes(self._truth_rows), TRUTH.dtype)
        )
        return {
            "schema_version": 1,
            "session": str(self._plan.out),
            "outcome": outcome,
            "reason": self._pipeline.reason.name,
            "board": self._plan.board,
            **metrics,
            "lost_ticks": self._ring.written - metrics["ticks"],
            "link_errors": board.link_errors,
            "payload_sha256": recorder.payload_sha256,
        }


def _longest_run(config: RigConfig) -> int:
    """Ticks that the longest possible experiment can have."""
    plan = config.experiment
    longest_s = 2.0 * plan.idle_s + plan.spin_up_timeout_s + plan.braking_timeout_s + plan.hold_s + _SPARE_S
    return round(longest_s * config.loop.rate_hz)


def _refusal(board: Board) -> str:
    because = board.identity.read_only_because if board.identity else "it was not identified"
    return (
        f"the board ({board.identity}) opens for reading only: {because}. "
        "Copy the profile, complete it on your rig, sign it with board.verified_by and name it in rig.toml"
    )


def _in_words(error: BaseException) -> str:
    """Type, text and place of an error, for people who wrote the code that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{place}"


class _Interrupts:
    """While inside, the signals that would end the program set the stop word, and do nothing else.

    One exception, for a controller that never returns: where the run allows it (`breaking`), a signal that comes
    a second after the first unanswered one breaks into the loop. It cannot break into what makes the outputs safe.
    """

    def __init__(self) -> None:
        self.stop = StopWord()
        self._may_break = False
        self._asked_s = 0.0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():  # Python delivers signals to no other
            wanted = [getattr(signal, name) for name in _ENDING if hasattr(signal, name)]
            self._before = {number: signal.signal(number, self._handle) for number in wanted}
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def breaking(self) -> Iterator[None]:
        """The loop is running, and may be broken into."""
        self._may_break = True
        try:
            yield
        finally:
            self._may_break = False

    def _handle(self, *_: object) -> None:
        now_s = time.monotonic()
        if not self.stop.requested:
            self._asked_s = now_s
            self.stop.request()
        elif self._may_break and now_s - self._asked_s > _PATIENCE_S:
            raise KeyboardInterrupt("a second signal")
