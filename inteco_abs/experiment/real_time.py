"""Runs in real time: shared memory, the mock board's process, and a supervisor for the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from inteco_abs.boards import check_address, check_kind, check_limits, simulated
from inteco_abs.config import RigConfig
from inteco_abs.control import Gain
from inteco_abs.experiment.plan import REAL_TIME, Plan, job_of, require_mock_board, ring_ticks
from inteco_abs.host import as_facts
from inteco_abs.host.doctor import examine
from inteco_abs.mock_board import ON_THE_HOST, Fault, require_possible
from inteco_abs.posix import require_linux
from inteco_abs.realtime import RunMemory, Screen, Tuner
from inteco_abs.realtime.processes.manual import ONLY_WATCHED, ManualClient, slowed
from inteco_abs.realtime.processes.supervisor import Supervisor
from inteco_abs.sessions import TICK, TRUTH, RunResult

_PANEL_RING_S: Final = 30.0
"""After this time without reading ticks, a screen counts as ended."""


def run_in_real_time(config: RigConfig, plan: Plan, screen: Screen, tuner: Tuner, gains: Sequence[Gain]) -> RunResult:
    """Run one experiment in real time; `tuner` changes its `gains`."""
    declared = [gain.name for gain in plan.controllers[config.controller.name].gains]
    doctor = {"doctor": as_facts(examine(plan.out.absolute().parent))}
    with processes(config, plan, ring_ticks(config), doctor) as (memory, supervisor):
        try:
            return supervisor.run(screen, tuner.connected(memory, gains, declared))
        except BaseException:
            if memory.tick_reader().written:
                memory.keep()  # the file may lack some ticks
            raise


@contextmanager
def processes(
    config: RigConfig, plan: Plan, ring_ticks: int, facts: Mapping[str, Mapping[str, str]] | None = None
) -> Iterator[tuple[RunMemory, Supervisor]]:
    """Shared memory with the job in it, the mock board's process, and a supervisor for the rest."""
    memory = RunMemory.create(TICK.size, ring_ticks, TRUTH.size, ring_ticks)
    try:
        job = job_of(config, plan, facts or {})
        if simulated(plan.board):
            job = replace(job, address=f"{plan.board}{memory.socket}")
        job.post(memory)
        supervisor = Supervisor(memory, job)
        try:
            if simulated(plan.board):
                supervisor.spawn("board", "inteco_abs.mock_board_process", str(memory.path))
            yield memory, supervisor
        finally:
            supervisor.end()  # also after an interrupt before its start
    finally:
        memory.remove()


class RoundTrips(NamedTuple):
    """Times of exchanges with a board."""

    times_us: list[float]
    """Times of the exchanges that succeeded."""
    engines: dict[str, str]
    """The link's engine in use, and the times with each engine; empty without a choice."""


def measure_round_trips(config: RigConfig, board: str) -> RoundTrips:
    """Time exchanges of SAFE with the board in a process like the loop's; the outputs stay off.

    Raises BoardError if the board cannot be opened or does not answer.
    """
    check_address(board)
    check_kind(board, config)
    require_linux(REAL_TIME)
    with processes(config, Plan(Path(), board, virtual=False), ring_ticks=1) as (_, supervisor):
        return RoundTrips(**supervisor.ask("trips"))


def manual_checks(
    config: RigConfig, board: str, faults: Sequence[Fault] = (), *, outputs: bool = True
) -> Iterator[Callable[[], object]]:
    """Checks before a board is opened for manual control; each raises AbsError if it fails."""
    yield partial(check_address, board)
    yield partial(check_kind, board, config)
    if outputs:
        yield partial(check_limits, board, config)
    if faults:
        yield partial(_check_manual_faults, config, board, faults)
    yield partial(require_linux, REAL_TIME)


@contextmanager
def manual_control(
    config: RigConfig, board: str, *, outputs: bool, faults: tuple[Fault, ...] = ()
) -> Iterator[ManualClient]:
    """Control a board from another process, with outputs or for reading only.

    `faults` are injected into the mock board. Leaving the context ends with SAFE, read back. Raises ReadOnlyError if
    the profile does not allow outputs, BoardError if the board cannot be opened or its process died, UnsafeError if
    SAFE was not confirmed.
    """
    for condition in manual_checks(config, board, faults, outputs=outputs):
        condition()
    config = slowed(config)
    if not outputs:
        because = config.board.read_only or ONLY_WATCHED
        config = replace(config, board=replace(config.board, read_only=because))
    ring_ticks = round(_PANEL_RING_S * config.loop.rate_hz)
    with (
        processes(config, Plan(Path(), board, virtual=False, faults=faults), ring_ticks) as (memory, supervisor),
        supervisor.manual_control(drill=outputs),
    ):
        yield ManualClient(memory)


def _check_manual_faults(config: RigConfig, board: str, faults: Sequence[Fault]) -> None:
    require_mock_board(board)
    impossible = dict.fromkeys(ON_THE_HOST, "the panel records nothing; use inteco-abs run --inject")
    require_possible(faults, config.board.kind, impossible)
