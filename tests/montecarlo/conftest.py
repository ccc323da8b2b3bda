from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.hookimpl(tryfirst=True)  # then xdist names the groups
def pytest_collection_modifyitems(items):
    """Let one worker compile what two would compile at the same time."""
    for item in items:
        if item.path.is_relative_to(HERE):
            item.add_marker(pytest.mark.xdist_group("compiled"))
