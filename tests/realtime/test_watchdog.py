"""The watchdog is seen open, close and open before each run, or the run is refused."""

import pytest

from inteco_abs.config import load_config
from inteco_abs.errors import BoardError
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.mock_board import parse_faults
from inteco_abs.sessions import read_session

WATCHED = (
    "experiment.start_speed_rad_s=15.0",
    "board.watchdog_pin=17",
    "board.watchdog_contact_pin=9",
    "board.verified_by=the simulation",
    "board.verified_on=2026-01-01",
    "board.verified_logic=0x0103",
    "simulation.watchdog_pin=17",
    "simulation.watchdog_contact_pin=9",
)


def stop(tmp_path, *settings, faults=()):
    out = tmp_path / "stop.mcap"
    run_stop(load_config(settings=[*WATCHED, *settings]), Plan(out, faults=parse_faults(faults)))
    return read_session(out)


def test_a_run_with_a_watchdog_decides_as_one_without(tmp_path):
    session = stop(tmp_path)
    plain = tmp_path / "plain.mcap"
    run_stop(load_config(settings=WATCHED[:1]), Plan(plain))
    columns = ["tick", "dt_s", "wheel_count", "road_count", "slip", "drive", "brake", "phase"]
    assert session.ticks[columns].tolist() == read_session(plain).ticks[columns].tolist()
    assert session.metadata["rig"]["watchdog_opened_ms"] == "50.5"


@pytest.mark.parametrize(
    ("settings", "faults", "words"),
    [
        ((), ["watchdog-stuck@start"], r"stays closed 0\.1 s after its last pulse: is it welded"),
        (("simulation.watchdog_hold_s=0.2",), [], r"stays closed 0\.1 s after its last pulse"),
        (("simulation.watchdog_pin=18",), [], "does not close although it is fed"),
        (("simulation.watchdog_contact_pin=10",), [], "does not close although it is fed"),
        (("simulation.watchdog_hold_s=0.0019",), [], r"opens within 2\.0 ms, less than 5 periods"),
    ],
)
def test_a_watchdog_that_does_not_do_its_work_is_refused_before_anything_moves(tmp_path, settings, faults, words):
    with pytest.raises(BoardError, match=words):
        stop(tmp_path, *settings, faults=faults)
    assert not list(tmp_path.iterdir())
