"""The check list in this process, and over USB/IP on the loopback interface."""

import pytest
from check_list import CHECKS

pytestmark = pytest.mark.untraced  # other tests reach these lines, too


@pytest.mark.parametrize("name", CHECKS)
def test_board_check_passes(bench, name):
    CHECKS[name](bench)
