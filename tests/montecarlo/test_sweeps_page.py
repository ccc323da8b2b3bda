"""What docs/sweeps.md shows runs: the job array's script, and questions to the folder."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import polars as pl
import pytest

from inteco_abs.control import CONTROLLERS
from inteco_abs.montecarlo import InThisProcess, SweepFolder, SweepPlan, combinations, parse_draws, work

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

PAGE = (Path(__file__).parents[2] / "docs/sweeps.md").read_text(encoding="utf-8")
BLOCKS = {kind: text for kind, text in re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL) if kind in {"bash", "python"}}
GRID = combinations(["experiment.start_speed_rad_s=60", "controller.name=steps,relay"], CONTROLLERS)
PLAN = SweepPlan(GRID, [parse_draws("hard:0-14")], run_up=False)


@pytest.fixture
def array(tmp_path):
    """Runs the script as task number `index` of two."""
    (tmp_path / "sweep.sh").write_text(BLOCKS["bash"])

    def task(index):
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        slurm = {"SLURM_ARRAY_TASK_ID": str(index), "SLURM_ARRAY_TASK_COUNT": "2"}
        subprocess.run(
            ["bash", "sweep.sh", "stops"], cwd=tmp_path, env={**os.environ, "PATH": path, **slurm}, check=True
        )

    return task


@pytest.mark.long
def test_the_tasks_of_a_job_array_make_the_whole_sweep(array, tmp_path):
    shared = SweepFolder.make(tmp_path / "stops", PLAN)
    array(2)
    assert [row.stops for row in shared.rows()] == [5, 5]
    array(1)
    whole = SweepFolder.make(tmp_path / "whole", PLAN)
    work(whole, InThisProcess())
    assert [row.facts() for row in shared.rows()] == [row.facts() for row in whole.rows()]


def test_the_answer_of_polars_is_that_of_the_table(tmp_path, monkeypatch, capsys):
    folder = SweepFolder.make(tmp_path / "stops", PLAN)
    work(folder, InThisProcess())
    monkeypatch.chdir(tmp_path)
    found = {}
    exec(BLOCKS["python"], found)  # noqa: S102  the page's
    assert "p99" in capsys.readouterr().out
    answers = {row["controller"]: row for row in found["answer"].collect().to_dicts()}
    for row in folder.rows():
        spread, answer = row.summary.spreads["slip_rms_fixed_true"], answers[row.combination.config.controller.name]
        expected = {"stops": row.stops, "median": spread.median, "p99": pytest.approx(spread.p99)}
        assert {name: answer[name] for name in expected} == expected
    assert json.loads((tmp_path / "stops" / "sweep.json").read_text())["sha256"] == PLAN.name
    assert isinstance(found["answer"], pl.LazyFrame)
