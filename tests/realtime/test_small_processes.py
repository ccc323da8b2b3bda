"""The processes that hold a board load nothing that they do not need: it would cost start, memory and page faults."""

import subprocess
import sys

import pytest

NEEDLESS = {"numpy", "pydantic", "mcap", "rich", "click", "inteco_abs.sessions"}


@pytest.mark.untraced
@pytest.mark.parametrize("module", ["loop", "guardian", "drill", "manual"])
def test_a_process_that_holds_a_board_is_small(module):
    loaded = subprocess.run(
        [sys.executable, "-c", f"import sys, inteco_abs.realtime.processes.{module}; print(*sys.modules)"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert NEEDLESS.isdisjoint(loaded.stdout.split())
