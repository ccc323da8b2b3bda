"""The verb `inteco-abs demo`; README's commands run the tour itself."""

import io
import json

import pytest

from inteco_abs.cli import demo as module


def test_its_folder_is_replaced_and_nothing_else_is_touched(main_here, tmp_path):
    (tmp_path / "demo").mkdir()
    run = main_here("demo", "--no-wait", check=2)
    assert "name a folder that does not exist" in run.stderr
    assert list((tmp_path / "demo").iterdir()) == []


@pytest.fixture
def short(monkeypatch):
    """A tour of two steps, of which the first needs what is not there."""
    steps = (
        module.Step("one.", "figure x.mcap -o x.png", "no_such_module"),
        module.Step("two.", "run --virtual --set experiment.start_speed_rad_s=12 --out x.mcap --json"),
        module.Step("three.", "info x.mcap --json"),
    )
    monkeypatch.setattr(module, "STEPS", steps)


@pytest.mark.usefixtures("short")
def test_each_step_prints_its_command_and_runs_it(main_here, tmp_path):
    run = main_here("demo", "-o", "here", check=0)
    assert "it needs no_such_module" in run.stderr
    assert "2 of 3: two." in run.stderr
    assert "$ inteco-abs info x.mcap --json" in run.stderr
    card, info = map(json.loads, run.stdout.splitlines())
    assert (tmp_path / "here" / "x.mcap").is_file()
    assert info["ticks"] == card["ticks"]


def test_a_step_that_fails_ends_the_tour_with_its_code(main_here, monkeypatch):
    monkeypatch.setattr(module, "STEPS", (module.Step("one.", "info missing.mcap"), module.Step("two.", "list .")))
    run = main_here("demo", "--no-wait")
    assert run.returncode == 1
    assert "two." not in run.stderr


@pytest.mark.usefixtures("short")
def test_leaving_at_a_question_ends_its_line(main_here, monkeypatch):
    monkeypatch.setattr(module, "on_terminal", lambda _stream: True)
    monkeypatch.setattr("sys.stdin", io.StringIO())
    run = main_here("demo", check=130)
    assert run.stderr.endswith("Enter \ninteco-abs: interrupted\n")
