"""A session is kept while disks fill up, vanish and come back, and the program dies, in any order."""

import errno
import os
import shutil
import tempfile
from contextlib import suppress
from functools import cache, partial
from io import FileIO
from pathlib import Path
from typing import ClassVar

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from inteco_abs.errors import AbsError, SessionError
from inteco_abs.sessions import (
    TICK,
    TRUTH,
    FailoverWriter,
    FileWriter,
    RunEnd,
    RunHeader,
    file_writer,
    read_session,
    recover_session,
)
from inteco_abs.sessions.mcap_writer import McapWriter
from inteco_abs.signals import Reason
from tests.faults.stage import SHORTEST, configured, ride

pytestmark = pytest.mark.untraced

FEW = settings(max_examples=max(15, settings().max_examples // 2), stateful_step_count=25)
ID = "an-id"


@cache
def stop():
    """Ticks and truths of a stop, each back to back."""
    result = ride(configured(*SHORTEST))
    return b"".join(map(TICK.pack, result.ticks)), b"".join(map(TRUTH.pack, result.truths))


class Full(FileIO):
    """Files on disks that may be full."""

    folders: ClassVar[set[str]] = set()

    def write(self, data, /):
        if str(Path(self.name).parent) in self.folders:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(data)


class Keeping(RuleBasedStateMachine):
    """A fail-over writer, its two disks, and the ticks that were added."""

    steps = recoveries = 0

    def __init__(self):
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="keeper-"))
        self.places = {name: self.folder / name / "stop.mcap" for name in ("out", "spill")}
        for path in self.places.values():
            path.parent.mkdir()
        self.given = self.truths = b""
        self.released = 0
        self.flushed = {}
        """What each file has for sure."""
        self.keeper = None

    @initialize(spill=st.booleans())
    def introduce(self, spill):
        opener = partial(FileWriter, start_ns=0, session_id=ID, epoch_ns=10**18)
        self.keeper = FailoverWriter(self.places["out"], opener, self.held, self.places["spill"] if spill else None)
        self.keeper.write_header(configured(*SHORTEST), RunHeader("sim:", {}, True, {}, [], b""), self.places["out"])

    @property
    def left(self):
        return len(stop()[0]) - len(self.given)

    @precondition(lambda self: self.left)
    @rule(ticks=st.integers(1, 30))
    def add(self, ticks):
        at = len(self.given)
        more = stop()[0][at : at + ticks * TICK.size]
        truths = stop()[1] if not at else b""
        self.given += more
        self.truths = self.truths or truths
        self.keeper.add(more, truths)

    def held(self):
        """As a ring: what is in no file for sure."""
        yield self.given[self.released :], b"" if self.released else self.truths

    @rule(killed=st.booleans())
    def flush(self, killed):
        self.keeper.flush()
        if self.keeper.writing:
            self.flushed[self.keeper.path] = self.released = len(self.given)
            if killed:
                self.recover_what_a_kill_would_leave_now(self.keeper.path.parent.name)

    @rule()
    def warn(self):
        self.keeper.warn(10**18 + len(self.given), "the disk is slow")

    @rule(name=st.sampled_from(["out", "spill"]))
    def vanish(self, name):
        shutil.rmtree(self.places[name].parent, ignore_errors=True)
        self.flushed.pop(self.places[name], None)

    @rule(name=st.sampled_from(["out", "spill"]))
    def come_back(self, name):
        self.places[name].parent.mkdir(exist_ok=True)

    @rule(name=st.sampled_from(["out", "spill"]))
    def fill_up(self, name):
        Full.folders.add(str(self.places[name].parent))

    @rule()
    def make_room(self):
        Full.folders.clear()

    @rule(name=st.sampled_from(["out", "spill"]))
    def recover_what_a_kill_would_leave_now(self, name):
        """Recover from what the disk has by now: buffers of the program die with it."""
        file = self.places[name]
        if not file.exists():
            return
        left, again = self.folder / "left.mcap", self.folder / "again.mcap"
        shutil.copy(file, left)
        again.unlink(missing_ok=True)
        full, Full.folders = Full.folders, set()
        try:
            payload = recovered(left, again)
        finally:
            Full.folders = full
        assert self.given.startswith(payload), "a tick that never was"
        assert len(payload) >= self.flushed.get(file, 0), "a flushed tick is gone"
        type(self).recoveries += 1

    @invariant()
    def nothing_is_forgotten(self):
        type(self).steps += 1
        if self.keeper is not None:
            assert self.keeper.ticks == len(self.given) // TICK.size

    def teardown(self):
        try:
            if self.keeper is not None:
                self._conclude()
        finally:
            Full.folders.clear()
            shutil.rmtree(self.folder)

    def _conclude(self):
        with self.keeper:
            try:
                account = self.keeper.finish(RunEnd(Reason.NONE, self.keeper.ticks))
            except SessionError:
                assert b"".join(ticks for ticks, _ in self.keeper.rows()) == self.given
            else:
                session = read_session(Path(account.card["session"]))
                assert not session.incomplete
                assert bytes(session.payload) == self.given
        assert not list(self.folder.rglob("*.part"))


def recovered(left, again):
    """Ticks that can be had of a file that was cut; none where there is none."""
    with suppress(AbsError):
        recover_session(left, again)
        return bytes(read_session(again).payload)
    return b""


def test_every_tick_is_kept_through_failing_disks_and_dying_programs(monkeypatch, record_property):
    disk = type("FullDisk", (file_writer.Disk, Full), {})
    monkeypatch.setattr(file_writer, "Disk", disk)
    monkeypatch.setattr(file_writer, "McapWriter", partial(McapWriter, chunk_bytes=2048))
    run_state_machine_as_test(Keeping, settings=FEW)
    record_property("figures", f"keeper: {Keeping.steps} steps, {Keeping.recoveries} recoveries of what a kill left")
