"""Off the rig everywhere: the verbs without what Windows and macOS lack, and what says that it needs Linux."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import faked_system
import pytest

from inteco_abs.sessions import check_output

PACKAGE = Path(__file__).parents[2] / "inteco_abs"
SHORT = [
    *("--set", "experiment.start_speed_rad_s=40"),
    *("--set", "experiment.idle_s=0.02", "--set", "experiment.hold_s=0"),
]
RUN = ["run", "--virtual", "--seed", "1", *SHORT]
USUAL = [
    [*RUN, "--out", "stop.mcap", "--json"],
    ["replay", "stop.mcap"],
    ["info", "stop.mcap"],
    ["list", "."],
    ["export", "stop.mcap", "-o", "stop.csv"],
]
LINUX_ONLY = [["run", "--out", "rt.mcap"], ["doctor"], ["commission"]]


def on(system, folder, verbs):
    command = [sys.executable, faked_system.__file__, system, folder, json.dumps(verbs)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def payload(text):
    return json.loads(text.splitlines()[-1])["payload_sha256"]


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """Hash of the same stop on this system as it is."""
    from inteco_abs.config import load_config
    from inteco_abs.experiment import Plan, run_stop

    out = tmp_path_factory.mktemp("here") / "stop.mcap"
    return run_stop(load_config(settings=SHORT[1::2]), Plan(out, seed=1)).card["payload_sha256"]


@pytest.mark.parametrize("system", [pytest.param("darwin", marks=pytest.mark.long), "win32"])
def test_stop_is_recorded_and_replayed_bit_for_bit_and_the_rest_needs_linux(system, tmp_path, here):
    (tmp_path / "umläut λ").mkdir()
    verbs = [*USUAL, ["annotate", "stop.mcap", "--note", "привет λ"], ["info", "stop.mcap", "--all"], *LINUX_ONLY]
    if system == "win32":
        verbs += [["mock-board", "--pty"], ["mock-board", "--usbip", "unix:x"], [*RUN, "--out", "nul.mcap"]]
    found = on(system, tmp_path, verbs)
    usual, others = found["verbs"][: -len(verbs) + len(USUAL) + 2], found["verbs"][len(USUAL) + 2 :]
    assert [one["code"] for one in usual] == [0] * (len(USUAL) + 2), usual
    assert payload(usual[0]["text"]) == here
    assert "none differ" in usual[1]["text"]
    for one in others[:5]:
        assert one["code"] == 1
        assert f"needs Linux, and this is {system}" in one["text"]
        said = [line for line in one["text"].splitlines() if "an earlier run left its ticks" not in line]
        assert len(said) <= 2
    if system == "win32":
        assert (others[5]["code"], "Windows has no such file names" in others[5]["text"]) == (2, True)
    assert found["board"] == 328


@pytest.mark.long
@pytest.mark.parametrize("system", faked_system.NAMES)
def test_reports_figures_sweeps_and_the_rest_run_there(system, tmp_path):
    verbs = [
        USUAL[0],
        ["report", "stop.mcap", "-o", "report.html"],
        ["figure", "stop.mcap", "-o", "figure.png"],
        ["export", "stop.mcap", "-o", "stop.parquet"],
        ["what-if", "stop.mcap", "--set", "controller.gains.Mk=5"],
        ["publish", "published", "stop.mcap", "--author", "A. Person", "--licence", "CC-BY-4.0"],
        ["golden", "add", "stop.mcap", "--reason", "first"],
        ["golden", "test"],
        ["config", "init", "rig.toml"],
        ["controllers", "reaching-law"],
    ]
    if system != "win32":  # numba compiles for the faked system
        verbs.append(["sweep", "--rigs", "hard:0-1", "--jobs", "1", "--store", "stored", "--csv", "sweep.csv"])
    found = on(system, tmp_path, verbs)
    assert [one["code"] for one in found["verbs"]] == [0] * len(verbs), found["verbs"]


@pytest.mark.long
def test_text_is_written_with_the_same_line_ends_on_every_system():
    kernel = {"realtime/tuning.py", "boards/transports/serial_ports.py", "cli/run.py"}  # files of the kernel's
    for path in PACKAGE.rglob("*.py"):
        if path.relative_to(PACKAGE).as_posix() in kernel:
            continue
        for node in ast.walk(ast.parse(path.read_bytes())):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            modes = [one.value for one in node.args[:1] if isinstance(one, ast.Constant)]
            writes = node.func.attr == "write_text" or (node.func.attr == "open" and modes in (["w"], ["x"], ["a"]))
            keywords = {each.arg for each in node.keywords}
            if writes and "force_zip64" not in keywords and ast.unparse(node.func.value) != "archive":
                assert {"encoding", "newline"} <= keywords, f"{path}:{node.lineno}"


@pytest.mark.parametrize("name", ["CON.mcap", "com1.mcap", "a:b.mcap", "a?.mcap", "stop.mcap."])
def test_names_that_windows_keeps_are_refused_there_alone(name, tmp_path, monkeypatch):
    check_output(tmp_path / name)
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(Exception, match="Windows has no such file names"):
        check_output(tmp_path / name)
    check_output(tmp_path / "console.mcap")
