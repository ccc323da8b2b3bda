"""A name in a file is data: nothing is written anywhere but where the user said."""

from dataclasses import replace

import pytest

from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.sessions import extract

HOSTILE = [
    "../outside.txt",
    "/tmp/outside.txt",  # noqa: S108  nothing is written there
    "sub/inside.txt",
    "..",
    ".",
    "",
    ".bashrc",
    "-rf",
    "a\0b",
    "a\nb",
    "\x1b[2Jscreen",
    "C:\\outside.txt",
    "a" * 300,
    "\u202etxt.exe",
]


@pytest.fixture
def session(short_session):
    return lambda name: replace(short_session, attachments={name: b"content"})


@pytest.fixture(scope="module")
def short_session(short):
    from inteco_abs.sessions import read_session

    return read_session(short)


def test_into_a_file(session, tmp_path):
    assert extract(session("a.txt"), "a.txt", tmp_path / "b.txt") == tmp_path / "b.txt"
    assert (tmp_path / "b.txt").read_bytes() == b"content"


def test_into_a_folder_under_its_own_name(session, tmp_path):
    assert extract(session("a.txt"), "a.txt", tmp_path).read_bytes() == b"content"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("name", HOSTILE)
def test_a_name_that_cannot_be_a_file_name_is_refused(session, tmp_path, name):
    (tmp_path / "place").mkdir()
    with pytest.raises(SessionError, match="not named as a file; name one: --out FILE"):
        extract(session(name), name, tmp_path / "place")
    assert [path.name for path in tmp_path.rglob("*")] == ["place"]


@pytest.mark.parametrize("name", HOSTILE)
def test_but_can_be_had_under_a_name_of_the_users(session, tmp_path, name):
    extract(session(name), name, tmp_path / "mine.txt")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_nothing_is_overwritten(session, tmp_path):
    (tmp_path / "a.txt").write_text("mine")
    with pytest.raises(ConfigError, match="never overwritten"):
        extract(session("a.txt"), "a.txt", tmp_path)
    assert (tmp_path / "a.txt").read_text() == "mine"


def test_a_link_is_not_followed(session, tmp_path):
    (tmp_path / "place").mkdir()
    (tmp_path / "place" / "a.txt").symlink_to(tmp_path / "outside.txt")
    extract(session("a.txt"), "a.txt", tmp_path / "place")
    assert not (tmp_path / "outside.txt").exists()


def test_a_name_that_is_not_there_is_said_with_the_nearest(session, tmp_path):
    with pytest.raises(ConfigError, match=r"did you mean config\.toml"):
        extract(session("config.toml"), "conf.toml", tmp_path)


def test_a_session_without_attachments_says_so(short_session, tmp_path):
    with pytest.raises(ConfigError, match="it has none"):
        extract(replace(short_session, attachments={}), "a.txt", tmp_path)


def test_a_full_disk_leaves_nothing(session, tmp_path, room):
    room(3)
    with pytest.raises(SessionError, match="cannot be written"):
        extract(session("a.txt"), "a.txt", tmp_path)
    room(-1)
    assert list(tmp_path.iterdir()) == []
