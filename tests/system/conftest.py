import json
import subprocess
import sysconfig
from pathlib import Path

import pytest

COMMAND = Path(sysconfig.get_path("scripts")) / "inteco-abs"


@pytest.fixture(scope="session")
def command_path():
    return COMMAND


@pytest.fixture
def inteco_abs(tmp_path):
    """Runs the installed command in an empty folder; gives back the finished process."""

    def run(*arguments, check=None, folder=tmp_path):
        process = subprocess.run(
            [COMMAND, *map(str, arguments)], cwd=folder, capture_output=True, text=True, timeout=120, check=False
        )
        if check is not None:
            assert process.returncode == check, process.stderr
        assert "Traceback" not in process.stderr
        return process

    return run


@pytest.fixture
def card(inteco_abs):
    """Runs one stop in virtual time and gives its result card."""

    def stop(*arguments, out="stop.mcap", seed=1):
        run = inteco_abs(
            "run", "--board", "sim:", "--virtual", "--seed", seed, "--out", out, "--json", *arguments, check=0
        )
        return json.loads(run.stdout)

    return stop
