import shutil

import pytest
from host_board import HostBoard


@pytest.fixture(scope="session", autouse=True)
def compiler():
    import os

    if all(map(shutil.which, ("cc", "make"))):
        return
    if os.environ.get("CI"):
        pytest.fail("cc and make build the firmware for the tests, and one of them is missing")
    pytest.skip("cc or make is missing (Debian: sudo apt-get install gcc make)")


@pytest.fixture(scope="session")
def only_board(tmp_path_factory):
    return HostBoard(tmp_path_factory.mktemp("board"))


@pytest.fixture
def board(only_board):
    only_board.reset()
    return only_board
