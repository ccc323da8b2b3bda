"""The verb on the command line."""

import csv
import errno
import json
import os
import subprocess
import sysconfig
from pathlib import Path

import pytest

from inteco_abs.cli.command import cli
from inteco_abs.errors import AbsError, ConfigError

COMMAND = Path(sysconfig.get_path("scripts")) / "inteco-abs"

OWN = """
class Own:
    gains = internals = ()
    def __init__(self, setup): ...
    def update(self, estimate, dt_s): ...
"""


@pytest.fixture
def design(tmp_path, monkeypatch, capsys):
    """Runs the verb in an empty folder, in this process; gives exit code and what it printed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")

    def run(*arguments):
        code = cli.main(["design", *arguments], standalone_mode=False)
        return code, capsys.readouterr().out

    return run


def test_installed_command_exits_3_with_advice_and_2_on_wrong_usage():
    def run(*arguments):
        return subprocess.run([COMMAND, "design", *arguments], capture_output=True, text=True, timeout=60, check=False)

    advised = run("--json")
    assert advised.returncode == 3
    assert advised.stderr == ""
    assert json.loads(advised.stdout)["advice"]
    reversed_ = run("--speeds", "180", "10", "--uncertain", "mu=1%")
    assert reversed_.returncode == 2
    assert "--speeds: 180 10: must rise; write --speeds 10 180" in reversed_.stderr


def test_an_identified_fade_makes_the_brakes_of_the_set_weaker(design):
    rig = ("--set", "model.identified.brake_fade_per_kj=1.0", "--json")
    stated = json.loads(design("--uncertain", "brake_gain=10%", *rig)[1])["uncertain"]["brake_gain"]
    energy_kj = 0.5e-3 * (0.02560 + (99 / 99.5) ** 2 * 0.0075281) * 180.0**2
    assert stated == pytest.approx([0.9 / (1.0 + energy_kj), 1.1], rel=1e-3)
    assert json.loads(design("--uncertain", "mu=1%", *rig)[1])["uncertain"]["brake_gain"][1] == 1.0


def test_the_json_object_has_the_numbers_and_the_curves(design):
    code, printed = design("--uncertain", "mu=10%", "--set", "guard.brake_limit=0.7", "--from-slip", "0.4", "--json")
    report = json.loads(printed)
    assert code == 3
    assert report["uncertain"] == {"mu": pytest.approx([0.9, 1.1])}
    assert report["fails_25_rad_s"] == [[10.0, pytest.approx(71.4, abs=0.05)]]
    assert report["mq_25_times_speed_rad_s2"] == pytest.approx(71.4, abs=0.05)
    assert [way["from_slip"] for way in report["reaching"]] == [0.0, 0.4]
    assert report["reaching"][0]["peak_torque_nm"] == pytest.approx(6.11, abs=0.01)
    assert {one["about"] for one in report["advice"]} == {"existence", "holding", "saturation", "reaching"}
    assert {len(values) for values in report["curves"].values()} == {171}


def test_what_has_no_bound_is_null(design):
    _, printed = design("--uncertain", "J1=70%", "--set", "controller.gains.Mq=0", "--json")
    report = json.loads(printed)
    assert report["mq_26_per_s"] is None
    assert set(report["curves"]["mq_26_per_s"]) == {None}
    assert report["reaching"][0]["bound_s"] is None
    assert report["reaching"][0]["time_s"] is None
    code, text = design("--uncertain", "J1=70%", "--set", "controller.gains.Mq=0")
    assert code == 3
    assert "no bound by (20)" in text
    assert " - " in text


def test_on_a_terminal_of_80_columns_every_number_is_whole(design):
    code, text = design()
    assert code == 3
    assert "…" not in text
    assert "-> Mq = " in text
    assert "conditions for" not in text
    for name in ("J1", "brake_duty_offset", "adhesion_blend"):
        assert name in text


def test_a_band_of_slips_is_named(design):
    _, text = design("--uncertain", "mu=1%", "--slip-band", "0.1", "0.5")
    assert "slips 0.1..0.5" in text


def test_guaranteed_sliding_is_reported(design):
    code, text = design("--uncertain", "mu=1%")
    assert code == 0
    assert "sliding is guaranteed for the whole set" in text
    _, text = design("--uncertain", "mu=0%", "--controller", "boundary-layer")
    assert "slip within 0.02 of the reference is guaranteed" in text


def test_the_table_has_one_row_a_speed(design, tmp_path):
    design("--uncertain", "J1=70%", "--speeds", "20", "40", "--csv", "curves.csv")
    with (tmp_path / "curves.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["road_speed_rad_s"]) for row in rows] == [20.0 + step for step in range(21)]
    assert {row["mq_26_per_s"] for row in rows} == {""}
    assert float(rows[0]["mq_25_per_s"]) > 0.0


def test_the_range_begins_at_10_and_ends_where_braking_begins(design):
    _, printed = design("--uncertain", "mu=1%", "--set", "experiment.start_speed_rad_s=120", "--json")
    speeds = json.loads(printed)["curves"]["road_speed_rad_s"]
    assert (speeds[0], speeds[-1]) == (10.0, 120.0)


def test_a_figure_is_drawn(design, tmp_path):
    design("--uncertain", "mu=10%", "--figure", "design.svg")
    assert (tmp_path / "design.svg").read_bytes().startswith(b"<?xml")


WRONG = [
    (["--uncertain", "brake_gian=5%"], ["brake_gian", "did you mean brake_gain"]),
    (["--uncertain", "J1=-5%"], ["J1=-5%", "must not be negative"]),
    (["--uncertain", "mu=-5%", "--uncertain", "J9"], ["2 mistakes", "mu=-5%", "J9"]),
    (["--speeds", "180", "10"], ["--speeds", "180 10", "--speeds 10 180"]),
    (["--speeds", "0", "180"], ["--speeds", "0.1..245 rad/s"]),
    (["--slip-band", "0.5", "0.1"], ["--slip-band", "must rise"]),
    (["--slip-band", "0", "0.1"], ["--slip-band", "0.01..1"]),
    (["--from-slip", "2"], ["--from-slip", "2", "0..1"]),
    (["--set", "controller.reference_slip=0.001"], ["controller.reference_slip", "0.001", "at least 0.01"]),
    (
        ["--set", "controller.reference_points=[0.3, 0.1]", "--set", "controller.reference_at_s=[0, 1]"],
        ["controller.reference_points", "one slip", "controller.reference_slip"],
    ),
    (["--controller", "pi"], ["'pi' has no switching gain", "reaching-law"]),
    (["--controller", "own.py"], ["own.py:Class"]),
    (["--controller", "reachin-law"], ["did you mean reaching-law"]),
    (["--set", "controller.gains.Mx=1"], ["controller.gains.Mx", "Mk, Mq"]),
    (["--csv", "curves.txt"], ["--csv", ".csv"]),
    (["--csv", "nowhere/curves.csv"], ["--csv", "nowhere does not exist"]),
    (["--figure", "design.bmp"], ["--figure", ".png"]),
]


@pytest.mark.parametrize(("arguments", "words"), WRONG, ids=lambda value: " ".join(value)[:50])
def test_wrong_input_is_explained_and_nothing_is_written(design, tmp_path, arguments, words):
    with pytest.raises(ConfigError) as caught:
        design("--csv", "all.csv", *arguments)
    for word in words:
        assert word in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_controller_of_the_users_own_is_known_but_not_judged(design, tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    with pytest.raises(ConfigError, match=r"'own\.py:Own' has no switching gain"):
        design("--controller", "own.py:Own")


def test_a_table_that_cannot_be_written_is_an_error_and_nothing_is_left(design, monkeypatch, tmp_path):
    def full(*_columns):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("csv.DictWriter", full)
    with pytest.raises(AbsError, match=r"curves\.csv: the table cannot be written: No space left"):
        design("--csv", "curves.csv")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("option", "name"), [("--csv", "curves.csv"), ("--figure", "design.svg")])
def test_no_file_is_overwritten(design, tmp_path, option, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(ConfigError, match=f"{option}: {name}: exists already, and files are never overwritten"):
        design(option, name)
    assert (tmp_path / name).read_text() == "mine"
