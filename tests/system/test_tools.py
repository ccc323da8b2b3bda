import subprocess
import sys
from pathlib import Path

import pytest

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
    for stage in ("rig", "frames", "decide", "record", "MCAP write", "MCAP read", "replay", "times real time"):
        assert stage in printed


@pytest.mark.long
@pytest.mark.xdist_group("real time")
def test_bench_deaths_finds_no_tick_lost(untraced):
    rows = run("bench_deaths", "2", environment=untraced).splitlines()[1:]
    assert len(rows) == 5
    for row in rows:
        runs, *_, lost, whole = row[24:].split()
        assert (lost, whole) == ("0", runs)
