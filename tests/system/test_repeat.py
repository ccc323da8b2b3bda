"""The verb `inteco-abs repeat`."""

import json
import tomllib
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from inteco_abs.analysis.stop_statistics import METRICS, UNITS, MetricStatistics, metric_statistics
from inteco_abs.cli import repeat
from inteco_abs.sessions import read_session
from inteco_abs.signals import Phase
from inteco_abs.views.series import render_series

QUICK = ("--virtual", "--set", "experiment.start_speed_rad_s=20", "--set", "experiment.hold_s=0.05")

FAILS_THE_SECOND_TIME = """
from inteco_abs.signals import BrakeDemand
class Law:
    gains = ()
    internals = ()
    made = 0
    def __init__(self, setup):
        Law.made += 1
    def update(self, estimate, dt_s):
        import pathlib
        if pathlib.Path("series/stop-1.mcap").exists() and pathlib.Path("series/stop-2.mcap").exists():
            raise RuntimeError("brake hot")
        return BrakeDemand(0.7)
"""


def test_each_stop_is_that_of_run_with_its_own_seed(main_here, tmp_path):
    report = json.loads(main_here("repeat", 3, *QUICK, "--seed", 5, "-o", "series", "--json", check=0).stdout)
    for number in range(3):
        main_here("run", *QUICK, "--seed", 5 + number, "--out", f"{number}.mcap", "--json", check=0)
        again = read_session(tmp_path / f"{number}.mcap")
        assert read_session(tmp_path / "series" / f"stop-{number + 1}.mcap").payload == again.payload
    times = [card["stop_time_s"] for card in report["stops"]]
    assert report["statistics"]["stop_time_s"]["mean"] == pytest.approx(np.mean(times), rel=1e-12)
    assert report["statistics"]["stop_time_s"]["stops"] == 3


def test_a_safety_stop_ends_the_series_and_reports_the_rest(main_here, tmp_path):
    (tmp_path / "law.py").write_text(FAILS_THE_SECOND_TIME)
    run = main_here("repeat", 4, *QUICK, "--controller", "law.py:Law", "-o", "series", "--figure", "all.svg")
    assert run.returncode == 5
    assert "stop-2.mcap: safety stop" in run.stderr
    assert sorted(path.name for path in (tmp_path / "series").iterdir()) == ["stop-1.mcap", "stop-2.mcap"]
    assert "stop time" in run.stdout
    assert (tmp_path / "all.svg").read_text().startswith("<?xml")


LEARNING = ("--controller", "predictive-reaching", "--estimator", "adaptive-observer", "--learn", "--virtual")
SLOWER = ("--set", "experiment.start_speed_rad_s=60")


def test_a_stop_begins_with_what_the_one_before_learnt_of_the_brake(main_here, tmp_path):
    run = main_here("repeat", 2, *LEARNING, *SLOWER, "--rig", "hard:7", "-o", "series", check=0)
    first, second = (read_session(tmp_path / "series" / f"stop-{number}.mcap") for number in (1, 2))
    known = tomllib.loads(second.attachments["config.toml"].decode())["model"]["identified"]
    assert set(known) == {"c31", "brake_dead_time_s", "brake_release_ratio"}
    assert not tomllib.loads(first.attachments["config.toml"].decode())["model"]["identified"]
    braking = first.ticks[first.ticks["phase"] == Phase.BRAKING]
    assert known["brake_dead_time_s"] == pytest.approx(braking["c2"][-1], rel=0.1)  # it learns on until the road stops
    assert f"--set model.identified.c31={known['c31']!r}" in run.stderr
    main_here("replay", "series/stop-2.mcap", check=0)


def test_an_estimator_that_learns_nothing_is_refused_before_anything_moves(main_here, tmp_path):
    for more in ((), ("--dry-run",)):
        run = main_here("repeat", 2, *QUICK, "--learn", "-o", "series", *more, check=2)
        assert "--learn: moving-window learns nothing of the brake; use --estimator observer or adaptive" in run.stderr
    assert not (tmp_path / "series").exists()


def test_an_interrupt_while_the_brake_cools_ends_the_series(main_here, monkeypatch):
    slept = []

    def interrupted(seconds):
        slept.append(seconds)
        raise KeyboardInterrupt

    monkeypatch.setattr(repeat, "time", SimpleNamespace(sleep=interrupted))
    run = main_here("repeat", 3, *QUICK, "-o", "series", "--pause", 7, "--json")
    assert (run.returncode, slept) == (130, [7.0])
    assert len(json.loads(run.stdout)["stops"]) == 1


def test_every_metric_of_a_series_has_its_name_and_unit_on_eighty_columns():
    values = {name: MetricStatistics(12, 12345.6, 0.00123, 1234.5, 12345.6, -0.00123) for name in METRICS}
    console = Console(width=80, file=StringIO())
    console.print(render_series(values))
    text = console.file.getvalue()
    assert "…" not in text
    for words in ("start speed", "rad/s", "torque variation", "N m/s", "slip RMS, estimated", "1/s"):
        assert words in text
    suffixes = {"rad/s": "_rad_s", "s": "_s", "m": "_m", "N m/s": "_nm_per_s", "1/s": "_per_s"}
    for name, unit in UNITS.items():
        assert name.endswith(suffixes.get(unit, ""))


def test_statistics_are_those_of_numpy():
    generator = np.random.default_rng(1)
    values = generator.normal(1.4, 0.1, 12)
    cards = [{**dict.fromkeys(METRICS), "stop_time_s": value} for value in values.tolist()]
    cards[4]["stop_time_s"] = None
    kept = np.delete(np.arange(12), 4)
    (name, spread), *others = metric_statistics(cards).items()
    assert (name, others, spread.stops) == ("stop_time_s", [], 11)
    assert spread.mean == pytest.approx(values[kept].mean(), rel=1e-12)
    assert spread.deviation == pytest.approx(values[kept].std(ddof=1), rel=1e-12)
    assert spread.drift == pytest.approx(np.polyfit(kept, values[kept], 1)[0], rel=1e-9)
    assert (spread.smallest, spread.largest) == (values[kept].min(), values[kept].max())


def test_one_stop_has_no_deviation_and_no_drift():
    spread = metric_statistics([{"stop_time_s": 1.5}])["stop_time_s"]
    assert (spread.mean, spread.deviation, spread.drift) == (1.5, None, None)
