import json
import signal
import subprocess
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


@pytest.mark.parametrize("most_mb", [140, 160])
def test_too_little_memory_is_told_as_that_and_as_no_interrupt(command_path, untraced, tmp_path, most_mb):
    limited = (
        f"ulimit -v {most_mb}000; exec {command_path} run --board sim: --virtual --set loop.rate_hz=200 --out x.mcap"
    )
    done = subprocess.run(
        ["sh", "-c", limited], cwd=tmp_path, env=untraced, capture_output=True, text=True, timeout=120, check=False
    )
    assert "interrupted" not in done.stderr
    assert done.returncode in {0, 1, 3}
