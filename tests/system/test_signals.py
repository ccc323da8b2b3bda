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
def test_a_signal_ends_a_real_time_run_with_a_complete_session(command_path, inteco_abs, tmp_path, number):
    out = tmp_path / "stop.mcap"
    process = subprocess.Popen(
        [command_path, "run", "--board", "sim:", "--out", out, "--json"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
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
