import json
import os
import subprocess
import sys
import sysconfig
from contextlib import ExitStack
from pathlib import Path

import pytest
from live import LiveRun
from wrong_inputs import Answers, Place

from inteco_abs.cli import main
from inteco_abs.config import GuardConfig, load_config
from inteco_abs.experiment import Plan, run_stop

RATES_HZ = (500, 200, 100)
"""The limits count periods: at a lower rate a shared computer may pause for longer."""
ABORTED = 5
BUSY = ("late, slow or failed", "hung and was killed")
"""Message of a run on a computer that did not keep the rate."""
COMMAND = Path(sysconfig.get_path("scripts")) / "inteco-abs"


@pytest.fixture(scope="session")
def command_path():
    return COMMAND


@pytest.fixture(scope="session")
def untraced():
    """Environment without coverage's tracing: what must keep real time, or fit on a small disk, cannot carry it."""
    return {key: value for key, value in os.environ.items() if not key.startswith("COV")}


@pytest.fixture
def inteco_abs(tmp_path):
    """Runs the installed command in an empty folder; gives back the finished process."""

    def run(*arguments, check=None, folder=tmp_path, environment=None):
        process = subprocess.run(
            [COMMAND, *map(str, arguments)],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        if check is not None:
            assert process.returncode == check, process.stderr
        assert "Traceback" not in process.stderr
        return process

    return run


@pytest.fixture
def real_stop(inteco_abs, untraced, tmp_path):
    """Runs a stop in real time with the guard of a real board, at the first rate that this computer keeps."""
    limits = GuardConfig()
    kept = [f"guard.{key}={getattr(limits, key)}" for key in ("missed_in_a_row", "bucket_limit", "silence_s")]

    def run(*arguments):
        for rate_hz in RATES_HZ:
            (tmp_path / "stop.mcap").unlink(missing_ok=True)
            words = [word for setting in (*kept, f"loop.rate_hz={rate_hz}") for word in ("--set", setting)]
            done = inteco_abs("run", "--out", "stop.mcap", "--json", *arguments, *words, environment=untraced)
            if done.returncode != ABORTED or not any(words in done.stderr for words in BUSY):
                break
        assert done.returncode in (0, 3), done.stderr  # a shared computer may be late: that is said, not hidden
        return done

    return run


@pytest.fixture
def live(command_path, tmp_path, untraced):
    """Starts runs in real time; what is left of them afterwards is killed and removed."""
    with ExitStack() as ends:

        def start(*arguments, **options):
            run = LiveRun(command_path, tmp_path, untraced, *arguments, **options)
            ends.callback(run.destroy)
            return run

        yield start


@pytest.fixture
def main_here(tmp_path, monkeypatch, capsys):
    """Runs the command's main() in this process, in an empty folder: a tenth of what starting the command costs."""

    def run(*arguments, check=None):
        monkeypatch.setattr(sys, "argv", ["inteco-abs", *map(str, arguments)])
        monkeypatch.chdir(tmp_path)
        with pytest.raises(SystemExit) as end:
            main()
        code, said = end.value.code, capsys.readouterr()
        if check is not None:
            assert int(code or 0) == check, said.err
        assert "Traceback" not in said.err
        return subprocess.CompletedProcess(sys.argv, int(code or 0), said.out, said.err)

    return run


@pytest.fixture
def card(main_here):
    """Runs one stop in virtual time and gives its result card."""

    def stop(*arguments, out="stop.mcap", seed=1):
        run = main_here(
            "run", "--board", "sim:", "--virtual", "--seed", seed, "--out", out, "--json", *arguments, check=0
        )
        return json.loads(run.stdout)

    return stop


@pytest.fixture(scope="session")
def whole_stop(tmp_path_factory):
    """Bytes of the session of a short stop."""
    path = tmp_path_factory.mktemp("stop") / "stop.mcap"
    run_stop(load_config(settings=["experiment.start_speed_rad_s=20"]), Plan(path))
    return path.read_bytes()


@pytest.fixture
def answers(main_here, tmp_path, monkeypatch, request):
    """Types the rows of `wrong_inputs` in an empty folder."""
    with ExitStack() as stack:

        def opened(path):
            return stack.enter_context(Path(path).open())

        yield Answers(main_here, Place(tmp_path, monkeypatch, lambda: request.getfixturevalue("whole_stop"), opened))
