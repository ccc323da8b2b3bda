"""The check list in this process, and over USB/IP on the loopback interface."""

import pytest
from check_list import CHECKS


@pytest.mark.parametrize("name", CHECKS)
def test_check(bench, name):
    CHECKS[name](bench)
