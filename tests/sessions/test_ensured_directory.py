"""A folder for what is about to be written: made with its parents, and taken back where nothing was."""

from pathlib import Path

import pytest

from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.sessions import ensured_directory


def test_an_empty_folder_is_removed_with_the_parents_it_created(tmp_path):
    (tmp_path / "old").mkdir()
    with ensured_directory(tmp_path / "old" / "new" / "newer"):
        assert (tmp_path / "old" / "new" / "newer").is_dir()
    assert [path.name for path in tmp_path.rglob("*")] == ["old"]


def test_what_holds_a_file_stays_also_after_an_error(tmp_path):
    file = tmp_path / "new" / "newer" / "stop.mcap"
    with pytest.raises(ZeroDivisionError), ensured_directory(file.parent):
        1 / file.write_bytes(b"")
    assert file.exists()


def test_a_folder_that_was_there_before_stays_empty_or_not(tmp_path):
    with ensured_directory(tmp_path):
        pass
    assert tmp_path.is_dir()


def test_a_new_folder_is_not_an_old_one(tmp_path):
    with (
        pytest.raises(ConfigError, match=r"--out: the folder .* exists already"),
        ensured_directory(tmp_path, new=True),
    ):
        pytest.fail("it was entered")
    assert tmp_path.is_dir()


def test_a_file_is_in_the_way_of_a_folder_below_it(tmp_path):
    (tmp_path / "file").write_text("no folder")
    with (
        pytest.raises(ConfigError, match=r"--folder: .*Not a directory"),
        ensured_directory(tmp_path / "file/x", "--folder"),
    ):
        pytest.fail("it was entered")


def test_a_disk_that_takes_no_folder_is_not_wrong_usage():
    place = Path("/proc/none/such")
    with pytest.raises(SessionError, match=r"the folder /proc/none/such cannot be made: "), ensured_directory(place):
        pytest.fail("it was entered")
