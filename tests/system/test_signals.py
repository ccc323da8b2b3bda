import json
import signal
import subprocess
import time

import pytest


def interrupt_when(process, out, written, number, deadline_s=60.0):
    """Sends the signal once the session file shows that the run has begun."""
    end = time.monotonic() + deadline_s
    while time.monotonic() < end and not (out.exists() and written in out.read_bytes()):
        time.sleep(0.02)
    time.sleep(1.0)  # well into the run: the wheel is turning
    process.send_signal(number)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda n: n.name)
def test_a_signal_ends_a_real_time_run_with_a_complete_session(command_path, inteco_abs, untraced, tmp_path, number):
    out = tmp_path / "stop.mcap"
    process = subprocess.Popen(
        [command_path, "run", "--board", "sim:", "--out", out, "--json"],
        cwd=tmp_path, env=untraced, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    interrupt_when(process, out, b"inteco_abs.session", number)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 130, stderr
    assert "Traceback" not in stderr
    assert json.loads(stdout)["outcome"] == "interrupted"
    info = json.loads(inteco_abs("info", out, "--json", check=0).stdout)
    assert info["incomplete"] == ""
    assert info["metadata"]["session"]["outcome"] == "interrupted"
    assert json.loads(inteco_abs("replay", out, "--json", check=0).stdout)["differing"] == 0


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
