import pytest
from host_board import HostBoard


@pytest.fixture(scope="session")
def only_board(tmp_path_factory):
    return HostBoard(tmp_path_factory.mktemp("board"))


@pytest.fixture
def board(only_board):
    only_board.reset()
    return only_board
