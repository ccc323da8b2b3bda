"""The verb `inteco-abs sweep`, as a lab uses it."""

import contextlib
import csv
import errno
import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest

from inteco_abs.cli.command import cli
from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.montecarlo import SweepFolder

pytestmark = pytest.mark.xdist_group("compiled")

QUICK = ("--rigs", "hard:3-4", "--no-run-up", "--set", "experiment.start_speed_rad_s=30")

OWN = """
from inteco_abs.control import Gain
from inteco_abs.signals import BrakeDemand
print("hello")
class Own:
    gains = (Gain("duty", 0.6, 0.0, 1.0, "1", "of the brake"),)
    internals = ()
    def __init__(self, setup, duty):
        self.duty = duty
    def update(self, estimate, dt_s):
        if self.duty == 0.5 and estimate.road_speed_rad_s < 20.0:
            1 / 0
        return BrakeDemand(self.duty)
"""


@pytest.mark.long
def test_controllers_gains_and_estimators_are_compared_on_populations(inteco_abs, tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    run = inteco_abs(
        "sweep",
        *QUICK,
        *("--rigs", "capped:0-1", "--controller", "own.py:Own,pi", "--estimator", "euler", "--estimator", "ideal"),
        *("--set", "controller.gains.duty=0.65,0.8", "--jobs", "2", "--csv", "stops.csv", "--figure", "rms.svg"),
        "--json",
        check=0,
    )
    rows = json.loads(run.stdout)["rows"]
    assert len(rows) == 2 * 6
    assert [(row["controller"], row["estimator"], row["settings"]) for row in rows[:3]] == [
        ("own.py:Own", "euler", {"controller.gains.duty": "0.65"}),
        ("own.py:Own", "euler", {"controller.gains.duty": "0.8"}),
        ("own.py:Own", "ideal", {"controller.gains.duty": "0.65"}),
    ]
    assert (rows[6]["rigs"], rows[6]["stops"], rows[6]["left_out"]) == ("capped:0-1", 1, [1])
    assert "capped:0-1: 1 of 2 rigs are left out" in run.stderr
    assert "ticks/s on 2 processes" in run.stderr
    assert "hello" in run.stderr
    with (tmp_path / "stops.csv").open(newline="") as file:
        stops = list(csv.DictReader(file))
    assert len(stops) == sum(row["stops"] for row in rows)
    assert (stops[0]["population"], stops[0]["seed"], stops[0]["controller.gains.duty"]) == ("hard", "3", "0.65")
    distances = [float(stop["stop_distance_m"]) for stop in stops[:2]]
    assert rows[0]["metrics"]["stop_distance_m"]["max"] == max(distances)
    assert (tmp_path / "rms.svg").read_text().startswith("<?xml")


@pytest.mark.long
def test_stops_that_fail_are_reported_and_the_others_scored(inteco_abs, tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    run = inteco_abs("sweep", *QUICK, "--controller", "own.py:Own", "--set", "controller.gains.duty=0.5,0.8", check=3)
    assert "Own on moving-window, duty=0.5: 2 of 2 stops failed, first hard:3: ZeroDivisionError" in run.stderr
    assert "own.py, line 12" in run.stderr
    assert "hard:3-4: slip RMS of 2 stops each" in run.stdout
    assert "duty=0.8" in run.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rigs", "hard:0", "--rigs", "hrad:0-9"], ["--rigs", "did you mean hard"]),
        (["--rigs", "none.toml:0-9"], ["--rigs", "none.toml: No such file"]),
        (["--rigs", "hard:9-0"], ["--rigs", "reversed", "hard:0-9"]),
        (["--controller", "pi,reachin-law"], ["did you mean reaching-law"]),
        (["--estimator", "kallman"], ["did you mean kalman"]),
        (["--controller", "own.py"], ["name the class too"]),
        (["--controller", "pi,own.py:Own"], ["own.py", "No such file"]),
        (["--set", "controller.name=own.py:Own"], ["named by --controller"]),
        (["--csv", "nowhere/x.csv"], ["--csv", "nowhere", "create it first"]),
        (["--csv", "."], ["--csv", "is a folder"]),
        (["--set", "encoders.counts_per_turn=4096"], ["encoders.counts_per_turn", "4096", "2048"]),
        (["--set", "simulation.rig=hard:2"], ["simulation", "--rigs"]),
        (["--figure", "x.bmp"], ["--figure", "x.bmp"]),
        (["--csv", "x.svg", "--figure", "x.svg"], ["--figure", "--csv"]),
        (["--work", "nowhere"], ["--work", "nowhere", "not the folder of a sweep"]),
        (["--show", "nowhere"], ["--show", "nowhere", "not the folder of a sweep"]),
        (["--work", "x", "--rigs", "hard:1", "--json"], ["--rigs: changes nothing with --work", "--json: changes"]),
        (["--show", "x", "--jobs", "2"], ["--jobs: changes nothing with --show"]),
        (["--store", "x", "--prepare", "--csv", "x.csv"], ["--csv: changes nothing with --prepare"]),
        (["--part", "1/2"], ["--part: needs --work"]),
        (["--prepare"], ["--prepare: needs --store"]),
        (["--executor", "dask=tcp://here:1"], ["--executor: needs --store DIR or --work DIR"]),
    ],
)
def test_wrong_input_gets_one_clear_answer(monkeypatch, tmp_path, arguments, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as caught:
        cli.main(["sweep", *arguments], standalone_mode=False)
    for word in words:
        assert word in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_populations_whose_names_some_disks_take_for_one_are_refused(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "Hard.toml").write_text('base = "hard"\n')
    with pytest.raises(ConfigError, match="two different populations have the same name"):
        cli.main(["sweep", "--rigs", "hard:1", "--rigs", "Hard.toml:1"], standalone_mode=False)


def test_a_table_that_cannot_be_written_is_an_error_after_the_result(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)

    def full(*_arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("csv.DictWriter", full)
    with pytest.raises(AbsError, match=r"stops\.csv: the table cannot be written: No space left on device"):
        cli.main(["sweep", *QUICK, "--jobs", "1", "--csv", "stops.csv"], standalone_mode=False)
    assert not list(tmp_path.iterdir())
    printed = capsys.readouterr()
    assert "slip RMS" in printed.out
    assert printed.err.startswith("combinations: 1, stops to brake: 2;")


def test_a_narrow_terminal_takes_no_name_and_no_digit_away(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "50")
    cli.main(["sweep", *QUICK, "--jobs", "1"], standalone_mode=False)
    printed = capsys.readouterr().out
    assert "controller on" in printed
    assert "…" not in printed


@pytest.mark.long
def test_the_processes_of_a_sweep_end_with_the_command_that_was_killed(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    code = "from inteco_abs.cli import main; main()"
    arguments = ["sweep", "--rigs", "nominal:0-999", "--controller", "own.py:Own", "--jobs", "2"]
    with subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(tmp_path)},  # the killed command leaves its folder
    ) as run:
        greetings = (line for line in run.stderr if "hello" in line)  # two workers may share a line
        next(greetings)  # the command's own
        next(greetings)  # a worker's
        run.kill()
        run.communicate(timeout=60)  # the pipe ends when no process holds it


def test_without_numba_the_extra_is_named():
    code = "import sys; sys.modules['numba'] = None; from inteco_abs.cli import main; sys.argv[1:] = ['sweep']; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert "pip install 'inteco-abs[lab]'" in done.stderr


def test_the_command_itself_loads_no_numba():
    code = "import sys, inteco_abs.cli; sys.exit('numba' in sys.modules or 'numpy' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


WAITING = """
import os, time
from inteco_abs.signals import BrakeDemand
class Law:
    gains = ()
    internals = ()
    def __init__(self, setup):
        pass
    def update(self, estimate, dt_s):
        while len(os.listdir("folder/part")) > 1 and not os.path.exists("go"):
            open("waiting", "w").close()
            time.sleep(0.01)
        return BrakeDemand(0.6)
"""
"""Waits when two units are done."""


@pytest.mark.long
@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_busy_workers_and_the_same_command_continues(
    inteco_abs, command_path, tmp_path, jobs, number, code
):
    (tmp_path / "law.py").write_text(WAITING)
    command = ("sweep", *QUICK, "--rigs", "hard:5-44", "--controller", "law.py:Law", "--jobs", str(jobs))
    command = (*command, "--store", "folder", "--json")
    sweep = subprocess.Popen(
        [command_path, *command], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    while sweep.poll() is None and not (tmp_path / "waiting").exists():
        time.sleep(0.02)
    sweep.send_signal(number)
    stdout, stderr = sweep.communicate(timeout=60)
    assert (sweep.returncode, stdout) == (code, ""), stderr
    assert not {"Traceback", "leaked"} & set(stderr.split())
    assert 2 <= len(list((tmp_path / "folder" / "part").iterdir())) <= 4
    (tmp_path / "go").touch()
    again = inteco_abs(*command, check=0)
    assert [row["stops"] for row in json.loads(again.stdout)["rows"]] == [2, 40]
    assert int(re.search(r"^(\d+) stops, ", again.stderr, re.MULTILINE)[1]) < 42
    assert inteco_abs("sweep", "--show", "folder", "--json", check=0).stdout == again.stdout


KILLED = """
import os, signal
from inteco_abs.signals import BrakeDemand
class Law:
    gains = ()
    internals = ()
    def __init__(self, setup):
        self.ticks = 0
    def update(self, estimate, dt_s):
        self.ticks += 1
        if self.ticks == 100 and not os.path.exists("killed"):
            open("killed", "w").close()
            os.kill(os.getpid(), signal.SIGKILL)
        return BrakeDemand(0.6)
"""


@pytest.mark.long
def test_a_worker_that_is_killed_in_a_unit_changes_nothing(inteco_abs, tmp_path):
    (tmp_path / "law.py").write_text(KILLED)
    command = ("sweep", *QUICK, "--rigs", "hard:5-24", "--controller", "law.py:Law", "--jobs", "2", "--csv")
    disturbed = inteco_abs(*command, "disturbed.csv", check=0)
    assert (tmp_path / "killed").exists()
    undisturbed = inteco_abs(*command, "undisturbed.csv", check=0)
    assert disturbed.stdout == undisturbed.stdout
    assert (tmp_path / "disturbed.csv").read_bytes() == (tmp_path / "undisturbed.csv").read_bytes()


@pytest.fixture
def dask(tmp_path):
    """Address of a scheduler with two workers, each a process that nothing restarts."""
    place = tmp_path / "scheduler.json"
    common = ("--no-dashboard", "--scheduler-file", place)
    with contextlib.ExitStack() as stack:

        def start(kind, *options):
            words = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *common, *options]
            process = stack.enter_context(subprocess.Popen(words, cwd=tmp_path, stderr=subprocess.DEVNULL))
            stack.callback(process.kill)
            return process

        start("scheduler", "--host", "127.0.0.1", "--port", "0")
        while not place.exists():
            time.sleep(0.1)
        workers = [start("worker", "--no-nanny", "--nthreads", "1", "--host", "127.0.0.1") for _ in range(2)]
        yield json.loads(place.read_text())["address"], workers


@pytest.mark.long
def test_a_worker_of_dask_that_is_killed_in_a_unit_changes_nothing(inteco_abs, dask, tmp_path):
    address, workers = dask
    (tmp_path / "law.py").write_text(KILLED)
    command = ("sweep", *QUICK, "--rigs", "hard:5-44", "--controller", "law.py:Law", "--json", "--csv")
    disturbed = inteco_abs(*command, "disturbed.csv", "--store", "dir", "--executor", f"dask={address}", check=0)
    assert [worker.poll() is None for worker in workers].count(False) == 1
    undisturbed = inteco_abs(*command, "undisturbed.csv", check=0)
    assert disturbed.stdout == undisturbed.stdout
    assert (tmp_path / "disturbed.csv").read_bytes() == (tmp_path / "undisturbed.csv").read_bytes()


def test_computers_share_a_folder_by_parts(main_here, tmp_path):
    (tmp_path / "own.py").write_text(
        "from pathlib import Path\n"
        + OWN.replace("= duty", "= duty + float(Path(__file__).with_name('more').read_text())")
    )
    (tmp_path / "more").write_text("0.0")
    own = ("--controller", "own.py:Own", "--set", "controller.gains.duty=0.7,0.8")
    main_here("sweep", *QUICK, *own, "--store", "shared", "--prepare", check=0)
    (tmp_path / "own.py").unlink()  # its source is in the folder, and what it reads
    (tmp_path / "more").unlink()
    folder = SweepFolder.open(tmp_path / "shared")
    folder.fail(next(folder.plan.units()), "the disk was full")
    nothing = main_here("sweep", "--show", "shared", check=0).stderr
    assert "0 of 4 stops so far" in nothing
    assert "was given up: the disk was full" in nothing
    second = main_here("sweep", "--work", "shared", "--part", "2/2", "--jobs", "1", check=0)
    assert "2 stops, " in second.stderr
    assert second.stdout == ""
    table = main_here("sweep", "--show", "shared", "--csv", "first.csv", check=0)
    assert "duty=0.8" in table.stdout
    assert "duty=0.7" not in table.stdout
    assert "2 of 4 stops so far" in table.stderr
    main_here("sweep", "--work", "shared", "--part", "1/2", "--jobs", "1", check=0)
    complete = main_here("sweep", "--show", "shared", "--csv", "all.csv", "--figure", "rms.svg", check=0)
    assert "so far" not in complete.stderr
    assert len((tmp_path / "all.csv").read_text().splitlines()) == 5
