"""A wait for a sync that cannot come ends."""

import os
from threading import Event, Thread
from threading import enumerate as enumerate_threads

import pytest

from inteco_abs.errors import SessionError
from inteco_abs.sessions.disk import Disk


def test_closing_ends_a_wait_for_a_disk_that_hangs(tmp_path, monkeypatch):
    hangs, ended, said = Event(), Event(), []
    monkeypatch.setattr(os, "fdatasync", lambda _file: hangs.set() or ended.wait(20.0))
    disk = Disk(tmp_path / "stop.mcap")

    def wait():
        with pytest.raises(SessionError, match="closed before its content was on the disk") as error:
            disk.sync(7, wait=True)
        said.append(error.value)

    waiting = Thread(target=wait)
    waiting.start()
    assert hangs.wait(20.0)
    disk.close()
    waiting.join(20.0)
    ended.set()
    assert said


def test_an_error_that_is_not_the_disks_ends_a_wait(tmp_path, monkeypatch):
    def fail(_file):
        raise MemoryError

    monkeypatch.setattr(os, "fdatasync", fail)
    monkeypatch.setattr("threading.excepthook", lambda _what: None)
    with Disk(tmp_path / "stop.mcap") as disk, pytest.raises(SessionError, match="closed before"):
        disk.sync(7, wait=True)
    for thread in enumerate_threads():  # while its error is still expected
        if thread.name == "sync":
            thread.join(20.0)
