import json
import os
import re
import runpy
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from inteco_abs.control import ESTIMATORS
from inteco_abs.control.estimators.braking_ekf import EkfTuning
from inteco_abs.published.fitted_q_weights import LAYERS

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

TOOLS = Path(__file__).parent.parent.parent / "tools"


def run(tool, *arguments, environment):
    process = subprocess.run(
        [sys.executable, TOOLS / tool, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    return process.stdout


COMMAND_REPORTS = {"run"}
NAMES = sorted(path.name for path in TOOLS.iterdir() if path.is_file() and not path.suffix)


@pytest.mark.parametrize("name", [name for name in NAMES if name not in COMMAND_REPORTS])
def test_every_tool_prints_its_help_and_does_nothing_else(name, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    if (TOOLS / name).read_text().startswith("#!/bin/sh"):
        assert subprocess.call(["sh", TOOLS / name, "--help"]) == 0
    else:  # here, where most of what they import has been imported
        monkeypatch.setattr(sys, "argv", [name, "--help"])
        monkeypatch.setattr(sys, "path", [str(TOOLS), *sys.path])
        codes = []
        try:
            runpy.run_path(str(TOOLS / name), run_name="__main__")
        except SystemExit as end:
            codes.append(end.code)
        assert codes in ([], [0], [None])
    printed = capfd.readouterr()
    assert printed.err == ""
    assert f"tools/{name}" in printed.out or printed.out.startswith(f"usage: {name}")


@pytest.mark.long
def test_a_stop_more_adds_its_rows_to_the_ring_and_next_to_nothing_else(untraced):
    """Runs of so many ticks have loaded machine code, which shorter ones do without, and their ring is full."""
    printed = run("bench_memory", "60", "120", "--quick", "--json", environment=untraced)
    runs = json.loads(printed)["runs"]
    many, more = (runs[stops]["peaks_mb"]["command"] for stops in ("60", "120"))
    assert runs["60"]["ticks"] > 60_000
    assert more - many < 4.0


@pytest.mark.long
@pytest.mark.parametrize("disabled", ["0", "1"], ids=["machine code", "Python"])
def test_1000_stops_in_virtual_time_take_less_than_150_mb(untraced, disabled):
    stops = {"0": "1000", "1": "120"}[disabled]  # in Python further stops, at 0.1 s each, add next to nothing
    printed = run("bench_memory", stops, "--quick", "--json", environment={**untraced, "NUMBA_DISABLE_JIT": disabled})
    long = json.loads(printed)["runs"][stops]
    assert long["ticks"] > int(stops) * 1_000
    assert long["peaks_mb"]["command"] < 150.0


@pytest.mark.long
@pytest.mark.xdist_group("real time")
@pytest.mark.parametrize(
    ("arguments", "rows"),
    [
        (["1"], ["pipes, same CPU, 2 kHz", "in the loop's process, 2 kHz", "in its own process, 2 kHz"]),
        (["1", "--run"], ["lateness, reaching-law in its own process", "work when braking, in its own process"]),
    ],
)
def test_bench_isolation_prints_the_cost_of_a_process_round_trip(untraced, arguments, rows):
    printed = run("bench_isolation", *arguments, environment=untraced)
    for row in rows:
        median, *_, worst = map(float, re.search(rf"{row} +((?:[\d.]+ *){{4}})", printed).group(1).split())
        assert 0.0 < median < worst


@pytest.mark.long
def test_bench_screen_prices_every_size_against_a_line(untraced):
    printed = run("bench_screen", "1", environment=untraced).splitlines()
    rows = {line[2:18].rstrip(): line[18:].split() for line in printed if line.startswith("  ")}
    assert list(rows)[1:] == ["rich, one line", "our line", "80 x 24", "120 x 36", "looking"]
    assert rows["rich, one line"][-1] == "1.0"
    assert re.search(r"at most 10: (PASS|FAIL)$", printed[-1])


@pytest.mark.long
def test_bench_session_prices_writing_reading_and_replaying(untraced):
    printed = run("bench_session", "1", environment=untraced).splitlines()
    assert int(printed[0].split()[2]) >= 120_000
    rows = {line[2:24].rstrip(): [float(figure) for figure in line[24:].split()] for line in printed if line[0] == " "}
    assert {name: len(figures) for name, figures in rows.items()} == {
        "struct.pack": 2, "write": 3, "np.load": 2, "read": 2, "virtual run": 3, "virtual run, compiled": 3,
        "decide": 3, "replay": 3, "replay, compiled": 3, "read and replay": 3,
        **{f"{how}, level {n}": 2 for how in ("messages", "columns") for n in (-1, 1, 2, 3, 4, 6, 12, 19)},
    }  # fmt: skip
    assert all(figure > 0.0 for figures in rows.values() for figure in figures)


@pytest.mark.long
@pytest.mark.xdist_group("real time")
def test_bench_links_prints_every_link_and_judges_our_layers(untraced):
    printed = run("bench_links", "1", "20", environment=untraced).splitlines()
    rows = {line[:20].rstrip(): line[20:] for line in printed}
    for link in ("in process", "local socket", "pyusb", "libusb, one by one", "libusb, queued", "USB/IP"):
        left_out = "left out" in rows[link] and "CI" not in os.environ
        assert left_out or all(float(figure) > 0.0 for figure in rows[link].split())
    for judged in ("our layers", "the codec in use"):
        assert re.search(r"^ *-?[\d.]+ us, at most \d+: (PASS|FAIL)$", rows[judged])


@pytest.mark.long
@pytest.mark.xdist_group("real time")
def test_bench_deaths_finds_no_tick_lost(untraced):
    rows = run("bench_deaths", "2", environment=untraced).splitlines()[1:]
    assert len(rows) == 7
    for row in rows:
        runs, *_, lost, whole = row[24:].split()
        assert (lost, whole) == ("0", runs)


@pytest.mark.long
@pytest.mark.xdist_group("compiled")
def test_bench_sweep_finds_the_same_bits_after_any_kill(untraced):
    printed = run("bench_sweep", "400", "--every", "3", "--controller", "reaching-law", environment=untraced)
    assert printed.splitlines()[-1] == "the same to the last bit"


@pytest.mark.long
def test_bench_ensemble_compares_a_batch_with_scipy_and_the_scalar_plant(untraced):
    rows = run("bench_ensemble", "1", "20", environment=untraced).splitlines()
    assert [row.split(":")[0] for row in rows if row[0] != " "] == [
        "controlled stops",
        "held stops",
        "whole stops with a controller",
    ]
    assert len([row for row in rows if "  batch, step" in row]) == 5
    ratios = [int(row.split()[-1]) for row in rows if "ratio" in row]
    assert len(ratios) == 7
    assert min(ratios) > 1
    (in_c,) = [row for row in rows if "C, cc -O2" in row]
    assert ("left out" in in_c and "CI" not in os.environ) or int(in_c.split()[-5]) > 25
    rates = [float(row.split()[-6]) for row in rows if "stops per second and core" in row]
    assert len(rates) == 6
    assert all(compiled > python for compiled, python in zip(rates[::2], rates[1::2], strict=True))


@pytest.mark.long
def test_tune_estimators_prints_every_estimator_with_its_default_starred(untraced):
    rows = run("tune_estimators", "1", "1", environment=untraced).splitlines()[1:]
    starred = [row.split()[0].rstrip("*") for row in rows if "*" in row]
    assert starred == list(ESTIMATORS)
    for row in rows:
        bias, std, fast, slow, loop = map(float, row[44:].split())
        assert abs(bias) < 6.0
        assert min(std, fast, slow, loop) > 0.0


def test_the_bound_is_known_where_it_has_a_formula():
    tool = runpy.run_path(str(TOOLS / "tune_estimators"))
    # a jitter of many lines hides them: what is left is its variance and that of rounding
    assert tool["count_variance"](2.0) == pytest.approx(4.0 + 1.0 / 12.0, rel=1e-5)
    times, variance, known = np.arange(50.0), 0.2, np.array([9.0, 0.04])
    slopes = np.zeros((50, 3, 2))  # one encoder counts a line's start and slope, which is what is wanted
    slopes[:, 0], slopes[:, 2, 1] = np.stack([np.ones(50), times], axis=1), 1.0
    found = tool["bounds"](np.diag(known), slopes, variance)
    for until in (1, 2, 50):
        seen = times[:until]
        normal = np.array([[until, seen.sum()], [seen.sum(), (seen * seen).sum()]]) / variance + np.diag(1.0 / known)
        assert found[until - 1] == pytest.approx(np.linalg.inv(normal)[1, 1])


@pytest.mark.long
def test_no_estimator_beats_the_bound(untraced):
    rows = run("tune_estimators", "bound", "1", environment=untraced).splitlines()[1:]
    assert [row.split()[0] for row in rows] == list(ESTIMATORS)
    assert all(float(row.split()[3]) > 1.0 for row in rows)


@pytest.mark.long
@pytest.mark.xdist_group("compiled")
def test_train_fitted_q_writes_a_network_as_the_controller_has_it(untraced, tmp_path):
    chosen = ("--rounds", "3", "--rigs", "2", "--out", str(tmp_path / "weights.py"))
    assert run("train_fitted_q", *chosen, environment=untraced).startswith("round 3, ")
    layers = runpy.run_path(str(tmp_path / "weights.py"))["LAYERS"]
    assert [(len(layer), {len(row) for row in layer}) for layer in layers] == [
        (len(layer), {len(row) for row in layer}) for layer in LAYERS
    ]


def cells(printed):
    """Every line of every Markdown table."""
    return [line.strip("| ").split(" | ") for line in printed.splitlines() if line.startswith("|")]


@pytest.mark.long
def test_compare_controllers_sets_ours_beside_the_oracle_and_its_targets(untraced):
    chosen = "hard: (predictive|oracle)|capped: (predictive|oracle)"
    printed = run(
        "compare_controllers", "--first=1000", "--draws=2", "--jobs=1", f"--only={chosen}", environment=untraced
    )
    headings, _, ours, oracle, *_ = cells(printed)
    assert (ours[0], oracle[0]) == ("predictive-reaching, observer", "oracle")
    assert {len(row) for row in cells(printed)} == {len(headings)}
    assert float(ours[1].split()[0]) > float(oracle[1].split()[0])
    assert "hard:1000-1001: 2 rigs;" in printed
    assert "capped:1000-1001: 1 rig;" in printed
    assert "1 of 2 left out" in printed
    judged = [line for line in printed.splitlines() if line.startswith("- ")]
    assert len(judged) == 9
    assert all(line.endswith(("reached", "MISSED")) for line in judged)


@pytest.mark.long
def test_judge_search_sets_the_search_beside_hindsight_and_a_locked_wheel(untraced):
    printed = run(
        "judge_search", "--first=3000", "--draws=2", "--jobs=1", "--road=wet cobblestone", environment=untraced
    )
    headings, _, row = cells(printed)
    ratios = {name: float(text.split()[0]) for name, text in zip(headings[3:], row[3:], strict=True)}
    assert 1.0 <= ratios["search from 0.2"] < 1.03
    assert ratios["locked wheel"] > 1.2


@pytest.mark.long
def test_compare_controllers_takes_every_part_of_ours_away(untraced):
    printed = run("compare_controllers", "--draws=1", "--jobs=2", "--only=^without", environment=untraced)
    rows = {name: values for name, *values in cells(printed)[2:]}
    assert len(rows) == 13
    # each part does something, but the suspicion of a step: the adhesion of these rigs has none
    assert rows.pop("no step is suspected") == rows["ours"]
    assert len({tuple(values) for values in rows.values()}) == len(rows)


@pytest.mark.long
def test_tune_predictive_begins_with_what_is_in_force_and_prints_it_as_code(untraced):
    search = ("--generations=1", "--size=4", "--draws=1", "--sigma=1e-6", "--jobs=2")
    printed = run("tune_predictive", *search, environment=untraced).splitlines()
    present = {f"    {name}: float = {value!r}" for name, value in asdict(EkfTuning()).items()}
    searched = {line for line in printed if ": float = " in line}
    assert searched <= present
    unsearched = {line for line in present if line.endswith(("= 0.0", "= False"))}
    assert len(present - searched - unsearched) == 7
    assert "    controller.gains.kM=400.0" in printed


@pytest.mark.long
def test_bench_identify_prints_errors_and_coverage_of_each_number(untraced):
    rows = run("bench_identify", "hard:100-104", environment=untraced).splitlines()
    covered = {row.split()[0]: row.split()[1] for row in rows if "/5" in row}
    assert {"d", "M0", "brake_lag", "brake_dead_time", "M1(0.7)", "mu(0.2)"} <= covered.keys()
    assert sum(int(share.removesuffix("/5")) for share in covered.values()) >= 0.85 * 5 * len(covered)


UNLUCKY = """
import os, pytest

@pytest.fixture
def leftover():
    yield
    raise RuntimeError("a process is left")

def test_is_late():
    assert False

def test_leaves_something(leftover):
    pass

def test_ends_its_process():
    os._exit(3)
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("selection", "again"),
    [("late", ["test_is_late"]), ("late or leaves", []), ("late or ends", [])],
    ids=["a failure", "an error of a teardown", "a test that ends its process"],
)
def test_the_check_tries_again_only_what_a_busy_computer_may_have_caused(tmp_path, untraced, selection, again):
    (tmp_path / "test_unlucky.py").write_text(UNLUCKY)
    where = [
        "-c",
        "pyproject.toml",
        f"--rootdir={tmp_path}",
        "-o",
        f"cache_dir={tmp_path}/kept",
        "-p",
        "tests.conftest",
    ]
    code = subprocess.call(
        [sys.executable, "-m", "pytest", "-n1", "-k", selection, *where, tmp_path],
        cwd=TOOLS.parent,
        env={**untraced, "PYTHONPATH": "tests/system"},
        stdout=subprocess.DEVNULL,
    )
    checks = runpy.run_path(str(TOOLS / "checks.py"))
    assert code == checks["TESTS_FAILED"]
    tried = checks["unsteady_tests"](tmp_path / "kept" / "v")
    assert [name.rpartition(":")[2] for name in tried] == again
