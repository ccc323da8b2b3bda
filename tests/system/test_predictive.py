"""The predictive controller from the command line to the session and back."""

import json
import math

import pytest

from inteco_abs.sessions import read_session

pytestmark = pytest.mark.untraced  # the same code runs traced elsewhere, and a run of the command is long

OURS = ("--controller", "predictive-reaching", "--set", "experiment.start_speed_rad_s=60")


@pytest.fixture
def ours(card):
    return card(*OURS, "--rig", "hard:100000")


def test_it_brings_its_observer_holds_the_slip_and_replays_bit_for_bit(ours, inteco_abs, tmp_path):
    assert (ours["outcome"], ours["controller"], ours["estimator"]) == ("completed", "predictive-reaching", "observer")
    assert ours["slip_rms_true"] < 0.01
    session = read_session(tmp_path / "stop.mcap")
    assert session.metadata["controller"]["estimator"] == "observer"
    assert session.metadata["controller"]["gain.k"] == "60.0"
    assert b'name = "observer"' in session.attachments["config.toml"]
    replay = json.loads(inteco_abs("replay", "stop.mcap", "--json", check=0).stdout)
    assert (replay["differing"], replay["ticks"]) == (0, ours["ticks"])


def test_another_estimator_is_refused_before_anything_begins(main_here, tmp_path):
    run = main_here("run", "--virtual", *OURS, "--estimator", "kalman", check=2)
    assert "estimator.name: 'kalman': the controller predictive-reaching needs 'observer'" in run.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_loop_decides_in_machine_code_and_the_session_replays_bit_for_bit(real_stop, main_here, tmp_path):
    law = ("--controller", "boundary-layer", "--estimator", "kalman", "--set", "experiment.start_speed_rad_s=20")
    real_stop(*law, "--set", "loop.compiled=true")
    session = read_session(tmp_path / "stop.mcap")
    assert session.metadata["timing"]["decisions"] == "machine code"
    assert b"compiled = true" in session.attachments["config.toml"]
    assert json.loads(main_here("replay", "stop.mcap", "--json", check=0).stdout)["differing"] == 0


@pytest.mark.long
def test_machine_code_is_made_once_and_refused_where_it_cannot_be_kept(inteco_abs, untraced, tmp_path):
    (tmp_path / "no folder").touch()
    law = ("--estimator", "euler", "--set", "experiment.start_speed_rad_s=20", "--set", "loop.compiled=true")

    def run(folder):
        environment = {**untraced, "NUMBA_CACHE_DIR": str(tmp_path / folder)}
        (tmp_path / "stop.mcap").unlink(missing_ok=True)
        return inteco_abs("run", *law, "--out", "stop.mcap", environment=environment)

    first, second, refused = map(run, ("kept", "kept", "no folder"))
    assert "making machine code of the decisions, once" in first.stderr
    assert "making machine code" not in second.stderr
    assert {first.returncode, second.returncode} <= {0, 3}
    assert refused.returncode == 1
    assert "reaching-law with euler cannot be made, or not be kept, on this computer; set it to false" in refused.stderr
    assert not (tmp_path / "stop.mcap").exists()


@pytest.mark.untraced
def test_a_lag_to_be_inverted_is_a_gain_of_the_session(card, main_here):
    slow = ("--set", "experiment.start_speed_rad_s=60")
    with_lag = card(*slow, "--set", "controller.gains.lag_s=0.05", out="lag.mcap")
    assert with_lag["reaching_time_s"] < (card(*slow)["reaching_time_s"] or math.inf)
    info = json.loads(main_here("info", "lag.mcap", "--json", check=0).stdout)
    assert info["metadata"]["controller"]["gain.lag_s"] == "0.05"
    assert json.loads(main_here("replay", "lag.mcap", "--json", check=0).stdout)["differing"] == 0
