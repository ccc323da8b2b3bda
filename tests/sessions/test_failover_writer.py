"""A run is kept at any failure of its disk."""

import errno
import os
import shutil
from functools import partial
from pathlib import Path
from threading import Event, Thread

import pytest

from inteco_abs.errors import CaptureError, ConfigError, SessionError
from inteco_abs.sessions import (
    TICK,
    TRUTH,
    FailoverWriter,
    FileWriter,
    RunEnd,
    RunHeader,
    check_spill,
    read_session,
    spill_path,
)
from inteco_abs.signals import Reason

SLICES = 8
GONE = os.strerror(errno.ENOENT)


class Memory:
    """What is added to a keeper and not in a file for sure, as a ring holds it: that and `spare` rows more."""

    spare = 0

    def __init__(self, payload, truths):
        self._rows = (payload, TICK.size), (truths, TRUTH.size)
        self._end = self._taken = 0

    def more(self, rows):
        first, self._end = self._end, self._end + rows
        return self._between(first, self._end)

    def release(self):
        self._taken = self._end

    def held(self):
        first = max(self._taken - self.spare, 0)
        yield from (self._between(at, min(at + 100, self._end)) for at in range(first, self._end, 100))

    def _between(self, first, end):
        return tuple(data[first * size : end * size] for data, size in self._rows)


class Kept:
    """A stop added to a writer in slices; `out` and `spill` are folders of their own."""

    def __init__(self, folder, source, *, spill=True, **recorder):
        self.out, self.spill = folder / "out" / "stop.mcap", folder / "spill" / "stop.mcap"
        for path in (self.out, self.spill):
            path.parent.mkdir()
        self.said = []
        self._config = source.config
        session = source.session
        self.payload, self._truths = session.payload, b"".join(map(TRUTH.pack, session.truth.tolist()))
        self._rows = -(-len(session.ticks) // SLICES)
        opener = partial(FileWriter, start_ns=int(session.ticks["time_ns"][0]), session_id="an-id", epoch_ns=10**18)
        self.memory = Memory(self.payload, self._truths)
        self.keeper = FailoverWriter(
            self.out,
            partial(opener, **recorder),
            self.memory.held,
            self.spill if spill else None,
            lambda *warning: self.said.append(warning),
        )

    def introduce(self):
        self.keeper.write_header(self._config, RunHeader("sim:", {}, True, {"Mk": 2.0}, [], b""), Path("stop.mcap"))
        return self

    def slice(self):
        """One slice into the file, or so the caller believes."""
        self.add(self._rows)
        self.keeper.flush()
        if self.keeper.writing:
            self.memory.release()

    def add(self, rows):
        self.keeper.add(*self.memory.more(rows))

    def add_all(self, *, before=lambda _number: None):
        for number in range(SLICES):
            before(number)
            self.slice()
        return self

    def conclude(self, frames=None):
        with self.keeper:
            return self.keeper.finish(RunEnd(Reason.NONE, self.keeper.ticks, frames=frames))

    def vanish(self):
        shutil.rmtree(self.out.parent)


@pytest.fixture
def kept(tmp_path, tiny):
    made = []

    def make(**options):
        made.append(Kept(tmp_path, tiny, **options))
        return made[-1]

    yield make
    for each in made:
        with each.keeper:
            pass


def whole(path, kept):
    """The session at `path`, which has everything."""
    session = read_session(path)
    assert not session.incomplete
    assert session.payload == kept.payload
    assert session.metadata["session"]["session_id"] == "an-id"
    assert "config.toml" in session.attachments
    return session


def test_on_a_good_disk_the_file_is_where_it_should_be_and_nothing_is_said(kept):
    run = kept().introduce().add_all()
    account = run.conclude()
    assert (account.exit_code, account.trouble, run.said) == (0, "", [])
    assert account.card["session"] == "stop.mcap"
    whole(run.out, run)
    assert not run.spill.exists()


def test_lost_frames_are_reported_beside_disk_errors(kept):
    def none():
        raise CaptureError("no process has saved them")

    run = kept().introduce()
    trouble = run.add_all(before=lambda number: run.vanish() if number == 3 else None).conclude(none).trouble
    assert f"{run.out} is gone" in trouble
    assert "raw frames: no process has saved them; the whole session is in" in trouble
    whole(run.spill, run)


@pytest.mark.parametrize("at", range(SLICES))
def test_when_the_folder_vanishes_the_whole_session_is_in_the_second_folder(kept, replayed, at):
    run = kept().introduce()
    run.add_all(before=lambda number: run.vanish() if number == at else None)
    account = run.conclude()
    assert (account.exit_code, account.outcome) == (3, "completed")
    assert account.card["session"] == str(run.spill)
    assert f"{run.out} is gone" in account.trouble
    assert f"the whole session is in {run.spill}" in account.trouble
    ((text, path),) = run.said
    assert path == run.spill
    assert "the run continues, and it is now written to" in text
    session = whole(run.spill, run)
    assert [event.text for event in session.log if event.level == 3] == [f"{run.out} is gone: {GONE}"]
    if at in {0, SLICES - 1}:
        assert replayed(session).differing == 0
    assert not run.out.exists()


def test_when_the_folder_vanishes_after_the_last_tick_so_it_does_too(kept):
    run = kept().introduce().add_all()
    run.vanish()
    assert run.conclude().exit_code == 3
    whole(run.spill, run)


@pytest.mark.parametrize("at", range(SLICES))
def test_a_disk_that_refuses_once_has_the_whole_session_in_the_end(kept, room, at):
    run = kept(spill=False).introduce()
    lifted = os.sysconf("SC_PAGESIZE") << 30

    def limit(number):
        room(run.out.stat().st_size if number == at else lifted)

    run.add_all(before=limit)
    room(lifted)
    assert run.keeper.ticks == len(run.payload) // TICK.size
    assert not run.keeper.writing
    ((text, path),) = run.said
    assert path == run.out
    assert "its ticks are kept in memory" in text
    account = run.conclude()
    assert (account.exit_code, account.card["session"]) == (3, "stop.mcap")
    whole(run.out, run)
    assert {path.name for path in run.out.parent.iterdir()} == {"stop.mcap"}


def test_ticks_that_come_just_as_the_disk_refuses_are_kept(tmp_path, chunked, room):
    run = Kept(tmp_path, chunked, spill=False).introduce()
    room(run.out.stat().st_size)
    run.add(len(run.payload) // TICK.size)  # more than a chunk: some of it goes to the disk at once
    assert not run.keeper.writing
    assert run.keeper.ticks == len(run.payload) // TICK.size
    room(os.sysconf("SC_PAGESIZE") << 30)
    run.conclude()
    whole(run.out, run)


def test_a_disk_that_keeps_failing_is_an_error_at_the_end_and_loses_nothing(kept):
    run = kept(spill=False).introduce()
    run.add_all(before=lambda number: run.vanish() if number == 2 else None)
    with pytest.raises(SessionError, match=r"is gone: .*; the file could not be written again at the end either"):
        run.keeper.finish(RunEnd(Reason.NONE, run.keeper.ticks))
    assert b"".join(ticks for ticks, _ in run.keeper.rows()) == run.payload
    assert len(run.said) == 1


def test_a_second_folder_that_fails_too_is_named(kept):
    run = kept().introduce()
    run.spill.parent.rmdir()
    run.add_all(before=lambda number: run.vanish() if number == 2 else None)
    ((text, _),) = run.said
    assert str(run.out) in text
    assert f"the folder {run.spill.parent} does not exist" in text
    assert "its ticks are kept in memory" in text
    with pytest.raises(SessionError, match=r"out/stop\.mcap is gone"):
        run.conclude()


def test_the_first_folder_is_used_again_when_the_second_vanishes(kept):
    run = kept().introduce()

    def before(number):
        if number == 2:
            run.vanish()
        if number == 4:
            shutil.rmtree(run.spill.parent)
            run.out.parent.mkdir()

    run.add_all(before=before)
    assert run.conclude().card["session"] == "stop.mcap"
    whole(run.out, run)


def test_another_file_that_has_taken_the_name_is_left_alone(kept):
    run = kept(spill=False).introduce()

    def before(number):
        if number == 3:
            run.vanish()
            run.out.parent.mkdir()
            run.out.write_bytes(b"somebody else's")

    run.add_all(before=before)
    assert "another file has its name" in run.said[0][0]
    with pytest.raises(SessionError):
        run.conclude()
    assert run.out.read_bytes() == b"somebody else's"
    assert {path.name for path in run.out.parent.iterdir()} == {"stop.mcap"}


def test_a_disk_that_refuses_before_the_run_refuses_the_run_and_leaves_no_file(kept, room):
    run = kept()
    room(100)
    with pytest.raises(SessionError, match="cannot be written"):
        run.introduce()
    assert run.said == []
    assert not run.out.exists()
    assert not run.spill.exists()


def test_warnings_are_in_the_log_of_the_file_that_is_used_last(kept):
    run = kept().introduce()
    run.keeper.warn(10**18 + 5, "the disk is slow")
    run.add_all(before=lambda number: run.vanish() if number == 2 else None)
    run.keeper.warn(10**18 + 9, "the disk is slow again")
    run.conclude()
    texts = [event.text for event in read_session(run.spill).log]
    assert texts.count("the disk is slow") == texts.count("the disk is slow again") == 1


class TestSync:
    @pytest.fixture
    def synced(self, monkeypatch):
        """Sizes of the file whenever a sync of it began; `Gate.open` lets it go on."""
        gate, sync = Gate(), os.fdatasync
        monkeypatch.setattr(os, "fdatasync", lambda file: (gate.passed(os.fstat(file).st_size), sync(file)))
        yield gate
        gate.open.set()

    def test_the_header_every_flush_and_the_end_reach_the_disk(self, kept, synced, until):
        run = kept(durable=True).introduce()
        assert synced.sizes == [run.out.stat().st_size]
        for _ in range(SLICES):
            run.slice()
            until(lambda: run.keeper.synced == run.keeper.ticks, "it is on the disk")
            assert synced.sizes[-1] == run.out.stat().st_size
        run.conclude()
        assert (len(synced.sizes), synced.sizes[-1]) == (SLICES + 2, run.out.stat().st_size)
        assert run.said == []

    def test_writing_does_not_wait_for_a_disk_that_hangs_and_the_end_does(self, kept, synced, until):
        run = kept(durable=True).introduce()
        synced.open.clear()
        run.add_all()
        assert len(read_session(run.out).ticks) == run.keeper.ticks
        until(lambda: len(synced.sizes) == 2, "it waits for the disk")
        assert run.keeper.synced == 0
        ending = Thread(target=run.conclude)
        ending.start()
        until(lambda: not read_session(run.out).incomplete, "the file is complete")
        assert ending.is_alive()
        synced.open.set()
        ending.join()
        assert (len(synced.sizes), synced.sizes[-1]) == (3, run.out.stat().st_size)  # one for all that came meanwhile
        whole(run.out, run)

    def test_folder_is_synced_with_the_header_so_the_name_is_on_the_disk(self, kept, monkeypatch):
        folders, sync = [], os.fsync
        monkeypatch.setattr(
            os, "fsync", lambda file: (folders.append(Path(f"/proc/self/fd/{file}").readlink()), sync(file))
        )
        run = kept(durable=True).introduce()
        assert folders == [run.out.parent]
        run.add_all().conclude()
        assert folders == [run.out.parent]

    def test_a_folder_that_its_file_system_cannot_sync_is_no_error(self, kept, monkeypatch):
        monkeypatch.setattr(os, "fsync", refusing(errno.EINVAL))
        run = kept(durable=True).introduce().add_all()
        assert run.conclude().trouble == ""

    def test_a_run_in_virtual_time_syncs_nothing(self, kept, synced):
        kept().introduce().add_all().conclude()
        assert synced.sizes == []

    @pytest.mark.parametrize("call", ["fdatasync", "fsync"])
    def test_a_disk_that_fails_to_sync_the_header_refuses_the_run(self, kept, monkeypatch, call):
        run = kept(durable=True)
        monkeypatch.setattr(os, call, refusing(errno.EIO))
        with pytest.raises(SessionError, match="cannot be written: Input/output error; the rig was not moved"):
            run.introduce()
        assert not run.out.exists()

    def test_a_disk_that_fails_to_sync_is_left_for_the_second_one_with_all_ticks(self, kept, monkeypatch, until):
        run = kept(durable=True).introduce()
        run.slice()
        until(lambda: run.keeper.synced == run.keeper.ticks, "it is on the disk")
        failed, sync = [], os.fdatasync

        def fail(file):
            if Path(f"/proc/self/fd/{file}").readlink() == run.out:
                failed.append(file)
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            sync(file)

        monkeypatch.setattr(os, "fdatasync", fail)
        run.slice()
        until(lambda: failed, "the disk has failed")
        for _ in range(SLICES - 2):
            run.slice()
        assert "cannot be written: Input/output error; the run continues, and it is now written to" in run.said[0][0]
        run.conclude()
        whole(run.spill, run)

    def test_a_disk_that_fails_to_sync_at_the_end_is_left_too(self, kept, monkeypatch, until):
        run = kept(durable=True).introduce().add_all()
        until(lambda: run.keeper.synced == run.keeper.ticks, "it is on the disk")
        monkeypatch.setattr(os, "fdatasync", refusing(errno.EIO))
        with run.keeper, pytest.raises(SessionError, match="Input/output error"):
            run.keeper.finish(RunEnd(Reason.NONE, run.keeper.ticks))


class Gate:
    """Notes the sizes of a file that is synced, and lets syncs go on only while it is open."""

    def __init__(self):
        self.sizes = []
        self.open = Event()
        self.open.set()

    def passed(self, size):
        self.sizes.append(size)
        self.open.wait(30)


def refusing(number):
    """A call that always fails with an error number."""

    def call(_file):
        raise OSError(number, os.strerror(number))

    return call


class TestSpill:
    def test_it_is_off_by_default(self, tmp_path, quick):
        check_spill(quick.config)
        assert spill_path(tmp_path / "stop.mcap", quick.config, "12345678-9") is None

    def test_a_folder_that_is_not_there_is_refused_before_the_run(self, run, tmp_path, devices):
        with pytest.raises(ConfigError, match=r"session\.spill.*not a folder; create it first"):
            run(f"session.spill={tmp_path / 'nowhere'}")
        assert devices == []

    def test_what_is_there_already_is_not_overwritten(self, run, tmp_path):
        (tmp_path / "spill").mkdir()
        config = run(f"session.spill={tmp_path / 'spill'}").config
        first = spill_path(tmp_path / "stop.mcap", config, "12345678-9")
        assert first == tmp_path / "spill" / "stop.mcap"
        first.write_bytes(b"precious")
        assert spill_path(tmp_path / "stop.mcap", config, "12345678-9").name == "stop-12345678.mcap"
