"""The verb benchmark: its files, its exit codes, its refusals."""

import json
import subprocess

import pytest

from inteco_abs.benchmark import Law, read_laws, write_laws
from inteco_abs.sessions import read_session

STAIRS = Law("stairs", "steps", "moving-window", {"controller.gains.first": 0.6})


@pytest.fixture
def laws(tmp_path):
    write_laws([STAIRS], tmp_path / "own.toml")
    return tmp_path


def test_it_writes_results_table_figure_laws_and_page(main_here, laws):
    arguments = ("benchmark", "--laws", "own.toml", "--draws", "1", "--no-factors", "--jobs", "1")
    printed = main_here(*arguments, check=0).stdout
    assert "wild:700000: 1 rig" in printed
    folder = laws / "benchmark"
    assert read_laws(folder / "laws.toml") == [STAIRS]
    found = json.loads((folder / "results.json").read_text())["laws"]["stairs"]
    assert list(found["ranges"]) == ["nominal", "hard", "rough", "slow", "capped", "wild"]
    assert found["decision_us"] > 0.0
    table, page = ((folder / name).read_text() for name in ("table.md", "index.html"))
    assert "## rough:700000: 1 rig" in table
    assert all(f"{row['slip_rms']['median']:.4f}" in page for row in found["ranges"].values())
    assert (folder / "populations.svg").stat().st_size > 10_000

    kept = json.loads((folder / "results.json").read_text())
    kept["laws"]["stairs"]["ranges"]["hard"]["slip_rms"]["median"] /= 2.0
    (laws / "better.json").write_text(json.dumps(kept))
    answer = main_here(*arguments, "--against", "better.json", "--json", check=4)
    assert answer.stderr.count("stairs on") == answer.stderr.count("stairs on hard:700000: slip RMS, median") == 1
    assert json.loads(answer.stdout)["laws"]["stairs"]["ranges"] == found["ranges"]


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("--law", "predictve-reaching"), "did you mean predictive-reaching?"),
        (("--laws", "none.toml"), "none.toml: cannot be read"),
        (("--against", "own.toml"), "own.toml: not a results.json"),
        (("--against", "none.json"), "none.json: cannot be read"),
        (("--law", "none.py:Law"), "none.py"),
    ],
)
def test_wrong_usage_is_refused_before_anything_is_written(main_here, laws, arguments, problem):
    assert problem in main_here("benchmark", *arguments, check=2).stderr
    assert not (laws / "benchmark").exists()


@pytest.mark.long
@pytest.mark.xdist_group("real time")
def test_a_published_law_brakes_in_real_time_and_replays_bit_for_bit(command_path, untraced, inteco_abs, tmp_path):
    run = subprocess.run(
        [command_path, "run", "--controller", "neuro-fuzzy", "--estimator", "kalman", "--out", "stop.mcap", "--json"],
        cwd=tmp_path, env=untraced, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    card = json.loads(run.stdout)
    assert (card["outcome"], card["controller"]) == ("completed", "neuro-fuzzy"), run.stderr
    assert card["slip_rms_fixed_true"] < 0.2
    session = read_session(tmp_path / "stop.mcap")
    assert session.metadata["controller"]["package"].startswith("inteco-abs ")
    assert b"class NeuroFuzzy" in session.attachments["controller.py"]
    replay = json.loads(inteco_abs("replay", "stop.mcap", "--json", check=0).stdout)
    assert (replay["differing"], replay["ticks"]) == (0, card["ticks"])
