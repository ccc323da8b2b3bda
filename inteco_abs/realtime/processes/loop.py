"""The loop's process: it owns the board, decides, fills the ring, and does nothing else."""

from __future__ import annotations

import os
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from inteco_abs.boards import Wrap, open_board, simulated
from inteco_abs.control import Controller, build_pipeline, gains_in_force, gains_to_change
from inteco_abs.errors import AbsError
from inteco_abs.format import pack_tick
from inteco_abs.posix import resource
from inteco_abs.quantities import quantities
from inteco_abs.realtime.clock import AwaitedClock, PacedClock
from inteco_abs.realtime.failure_rules import LOOPS_WINDOW_NS
from inteco_abs.realtime.frame_spool import saving_frames
from inteco_abs.realtime.gain_changes import ChangeTable, GainChanges
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.loop import Loop, detail_of
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory
from inteco_abs.realtime.ownership import PATIENCE_S, holding, post_failure, stopped
from inteco_abs.realtime.processes.controller import controllers_of
from inteco_abs.realtime.round_trips import require_rate
from inteco_abs.realtime.tuning import apply, loop_tuning
from inteco_abs.realtime.watchdog import prove_watchdog
from inteco_abs.signals import Reason
from inteco_abs.wire import record_wire

_NONE: Final = Reason.NONE
_STALL_NS: Final = 100_000_000
"""A tick this late is a pause of the computer: five periods of the slowest loop, well within the window."""
_NAP_NS: Final = 50_000_000
"""Length of a nap, shorter than any suspension."""
_STOP, _GUARDIAN_STOP, _GUARDIAN_BEAT = int(Field.STOP), int(Field.GUARDIAN_STOP), int(Field.GUARDIAN_BEAT_NS)
_REASONS: Final = {int(reason): reason for reason in Reason}


def asleep_ns() -> int:
    """Return how long the computer has been suspended so far, ns: only the monotonic clock stands still meanwhile.

    A pause between the two readings makes it less, never more.
    """
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()


class SharedStop:
    """Stops the loop for the supervisor, for the guardian, or if the guardian is silent.

    A suspended computer has missed exchanges, although the loop's clock does not show it.
    """

    def __init__(self, memory: RunMemory, asleep_ns: Callable[[], int] = asleep_ns) -> None:
        self._words = memory.words
        self._asleep_ns = asleep_ns
        self._may_sleep_ns = asleep_ns() + _NAP_NS
        self._before_ns = 0
        self._trusted_ns = 0

    def wanted(self, now_ns: int) -> Reason:
        """Return why the run must end now, or NONE."""
        words = self._words
        word = words[_STOP] or words[_GUARDIAN_STOP]
        if word:
            return _REASONS[word]
        if self._asleep_ns() > self._may_sleep_ns:
            return Reason.MISSED_EXCHANGES
        if now_ns - self._before_ns > _STALL_NS:  # the computer paused, and the guardian with it
            self._trusted_ns = now_ns
        self._before_ns = now_ns
        silent_ns = now_ns - max(words[_GUARDIAN_BEAT], self._trusted_ns)
        return Reason.GUARDIAN_LOST if silent_ns > LOOPS_WINDOW_NS else _NONE


def main(path: str) -> int:
    """Run the job in the memory at `path`; exit code 0 if the run came to an end of any kind."""
    memory = RunMemory.open(Path(path))
    code = 0
    try:
        _run(memory, Job.of(memory))
    except AbsError as error:
        post_failure(memory, Mailbox.FAILURE, error)
        code = error.exit_code
    except BaseException as error:  # noqa: BLE001  the top of a process: its end must explain itself
        traceback.print_exc()
        post_failure(memory, Mailbox.FAILURE, error)
        code = 1
    sys.stderr.flush()
    os._exit(code)  # at once: the guardian may wait for it to take the board


def _run(memory: RunMemory, job: Job) -> None:
    wire = Path(job.wire) if job.wire else None
    with (
        controllers_of(job, memory.path) as controllers,
        record_wire(wire, job.config, keep=job.frames) as around,
        saving_frames(memory, job, around),
    ):
        try:
            _hold(memory, job, around, controllers)
        finally:
            memory.words[Field.SAVING] = bool(job.wire) or job.frames  # with the board closed, and everything posted


def _hold(memory: RunMemory, job: Job, around: Wrap, controllers: Mapping[str, type[Controller]]) -> None:
    config, words = job.config, memory.words
    pipeline = build_pipeline(config, controllers)
    ring = memory.tick_ring(pack_tick)
    controller = controllers[config.controller.name]
    table = ChangeTable(memory, (gain.name for gain in controller.gains))
    gains = gains_to_change(pipeline, config, controllers)
    if config.loop.compiled:
        from inteco_abs.realtime.compiled_pipeline import CompiledPipeline  # noqa: PLC0415  loads numpy and LLVM

        pipeline = CompiledPipeline(config, pipeline)
    changes = GainChanges(config, pipeline, gains, table.record, table)
    by_board = config.loop.pace == "board"
    clock = AwaitedClock() if by_board else PacedClock(config.period_ns)
    cost: dict[str, str] = {}
    with holding(memory), open_board(job.address, config, clock.now_ns, around) as board:
        identity = board.require_writable()
        memory.post(Mailbox.SAFE_IMAGE, board.safe_image)
        loop = Loop(board, pipeline, clock, ring, SharedStop(memory), changes, paced_by_board=by_board)
        settings = apply(loop_tuning())
        pace = {} if simulated(job.board) else require_rate(board, config.period_ns)
        watchdog = prove_watchdog(board, config.period_ns, time.sleep)
        header = {
            "identity": identity.facts() | watchdog,
            "gains": gains_in_force(config, controllers),
            "internals": quantities(controller.internals),
            "declared": [gain.quantity for gain in controller.gains],
            "settings": [setting._asdict() for setting in settings],
            "pace": pace,
        }
        memory.post(Mailbox.HEADER, header)
        words[Field.READY] = os.getpid()
        memory.wait(lambda: words[Field.GO] or stopped(memory), PATIENCE_S)
        if words[Field.GO]:
            cost = _drive(loop, clock) | {"decisions": pipeline.decides_in}
    if cost:
        end = {"reason": int(pipeline.reason), "detail": detail_of(pipeline, board), "cost": cost}
        memory.post(Mailbox.RUN_END, end)


def _drive(loop: Loop, clock: AwaitedClock | PacedClock) -> dict[str, str]:
    """Run the loop; return what it cost this process."""
    before, start = resource.getrusage(resource.RUSAGE_SELF), time.monotonic()
    loop.run()
    after = resource.getrusage(resource.RUSAGE_SELF)
    seconds = max(time.monotonic() - start, 1e-9)
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {
        "minor_page_faults": str(after.ru_minflt - before.ru_minflt),
        "major_page_faults": str(after.ru_majflt - before.ru_majflt),
        "cpu_share": f"{busy / seconds:.3f}",
        "spin_us": f"{clock.spin_ns * 1e-3:.0f}",
    }
