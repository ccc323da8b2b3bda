"""A stored sweep survives: killed and doubled workers, parts, failures, another sweep's files."""

import io
import json
import os
import resource
import shutil
import sys
import time
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import sweep_parts as parts
from rich.console import Console

from inteco_abs.control import CONTROLLERS
from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.montecarlo import (
    METRICS,
    InThisProcess,
    LocalProcesses,
    SweepFolder,
    SweepPlan,
    combinations,
    count_workers,
    named_executor,
    parse_draws,
    work,
)
from inteco_abs.montecarlo.table import figure_of_sweep, render_sweep
from inteco_abs.plugins import Controllers, Origin, load_controller
from inteco_abs.views.figure import save_figure

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

GRID = combinations(["experiment.start_speed_rad_s=12", "controller.name=steps,relay"], CONTROLLERS)
DRAWS = [parse_draws("hard:0-24"), parse_draws("capped:0-9")]
PLAN = SweepPlan(GRID, DRAWS, run_up=False)
"""Eight units of short stops."""


OPEN = Path("/proc/self/fd")


def digest(folder):
    return {row.combination.name + row.draws.name: [row[name].tobytes() for name in METRICS] for row in folder.rows()}


def files(folder):
    return {path.name: path.read_bytes() for path in (folder.path / "part").iterdir()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = SweepFolder.make(tmp_path_factory.mktemp("whole"), PLAN)
    assert work(folder, InThisProcess()).stops == 2 * (25 + len(DRAWS[1].seeds))
    return folder


@pytest.fixture
def begun(tmp_path):
    return SweepFolder.make(tmp_path / "begun", PLAN)


def test_a_unit_is_a_file_that_any_reader_of_parquet_understands(whole):
    assert {path.stem for path in (whole.path / "part").iterdir()} == {
        f"{combination}-{unit}"
        for combination in (0, 1)
        for unit in ("hard-0-10", "hard-10-10", "hard-20-5", "capped-0-10")
    }
    stops = pl.read_parquet(whole.path / "part" / "*.parquet")
    assert stops.columns == ["seed", "population", "controller", "estimator", *METRICS, "error"]
    relay = stops.filter((pl.col("controller") == "relay") & (pl.col("population") == "hard")).sort("seed")
    row = whole.rows()[1]
    assert relay["seed"].to_list() == row.seeds.tolist() == list(range(25))
    assert relay["stop_distance_m"].median() == row.facts()["metrics"]["stop_distance_m"]["median"]
    assert relay["slip_rms_estimated"].null_count() == np.isnan(row["slip_rms_estimated"]).sum()


def test_stored_units_are_not_computed_again(whole, begun):
    part = next((whole.path / "part").glob("0-hard-10-10.parquet"))
    (begun.path / "part" / part.name).write_bytes(part.read_bytes())
    counts = []
    assert work(begun, InThisProcess(), progress=lambda *both: counts.append(both)).stops == 40 + 2 * len(
        DRAWS[1].seeds
    )
    assert counts[0] == (10, 70)  # of draws
    assert counts[-1] == (70, 70)
    assert files(begun) == files(whole)
    assert work(begun, InThisProcess()) == (0, 0, 0)


def test_rows_that_are_under_way_have_a_table_and_a_figure(whole, begun, tmp_path):
    names = ("0-hard-0-10", "0-hard-20-5", "1-hard-0-10", "0-capped-0-10")
    for name in names:
        (begun.path / "part" / f"{name}.parquet").write_bytes(files(whole)[f"{name}.parquet"])
    rows = begun.rows()
    assert [row.stops for row in rows] == [15, 10, len(DRAWS[1].seeds)]
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(render_sweep(rows))
    assert "hard:0-24: slip RMS of at most 15 stops each" in console.export_text()
    save_figure(figure_of_sweep(rows), tmp_path / "rms.svg")
    assert (tmp_path / "rms.svg").exists()


def test_parts_make_the_whole(whole, begun):
    for index in (3, 1, 2):
        work(SweepFolder.open(begun.path), InThisProcess(), part=(index, 3))
    assert files(begun) == files(whole)


def test_two_workers_may_compute_the_same_unit(whole, begun):
    for _ in range(2):
        (begun.path / "part" / "0-hard-0-10.parquet").unlink(missing_ok=True)
        with parts.two_threads() as first, parts.two_threads() as second:
            work(begun, Doubled(first, second), ahead=8)
    assert files(begun) == files(whole)


class Doubled(InThisProcess):
    """Hands every task to two executors."""

    def __init__(self, *both):
        self._both = both

    def submit(self, function, /, *arguments):
        return [one.submit(function, *arguments) for one in self._both][1]


def test_a_unit_that_fails_twice_is_done_at_the_third_time(whole, begun):
    executor = parts.Failing(lambda unit: unit.first == 10, times=2)
    assert work(begun, executor).failed == 0
    assert set(executor.seen.values()) == {1, 3}
    assert files(begun) == files(whole)


def test_a_unit_that_fails_three_times_is_listed_and_the_others_are_done(whole, begun):
    executor = parts.Failing(lambda unit: unit.first == 10, times=3)
    assert work(begun, executor).failed == 2
    failures = begun.failures()
    assert failures.keys() == {"0-hard-10-10", "1-hard-10-10"}
    assert all(problem.startswith("MemoryError: no room") for problem in failures.values())
    assert [row.stops for row in begun.rows()][:2] == [15, 15]
    work(begun, InThisProcess())
    assert begun.failures() == {}
    assert digest(begun) == digest(whole)


def test_an_error_of_the_configuration_ends_the_sweep_at_once(tmp_path):
    source = (
        b"class Law:\n    gains = internals = ()\n"
        b"    def __init__(self, setup):\n        raise ValueError('not today')\n"
        b"    def update(self, estimate, dt_s):\n        pass\n"
    )
    own = Controllers({"law.py:Law": (load_controller("law.py:Law", source)[0], Origin(source))})
    grid = combinations(["controller.name=law.py:Law"], own)
    folder = SweepFolder.make(tmp_path, SweepPlan(grid, DRAWS, {"law.py:Law": source}))
    with pytest.raises(ConfigError, match="cannot be made: ValueError: not today"):
        work(SweepFolder.open(folder.path), InThisProcess())
    assert files(folder) == folder.failures() == {}


def test_a_killed_process_loses_its_task_and_another_takes_its_place(tmp_path):
    with LocalProcesses(1) as pool:
        first = pool.submit(parts.killed_once, tmp_path / "mark")
        with pytest.raises(BrokenExecutor):
            first.result()
        assert pool.submit(parts.killed_once, tmp_path / "mark").result() == "survived"


def test_an_executor_that_breaks_as_a_whole_is_an_error(begun):
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        broken = pool.submit(parts.killed_once, begun.path / "mark")
        with pytest.raises(BrokenExecutor):
            broken.result()
        with pytest.raises(AbsError, match="takes no more units, and the same command continues"):
            work(begun, pool)


def test_a_pool_for_many_cores_may_open_more_files_than_the_shell_allows():
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    files = len(list(OPEN.iterdir()))
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (files + 100, limits[1]))
        with LocalProcesses(100):
            assert len(list(OPEN.iterdir())) > files + 100
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)


def test_a_folder_with_another_sweep_is_refused(begun):
    other = SweepPlan(GRID, DRAWS[:1], run_up=False)
    with pytest.raises(ConfigError, match=f"has the sweep {PLAN.name[:12]}, and this is {other.name[:12]}"):
        SweepFolder.make(begun.path, other)
    assert SweepFolder.make(begun.path, SweepPlan(list(GRID), list(DRAWS), run_up=False)).plan.name == PLAN.name


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text.replace('"hard:0-24"', '"hard:0-25"'), "has been changed since it was written"),
        (lambda text: text[:-9], "is not the description of a sweep"),
        (lambda _text: "[]", "is not the description of a sweep"),
    ],
)
def test_a_description_that_was_changed_is_refused(begun, change, words):
    file = begun.path / "sweep.json"
    file.write_text(change(file.read_text()))
    with pytest.raises(ConfigError, match=words):
        SweepFolder.open(begun.path)


def test_the_description_of_another_program_is_refused(begun, monkeypatch):
    monkeypatch.setattr("inteco_abs.montecarlo.plan.source_sha256", lambda: "0" * 64)  # as of a changed source
    with pytest.raises(ConfigError, match=r"made by inteco-abs .*, and this is .* \(sources 000000000000\)"):
        SweepFolder.open(begun.path)


def test_a_folder_without_a_description_is_refused_as_a_sweep(tmp_path):
    with pytest.raises(ConfigError, match=r"--show: .*: not the folder of a sweep: sweep\.json: No such file"):
        SweepFolder.open(tmp_path, "--show")


def test_damaged_parts_are_braked_again_and_leftovers_removed(whole, begun):
    begun.path.joinpath("part").rmdir()
    shutil.copytree(whole.path / "part", begun.path / "part")
    empty, cut = (begun.path / "part" / f"{name}.parquet" for name in ("0-hard-0-10", "1-hard-20-5"))
    empty.write_bytes(b"")
    cut.write_bytes(cut.read_bytes()[:-20])
    left = [begun.path / name for name in ("sweep.json.1f.part", "part/0-hard-0-10.parquet.2f.part")]
    for file in left:
        file.touch()
    assert work(begun, InThisProcess()).stops == 15
    assert all(file.exists() for file in left)  # of the last day: someone may be writing them
    for file in left:
        os.utime(file, (0, time.time() - 90_000))
    assert work(begun, InThisProcess()).stops == 0
    assert files(begun) == files(whole)
    assert not any(file.exists() for file in left)


def test_impossible_draw_is_left_out_and_others_of_its_unit_are_braked(tmp_path):
    (tmp_path / "long.toml").write_text('base = "hard"\n[rig]\nbrake_dead_time_s = { factor = 15 }\n')
    draws = parse_draws(f"{tmp_path / 'long.toml'}:0-3")  # the second would have more dead time than any brake
    folder = SweepFolder.make(tmp_path / "sweep", SweepPlan(GRID[:1], [draws], run_up=False))
    assert work(folder, InThisProcess())[::2] == (3, 0)
    (row,) = folder.rows()
    assert (row.seeds.tolist(), row.left_out) == ([0, 2, 3], [1])


def test_parts_that_are_damaged_or_of_another_sweep_are_named(whole, begun):
    part = begun.path / "part" / "0-hard-0-10.parquet"
    part.write_bytes(files(whole)[part.name][:-20])
    with pytest.raises(AbsError, match=f"{part.name}: not readable; remove it"):
        begun.rows()
    flipped = bytearray(files(whole)[part.name])
    flipped[100] ^= 4  # among the values, which the file's own length and end do not reveal
    part.write_bytes(flipped)
    with pytest.raises(AbsError, match=f"{part.name}: not readable; remove it"):
        [list(row.records()) for row in begun.rows()]
    other = SweepFolder.make(begun.path.parent / "other", SweepPlan(GRID, DRAWS, run_up=True))
    (other.path / "part" / part.name).write_bytes(files(whole)[part.name])
    with pytest.raises(AbsError, match=f"{part.name}: belongs to another sweep; remove it"):
        other.rows()


def test_the_description_brings_back_grid_sources_and_ranges(begun):
    plan = SweepFolder.open(begun.path).plan
    assert (list(plan.grid), list(plan.draws), plan.run_up) == (list(GRID), DRAWS, False)
    assert plan.name == json.loads((begun.path / "sweep.json").read_text())["sha256"]
    source = SweepPlan(GRID, DRAWS, {"law.py:Law": "# Grüße\n".encode("latin-1")})
    assert SweepPlan.from_json(source.to_json(), "sweep.json", "--work").sources == source.sources


def test_a_population_of_a_file_is_braked_without_the_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("lab.toml").write_text('base = "hard"\n[rig]\nbrake_lag_s = [0, 0.1]\n')
    plan = SweepPlan(GRID[:1], [parse_draws("lab.toml:3-5")], run_up=False)
    Path("lab.toml").unlink()
    folder = SweepFolder.make(tmp_path / "sweep", SweepPlan.from_json(plan.to_json(), "sweep.json", "--work"))
    assert work(folder, InThisProcess()).stops == 3
    rigs = [rig for unit in folder.plan.units() for rig in folder.plan.experiment(unit)[0].rigs]
    assert [rig.seed for rig in rigs] == [3, 4, 5]
    assert len({rig.parameters.c31 for rig in rigs}) == 3
    assert {row.draws.name for row in folder.rows()} == {"lab:3-5"}


def test_units_are_few_for_many_draws_and_are_made_one_by_one():
    plan = SweepPlan(GRID, [parse_draws("hard:0-99999999")])
    units = plan.units()
    assert next(units) == (0, "hard", 0, 2000)
    assert sum(1 for _ in units) == 2 * 100_000_000 // 2000 - 1


def test_an_executor_of_a_package_is_named_by_module_and_callable():
    with named_executor("sweep_parts:two_threads") as executor:
        assert executor.submit(abs, -1).result() == 1


def test_an_executor_that_a_package_offers_is_known_by_its_name(tmp_path, monkeypatch):
    offer = tmp_path / "lab_cluster-1.0.dist-info"
    offer.mkdir()
    (offer / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-cluster\nVersion: 1.0\n")
    (offer / "entry_points.txt").write_text("[inteco_abs.executors]\nlab = sweep_parts:some_threads\n")
    monkeypatch.syspath_prepend(tmp_path)
    with named_executor("lab=3") as executor:
        assert count_workers(executor) == 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("dusk=tcp://here:1", "no executor 'dusk'; did you mean dask?"),
        ("sweep_parts:three_threads", "AttributeError"),
        ("no_such_module:executor", "No module named 'no_such_module'"),
        ("sweep_parts:not_an_executor", "made a int, not a concurrent.futures.Executor"),
        ("sweep_parts:two_threads=3", "TypeError"),
        ("dask=tcp://here:1", "needs Dask: pip install 'inteco-abs[cluster]'"),
    ],
)
def test_an_executor_that_cannot_be_had_is_an_error_of_the_option(monkeypatch, text, words):
    monkeypatch.setitem(sys.modules, "distributed", None)  # as without the extra
    with pytest.raises(ConfigError) as caught:
        named_executor(text)
    assert words in str(caught.value)
    assert caught.value.mistakes[0].path == "--executor"


def test_a_damaged_failure_record_is_named_and_a_missing_one_ignored(begun):
    (begun.path / "failed" / "gone.json").symlink_to("nowhere")  # listed, and not there when it is read
    assert begun.failures() == {}
    (begun.path / "failed" / "torn.json").write_text("{")
    with pytest.raises(AbsError, match=r"torn\.json: not readable; remove it"):
        begun.failures()
