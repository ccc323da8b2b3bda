"""The recorder's process: drains the rings into the session file, and completes it however the run ends.

The rings hold what is not in the file yet, so its own death loses nothing either: `rebuild` makes the file anew.
"""

from __future__ import annotations

import json
import os
import time
import traceback
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from inteco_abs.boards import STILL_ON
from inteco_abs.errors import AbsError, SessionError
from inteco_abs.realtime.holder import tell_failure
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.machine import prepare, recorder_wishes
from inteco_abs.realtime.memory import Note, RunMemory, Word, alive
from inteco_abs.realtime.ring import RingReader
from inteco_abs.sessions import (
    TICK,
    TRUTH,
    Account,
    Conclusion,
    Introduction,
    Recorder,
    Scribe,
    check_output,
    only_whole,
    read_session,
)
from inteco_abs.sessions.surroundings import Surroundings, surroundings
from inteco_abs.signals import Reason

_DRAIN_S: Final = 0.005
_FLUSH_S: Final = 0.1
_RESCUE_S: Final = 20.0
"""The guardian tries for 5 s, and the supervisor in its place after that."""
_LONGEST_START_S: Final = 120.0


def main(path: str) -> int:
    """Record the run in the memory at `path`."""
    memory = RunMemory.open(Path(path))
    memory.words[Word.RECORDER_PID] = os.getpid()
    prepare(recorder_wishes())
    job = Job.of(memory)
    try:
        _record(memory, job)
    except AbsError as error:
        tell_failure(memory, Note.RECORDER_FAILURE, error)
        return error.exit_code
    except Exception as error:  # noqa: BLE001  the top of a process: its end must explain itself
        traceback.print_exc()
        tell_failure(memory, Note.RECORDER_FAILURE, error)
        return 1
    if not alive(memory.words[Word.SUPERVISOR_PID]):
        memory.remove()  # in its place: the file holds everything
    return 0


def _record(memory: RunMemory, job: Job) -> None:
    words = memory.words
    memory.post(Note.SURROUNDINGS, surroundings().as_note())  # while the others still start
    memory.wait(lambda: words[Word.READY] == words[Word.LOOP_PID] != 0 or _nobody_drives(memory), _LONGEST_START_S)
    introduction = _introduction(memory, job)
    if introduction is None:
        return  # there was no run
    with Recorder(job.path, time.monotonic_ns(), introduction.internals, job.session_id) as recorder:
        scribe = Scribe(recorder, job.config, introduction, Path(job.session))
        scribe.introduce()
        memory.truth_reader().take()  # what the board did while it was opened belongs to no tick
        words[Word.RECORDER_BEAT_NS] = time.monotonic_ns()
        words[Word.RECORDING] = 1
        _drain_until_the_end(memory, recorder, scribe)
        if not scribe.ticks:
            recorder.discard()
            return
        account = scribe.conclude(conclusion(memory))
    tell_result(memory, account)


def _drain_until_the_end(memory: RunMemory, recorder: Recorder, scribe: Scribe) -> None:
    words, ticks, truths = memory.words, memory.tick_reader(), memory.truth_reader()
    flushed = time.monotonic()
    over = False
    while not over:
        over = _loop_ended(memory)
        if over:
            _wait_for_the_rescue(memory)
        records = ticks.take()
        scribe.add(records, truths.take())
        columns = TICK.array(records)
        memory.histogram.add(columns["late_us"].tolist(), int(columns["skipped"].sum()))
        now = time.monotonic()
        words[Word.RECORDER_BEAT_NS] = time.monotonic_ns()
        if now - flushed >= _FLUSH_S:
            recorder.flush()
            words[Word.FLUSHED] = scribe.ticks
            flushed = now
        if not over:
            time.sleep(_DRAIN_S)


def _nobody_drives(memory: RunMemory) -> bool:
    return _loop_ended(memory) or not alive(memory.words[Word.SUPERVISOR_PID])


def _loop_ended(memory: RunMemory) -> bool:
    pid = memory.words[Word.LOOP_PID]
    return pid != 0 and not alive(pid)


def _wait_for_the_rescue(memory: RunMemory) -> None:
    """After a loop that died holding the board: until the guardian has done what it can."""
    words = memory.words
    pid = words[Word.LOOP_PID]
    if words[Word.HOLDER_PID] == pid:
        memory.wait(lambda: words[Word.RESCUED_PID] == pid, _RESCUE_S)


def _introduction(memory: RunMemory, job: Job) -> Introduction | None:
    told, around = memory.note(Note.INTRODUCTION), memory.note(Note.SURROUNDINGS)
    if told is None:
        return None
    settings = {
        each["name"]: f"refused: {each['refused']}" if each["refused"] else each["value"] for each in told["settings"]
    }
    return Introduction(
        board=job.board,
        identity=told["identity"],
        virtual=False,
        gains=told["gains"],
        internals=told["internals"],
        controller_source=job.controller_source,
        controller_package=job.controller_package,
        facts={**job.facts, "realtime": settings | (memory.note(Note.DRILL) or {})},
        profile=job.profile,
        surroundings=Surroundings() if around is None else Surroundings.of(around),
    )


def conclusion(memory: RunMemory) -> Conclusion:
    """How the run ended, as far as its memory tells."""
    written = memory.tick_reader().written
    timing = {"timing": {"late_us.histogram": json.dumps(memory.histogram.sparse())}}
    told = memory.note(Note.CONCLUSION)
    # a loop that was taken for hung or dead has nothing more to say
    if told is None or memory.words[Word.RESCUED_PID] == memory.words[Word.LOOP_PID] != 0:
        return Conclusion(_last_reason(memory), written, aborted=_how_it_died(memory), facts=timing)
    timing["timing"] |= told["cost"]
    return Conclusion(Reason(told["reason"]), written, told["detail"], facts=timing)


def _last_reason(memory: RunMemory) -> Reason:
    newest = memory.tick_reader().newest()
    return Reason(int(TICK.array(newest)["reason"][0])) if newest else Reason.NONE


def _how_it_died(memory: RunMemory) -> str:
    """For a loop that left no conclusion."""
    words = memory.words
    failure = memory.note(Note.FAILURE)
    how = "the loop's process gave up" if failure else "the loop's process died"
    report = _rescue_of_the_loop(memory)
    if report is not None and report["cause"] == "hung":
        how = "the loop's process hung and was killed"
    newest = memory.tick_reader().newest()
    if newest:
        how += f" after tick {int(TICK.array(newest)['tick'][0])}"
    if failure:
        how += f" ({failure['text'].removesuffix(f'. {STILL_ON}')})"
    if words[Word.HOLDER_PID] != words[Word.LOOP_PID]:
        return f"{how}; its board was safe by then"
    return f"{how}; {rescue_in_words(report)}"


def board_in_words(memory: RunMemory) -> str:
    """Whether the board was left safe, by whom."""
    words = memory.words
    if words[Word.HOLDER_PID] != words[Word.LOOP_PID]:
        return "the run was stopped safely"
    return rescue_in_words(_rescue_of_the_loop(memory))


def _rescue_of_the_loop(memory: RunMemory) -> Any:
    """Report of who took the loop's board; None if nobody did: an older one is the drill's."""
    words = memory.words
    return memory.note(Note.RESCUE) if words[Word.RESCUED_PID] == words[Word.LOOP_PID] else None


def rescue_in_words(report: Any) -> str:
    """What became of the board of a process that died."""
    if report is None:
        return f"nobody took over its board. {STILL_ON}"
    if report["failure"]:
        return f"the {report['by']} could not make its board safe ({report['failure']}). {STILL_ON}"
    return f"the {report['by']} made its board safe in {(report['done_ns'] - report['seen_ns']) * 1e-6:.1f} ms"


def tell_result(memory: RunMemory, account: Account) -> None:
    """Leave the account for the supervisor."""
    told = {"outcome": account.outcome, "reason": int(account.reason), "explanation": account.explanation}
    memory.post(Note.RESULT, {**told, "card": account.card})


def recover_run(ring: Path, out: Path) -> Account:
    """Session file of a run whose every process is gone, from its memory `ring`, which is then removed.

    Raises SessionError if the run still goes on, if there is nothing in it, or if the file cannot be written.
    """
    check_output(out)
    memory = RunMemory.open(ring)
    if memory.in_use():
        raise SessionError(f"{ring}: the run still goes on; stop it first")
    job = Job.of(memory)
    account = rebuild(memory, job, out)
    if account is None:
        raise SessionError(f"{ring}: holds no ticks; remove it")
    memory.remove()
    return account


def rebuild(memory: RunMemory, job: Job, out: Path, session: Path | None = None) -> Account | None:
    """Make the session file from the rings, and from what a dead recorder has left at `job.out`.

    It is written to `out`, which the user may call `session`. None if there was no tick. Raises SessionError.
    """
    introduction = _introduction(memory, job)
    ticks, truths = memory.tick_reader(), memory.truth_reader()
    if introduction is None or not ticks.written:
        return None
    held_from = ticks.rewind()
    truths.rewind()
    before, truths_before = _from_the_file(job.path, held_from, truths) if held_from else (b"", b"")
    with (
        only_whole(out) as part,
        Recorder(part, time.monotonic_ns(), introduction.internals, job.session_id) as recorder,
    ):
        scribe = Scribe(recorder, job.config, introduction, session or out)
        scribe.introduce()
        scribe.add(before, truths_before)
        scribe.add(ticks.take(), truths.take())
        memory.histogram.clear()
        memory.histogram.add(*scribe.lateness())
        end = conclusion(memory)
        anew = f"the session was made from what the run left in memory, {scribe.ticks} ticks"
        return scribe.conclude(replace(end, detail=f"{end.detail}; {anew}" if end.detail else anew))


def _from_the_file(path: Path, ticks: int, truths: RingReader) -> tuple[bytes, bytes]:
    """What a ring that went round no longer holds: the first `ticks`, and the states before the ring's first."""
    session = read_session(path)
    first = truths.oldest()
    newer_ns = int(TRUTH.array(first)["time_ns"][0]) if first else 0
    rows = session.truth[session.truth["time_ns"] < newer_ns].tolist()
    return bytes(session.payload[: ticks * TICK.size]), b"".join(map(TRUTH.pack, rows))
