"""Sessions out of shared memory: by a recorder's process, and by hand after all processes died."""

import hashlib
import itertools
import json
import os
import resource
import signal
import struct
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from threading import Event

import pytest

from inteco_abs.analysis import replay_session
from inteco_abs.boards import STILL_ON, InProcessLink
from inteco_abs.boards.families.usb2 import RtdacUsb2
from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.control import CONTROLLERS, build_pipeline, gains_in_force, gains_to_change
from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.mock_board import Device
from inteco_abs.realtime import ChangeTable, GainChanges, Loop, StopFlag, VirtualClock
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory
from inteco_abs.realtime.processes import recorder
from inteco_abs.realtime.processes.recorder import describe_board, rebuild, recover_run, run_end
from inteco_abs.realtime.tuning import recorder_tuning
from inteco_abs.sessions import (
    TICK,
    TRUTH,
    FileWriter,
    RunHeader,
    SessionWriter,
    changes_among,
    disk,
    pack_tick,
    read_session,
    result_card,
)
from inteco_abs.signals import Phase, Reason

EVERYTHING = 1 << 30
CUT_RECORDS = (b"", b"\x06", b"\x06" + bytes([99]) * 7, struct.pack("<BQ", 6, 5000) + bytes(30))
"""What a recorder may leave at the end of a file when it is killed while it writes a chunk."""
NORMAL = {"reason": 0, "detail": "", "cost": {"cpu_share": "0.5"}}


class Filled:
    """A whole run of the loop, in virtual time, that leaves its ticks where a real one leaves them."""

    def __init__(self, memory, job, after_slice=lambda _run: None):
        self.memory, self.job = memory, job
        config, clock = job.config, VirtualClock(job.config.period_ns)
        truths = memory.truth_ring(TRUTH.pack_into)
        device = Device(config, clock.now_ns, job.seed, truths.append)
        board = RtdacUsb2(InProcessLink(Usb2FrontEnd(device)), config.board, clock.now_ns, config.period_ns)
        ring = memory.tick_ring(pack_tick)
        pipeline, declared = build_pipeline(config), CONTROLLERS[config.controller.name].gains
        self.payload = b""
        self.reader = memory.tick_reader()
        with board:
            memory.truth_reader().take()
            self.introduction = {
                "identity": board.require_writable().facts(),
                "gains": gains_in_force(config),
                "internals": [],
                "declared": [gain.quantity for gain in declared],
                "settings": [
                    {"name": "scheduler", "value": "SCHED_FIFO 80", "refused": ""},
                    {"name": "memory", "value": "default", "refused": "no right: raise memlock"},
                ],
            }
            memory.post(Mailbox.HEADER, self.introduction)
            table = ChangeTable(memory, (gain.name for gain in declared))
            changes = GainChanges(config, pipeline, gains_to_change(pipeline, config), table.record)
            loop = Loop(board, pipeline, clock, ring, StopFlag(), changes)
            over = False
            while not over:
                over = loop.run(100)
                after_slice(self)
        self.ticks = ring.written

    def conclude(self, reason=Reason.NONE, detail=""):
        posted = {**NORMAL, "reason": int(reason), "detail": detail}
        self.memory.post(Mailbox.RUN_END, {**posted, "written": self.ticks})


def in_ring(memory):
    """Ticks that the ring holds, as bytes; what was taken stays taken."""
    reader = memory.tick_reader()
    taken = reader.taken
    reader.release(reader.held_from())
    payload = reader.take()
    memory.tick_reader().release(taken)
    return payload


@pytest.fixture
def whole(new_memory, job_of):
    """A run whose ring holds all of it, and of which nothing was recorded."""
    memory = new_memory(5000, 5100)
    return Filled(memory, job_of(memory))


class Crash:
    """A run whose ring has wrapped, and whose recorder died once `flushed` ticks were on the disk."""

    capacity = 500

    def __init__(self, memory, job, flushed, extra):
        self.truths = b""
        self.hash = hashlib.sha256()
        self.known = 0
        """Ticks in the file that the recorder has left."""
        self._flushed = flushed
        self._on_disk = b""
        with ExitStack() as stack:
            self._stack = stack
            self._writer = self._recorder = None
            self.run = Filled(memory, job, self._record)
        job.path.write_bytes(self._on_disk + extra)
        self.held_from = self.run.ticks - self.capacity
        """Ticks that the ring does not hold any more."""
        assert self.held_from > self.capacity

    def _record(self, run):
        if self._writer is None:
            posted, job = run.introduction, run.job
            self._recorder = self._stack.enter_context(FileWriter(job.path, 0, job.session_id))
            introduction = RunHeader(job.board, posted["identity"], False, posted["gains"], posted["internals"], b"")
            self._writer = SessionWriter(self._recorder, job.config, introduction)
            self._writer.write_header()
        ticks, truths = run.reader.take(), run.memory.truth_reader().take()
        self.hash.update(ticks)
        self.truths += truths
        if self._writer.card.ticks < self._flushed:
            self._writer.add(ticks, truths)
            self._recorder.flush()
            self._on_disk = run.job.path.read_bytes()
            self.known = self._writer.card.ticks


class TestRebuild:
    def test_every_tick_of_the_ring_is_in_a_complete_session(self, whole):
        whole.conclude()
        expected = in_ring(whole.memory)
        account = rebuild(whole.memory, whole.job, whole.job.path)
        session = read_session(whole.job.path)
        assert not session.incomplete
        assert session.payload == expected
        assert len(session.ticks) == whole.ticks == account.card["ticks"]
        assert (account.outcome, account.card["lost_ticks"]) == ("completed", 0)
        assert account.card["session"] == str(whole.job.path)
        assert account.card["payload_sha256"] == hashlib.sha256(expected).hexdigest()

    def test_the_session_replays_bit_for_bit_with_what_is_in_it(self, whole):
        whole.conclude()
        rebuild(whole.memory, whole.job, whole.job.path)
        session = read_session(whole.job.path)
        again = replay_session(session, build_pipeline(whole.job.config))
        assert (again.ticks, again.differing) == (whole.ticks, 0)

    def test_changes_of_gains_come_from_memory_and_replay(self, new_memory, job_of):
        memory = new_memory(5000, 5100)
        run = Filled(memory, job_of(memory, 'experiment.changes=["Mk=9@brake+#5", "reference_slip=0.3@brake+#9"]'))
        run.conclude()
        rebuild(run.memory, run.job, run.job.path)
        session = read_session(run.job.path)
        assert [(each.name, each.value) for each in changes_among(session.parameters)] == [
            ("Mk", 9.0),
            ("reference_slip", 0.3),
        ]
        assert replay_session(session, build_pipeline(run.job.config)).differing == 0

    def test_the_session_names_its_software_and_settings(self, whole):
        whole.conclude()
        whole.memory.post(Mailbox.DRILL, {"guardian drill": "SAFE 4.0 ms after the kill"})
        account = rebuild(whole.memory, whole.job, whole.job.path)
        session = read_session(whole.job.path)
        assert f"made from what the run left in memory, {whole.ticks} ticks" in account.explanation
        assert session.metadata["realtime"] == {
            "scheduler": "SCHED_FIFO 80",
            "memory": "refused: no right: raise memlock",
            "guardian drill": "SAFE 4.0 ms after the kill",
        }
        assert session.metadata["software"]["seed"] == "1"

    def test_the_board_of_a_simulated_rig_has_its_say_too(self, whole):
        whole.conclude()
        card = rebuild(whole.memory, whole.job, whole.job.path).card
        session = read_session(whole.job.path)
        assert len(session.truth) >= whole.ticks
        assert card["start_speed_rad_s"] == pytest.approx(15.0, rel=0.05)
        assert card["stop_time_s"] > 0.0

    def test_making_it_twice_gives_the_same_ticks(self, whole, tmp_path):
        whole.conclude()
        first = rebuild(whole.memory, whole.job, tmp_path / "a.mcap")
        second = rebuild(whole.memory, whole.job, tmp_path / "b.mcap")
        assert first.card["payload_sha256"] == second.card["payload_sha256"]

    def test_a_file_that_the_recorder_began_is_replaced_and_nothing_else_is_left(self, whole, tmp_path):
        whole.conclude()
        whole.job.path.write_bytes(b"begun: " + whole.job.session_id.encode())
        (tmp_path / "stop.mcap.part").write_bytes(b"somebody else's")
        rebuild(whole.memory, whole.job, whole.job.path)
        assert {path.name for path in tmp_path.iterdir()} == {"stop.mcap", "stop.mcap.part"}
        assert (tmp_path / "stop.mcap.part").read_bytes() == b"somebody else's"
        assert not read_session(whole.job.path).incomplete

    def test_another_file_with_the_name_of_the_session_is_left_alone(self, whole):
        whole.conclude()
        whole.job.path.write_bytes(b"somebody else's")
        with pytest.raises(SessionError, match="never overwritten"):
            rebuild(whole.memory, whole.job, whole.job.path)
        assert whole.job.path.read_bytes() == b"somebody else's"

    def test_a_run_without_ticks_or_without_a_beginning_makes_no_session(self, memory, job_of, tmp_path):
        job = job_of(memory)
        assert rebuild(memory, job, job.path) is None
        memory.post(Mailbox.HEADER, {"identity": {}, "gains": {}, "internals": [], "settings": []})
        assert rebuild(memory, job, job.path) is None
        assert not list(tmp_path.iterdir())

    def test_the_lateness_of_every_tick_is_counted(self, whole):
        whole.conclude()
        rebuild(whole.memory, whole.job, whole.job.path)
        counts = json.loads(read_session(whole.job.path).metadata["timing"]["late_us.histogram"])
        assert sum(counts.values()) == whole.ticks


@pytest.fixture
def crash(new_memory, job_of):
    """Makes a run whose ring has wrapped and whose recorder died."""

    def make(flushed=EVERYTHING, extra=b""):
        memory = new_memory(Crash.capacity, Crash.capacity + 100)
        return Crash(memory, job_of(memory), flushed, extra)

    return make


class TestWrappedRing:
    @pytest.mark.parametrize("extra", CUT_RECORDS, ids=len)
    @pytest.mark.parametrize("flushed", [EVERYTHING, 1300])
    def test_ticks_of_the_cut_file_and_of_the_ring_are_joined_without_gap_or_repeat(self, crash, flushed, extra):
        made = crash(flushed, extra)
        run = made.run
        assert made.held_from <= made.known
        run.conclude()
        account = rebuild(run.memory, run.job, run.job.path)
        session = read_session(run.job.path)
        assert not session.incomplete
        assert session.ticks["tick"].tolist() == list(range(run.ticks))
        assert account.card["payload_sha256"] == made.hash.hexdigest()
        assert account.card["lost_ticks"] == 0
        assert replay_session(session, build_pipeline(run.job.config)).differing == 0

    def test_ticks_that_exist_nowhere_are_reported_as_lost(self, crash):
        made = crash(200)
        run = made.run
        run.conclude()
        account = rebuild(run.memory, run.job, run.job.path)
        assert account.card["lost_ticks"] == made.held_from - made.known > 0
        ticks = read_session(run.job.path).ticks["tick"].tolist()
        assert ticks == [*range(made.known), *range(made.held_from, run.ticks)]

    def test_the_card_is_the_one_that_the_run_would_have_had(self, crash):
        made = crash()
        run = made.run
        run.conclude()
        card = rebuild(run.memory, run.job, run.job.path).card
        expected = result_card(run.job.config, read_session(run.job.path).ticks, TRUTH.array(made.truths))
        assert {name: card[name] for name in expected} == expected

    def test_if_the_file_is_gone_the_ring_is_saved_and_the_rest_is_reported_as_lost(self, crash):
        made = crash()
        made.run.conclude()
        made.run.job.path.unlink()
        account = rebuild(made.run.memory, made.run.job, made.run.job.path)
        assert account.card["lost_ticks"] == made.held_from
        assert (
            f"those before tick {made.held_from} were in {made.run.job.path}, which is missing" in account.explanation
        )
        assert read_session(made.run.job.path).ticks["tick"].tolist() == list(range(made.held_from, made.run.ticks))

    def test_what_another_run_has_written_there_is_not_mistaken_for_ticks_of_this_one(self, crash, tmp_path):
        made = crash()
        made.run.conclude()
        made.run.job.path.rename(tmp_path / "moved.mcap")
        made.run.job.path.write_bytes((tmp_path / "moved.mcap").read_bytes().replace(b"an-id", b"is-no"))
        account = rebuild(made.run.memory, made.run.job, tmp_path / "again.mcap")
        assert account.card["lost_ticks"] == made.held_from
        assert read_session(tmp_path / "again.mcap").ticks["tick"].tolist() == list(
            range(made.held_from, made.run.ticks)
        )

    def test_the_session_is_dated_by_its_first_tick(self, crash):
        made = crash()
        made.run.conclude()
        made.run.memory.words[Field.EPOCH_NS] = 600_000  # the first tick is 500 us later, in the next millisecond
        rebuild(made.run.memory, made.run.job, made.run.job.path)
        assert read_session(made.run.job.path).metadata["session"]["started_utc"] == "1970-01-01T00:00:00.001+00:00"

    def test_nothing_of_a_damaged_file_is_replaced(self, crash):
        made = crash()
        made.run.conclude()
        data = bytearray(made.run.job.path.read_bytes())
        data[data.index(b"zstd") + 500] ^= 0xFF  # in the first chunk
        made.run.job.path.write_bytes(data)
        with pytest.raises(SessionError, match=r"stop\.mcap"):
            rebuild(made.run.memory, made.run.job, made.run.job.path)
        assert made.run.job.path.read_bytes() == data


PID, OTHER = 4000, 4001
RESCUED = {"cause": "died", "seen_ns": 1_000_000, "done_ns": 5_200_000, "failure": "", "by": "guardian"}


@pytest.fixture
def dead(memory):
    """The memory of a run whose loop ended at tick 7, with nothing said of how."""
    ring = memory.tick_ring(pack_tick)
    for number in range(8):
        ring.append([number if name == "tick" else 0 for name in (column.name for column in TICK.columns)])
    memory.words[Field.LOOP_PID] = PID
    return memory


def failure(kind, text):
    return {"kind": kind, "text": text, "notes": []}


DIED, GAVE_UP = "the loop's process died after tick 7", "the loop's process gave up after tick 7"
BY_THEN = "its board was already safe"
MADE_SAFE = "the guardian made its board safe in 4.2 ms"
NOBODY = f"no process took over its board. {STILL_ON}"
UNCONFIRMED = "SAFE could not be confirmed (no answer)"
UNSAFE = failure("UnsafeError", f"{UNCONFIRMED}. {STILL_ON}")
FULL = failure("BufferError", "BufferError: the ring is full")
HUNG = {**RESCUED, "cause": "hung"}
IN_VAIN = {**RESCUED, "failure": "no board at x"}
NOT_SAFE = f"the guardian could not make its board safe (no board at x). {STILL_ON}"
ENDS = {
    "died, rescued": (PID, PID, RESCUED, None, f"{DIED}; {MADE_SAFE}"),
    "died, not rescued": (PID, 0, None, None, f"{DIED}; {NOBODY}"),
    "died, only the drill was rescued": (PID, OTHER, RESCUED, None, f"{DIED}; {NOBODY}"),
    "died, rescued in vain": (PID, PID, IN_VAIN, None, f"{DIED}; {NOT_SAFE}"),
    "died after letting go": (0, 0, None, None, f"{DIED}; {BY_THEN}"),
    "hung": (PID, PID, HUNG, None, f"the loop's process hung and was killed after tick 7; {MADE_SAFE}"),
    "gave up": (0, 0, None, FULL, f"{GAVE_UP} (BufferError: the ring is full); {BY_THEN}"),
    "unsafe, rescued": (PID, PID, RESCUED, UNSAFE, f"{GAVE_UP} ({UNCONFIRMED}); {MADE_SAFE}"),
    "unsafe, not rescued": (PID, 0, None, UNSAFE, f"{GAVE_UP} ({UNCONFIRMED}); {NOBODY}"),
}
"""By what happened: holder, whom the guardian rescued, its report, the loop's failure, and what is made of it."""

DEATHS = {
    "loop": ({Field.HOLDER_PID: PID}, None),
    "loop, guardian": ({Field.HOLDER_PID: PID, Field.RESCUED_PID: PID}, {**RESCUED, "by": "supervisor"}),
    "loop, recorder, supervisor": ({Field.RECORDER_PID: 1 << 30, Field.SUPERVISOR_PID: 1 << 30}, None),
    "loop, supervisor": ({Field.GUARDIAN_STOP: Reason.SUPERVISOR_LOST}, None),
}  # fmt: skip


class TestConclusion:
    def test_a_normal_end_is_reported_as_the_loop_posted_it(self, dead):
        dead.post(Mailbox.RUN_END, {**NORMAL, "reason": int(Reason.OVER_SPEED), "detail": "far too fast"})
        dead.histogram.add([3.5, 3.6])
        end = run_end(dead)
        assert (end.reason, end.detail, end.aborted, end.written) == (Reason.OVER_SPEED, "far too fast", "", 8)
        assert end.facts == {"timing": {"late_us.histogram": '{"3": 2}', "cpu_share": "0.5"}}

    @pytest.mark.parametrize("end", ENDS)
    def test_an_end_that_was_not_posted_is_derived_from_the_memory(self, dead, end):
        holder, rescued, report, trouble, text = ENDS[end]
        dead.words[Field.HOLDER_PID], dead.words[Field.RESCUED_PID] = holder, rescued
        if report is not None:
            dead.post(Mailbox.RESCUE, report)
        if trouble is not None:
            dead.post(Mailbox.FAILURE, trouble)
        found = run_end(dead)
        assert found.aborted == text
        assert found.written == 8

    @pytest.mark.parametrize("names", DEATHS)
    def test_it_says_which_processes_died(self, dead, names):
        words, report = DEATHS[names]
        for word, value in words.items():
            dead.words[word] = value
        if report is not None:
            dead.post(Mailbox.RESCUE, report)
        assert ", ".join(run_end(dead).died) == names

    def test_after_a_normal_run_no_process_has_died(self, dead, ended):
        dead.post(Mailbox.RUN_END, NORMAL)
        dead.words[Field.RECORDER_PID] = dead.words[Field.SUPERVISOR_PID] = os.getpid()
        assert run_end(dead).died == []
        dead.words[Field.RECORDER_PID] = ended
        assert run_end(dead).died == ["recorder"]
        dead.post(Mailbox.RECORDER_FAILURE, failure("SessionError", "no room"))
        assert run_end(dead).died == []  # it has ended, and said why
        dead.words[Field.STOP] = Reason.GUARDIAN_LOST
        assert run_end(dead).died == ["guardian"]

    @pytest.mark.parametrize("reason", [Reason.NONE, Reason.MISSED_EXCHANGES])
    def test_the_reason_of_the_last_tick_is_kept(self, memory, reason):
        values = [int(reason) if column.name == "reason" else 0 for column in TICK.columns]
        memory.tick_ring(pack_tick).append(values)
        memory.words[Field.LOOP_PID] = PID
        assert run_end(memory).reason is reason

    def test_a_loop_that_died_holding_the_board_makes_an_aborted_session_that_says_so(self, whole):
        whole.memory.words[Field.LOOP_PID] = whole.memory.words[Field.HOLDER_PID] = PID
        account = rebuild(whole.memory, whole.job, whole.job.path)
        assert (account.outcome, account.exit_code) == ("aborted", 5)
        assert STILL_ON in account.explanation
        facts = read_session(whole.job.path).metadata["session"]
        assert STILL_ON in facts["reason"]
        assert (facts["died"], facts["last_tick"]) == ("loop", str(whole.ticks - 1))


class TestRecover:
    def test_the_session_is_written_and_the_memory_removed(self, whole, tmp_path, ended):
        for word in (Field.SUPERVISOR_PID, Field.LOOP_PID, Field.RECORDER_PID):
            whole.memory.words[word] = ended
        account = recover_run(whole.memory.path, tmp_path / "saved.mcap")
        assert account.card["ticks"] == whole.ticks
        assert len(read_session(tmp_path / "saved.mcap").ticks) == whole.ticks
        assert not whole.memory.path.exists()

    @pytest.mark.parametrize("word", [Field.SUPERVISOR_PID, Field.LOOP_PID, Field.RECORDER_PID])
    def test_a_run_in_progress_is_left_alone(self, whole, tmp_path, ended, word):
        whole.memory.words[Field.SUPERVISOR_PID] = ended
        whole.memory.words[word] = os.getpid()
        with pytest.raises(SessionError, match="still going on"):
            recover_run(whole.memory.path, tmp_path / "saved.mcap")
        assert whole.memory.path.exists()
        assert not (tmp_path / "saved.mcap").exists()

    def test_a_session_is_never_overwritten(self, whole, tmp_path):
        (tmp_path / "saved.mcap").write_bytes(b"another one")
        with pytest.raises(ConfigError, match="never overwritten"):
            recover_run(whole.memory.path, tmp_path / "saved.mcap")
        assert (tmp_path / "saved.mcap").read_bytes() == b"another one"
        assert whole.memory.path.exists()

    def test_a_run_without_a_tick_is_said_to_be_empty(self, memory, job_of, tmp_path, ended):
        job_of(memory)
        memory.words[Field.SUPERVISOR_PID] = ended
        with pytest.raises(SessionError, match="holds no ticks"):
            recover_run(memory.path, tmp_path / "saved.mcap")
        assert memory.path.exists()
        assert not list(tmp_path.iterdir())

    def test_a_copy_is_the_users_own_and_stays(self, whole, tmp_path, ended):
        for word in (Field.SUPERVISOR_PID, Field.LOOP_PID, Field.RECORDER_PID):
            whole.memory.words[word] = ended
        copy = tmp_path / "copy.ring"
        copy.write_bytes(whole.memory.path.read_bytes())
        assert recover_run(copy, tmp_path / "saved.mcap").card["ticks"] == whole.ticks
        assert copy.exists()

    def test_a_disk_that_is_full_keeps_the_memory(self, whole, tmp_path, ended):
        whole.memory.words[Field.SUPERVISOR_PID] = ended
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
        try:
            with pytest.raises(SessionError, match="cannot be written"):
                recover_run(whole.memory.path, tmp_path / "saved.mcap")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert whole.memory.path.exists()
        assert recover_run(whole.memory.path, tmp_path / "saved.mcap").card["ticks"] == whole.ticks

    def test_a_memory_without_a_job_is_said_to_be_empty(self, memory, tmp_path):
        with pytest.raises(SessionError):
            recover_run(memory.path, tmp_path / "saved.mcap")


class Recording:
    """A recorder's process, with a loop that is a sleeping process and ticks that the test writes."""

    def __init__(self, memory, job, child, until, code=""):
        self.memory, self.job, self.until, self.words = memory, job, until, memory.words
        self.words[Field.SUPERVISOR_PID] = os.getpid()
        self.loop = child()
        self.words[Field.LOOP_PID] = self.loop.pid
        self.source = in_ring_of_a_run(job)
        self._ring = memory.tick_ring(lambda buffer, at, data: buffer.__setitem__(slice(at, at + TICK.size), data))
        self.start(child, code)

    def start(self, child, code):
        role = ("-c", code) if code else ("-m", "inteco_abs.realtime.processes", "recorder")
        self.process = child(sys.executable, *role, self.memory.path)

    def ready(self):
        self.memory.post(Mailbox.HEADER, {"identity": {}, "gains": {}, "internals": [], "settings": []})
        self.words[Field.READY] = self.loop.pid
        self.until(lambda: self.words[Field.RECORDING], "it records")

    def ticks(self, count):
        for _ in range(count):
            number = self._ring.written
            self._ring.append(self.source[number * TICK.size : (number + 1) * TICK.size])

    @property
    def payload(self):
        return self.source[: self._ring.written * TICK.size]

    def end(self, code=0):
        assert self.process.wait(30) == code
        return self.memory.note(Mailbox.RESULT)

    def session(self):
        return read_session(self.job.path)


class RecordingHere(Recording):
    """The same in a thread of the test."""

    def start(self, _child, _code):
        self._pool = ThreadPoolExecutor(1)
        self.running = self._pool.submit(recorder.main, str(self.memory.path))

    def end(self, code=0):
        assert self.running.result(15) == code  # sooner than it gives up to wait for a rescue
        return self.memory.note(Mailbox.RESULT)

    def close(self):
        self.loop.kill()
        self.loop.wait()
        self.words[Field.RESCUED_PID] = self.words[Field.LOOP_PID]  # ends any wait
        self._pool.shutdown()


def in_ring_of_a_run(job):
    """Ticks of a run with that job's configuration."""
    memory = RunMemory.create(TICK.size, 5000, TRUTH.size, 5100)
    payload = in_ring(Filled(memory, job).memory)
    memory.remove()
    return payload


@pytest.fixture
def recording(new_memory, job_of, child, until):
    memory = new_memory(400, 400)
    return Recording(memory, job_of(memory), child, until)


@pytest.fixture
def here(new_memory, job_of, child, until, monkeypatch):
    tunings = []
    monkeypatch.setattr(recorder, "apply", tunings.append)
    memory = new_memory(400, 400)
    made = RecordingHere(memory, job_of(memory), child, until)
    yield made
    made.close()
    assert [tuning.name for tuning in tunings[0]] == [tuning.name for tuning in recorder_tuning()]


class TestRecorder:
    def test_everything_that_the_loop_leaves_is_in_the_file_when_it_has_ended(self, here, until):
        here.ready()
        assert here.job.path.exists()
        until(lambda: here.memory.note(Mailbox.ENVIRONMENT), "it has looked around")
        beat = here.words[Field.RECORDER_BEAT_NS]
        here.ticks(300)
        until(lambda: here.words[Field.SYNCED] == 300, "they are on the disk")
        assert here.words[Field.RECORDER_BEAT_NS] > beat
        assert len(here.session().ticks) == 300
        here.ticks(300)  # more than there is room for without a recorder that takes
        here.memory.post(Mailbox.RUN_END, NORMAL)
        here.loop.kill()
        result = here.end()
        assert (result["outcome"], result["card"]["ticks"], result["card"]["lost_ticks"]) == ("completed", 600, 0)
        assert here.session().payload == here.payload
        assert not here.session().incomplete
        assert b"numpy==" in here.session().attachments["requirements.txt"]
        assert here.session().metadata["software"]["packages_sha256"]
        assert sum(here.memory.histogram.sparse().values()) == 600
        assert here.memory.path.exists()

    def test_ticks_reach_the_disk_while_it_looks_around(self, here, monkeypatch):
        seen, look = Event(), recorder.current_environment
        monkeypatch.setattr(recorder, "current_environment", lambda: (seen.wait(30), look())[1])
        here.ready()
        here.ticks(100)
        here.until(lambda: here.words[Field.SYNCED] == 100, "they are on the disk")
        assert here.memory.note(Mailbox.ENVIRONMENT) is None
        here.memory.post(Mailbox.RUN_END, NORMAL)
        here.loop.kill()
        seen.set()
        here.end()
        assert b"numpy==" in here.session().attachments["requirements.txt"]

    def test_after_a_loop_died_it_waits_for_the_report_on_the_board(self, here):
        here.ready()
        here.ticks(50)
        here.words[Field.HOLDER_PID] = here.loop.pid
        here.loop.kill()
        time.sleep(0.1)
        assert not here.running.done()
        here.memory.post(Mailbox.RESCUE, RESCUED)
        here.words[Field.RESCUED_PID] = here.loop.pid
        result = here.end()
        assert result["outcome"] == "aborted"
        assert "the loop's process died after tick 49" in result["explanation"]
        assert "made its board safe in 4.2 ms" in result["explanation"]
        assert here.session().payload == here.payload

    def test_a_loop_that_ends_before_its_first_tick_leaves_no_file(self, here):
        here.ready()
        here.loop.kill()
        assert here.end() is None
        assert not here.job.path.exists()
        assert here.memory.note(Mailbox.RECORDER_FAILURE) is None

    def test_a_loop_that_never_was_ready_leaves_no_file(self, here):
        here.loop.kill()
        assert here.end() is None
        assert not here.job.path.exists()

    def test_without_a_supervisor_it_removes_the_memory_itself(self, here, child):
        supervisor = child()
        here.words[Field.SUPERVISOR_PID] = supervisor.pid
        here.ready()
        here.ticks(20)
        supervisor.kill()
        here.memory.post(Mailbox.RUN_END, NORMAL)
        here.loop.kill()
        assert here.end()["card"]["ticks"] == 20
        assert not here.memory.path.exists()
        assert len(here.session().ticks) == 20

    def test_a_file_that_cannot_be_made_is_reported_and_ends_it(self, here):
        here.job.path.mkdir()
        here.memory.post(Mailbox.HEADER, {"identity": {}, "gains": {}, "internals": [], "settings": []})
        here.words[Field.READY] = here.loop.pid
        here.end(code=2)
        assert "is a folder" in here.memory.note(Mailbox.RECORDER_FAILURE)["text"]

    def test_each_wait_for_the_disk_that_users_should_know_of_is_noted(self, here, monkeypatch):
        monkeypatch.setattr(disk, "_SLOW_NS", 0)
        here.ready()
        here.ticks(20)
        here.until(lambda: here.words[Field.SYNCED] == 20, "they are on the disk")
        here.memory.post(Mailbox.RUN_END, NORMAL)
        here.loop.kill()
        here.end()
        warnings = [event.text for event in here.session().log if event.level == 3]
        assert warnings[0].startswith("the disk took 0.0 s")

    def test_a_defect_is_reported_with_its_traceback_and_ends_it(self, here, monkeypatch, capfd):
        monkeypatch.setattr(recorder, "spill_path", lambda *_: 1 // 0)
        here.memory.post(Mailbox.HEADER, {"identity": {}, "gains": {}, "internals": [], "settings": []})
        here.words[Field.READY] = here.loop.pid
        here.end(code=1)
        assert here.memory.note(Mailbox.RECORDER_FAILURE)["kind"] == "ZeroDivisionError"
        assert "Traceback" in capfd.readouterr().err

    def test_a_disk_that_refuses_is_reported_and_nothing_leaves_the_ring(self, here):
        here.ready()
        here.ticks(100)
        here.until(lambda: here.words[Field.SYNCED] == 100, "they are on the disk")
        here.job.path.unlink()
        here.ticks(100)
        here.until(lambda: here.words[Field.TROUBLES] == 1, "it says so")
        posted = here.memory.note(Mailbox.TROUBLES)
        assert "its ticks are kept in memory" in posted["texts"][0]
        assert posted["file"] == str(here.job.path)
        assert here.memory.tick_reader().taken == 100
        here.memory.post(Mailbox.RUN_END, NORMAL)
        here.loop.kill()
        result = here.end()
        assert (result["outcome"], result["card"]["ticks"]) == ("completed", 200)
        assert "is gone" in result["trouble"]
        assert here.session().payload == here.payload


class TestRecorderProcess:
    def test_a_recorder_that_is_killed_loses_nothing_that_rebuild_does_not_find(self, recording, until):
        recording.ready()
        for part in range(3):
            recording.ticks(250)
            until(lambda part=part: recording.words[Field.SYNCED] == 250 * (part + 1), "they are on the disk")
        recording.process.kill()
        recording.process.wait()
        recording.ticks(400)
        recording.memory.post(Mailbox.RUN_END, NORMAL)
        recording.loop.kill()
        account = rebuild(recording.memory, recording.job, recording.job.path)
        assert (account.card["ticks"], account.card["lost_ticks"]) == (1150, 0)
        assert recording.session().payload == recording.payload


SLOW = """
import os, sys, time
sync = os.fdatasync
def slow(file):
    if slow.calls == 1:
        time.sleep(1.5)
    slow.calls += 1
    sync(file)
slow.calls = 0
os.fdatasync = slow
from inteco_abs.realtime.processes.recorder import main
sys.exit(main(sys.argv[1]))
"""
"""A recorder on a disk that takes its time once, after the beginning."""


NOTED = """
import os, sys, time
sync = os.fdatasync
def noted(file):
    size = os.fstat(file).st_size
    sync(file)
    with open(sys.argv[1] + ".syncs", "a") as notes:
        print(time.monotonic_ns(), size, file=notes)
os.fdatasync = noted
from inteco_abs.realtime.processes.recorder import main
sys.exit(main(sys.argv[1]))
"""
"""A recorder that notes the end of each sync, and the size of the file when it began."""


class TestDisk:
    def test_what_was_synced_before_a_power_cut_has_every_tick_but_the_newest(self, new_memory, job_of, child, until):
        """`test_power_loss` cuts a file system's power; here a file keeps what was written before the last sync."""
        memory = new_memory(2000, 2000)
        recording = Recording(memory, job_of(memory), child, until, NOTED)
        recording.ready()
        came_ns = []
        while len(came_ns) < 100:
            recording.ticks(10)
            came_ns.append(time.monotonic_ns())
            time.sleep(0.01)
        recording.process.kill()
        recording.process.wait()
        notes = Path(f"{memory.path}.syncs")
        syncs = [tuple(map(int, line.split())) for line in notes.read_text().splitlines()]
        notes.unlink()
        data, lost_ms = recording.job.path.read_bytes(), []
        for (_, size), (cut_ns, _) in itertools.pairwise(syncs):  # just before the next sync has ended
            recording.job.path.write_bytes(data[:size])
            saved = recording.session()
            assert recording.payload.startswith(bytes(saved.payload))
            lost_ms.append((cut_ns - came_ns[len(saved.ticks) // 10]) * 1e-6)
        assert len(lost_ms) >= 5
        assert max(lost_ms) <= 300.0

    def test_what_is_not_in_the_file_stays_in_the_ring(self, recording, until):
        recording.ready()
        recording.ticks(100)
        until(lambda: recording.words[Field.SYNCED] == 100, "they are on the disk")
        until(lambda: recording.memory.tick_reader().taken == 100, "the ring is free again")
        recording.process.send_signal(signal.SIGSTOP)
        recording.ticks(50)
        assert recording.memory.tick_reader().taken == 100

    def test_a_slow_disk_is_neither_a_lost_recorder_nor_a_lost_tick(self, new_memory, job_of, child, until):
        memory = new_memory(2000, 2000)
        slow = Recording(memory, job_of(memory), child, until, SLOW)
        slow.ready()
        slow.ticks(100)
        until(lambda: memory.tick_reader().written - memory.words[Field.SYNCED] == 100, "it waits for the disk")
        time.sleep(0.3)
        waiting = [memory.words[Field.RECORDER_BEAT_NS]]
        until(lambda: memory.words[Field.RECORDER_BEAT_NS] > waiting[0], "it shows that it is alive")
        assert memory.words[Field.SYNCED] == 0
        slow.ticks(200)
        until(lambda: len(slow.session().ticks) == 300, "it writes on")
        assert memory.words[Field.SYNCED] == 0
        assert memory.tick_reader().taken == 0
        until(lambda: memory.words[Field.SYNCED] == 300, "the disk has taken it all")
        until(lambda: memory.tick_reader().taken == 300, "the ring is free again")
        memory.post(Mailbox.RUN_END, NORMAL)
        slow.loop.kill()
        assert slow.end()["card"]["lost_ticks"] == 0
        assert slow.session().payload == slow.payload
        (warning,) = [event.text for event in slow.session().log if event.level == 3]
        assert warning.startswith("the disk took 1.")

    def vanish(self, recording, until):
        recording.job.path.unlink()
        recording.ticks(100)
        until(lambda: recording.words[Field.TROUBLES], "it says so")
        return recording.memory.note(Mailbox.TROUBLES)

    def test_refusing_disk_is_the_recorders_failure_and_the_ring_keeps_all(self, recording, until, tmp_path):
        recording.ready()
        recording.ticks(100)
        posted = self.vanish(recording, until)
        recording.job.path.write_bytes(b"somebody else's")
        recording.memory.post(Mailbox.RUN_END, NORMAL)
        recording.loop.kill()
        recording.end(code=1)
        assert "the file could not be written again" in recording.memory.note(Mailbox.RECORDER_FAILURE)["text"]
        assert posted["file"] == str(recording.job.path)
        account = rebuild(recording.memory, recording.job, tmp_path / "saved.mcap")
        session = read_session(tmp_path / "saved.mcap")
        assert (account.card["ticks"], session.payload) == (200, recording.payload)
        assert "died" not in session.metadata["session"]

    @pytest.mark.parametrize("killed", [False, True], ids=["whole", "killed later"])
    def test_the_second_folder_has_everything_including_ticks_that_left_the_ring(
        self, new_memory, job_of, child, until, tmp_path, killed
    ):
        (tmp_path / "spill").mkdir()
        memory = new_memory(400, 400)
        recording = Recording(memory, job_of(memory, f"session.spill={tmp_path / 'spill'}"), child, until)
        recording.ready()
        for part in range(3):
            recording.ticks(200)
            until(lambda part=part: recording.words[Field.SYNCED] == 200 * (part + 1), "they are on the disk")
        posted = self.vanish(recording, until)
        spilt = tmp_path / "spill" / "stop.mcap"
        assert posted["file"] == str(spilt)
        until(lambda: recording.words[Field.SYNCED] == 700, "they are on the other disk")
        if killed:
            recording.process.kill()
            recording.process.wait()
        recording.ticks(100)
        recording.memory.post(Mailbox.RUN_END, NORMAL)
        recording.loop.kill()
        if killed:
            rebuild(memory, recording.job, spilt)
        else:
            result = recording.end()
            assert result["card"]["session"] == str(spilt)
            assert f"the whole session is in {spilt}" in result["trouble"]
        assert read_session(spilt).payload == recording.payload
        assert read_session(spilt).ticks["tick"].tolist() == list(range(800))


def test_a_filled_memory_holds_a_whole_stop(whole):
    phases = list(dict.fromkeys(TICK.array(in_ring(whole.memory))["phase"].tolist()))
    assert phases == [Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED, Phase.DONE]


class TestBoardInWords:
    def test_a_loop_that_released_its_board_stopped_safely(self, dead):
        assert describe_board(dead) == "the run was stopped safely"

    @pytest.mark.parametrize(
        ("rescued", "report", "text"), [(PID, RESCUED, MADE_SAFE), (PID, IN_VAIN, NOT_SAFE), (OTHER, RESCUED, NOBODY)]
    )
    def test_a_held_board_is_safe_only_after_a_rescue(self, dead, rescued, report, text):
        dead.words[Field.HOLDER_PID], dead.words[Field.RESCUED_PID] = PID, rescued
        dead.post(Mailbox.RESCUE, report)
        assert describe_board(dead) == text
