"""The recorder's process: it drains the rings into the session file, and completes it however the run ends.

The rings hold what is not in the file yet, so neither its death nor a full disk loses anything: `rebuild` makes the
file again.
"""

from __future__ import annotations

import json
import os
import time
import traceback
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, Final

from inteco_abs.boards import STILL_ON
from inteco_abs.config import parse_config
from inteco_abs.errors import AbsError, SessionError
from inteco_abs.quantities import quantities
from inteco_abs.realtime.alarm import Alarm
from inteco_abs.realtime.frame_spool import spooled_frames
from inteco_abs.realtime.gain_changes import ChangeTable
from inteco_abs.realtime.heartbeat import beating
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.live_view import LiveView, live_view
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory, alive
from inteco_abs.realtime.ownership import post_failure
from inteco_abs.realtime.tuning import apply, recorder_tuning
from inteco_abs.realtime.window import Window
from inteco_abs.sessions import (
    TICK,
    Environment,
    FailoverWriter,
    FileWriter,
    Opener,
    RunEnd,
    RunHeader,
    RunResult,
    SessionWriter,
    atomic_write,
    check_output,
    current_environment,
    joined,
    opened,
    require_own_file,
    spill_path,
    stored_rows,
)
from inteco_abs.signals import Reason

_DRAIN_S: Final = 0.005
_FLUSH_S: Final = 0.1
_RESCUE_S: Final = 20.0
"""The guardian tries for 5 s, and the supervisor in its place after that."""
_LONGEST_START_S: Final = 120.0


def main(path: str) -> int:
    """Record the run in the memory at `path`."""
    memory = RunMemory.open(Path(path))
    memory.name(Field.RECORDER_PID, os.getpid())
    apply(recorder_tuning())
    job = Job.of(memory)
    try:
        with live_view(memory, job) as view:
            _record(memory, job, view)
    except AbsError as error:
        post_failure(memory, Mailbox.RECORDER_FAILURE, error)
        return error.exit_code
    except Exception as error:  # noqa: BLE001  the top of a process: its end must explain itself
        traceback.print_exc()
        post_failure(memory, Mailbox.RECORDER_FAILURE, error)
        return 1
    if not alive(memory.words[Field.SUPERVISOR_PID]):
        memory.remove()  # in the supervisor's place: the file holds everything
    return 0


def _record(memory: RunMemory, job: Job, view: LiveView) -> None:
    words = memory.words
    memory.wait(lambda: words[Field.READY] == words[Field.LOOP_PID] != 0 or _nobody_drives(memory), _LONGEST_START_S)
    header = _header(memory, job)
    if header is None:
        return  # there was no run
    opener = _opener(memory, job, header, time.monotonic_ns())
    spill = spill_path(job.path, job.config, job.session_id)
    window = Window(memory.tick_reader(), memory.truth_reader())
    with FailoverWriter(job.path, opener, window.held, spill, _Troubles(memory, view).report) as writer:
        writer.write_header(job.config, header, Path(job.session))
        window.skip_truths()  # states from before the first tick
        words[Field.RECORDER_BEAT_NS] = time.monotonic_ns()
        # a thread beats, as the disk may take seconds, for which the rings have room
        with beating(memory, Field.RECORDER_BEAT_NS, _FLUSH_S), ThreadPoolExecutor(1) as pool:
            words[Field.RECORDING] = 1
            environment = pool.submit(current_environment)  # takes tenths of a second, in which ticks come
            _Drain(memory, window, writer, environment, view, change_table(memory, header)).until_the_end()
            if not writer.ticks:
                writer.discard()
                return
            result = writer.finish(replace(run_end(memory), frames=spooled_frames(memory, job)))
            view.finish(result.card)
    memory.post(Mailbox.RESULT, asdict(result) | {"reason": int(result.reason)})


def _opener(memory: RunMemory, job: Job, header: RunHeader, start_ns: int) -> Opener:
    return partial(
        FileWriter,
        start_ns=start_ns,
        internals=header.internals,
        gains=header.declared,
        session_id=job.session_id,
        epoch_ns=memory.words[Field.EPOCH_NS],
        durable=True,
    )


class _Troubles:
    """Posts trouble with the disks for the supervisor to show."""

    def __init__(self, memory: RunMemory, view: LiveView) -> None:
        self._memory, self._view = memory, view
        self._texts: list[str] = []

    def report(self, text: str, path: Path) -> None:
        """Add one trouble; the session's file is at `path` now."""
        self._texts.append(text)
        self._view.warn(text)
        self._memory.post(Mailbox.TROUBLES, {"texts": self._texts, "file": str(path)})
        self._memory.words[Field.TROUBLES] = len(self._texts)


class _Drain:
    """Moves ticks from the rings to the writer; they stay in the rings until they are on a disk."""

    def __init__(
        self,
        memory: RunMemory,
        window: Window,
        writer: FailoverWriter,
        environment: Future[Environment],
        view: LiveView,
        changes: ChangeTable,
    ) -> None:
        self._changes = changes
        self._memory, self._window, self._writer, self._view = memory, window, writer, view
        self._environment: Future[Environment] | None = environment
        self._alarm = Alarm(memory, turn=3)

    def until_the_end(self) -> None:
        """Return when the loop has ended, its board is safe, and everything was written."""
        flushed = time.monotonic()
        while True:
            over = _loop_ended(self._memory)
            if over:
                self._wait_for_the_rescue()
            self._alarm.look()
            self._hand_over(last=over)
            self._add_environment(wait=over)
            if time.monotonic() - flushed >= _FLUSH_S:
                self._flush()
                flushed = time.monotonic()
            if over:
                return
            time.sleep(_DRAIN_S)

    def _wait_for_the_rescue(self) -> None:
        """Wait until the board of a loop that died was taken over, for up to 20 s."""
        words = self._memory.words
        pid = words[Field.LOOP_PID]

        def done() -> bool:
            self._alarm.look()
            return words[Field.RESCUED_PID] == pid

        if words[Field.HOLDER_PID] == pid:
            self._memory.wait(done, _RESCUE_S)

    def _add_environment(self, *, wait: bool) -> None:
        """Add the environment once, when it is known."""
        if self._environment is not None and (wait or self._environment.done()):
            self._writer.add_environment(self._environment.result())
            self._memory.post(Mailbox.ENVIRONMENT, self._writer.header.environment.as_note())
            self._environment = None

    def _hand_over(self, *, last: bool) -> None:
        ticks, truths = self._window.more(last=last)
        self._writer.change(self._changes.changes(len(self._writer.changes)))  # those of these ticks are there
        self._writer.add(ticks, truths)
        _count(self._memory, ticks)

    def _flush(self) -> None:
        self._writer.flush()
        for began_ns, took_ns in self._writer.slow_syncs():
            text = f"the disk took {took_ns * 1e-9:.1f} s to sync, which comes ten times a second; no tick was lost"
            self._writer.warn(self._memory.words[Field.EPOCH_NS] + began_ns, text)
            self._view.warn(text, began_ns)
        if self._writer.writing:
            self._memory.words[Field.SYNCED] = synced = self._writer.synced
            self._window.release(synced)


def change_table(memory: RunMemory, header: RunHeader) -> ChangeTable:
    """The changes of gains of the run."""
    return ChangeTable(memory, (gain.name for gain in header.declared))


def _count(memory: RunMemory, ticks: bytes) -> None:
    columns = TICK.array(ticks)
    memory.histogram.add(columns["late_us"].tolist(), int(columns["skipped"].sum()))


def _nobody_drives(memory: RunMemory) -> bool:
    return _loop_ended(memory) or not alive(memory.words[Field.SUPERVISOR_PID])


def _loop_ended(memory: RunMemory) -> bool:
    pid = memory.words[Field.LOOP_PID]
    return pid != 0 and not alive(pid)


def _header(memory: RunMemory, job: Job) -> RunHeader | None:
    header, environment = memory.note(Mailbox.HEADER), memory.note(Mailbox.ENVIRONMENT)
    if header is None:
        return None
    settings = {
        each["name"]: f"refused: {each['refused']}" if each["refused"] else each["value"] for each in header["settings"]
    }
    return RunHeader(
        board=job.board,
        identity=header["identity"],
        virtual=job.virtual,
        gains=header["gains"],
        internals=quantities(header["internals"]),
        declared=quantities(header.get("declared", ())),
        controller_source=job.controller_source,
        controller_package=job.controller_package,
        facts={**job.facts, "realtime": settings | header.get("pace", {}) | (memory.note(Mailbox.DRILL) or {})},
        profile=job.profile,
        environment=Environment() if environment is None else Environment.of(environment),
    )


def run_end(memory: RunMemory) -> RunEnd:
    """Return how the run ended, as far as its memory shows."""
    written = memory.tick_reader().written
    timing = {"timing": {"late_us.histogram": json.dumps(memory.histogram.sparse())}}
    injected = memory.note(Mailbox.INJECTED)
    if injected:
        timing["injected"] = injected
    note = memory.note(Mailbox.RUN_END)
    # what a loop posts after the guardian has replaced it does not count
    if note is None or memory.words[Field.RESCUED_PID] == memory.words[Field.LOOP_PID] != 0:
        died = ["loop", *_others_that_died(memory)]
        return RunEnd(_last_reason(memory), written, aborted=_how_it_died(memory), facts=timing, died=died)
    timing["timing"] |= note["cost"]
    reason, aborted, died = Reason(note["reason"]), note.get("aborted", ""), _others_that_died(memory)
    return RunEnd(reason, written, note["detail"], aborted, facts=timing, died=died)


def _others_that_died(memory: RunMemory) -> list[str]:
    """Return the other processes that died, hung or were killed, as far as the memory shows."""
    words = memory.words
    reasons = {words[Field.GUARDIAN_STOP], words[Field.STOP], _last_reason(memory)}
    rescued = _rescue_of_the_loop(memory)

    def gone(word: Field) -> bool:
        return words[word] != 0 and not alive(words[word])

    found = {
        "recorder": gone(Field.RECORDER_PID) and memory.note(Mailbox.RECORDER_FAILURE) is None,
        "guardian": Reason.GUARDIAN_LOST in reasons or (rescued is not None and rescued["by"] == "supervisor"),
        "supervisor": Reason.SUPERVISOR_LOST in reasons or (gone(Field.SUPERVISOR_PID) and not words[Field.KEPT]),
    }
    return [name for name, died in found.items() if died]


def _last_reason(memory: RunMemory) -> Reason:
    newest = memory.tick_reader().newest()
    return Reason(int(TICK.array(newest)["reason"][0])) if newest else Reason.NONE


def _how_it_died(memory: RunMemory) -> str:
    """Describe the end of a loop that posted none."""
    words = memory.words
    failure = memory.note(Mailbox.FAILURE)
    how = "the loop's process gave up" if failure else "the loop's process died"
    report = _rescue_of_the_loop(memory)
    if report is not None and report["cause"] == "hung":
        how = "the loop's process hung and was killed"
    newest = memory.tick_reader().newest()
    if newest:
        how += f" after tick {int(TICK.array(newest)['tick'][0])}"
    if failure:
        how += f" ({failure['text'].removesuffix(f'. {STILL_ON}')})"
    if words[Field.HOLDER_PID] != words[Field.LOOP_PID]:
        return f"{how}; its board was already safe"
    return f"{how}; {describe_rescue(report)}"


def describe_board(memory: RunMemory) -> str:
    """Describe whether the board is safe, and which process made it so."""
    words = memory.words
    if words[Field.HOLDER_PID] != words[Field.LOOP_PID]:
        return "the run was stopped safely"
    return describe_rescue(_rescue_of_the_loop(memory))


def _rescue_of_the_loop(memory: RunMemory) -> Any:
    """Return the report on the rescue of the loop's board; None without one: an older report is the drill's."""
    words = memory.words
    return memory.note(Mailbox.RESCUE) if words[Field.RESCUED_PID] == words[Field.LOOP_PID] else None


def describe_rescue(report: Any) -> str:
    """Describe the state of the board of a dead process."""
    if report is None:
        return f"no process took over its board. {STILL_ON}"
    if report["failure"]:
        return f"the {report['by']} could not make its board safe ({report['failure']}). {STILL_ON}"
    return f"the {report['by']} made its board safe in {(report['done_ns'] - report['seen_ns']) * 1e-6:.1f} ms"


def recover_run(ring: Path, out: Path) -> RunResult:
    """Write the session file of a run whose processes have all ended from its memory `ring`, and remove the ring.

    Raises SessionError if the run is still going on, has no ticks, or if the file cannot be written.
    """
    check_output(out)
    memory = RunMemory.open(ring)
    if memory.in_use():
        raise SessionError(f"{ring}: the run is still going on; stop it first")
    job = Job.of(memory, parse_config)
    result = rebuild(memory, job, out)
    if result is None:
        raise SessionError(f"{ring}: holds no ticks; remove it")
    memory.remove()
    return result


def rebuild(memory: RunMemory, job: Job, out: Path, session: Path | None = None) -> RunResult | None:
    """Make the session file from the rings and from what a dead recorder wrote.

    Writes to `out`, which the user may call `session`. Returns None if there was no tick. Raises ConfigError or
    SessionError if it cannot be written, or if the recorder's file is damaged.
    """
    header, ticks = _header(memory, job), memory.tick_reader()
    if header is None or not ticks.written:
        return None
    file, held_from = file_of(memory, job), ticks.held_from()
    gone = bool(held_from) and not _is_ours(file, job)
    rows = joined(lambda: () if gone else _rows_of(file), Window(ticks, memory.truth_reader(), over=True).held)
    begin = list[tuple[bytes, bytes]]()
    while not begin or not begin[-1][0]:  # up to the first tick, which dates the session
        begin.append(next(rows))
    opener = _opener(memory, job, header, int(TICK.array(begin[-1][0])["time_ns"][0]))
    require_own_file(out, job.session_id)
    with atomic_write(out) as part, opener(part) as file_writer:
        writer = SessionWriter(file_writer, job.config, header, session or out)
        writer.write_header()
        writer.change(change_table(memory, header).changes())
        memory.histogram.clear()
        for records, states in chain(begin, rows):
            writer.add(records, states)
            _count(memory, records)
        end = replace(run_end(memory), frames=spooled_frames(memory, job))
        note = f"the session was made from what the run left in memory, {writer.card.ticks} ticks"
        if gone:
            note += f"; those before tick {held_from} were in {file}, which is missing or another session's"
        return writer.finish(replace(end, detail=f"{end.detail}; {note}" if end.detail else note))


def _is_ours(file: Path, job: Job) -> bool:
    """Return whether the file exists and is this run's."""
    try:
        require_own_file(file, job.session_id)
    except SessionError:
        return False
    return file.exists()


def _rows_of(path: Path) -> Iterator[tuple[bytes, bytes]]:
    with opened(path) as (file, size):
        yield from stored_rows(file, size, path)


def file_of(memory: RunMemory, job: Job) -> Path:
    """Return the file that the recorder wrote last."""
    note = memory.note(Mailbox.TROUBLES)
    return job.path if note is None else Path(note["file"])
