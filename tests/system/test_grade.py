"""The verb grade: what it lists, what it writes, how it ends."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest

from inteco_abs.course import exercise as course

SOLUTION = Path(__file__).parents[1] / "course" / "solutions" / "faults.py"
SILENT = "class Monitor:\n    def __init__(self, *given): pass\n    def update(self, sample, command): return ''\n"


@pytest.fixture
def few(monkeypatch, tmp_path):
    """Few cases in each exercise, and two submissions to `faults`."""
    known = {name: replace(one, cases=3) for name, one in course.exercises().items()}
    monkeypatch.setattr(course, "exercises", lambda: known)
    (tmp_path / "good.py").write_text(SOLUTION.read_text())
    (tmp_path / "silent.py").write_text(SILENT)


def test_it_lists_the_exercises_and_the_limits_of_one(main_here):
    listed = main_here("grade", check=0).stdout
    assert all(f"{name} " in listed and one.page in listed for name, one in course.exercises().items())
    known = json.loads(main_here("grade", "--json", check=0).stdout)["exercises"]
    assert [each["name"] for each in known] == list(course.exercises())
    assert "slip RMS from 0.25 s on: at most 0.03 in 90 %" in main_here("grade", "pi", check=0).stdout
    limits = json.loads(main_here("grade", "pi", "--json", check=0).stdout)["limits"]
    assert {"measure": "band_entry_s", "what": "arrival within 0.01", "unit": "s", "most": 0.4, "share": 0.9} in limits


def test_it_writes_the_starting_file_and_overwrites_none(main_here, tmp_path):
    said = main_here("grade", "pi", "--start", "law.py", check=0).stderr
    assert "docs/course/pi.md" in said
    assert "inteco-abs grade pi law.py" in said
    assert (tmp_path / "law.py").read_text() == course.exercises()["pi"].start
    (tmp_path / "law.py").write_text("mine")
    assert "law.py" in main_here("grade", "pi", "--start", "law.py", check=2).stderr
    assert (tmp_path / "law.py").read_text() == "mine"


@pytest.mark.usefixtures("few")
def test_all_files_of_a_call_get_the_same_rigs_and_a_line_in_the_table(main_here, tmp_path):
    graded = main_here("grade", "faults", "good.py", "silent.py", "--seed", "3", "--csv", "marks.csv", check=4)
    good, silent = graded.stdout.splitlines()
    assert good.startswith("good.py: passed, score ")
    assert silent.startswith("silent.py: not passed, score ")
    assert "not found, or wrong name: at most 0" in silent
    with (tmp_path / "marks.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["file"], row["passed"], row["confined"], row["seed"]) for row in rows] == [
        ("good.py", "True", "True", "3"),
        ("silent.py", "False", "True", "3"),
    ]
    found = json.loads(main_here("grade", "faults", "good.py", "--seed", "3", "--json", check=0).stdout)
    assert found["passed"]
    assert found["grades"][0]["score"] == int(rows[0]["score"])


@pytest.mark.long
@pytest.mark.usefixtures("few")
def test_the_table_says_the_seed_that_repeats_it(main_here):
    first = main_here("grade", "faults", "silent.py", check=4).stdout
    assert "NOT PASSED" in first
    seed = first.partition("--seed ")[2].split()[0]
    assert main_here("grade", "faults", "silent.py", "--seed", seed, check=4).stdout == first


def test_without_confinement_it_is_no_grade_for_marks(main_here, monkeypatch, tmp_path):
    monkeypatch.setattr("inteco_abs.course.grading.SECRETS", ("what no system has",))
    (tmp_path / "broken.py").write_text("1 / 0")
    done = main_here("grade", "faults", "broken.py", check=4)
    assert "missing: ZeroDivisionError: division by zero, line 1" in done.stdout
    assert "no grade for marks" in done.stderr
