import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from inteco_abs.control import ESTIMATORS

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


@pytest.mark.xdist_group("real time")
def test_bench_stack_prints_every_stage(untraced):
    printed = run("bench_stack", "1", environment=untraced)
    for stage in (
        "rig",
        "frames",
        "decide",
        "record",
        "MCAP write",
        "MCAP read",
        "replay",
        "times real time",
        "replay from the file",
    ):
        assert stage in printed


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
    assert len(rows) == 5
    for row in rows:
        runs, *_, lost, whole = row[24:].split()
        assert (lost, whole) == ("0", runs)


@pytest.mark.long
def test_bench_ensemble_compares_a_batch_with_scipy_and_the_scalar_plant(untraced):
    rows = run("bench_ensemble", "1", "20", environment=untraced).splitlines()
    assert [row.split(":")[0] for row in rows if row[0] != " "] == ["controlled stops", "held stops"]
    assert len([row for row in rows if "  batch, step" in row]) == 5
    ratios = [int(row.split()[-1]) for row in rows if "ratio" in row]
    assert len(ratios) == 7
    assert min(ratios) > 1


@pytest.mark.long
def test_tune_estimators_prints_every_estimator_with_its_default_starred(untraced):
    rows = run("tune_estimators", "1", "1", environment=untraced).splitlines()[1:]
    starred = [row.split()[0].rstrip("*") for row in rows if "*" in row]
    assert starred == list(ESTIMATORS)
    for row in rows:
        bias, std, fast, slow, loop = map(float, row[44:].split())
        assert abs(bias) < 6.0
        assert min(std, fast, slow, loop) > 0.0
