"""Raw frames on their way from the loop's process to the session."""

from contextlib import nullcontext
from dataclasses import replace

import pytest

from inteco_abs.boards.transports.links import Link
from inteco_abs.errors import CaptureError, LinkError
from inteco_abs.realtime.frame_spool import saving_frames, spooled_frames
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory
from inteco_abs.realtime.processes.recorder import rebuild, recover_run
from inteco_abs.realtime.spool import spool_run
from inteco_abs.realtime.window import Window
from inteco_abs.sessions import TICK, RunEnd, RunHeader, pack_tick, read_frames, read_session
from inteco_abs.signals import Reason
from inteco_abs.wire.capture import Capture, Record, RecordKind, write_capture
from inteco_abs.wire.recording import record_wire

CAPTURE = Capture(
    "usb2",
    "inteco-abs",
    "monotonic",
    (Record(0.0, RecordKind.OUT, None, b"request"), Record(0.0001, RecordKind.ERROR, None, b"", "no answer", "in")),
    "",
    10**9,
)


class Inner(Link):
    """A link that takes everything."""

    def write(self, data):
        pass

    def read(self, length):
        return bytes(length)

    def discard(self, length):
        pass

    def close(self):
        pass


@pytest.fixture
def ended(new_memory, job_of):
    """The memory of a run of eight ticks that ended well, and whose job wants frames."""
    memory = new_memory()
    job = replace(job_of(memory), frames=True)
    job.post(memory)
    note = {"identity": {}, "gains": {}, "internals": [], "settings": []}
    memory.post(Mailbox.HEADER, note)
    memory.post(Mailbox.RUN_END, {"reason": 0, "detail": "", "cost": {}})
    ring = memory.tick_ring(pack_tick)
    for number in range(8):
        ring.append([number if column.name in {"tick", "time_ns"} else 0 for column in TICK.columns])
    return memory, job


def test_a_session_rebuilt_from_memory_has_the_loops_frames(ended):
    memory, job = ended
    write_capture(memory.frames, CAPTURE)
    account = rebuild(memory, job, job.path)
    assert (account.trouble, len(read_session(job.path).ticks)) == ("", 8)
    assert read_frames(job.path)._replace(name="") == CAPTURE
    memory.remove()
    assert not memory.frames.exists()


def test_a_killed_loops_session_lacks_only_the_frames_and_says_so(ended):
    memory, job = ended
    part = memory.frames.with_name(f"{memory.frames.name}.part")
    part.write_text('{"format"')
    account = rebuild(memory, job, job.path)
    assert "raw frames: the loop's process ended before it had saved them" in account.trouble
    session = read_session(job.path)
    assert (len(session.ticks), session.frames) == (8, 0)
    assert "ended before" in session.metadata["frames"]["missing"]
    memory.remove()
    assert not part.exists()


def test_the_loops_error_about_frames_is_quoted(ended):
    memory, job = ended
    memory.post(Mailbox.FAILURE, {"kind": "CaptureError", "text": "No space left on device", "notes": []})
    assert "No space left on device" in rebuild(memory, job, job.path).trouble


def test_frames_that_were_not_requested_are_not_missed(ended):
    memory, job = ended
    assert spooled_frames(memory, replace(job, frames=False)) is None
    assert rebuild(memory, replace(job, frames=False), job.path).trouble == ""


def test_recover_of_a_ring_finds_the_frames_beside_it(ended, child, tmp_path):
    memory, _ = ended
    write_capture(memory.frames, CAPTURE)
    gone = child("true")
    gone.wait()
    for word in (Field.SUPERVISOR_PID, Field.LOOP_PID):
        memory.words[word] = gone.pid
    recover_run(memory.path, tmp_path / "saved.mcap")
    assert read_frames(tmp_path / "saved.mcap").records == CAPTURE.records
    assert not memory.frames.exists()


class TestLeaving:
    @pytest.fixture
    def loop(self, ended):
        """What a loop's process does with its recording: a message, then the test's action."""
        memory, job = ended

        def run(then=lambda: None):
            with record_wire(None, job.config, keep=True) as around, saving_frames(memory, job, around):
                around(Inner()).write(b"safe")
                then()

        return run

    def fail(self):
        raise LinkError("gone")

    def test_messages_lie_beside_the_ring_in_the_end(self, loop, ended):
        loop()
        with spooled_frames(*ended)() as (head, records):
            assert (head.board, [record.data for record in records]) == ("usb2", [b"safe"])

    def test_where_no_board_was_opened_nothing_lies_there(self, ended):
        memory, job = ended
        with record_wire(None, job.config, keep=True) as around, saving_frames(memory, job, around):
            pass
        assert not memory.frames.exists()

    def test_of_a_run_that_failed_too(self, loop, ended):
        with pytest.raises(LinkError, match="gone"):
            loop(self.fail)
        assert ended[0].frames.exists()

    def test_no_room_does_not_hide_how_the_run_ended(self, loop, ended):
        ended[0].frames.mkdir()
        with pytest.raises(LinkError, match="gone") as error:
            loop(self.fail)
        assert "cannot be renamed" in error.value.__notes__[0]
        ended[0].frames.with_suffix(".frames.part").unlink()
        with pytest.raises(CaptureError, match="cannot be renamed"):
            loop()


def test_a_run_that_is_stowed_without_room_for_its_frames_is_stowed(ended, memory_folder, monkeypatch):
    memory, job = ended
    window = Window(memory.tick_reader(), memory.truth_reader(), over=True)
    monkeypatch.setattr(RunMemory, "frames", memory_folder / "missing" / "x.frames")
    end = RunEnd(Reason.NONE, 1, frames=lambda: nullcontext((CAPTURE, CAPTURE.records)))
    introduction = RunHeader("sim:", {}, virtual=True, gains={}, internals=[], controller_source=b"")
    ring = spool_run(job, introduction, end, window, job.path)
    assert RunMemory.open(ring).tick_reader().written == memory.tick_reader().written > 0
