"""Sessions to open in other people's readers."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from inteco_abs.config import load_config
from inteco_abs.control import CONTROLLERS, control_check
from inteco_abs.experiment import Plan, run_stop

HERE = Path(__file__).parent
KEPT = {
    "golden": HERE.parent / "golden" / "published-rig.mcap",
    "golden of a drawn rig": HERE.parent / "golden" / "drawn-rig.mcap",
    "archived": HERE.parent / "sessions" / "archive" / "v1.mcap",
}
TINY = ("experiment.start_speed_rad_s=10.0", "experiment.idle_s=0.01", "experiment.hold_s=0.0", "loop.rate_hz=200.0")


@pytest.fixture(scope="session")
def fresh(tmp_path_factory):
    """A session of a few hundred ticks and their raw frames, as this version writes it."""
    path = tmp_path_factory.mktemp("fresh") / "stop.mcap"
    run_stop(load_config(settings=TINY, checks=[control_check(CONTROLLERS)]), Plan(out=path, seed=1, frames=True))
    return path


@pytest.fixture(scope="session", params=[*KEPT, "fresh"])
def path(request):
    """A session: one that is kept, or one just recorded."""
    return KEPT.get(request.param) or request.getfixturevalue("fresh")


@pytest.fixture(scope="session")
def in_typescript():
    """What the official TypeScript reader finds in a file."""
    node = shutil.which("node")
    if node is None or not (HERE / "node_modules" / "@mcap").is_dir():
        missing = "the TypeScript reader is missing: install Node.js 20 or newer with npm, and run tools/check again"
        if os.environ.get("CI"):
            pytest.fail(missing)
        pytest.skip(missing)

    def read(path):
        command = [node, HERE / "read_session.mjs", path]
        process = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert process.returncode == 0, process.stderr
        return json.loads(process.stdout)

    return read
