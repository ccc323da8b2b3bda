import json
import signal
import subprocess
import sys
import time

import pytest

HANGING = """
class Law:
    gains = ()
    internals = ()
    def __init__(self, setup):
        pass
    def update(self, estimate, dt_s):
        open("hanging", "w").close()
        while True:
            pass
"""


@pytest.mark.untraced
def test_a_controller_that_never_returns_is_broken_into_by_a_second_signal(command_path, inteco_abs, tmp_path):
    (tmp_path / "law.py").write_text(HANGING)
    process = subprocess.Popen(
        [command_path, "run", "--virtual", "--controller", "law.py:Law", "--out", "stop.mcap"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while process.poll() is None and not (tmp_path / "hanging").exists():
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    time.sleep(1.5)
    assert process.poll() is None  # one signal only asks
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130, stderr
    assert "Traceback" not in stderr
    info = json.loads(inteco_abs("info", "stop.mcap", "--json", check=0).stdout)
    assert info["metadata"]["session"]["outcome"] == "aborted"
    assert info["ticks"] > 10_000


THREADS = """
import pathlib, sys
from inteco_abs.cli import main
sys.argv = ["inteco-abs", "--version"]
try:
    main()
except SystemExit:
    import numpy
    print(len(list(pathlib.Path("/proc/self/task").iterdir())))
"""


def test_numpy_starts_no_thread_that_would_raise_sigint_where_memory_is_short(untraced):
    environment = {name: value for name, value in untraced.items() if name != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, "-c", THREADS], env=environment, capture_output=True, text=True, timeout=120, check=True
    )
    assert done.stdout.splitlines()[-1] == "1"


def test_missing_memory_is_reported_as_such(main_here, monkeypatch):
    def starve(*_args, **_options):
        raise MemoryError

    monkeypatch.setattr("inteco_abs.sessions.open_session", starve)
    done = main_here("info", "stop.mcap")
    assert done.returncode == 1
    assert "there is not enough memory; end other programs, or allow more (ulimit -v)" in done.stderr
