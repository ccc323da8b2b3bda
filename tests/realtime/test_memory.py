import errno
import gc
import math
import os
import resource
import shutil
import struct
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.realtime.memory import (
    Field,
    Mailbox,
    RunMemory,
    alive,
    is_ring,
    left_rings,
    require_room,
    run_bytes,
    start_time,
)
from inteco_abs.realtime.ring import ring_bytes
from inteco_abs.sessions import TICK, TRUTH

SIZE = 12
CAPACITY = 3
MADE = [Field.SUPERVISOR_PID, Field.EPOCH_NS, Field.SUPERVISOR_STARTED]
"""Words of a memory that was just made."""
RINGS_AT = run_bytes(SIZE, 0, SIZE, 0) - 2 * ring_bytes(SIZE, 0)
PIDS = (Field.SUPERVISOR_PID, Field.LOOP_PID, Field.RECORDER_PID)


def pack(buffer, offset, number):
    struct.pack_into("<QI", buffer, offset, number, number % 97)


def record(number):
    return struct.pack("<QI", number, number % 97)


def descriptors():
    """What this process has open, when what earlier tests have left is closed."""
    gc.collect()
    return sorted(each.name for each in Path("/proc/self/fd").iterdir())


@pytest.fixture
def small(memory_folder):
    """Both ends of a memory, as two processes have it."""
    memory = RunMemory.create(SIZE, CAPACITY, SIZE, CAPACITY)
    assert memory.path.parent == memory_folder
    return memory, RunMemory.open(memory.path)


class TestFile:
    def test_a_memory_that_was_made_can_be_opened_and_is_empty(self, small):
        memory, other = small
        assert other.path == memory.path
        assert other.tick_capacity == CAPACITY
        assert [word for word in Field if other.words[word]] == MADE
        assert [other.image(note) for note in Mailbox] == [None] * len(Mailbox)
        assert (other.tick_reader().written, other.truth_reader().written) == (0, 0)
        assert other.histogram.sparse() == {}

    def test_only_its_owner_may_look_into_it(self, memory):
        assert memory.path.stat().st_mode & 0o077 == 0

    def test_two_memories_are_two_files(self, new_memory):
        assert new_memory().path != new_memory().path

    def test_removing_takes_away_the_file_and_the_boards_socket_and_may_be_done_twice(self, memory, memory_folder):
        memory.socket.touch()
        for _ in range(2):
            memory.remove()
        assert not list(memory_folder.iterdir())

    def test_a_process_that_has_it_open_keeps_it_after_it_was_removed(self, small):
        memory, other = small
        memory.remove()
        memory.words[Field.STOP] = 7
        assert other.words[Field.STOP] == 7

    @pytest.mark.parametrize(
        ("content", "complaint"),
        [
            (lambda _whole: b"", "not a tick ring"),
            (lambda whole: bytes(len(whole)), "not a tick ring"),
            (lambda whole: b"inteco-abs ring 1\n" + whole[18:], "not a tick ring of this version"),
            (lambda whole: whole[:100], "not a tick ring"),
            (lambda whole: whole[:RINGS_AT], "was cut"),
            (lambda whole: whole[:-1], "was cut"),
            (lambda whole: whole[:-100], "was cut"),
            (lambda whole: whole + b"\0", "not what its header says"),
        ],
        ids=["empty", "foreign", "another version", "header only", "no rings", "one byte short", "short", "longer"],
    )
    def test_a_file_that_is_not_a_whole_memory_is_refused_by_name(self, memory, content, complaint):
        memory.path.write_bytes(content(memory.path.read_bytes()))
        with pytest.raises(SessionError, match=complaint) as refusal:
            RunMemory.open(memory.path)
        assert str(memory.path) in str(refusal.value)

    def test_a_file_that_is_missing_is_refused_by_name(self, memory_folder):
        with pytest.raises(SessionError, match=r"gone\.ring: No such file"):
            RunMemory.open(memory_folder / "gone.ring")

    def test_only_the_mappings_descriptors_stay_open(self, new_memory, memory_folder):
        before = len(descriptors())
        made = new_memory()
        opened = RunMemory.open(made.path)
        assert not list(left_rings(memory_folder))
        assert len(descriptors()) == before + len([made, opened])

    def test_one_that_cannot_be_opened_once_it_was_made_leaves_no_file(self, memory_folder, monkeypatch):
        monkeypatch.setattr(os, "pwrite", lambda *_: 0)
        with pytest.raises(SessionError, match="not a tick ring"):
            RunMemory.create(SIZE, CAPACITY, SIZE, CAPACITY)
        assert not list(memory_folder.iterdir())

    def test_a_folder_is_refused(self, memory_folder):
        with pytest.raises(SessionError, match="directory"):
            RunMemory.open(memory_folder)

    @pytest.mark.parametrize("number", [errno.ENOSPC, errno.ENOMEM, errno.EDQUOT])
    def test_too_little_memory_is_an_error_with_advice_and_leaves_no_file(self, memory_folder, monkeypatch, number):
        def refuse(*_):
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(os, "posix_fallocate", refuse)
        with pytest.raises(SessionError, match=r"105 MB.*loop\.ring_s") as refusal:
            RunMemory.create(980, 100_000, 8, 1)
        assert os.strerror(number) in str(refusal.value)
        assert not list(memory_folder.iterdir())

    def test_a_run_reserves_exactly_the_bytes_it_needs(self, memory, memory_folder, monkeypatch):
        size = memory.path.stat().st_size
        assert run_bytes(TICK.size, 50, TRUTH.size, 50) == size
        monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=size * (folder == memory_folder)))
        require_room(size)
        with pytest.raises(SessionError, match=rf"{size / 1e6:.0f} MB are free; free some"):
            require_room(size + 1)

    def test_a_memory_of_this_process_alone_has_no_file(self, memory_folder):
        memory = RunMemory.private(SIZE, CAPACITY)
        memory.tick_ring(pack).append(5)
        memory.words[Field.GO] = 1
        memory.post(Mailbox.DRILL, "result")
        assert memory.tick_capacity == CAPACITY
        assert memory.tick_reader().take() == record(5)
        assert memory.note(Mailbox.DRILL) == "result"
        assert not list(memory_folder.iterdir())

    def test_a_kept_memory_stays_without_the_boards_socket_and_is_not_in_use(self, memory):
        memory.socket.touch()
        memory.frames.touch()
        memory.keep()
        memory.remove()
        assert memory.path.exists()
        assert memory.frames.exists()
        assert not memory.socket.exists()
        assert memory.words[Field.KEPT] == 1
        assert not RunMemory.open(memory.path).in_use()

    def test_a_copy_in_another_folder_is_kept(self, memory, tmp_path):
        copy = tmp_path / "copy.ring"
        copy.write_bytes(memory.path.read_bytes())
        RunMemory.open(copy).remove()
        assert copy.exists()

    def test_files_beside_it_are_removed_with_it(self, memory, memory_folder):
        for beside in (memory.socket, memory.frames, memory.frames.with_suffix(".frames.part")):
            beside.touch()
        memory.remove()
        assert not list(memory_folder.iterdir())

    def test_it_knows_when_the_monotonic_clock_began(self, memory):
        assert abs(memory.words[Field.EPOCH_NS] - (time.time_ns() - time.monotonic_ns())) < 10**9

    def test_a_ring_is_recognised_without_waiting_for_a_pipe(self, memory, memory_folder):
        older, pipe, other = (memory_folder / name for name in ("older", "pipe", "other"))
        older.write_bytes(b"inteco-abs ring 1\n")
        other.write_bytes(b"inteco-abs session")
        os.mkfifo(pipe)
        found = [is_ring(each) for each in (memory.path, older, other, pipe, memory_folder, memory_folder / "none")]
        assert found == [True, True, False, False, False, False]
        assert not is_ring(memory_folder / ("long" * 100))


class TestNotes:
    @pytest.mark.parametrize("note", Mailbox)
    def test_a_mailbox_is_empty_before_the_first_message(self, small, note):
        memory, other = small
        assert other.note(note) is None
        assert other.image(note) is None
        content = {"text": "µs \0", "numbers": [1, -2.5, None, True], "nothing": ""}
        memory.post(note, content)
        assert other.note(note) == content
        assert [each for each in Mailbox if other.image(each) is not None] == [note]

    @pytest.mark.parametrize("image", [b"", b"\0", bytes(range(256)) * 2])
    def test_bytes_come_back_as_they_are(self, small, image):
        memory, other = small
        memory.post(Mailbox.SAFE_IMAGE, image)
        assert other.image(Mailbox.SAFE_IMAGE) == image

    def test_a_later_note_takes_the_place_of_an_earlier_one(self, small):
        memory, other = small
        memory.post(Mailbox.DRILL, {"a": "long one"})
        memory.post(Mailbox.DRILL, 1)
        assert other.note(Mailbox.DRILL) == 1

    def test_a_mailbox_is_empty_while_its_message_is_replaced(self, small):
        memory, other = small
        seen = []

        class Looking(bytes):
            def __len__(self):
                seen.append(other.image(Mailbox.DRILL))
                return super().__len__()

        memory.post(Mailbox.DRILL, b"one")
        memory.post(Mailbox.DRILL, Looking(b"two"))
        assert set(seen) == {b"one", None}
        assert other.image(Mailbox.DRILL) == b"two"

    def test_notes_of_the_greatest_length_fit_and_longer_ones_are_refused(self, small):
        memory, other = small
        posted = {}
        for note in Mailbox:
            with pytest.raises(SessionError, match=rf"{note.name.lower()} .*too long: at most \d+") as refusal:
                memory.post(note, bytes(10 << 20))
            most = int(str(refusal.value).rpartition(" ")[2])
            assert most > 60_000
            posted[note] = bytes([65 + note]) * most
            memory.post(note, posted[note])
            with pytest.raises(SessionError, match="too long"):
                memory.post(note, b"x" * (most + 1))
        assert {note: other.image(note) for note in Mailbox} == posted
        assert [word for word in Field if other.words[word]] == MADE
        assert other.histogram.sparse() == {}


class TestWords:
    def test_every_word_is_seen_by_another_mapping(self, small):
        memory, other = small
        for word in Field:
            memory.words[word] = -1 - word
        assert [other.words[word] for word in Field] == [-1 - word for word in Field]

    def test_fields_and_mailboxes_are_shared_with_another_process(self, memory, python_child):
        memory.words[Field.GO] = 2**62
        memory.post(Mailbox.DRILL, "result")
        code = """
import sys
from pathlib import Path
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory
memory = RunMemory.open(Path(sys.argv[1]))
print(memory.words[Field.GO] == 2**62, memory.note(Mailbox.DRILL))
memory.words[Field.STOP] = -5
memory.post(Mailbox.FAILURE, ["heard"])
"""
        process = python_child(code, memory.path)
        assert process.communicate(timeout=60)[0].split() == ["True", "result"]
        assert memory.words[Field.STOP] == -5
        assert memory.note(Mailbox.FAILURE) == ["heard"]

    def test_waiting_ends_with_the_condition_and_sleeps_until_then(self, memory, monkeypatch):
        asked, slept_s = [], []
        monkeypatch.setattr(time, "sleep", slept_s.append)
        assert memory.wait(lambda: asked.append(1) or len(asked) == 3, 60.0)
        assert len(asked) == 3
        assert len(slept_s) == 2
        assert min(slept_s) > 0.0

    def test_waiting_comes_to_an_end_without_it(self, memory):
        before = time.monotonic()
        assert not memory.wait(lambda: False, 0.02)
        assert time.monotonic() - before >= 0.02


class TestRings:
    @pytest.mark.parametrize("kind", ["tick", "truth"])
    def test_records_cross_from_one_mapping_to_the_other(self, small, kind):
        memory, other = small
        ring, reader = getattr(memory, f"{kind}_ring")(pack), getattr(other, f"{kind}_reader")()
        for first in range(0, 5 * CAPACITY, 2):
            ring.append(first)
            ring.append(first + 1)
            assert reader.newest() == record(first + 1)
            assert reader.take() == record(first) + record(first + 1)

    @pytest.mark.parametrize("kind", ["tick", "truth"])
    def test_what_a_reader_of_another_mapping_takes_makes_room(self, small, kind):
        memory, other = small
        ring, reader = getattr(memory, f"{kind}_ring")(pack), getattr(other, f"{kind}_reader")()
        for number in range(CAPACITY):
            ring.append(number)
        with pytest.raises(BufferError):
            ring.append(CAPACITY)
        reader.take(1)
        ring.append(CAPACITY)
        assert reader.take() == b"".join(map(record, range(1, CAPACITY + 1)))

    def test_the_two_rings_do_not_touch_each_other(self, small):
        memory, other = small
        ticks, truths = memory.tick_ring(pack), memory.truth_ring(pack)
        for number in range(CAPACITY):
            ticks.append(number)
        memory.histogram.add([3.0])
        truths.append(100)  # fewer: the same number in the wrong place would not be seen
        assert other.tick_reader().take() == b"".join(map(record, range(CAPACITY)))
        assert other.truth_reader().take() == record(100)
        assert other.histogram.sparse() == {"3": 1}

    def test_a_full_ring_writes_outside_no_row(self, memory):
        for ring in (memory.truth_ring(pack), memory.tick_ring(pack)):
            for number in range(50):
                ring.append(number)
            assert memory.histogram.sparse() == {}
            assert [note for note in Mailbox if memory.image(note) is not None] == []
        assert memory.truth_reader().written == 50

    def test_a_reader_that_begins_again_finds_what_the_ring_still_holds(self, small):
        memory, other = small
        ring, reader = memory.tick_ring(pack), other.tick_reader()
        for number in range(2 * CAPACITY + 1):
            ring.append(number)
            reader.take()
        late = RunMemory.open(memory.path).tick_reader()
        assert late.held_from() == CAPACITY + 1
        late.release(late.held_from())
        assert late.take() == b"".join(map(record, range(CAPACITY + 1, 2 * CAPACITY + 1)))


class TestLeftRings:
    def test_a_memory_whose_processes_are_all_gone_is_found(self, memory, memory_folder, ended):
        memory.tick_ring(pack).append(1)
        for word in PIDS:
            memory.words[word] = ended
        assert list(left_rings(memory_folder)) == [memory.path]

    def test_one_that_holds_no_tick_is_removed_as_nothing_ran(self, memory, memory_folder, ended):
        for word in PIDS:
            memory.words[word] = ended
        assert not list(left_rings(memory_folder))
        assert not memory.path.exists()

    def test_one_whose_ticks_were_for_a_screen_only_is_removed(self, memory, memory_folder, ended):
        memory.tick_ring(pack).append(1)
        memory.words[Field.UNRECORDED] = 1
        for word in PIDS:
            memory.words[word] = ended
        assert not list(left_rings(memory_folder))
        assert not memory.path.exists()

    @pytest.mark.parametrize("word", PIDS)
    def test_a_memory_with_one_living_process_is_left_alone(self, memory, memory_folder, ended, word):
        for each in PIDS:
            memory.words[each] = ended
        memory.name(word, os.getpid())
        assert memory.in_use()
        assert not list(left_rings(memory_folder))

    def test_a_living_process_whose_start_is_not_known_keeps_it(self, memory):
        memory.words[Field.SUPERVISOR_STARTED] = 0
        assert memory.in_use()

    @pytest.mark.parametrize("word", PIDS)
    def test_a_process_number_that_was_reused_keeps_nothing(self, memory, memory_folder, ended, word):
        memory.tick_ring(pack).append(1)
        for each in PIDS:
            memory.words[each] = ended
        memory.name(word, os.getpid())
        memory.words[PIDS.index(word) + Field.SUPERVISOR_STARTED] -= 1
        assert not memory.in_use()
        assert list(left_rings(memory_folder)) == [memory.path]

    def test_a_memory_that_is_just_being_made_is_left_alone(self, memory, memory_folder):
        memory.words[Field.SUPERVISOR_PID] = 0
        assert not list(left_rings(memory_folder))
        assert memory.path.exists()

    def test_pipes_links_and_other_users_files_are_passed_over_at_once(self, memory, memory_folder, ended, monkeypatch):
        memory.tick_ring(pack).append(1)
        memory.words[Field.SUPERVISOR_PID] = ended
        os.mkfifo(memory_folder / "inteco-abs-pipe.ring")
        (memory_folder / "inteco-abs-link.ring").symlink_to(memory.path)
        (memory_folder / "inteco-abs-nowhere.ring").symlink_to(memory_folder / "not there")
        assert list(left_rings(memory_folder)) == [memory.path]
        monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
        assert list(left_rings(memory_folder)) == []
        assert memory.path.exists()

    def test_several_are_found_in_order_and_other_files_are_skipped(self, new_memory, memory_folder, ended):
        memories = [new_memory() for _ in range(3)]
        for each in memories:
            each.tick_ring(pack).append(1)
            each.words[Field.SUPERVISOR_PID] = ended
        whole = memories[1].path.read_bytes()
        (memory_folder / "inteco-abs-foreign.ring").write_bytes(b"x" * len(whole))
        (memory_folder / "inteco-abs-cut.ring").write_bytes(whole[:100])
        (memory_folder / "inteco-abs-without.ring").write_bytes(whole[:RINGS_AT])
        memories[1].path.write_bytes(b"")
        (memory_folder / "inteco-abs-mine.ring").write_bytes(b"something else")
        (memory_folder / "inteco-abs-folder.ring").mkdir()
        memories[2].path.rename(memory_folder / "another-program.ring")
        assert list(left_rings(memory_folder)) == [memories[0].path]


class TestAlive:
    def test_a_process_that_runs_is_alive(self, child):
        for pid in (child().pid, os.getpid(), 1):
            assert alive(pid)

    def test_a_process_that_has_ended_is_not_alive_even_before_it_is_waited_for(self, child, until):
        process = child()
        process.kill()
        until(lambda: not alive(process.pid), "the kernel ends it")
        assert process.returncode is None
        process.wait()
        assert not alive(process.pid)

    @pytest.mark.parametrize("pid", [0, -1, -(2**31), 2**31 - 1, 2**31, 2**32 - 1, 2**40])
    def test_a_number_that_no_process_has_is_not(self, pid):
        assert not alive(pid)

    def test_without_a_descriptor_to_look_through_a_process_is_not_mistaken_for_dead(self, child):
        process = child()
        limits, taken = resource.getrlimit(resource.RLIMIT_NOFILE), []
        resource.setrlimit(resource.RLIMIT_NOFILE, (64, limits[1]))
        try:
            with suppress(OSError):
                while True:
                    taken.append(os.dup(0))
            with pytest.raises(OSError, match="Too many open files"):
                os.pidfd_open(process.pid)
            assert alive(process.pid)
            process.kill()
            process.wait()
            assert not alive(process.pid)
        finally:
            for file in taken:
                os.close(file)
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)

    @pytest.mark.parametrize("number", [errno.ENOSYS, errno.EPERM])
    def test_where_the_system_gives_no_descriptor_of_a_process_its_number_is_asked(self, ended, monkeypatch, number):
        def refuse(_pid):
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(os, "pidfd_open", refuse)
        assert alive(os.getpid())
        assert not alive(ended)
        monkeypatch.setattr(os, "kill", lambda _pid, _number: refuse(_pid))
        assert alive(ended)  # as far as known, when it is another user's

    def test_asking_leaves_no_descriptor_open(self, child):
        pid = child().pid
        before = descriptors()
        assert alive(pid)
        assert descriptors() == before

    def test_more_than_a_thousand_descriptors_are_not_an_obstacle(self, child):
        process = child()
        limits = resource.getrlimit(resource.RLIMIT_NOFILE)
        if limits[0] < 1200:
            resource.setrlimit(resource.RLIMIT_NOFILE, (1200, limits[1]))
        taken = [os.dup(0) for _ in range(1100)]
        try:
            assert alive(process.pid)
        finally:
            for file in taken:
                os.close(file)
            resource.setrlimit(resource.RLIMIT_NOFILE, limits)

    def test_the_start_of_a_process_is_later_than_that_of_its_parent(self, child):
        assert 0 < start_time(os.getpid()) <= start_time(child().pid)
        assert start_time(2**31 - 1) == 0

    def test_the_number_of_a_thread_is_not_a_process(self):
        over, numbers = threading.Event(), []
        thread = threading.Thread(target=lambda: (numbers.append(threading.get_native_id()), over.wait()))
        thread.start()
        try:
            while not numbers:
                time.sleep(0.001)
            assert not alive(numbers[0])
        finally:
            over.set()
            thread.join()


@pytest.mark.parametrize("key", ["over_speed_rad_s", "silence_s"])
def test_no_job_with_a_value_out_of_range_is_posted_for_processes_that_trust_it(new_memory, job_of, key):
    memory = new_memory(10)
    job = job_of(memory)
    config = replace(job.config, guard=replace(job.config.guard, **{key: math.nan}))
    with pytest.raises(ConfigError, match=f"guard.{key}: nan"):
        replace(job, config=config).post(memory)


def test_a_controller_fits_into_the_job_with_its_files_or_is_refused(memory, job_of):
    job = job_of(memory)
    largest = replace(job, controller_source=bytes(1_500_000))
    largest.post(memory)
    assert type(job).of(memory).controller_source == largest.controller_source
    with pytest.raises(ConfigError, match=r"the files beside it .* make 1\.5 MB compressed: must be at most 1\.5 MB"):
        replace(job, controller_source=bytes(1_500_001)).post(memory)
