"""The verb `inteco-abs paper`: its files, that they are the same each time, and what stops it."""

import csv
import io
import json
import os
import statistics
import subprocess
import sys
from contextlib import redirect_stdout

import pytest
from click.testing import CliRunner

from inteco_abs.cli.command import cli
from inteco_abs.errors import AbsError, ConfigError

FIGURES = ("simulation", "experiment-window", "experiment-euler")
TABLES = ("stops.csv", "table.csv", "table.md")
MAGIC = {"png": b"\x89PNG\r\n\x1a\n", "pdf": b"%PDF-", "csv": b"time_s,wheel_speed_rad_s,road_speed_rad_s,slip"}
COMMAND = "import sys; from inteco_abs.cli import main; sys.argv[1:] = ['paper', '--draws', '2']; main()"
pytestmark = pytest.mark.xdist_group("compiled")


@pytest.fixture(scope="module")
def paper(reproduced):
    """Runs the command, which gives what was found already, instead of braking again."""

    def run(folder, *options):
        cli.main(["paper", "-o", str(folder), "--draws", "2", *options], standalone_mode=False)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("inteco_abs.paper.reproduce", lambda _draws, _progress: reproduced)
        yield run


@pytest.fixture(scope="module")
def written(paper, tmp_path_factory):
    """The folder of a run, and its JSON."""
    folder, out = tmp_path_factory.mktemp("paper") / "new", io.StringIO()
    with redirect_stdout(out):
        paper(folder, "--json")
    return folder, json.loads(out.getvalue())


def python(code, folder):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=folder)


def table(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_every_file_is_there_and_of_its_kind(written):
    folder, facts = written
    expected = {*TABLES, *(f"{name}.{suffix}" for name in FIGURES for suffix in MAGIC)}
    assert {path.name for path in folder.iterdir()} == expected
    assert sorted(facts["files"]) == sorted(str(folder / name) for name in expected)
    for name in FIGURES:
        for suffix, magic in MAGIC.items():
            assert (folder / f"{name}.{suffix}").read_bytes().startswith(magic)


@pytest.mark.long
def test_another_process_writes_the_same_bytes_and_leaves_other_files_alone(written, tmp_path):
    folder, _ = written
    (tmp_path / "paper").mkdir()
    (tmp_path / "paper" / "notes.txt").write_text("mine")
    (tmp_path / "paper" / "table.md").write_text("old")
    run = python(COMMAND, tmp_path)
    assert run.returncode == 0, run.stderr
    for path in folder.iterdir():
        assert (tmp_path / "paper" / path.name).read_bytes() == path.read_bytes(), path.name
    assert (tmp_path / "paper" / "notes.txt").read_text() == "mine"
    assert "simulation: claim confirmed in part; against equal Mq: alike" in " ".join(run.stdout.split())
    assert max(map(len, run.stdout.splitlines())) <= 80
    assert run.stderr.startswith("written: paper/simulation.csv, paper/simulation.png")


def test_the_ratios_are_those_of_the_stops(written):
    folder, _ = written
    stops, rows = table(folder / "stops.csv"), table(folder / "table.csv")
    rivals = [row for row in rows if row["pairing"]]
    assert len(rivals) == 6
    for row in rivals:
        for metric in ("slip_rms_fixed_true", "stop_distance_m", "torque_variation_nm_per_s"):
            mine, rival = (
                [float(stop[metric]) for stop in stops if (stop["condition"], stop["pairing"]) == key]
                for key in ((row["condition"], ""), (row["condition"], row["pairing"]))
            )
            ratio = statistics.median(a / b for a, b in zip(mine, rival, strict=True))
            assert float(row[f"ratio_{metric}"]) == pytest.approx(ratio, rel=1e-12)
            assert float(row[f"median_{metric}"]) == pytest.approx(statistics.median(rival), rel=1e-12)
            assert float(row[f"largest_{metric}"]) == max(rival)


def test_the_files_say_what_json_says(written):
    folder, facts = written
    rows = table(folder / "table.csv")
    assert [(row["condition"], row["pairing"]) for row in rows] == [
        (row["condition"], row["pairing"]) for row in facts["rows"]
    ]
    text = (folder / "table.md").read_text(encoding="utf-8")
    assert "Made by `inteco-abs paper --draws 2`." in text
    for condition, words in facts["verdicts"].items():
        assert f"- {condition}: {words}\n" in text
    for condition, similarity in facts["similarity"].items():
        assert f"- {condition}, similar to the simulation: {similarity['words']}\n" in text
    assert facts["rows"][3]["rigs"] in text


def test_a_figures_data_are_those_of_its_stop(written):
    folder, _ = written
    course, stops = table(folder / "simulation.csv"), table(folder / "stops.csv")
    reached = next(float(tick["time_s"]) for tick in course if float(tick["slip"]) >= float(tick["slip_reference"]))
    assert reached == float(stops[0]["reaching_time_s"])
    assert float(course[-1]["time_s"]) == pytest.approx(float(stops[0]["stop_time_s"]))


@pytest.mark.parametrize(
    ("out", "words"),
    [
        ("file", ["--out", "file: is a file; name a folder"]),
        ("nowhere/paper", ["--out", "nowhere does not exist; create it first"]),
    ],
)
def test_what_is_not_a_folder_is_refused(monkeypatch, tmp_path, out, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("mine")
    with pytest.raises(ConfigError) as caught:
        cli.main(["paper", "-o", out], standalone_mode=False)
    for word in words:
        assert word in str(caught.value)
    assert (tmp_path / "file").read_text() == "mine"


def test_a_folder_without_permission_is_refused_at_once(monkeypatch, tmp_path):
    monkeypatch.setattr("os.access", lambda _path, mode: not mode & os.W_OK)
    with pytest.raises(AbsError, match="no permission to write to this folder; name another with -o"):
        cli.main(["paper", "-o", str(tmp_path)], standalone_mode=False)


def test_a_file_that_cannot_be_written_is_named(paper, tmp_path):
    (tmp_path / "simulation.csv").mkdir()
    with pytest.raises(AbsError, match=r"simulation\.csv: Is a directory"):
        paper(tmp_path)


@pytest.mark.parametrize("draws", ["0", "1001", "many"])
def test_draws_out_of_range_are_wrong_usage(draws):
    done = CliRunner().invoke(cli, ["paper", "--draws", draws])
    assert done.exit_code == 2
    assert "--draws" in done.stderr


@pytest.mark.parametrize(("package", "extra"), [("numba", "lab"), ("matplotlib", "figures")])
def test_a_missing_extra_is_named_and_nothing_is_written(tmp_path, package, extra):
    done = python(f"import sys; sys.modules[{package!r}] = None; {COMMAND}", tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert f"pip install 'inteco-abs[{extra}]'" in done.stderr
    assert list(tmp_path.iterdir()) == []
