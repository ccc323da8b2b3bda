import os
import shutil

import pytest
from host_board import HostBoard


@pytest.fixture(scope="session")
def needed():
    """Skips where one of these commands is missing; a server must have them."""

    def require(**packages):
        missing = [package for command, package in packages.items() if shutil.which(command) is None]
        if missing and os.environ.get("CI"):
            pytest.fail(f"not installed: {', '.join(missing)}")
        if missing:
            pytest.skip(f"not installed: {', '.join(missing)} (Debian: sudo apt-get install {' '.join(missing)})")

    return require


@pytest.fixture(scope="session", autouse=True)
def _compiler(needed):
    needed(cc="gcc", make="make")


@pytest.fixture(scope="session")
def only_board(tmp_path_factory):
    return HostBoard(tmp_path_factory.mktemp("board"))


@pytest.fixture
def board(only_board):
    only_board.reset()
    return only_board
