import errno
import os
from pathlib import Path

import numpy as np
import pytest

from inteco_abs.errors import AbsError, ConfigError, SessionError
from inteco_abs.sessions import TICK, FileWriter, check_output, read_session

pytestmark = pytest.mark.untraced  # other tests reach these lines, too


@pytest.fixture(scope="module")
def noise():
    """Ticks that do not compress, more than a chunk of them."""
    generator = np.random.default_rng(1)
    ticks = np.frombuffer(bytearray(TICK.pack([0] * len(TICK.columns)) * 8000), TICK.dtype)
    for name in ("slip", "switching", "c0", "c1", "c2", "c3"):
        ticks[name][:] = generator.random(len(ticks))
    return bytes(ticks.base)


def test_an_existing_file_is_not_overwritten(tmp_path):
    path = tmp_path / "stop.mcap"
    path.write_bytes(b"precious")
    for refuse in (check_output, lambda path: FileWriter(path, 0)):
        with pytest.raises(ConfigError, match=r"--out: .*stop\.mcap.* never overwritten"):
            refuse(path)
    assert path.read_bytes() == b"precious"


def test_a_folder_is_not_a_session(tmp_path):
    for refuse in (check_output, lambda path: FileWriter(path, 0)):
        with pytest.raises(ConfigError, match="is a folder"):
            refuse(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_not_made(tmp_path):
    for refuse in (check_output, lambda path: FileWriter(path, 0)):
        with pytest.raises(ConfigError, match="missing does not exist"):
            refuse(tmp_path / "missing" / "stop.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_not_a_folder(tmp_path):
    plain = tmp_path / "plain"
    plain.write_bytes(b"precious")
    with pytest.raises(ConfigError, match="plain"):
        FileWriter(plain / "stop.mcap", 0)
    assert plain.read_bytes() == b"precious"


def test_a_folder_without_permission_to_write(tmp_path):
    path = Path("/proc/stop.mcap")
    check_output(path)
    with pytest.raises(SessionError, match=r"stop\.mcap cannot be created: "):
        FileWriter(path, 0)
    assert not path.exists()
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_is_too_long(tmp_path):
    with pytest.raises(AbsError):
        FileWriter(tmp_path / ("n" * 300 + ".mcap"), 0)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_appears_after_the_check_is_not_overwritten(tmp_path, monkeypatch):
    path = tmp_path / "stop.mcap"
    path.write_bytes(b"precious")
    monkeypatch.setattr("inteco_abs.sessions.file_writer.check_output", lambda _path: None)
    with pytest.raises(SessionError, match="cannot be created"):
        FileWriter(path, 0)
    assert path.read_bytes() == b"precious"


def test_a_link_to_nowhere_is_not_followed(tmp_path):
    path, target = tmp_path / "stop.mcap", tmp_path / "target"
    path.symlink_to(target)
    with pytest.raises(SessionError, match="cannot be created"):
        FileWriter(path, 0)
    assert not target.exists()


def record(path, payload, result):
    with FileWriter(path, 0) as recorder:
        recorder.describe("rig", {"board": "sim:"})
        recorder.attach("config.toml", "application/toml", b"")
        recorder.begin({})
        recorder.ticks(payload)
        recorder.finish("completed", "no fault", result)


def test_a_disk_that_is_full_from_the_start_is_a_session_error(tmp_path, room, noise, quick):
    room(0)
    with pytest.raises(SessionError, match=rf"stop\.mcap .*{os.strerror(errno.EFBIG)}"):
        record(tmp_path / "stop.mcap", noise, quick.stop.card)


@pytest.mark.parametrize("share", [0.01, 0.2, 0.5, 0.7, 0.95, 0.999])
def test_a_disk_that_fills_up_is_a_session_error_and_what_is_there_stays_readable(tmp_path, room, noise, quick, share):
    whole, path = tmp_path / "whole.mcap", tmp_path / "stop.mcap"
    record(whole, noise, quick.stop.card)
    room(int(share * whole.stat().st_size))
    with pytest.raises(SessionError, match=rf"stop\.mcap .*{os.strerror(errno.EFBIG)}"):
        record(path, noise, quick.stop.card)
    session = read_session(path)
    assert session.incomplete
    assert noise.startswith(bytes(session.payload))
    assert session.metadata["rig"] == {"board": "sim:"}


def leave_unfinished(path, room):
    with FileWriter(path, 0) as recorder:
        recorder.begin({})
        recorder.describe("rig", {"board": "sim:"})
        room(path.stat().st_size)


def test_a_disk_that_fills_up_as_an_unfinished_file_is_closed_is_a_session_error(tmp_path, room):
    with pytest.raises(SessionError, match=os.strerror(errno.EFBIG)):
        leave_unfinished(tmp_path / "stop.mcap", room)
