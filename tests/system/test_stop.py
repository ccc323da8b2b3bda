import json
import subprocess
from importlib import import_module

import pytest

from inteco_abs.sessions import read_session

pytestmark = pytest.mark.untraced  # the same code runs traced elsewhere, and a run of the command is long

SLOW = ("--set", "experiment.start_speed_rad_s=20")
CARD_KEYS = {
    "session", "outcome", "controller", "estimator", "board", "ticks", "overruns", "lost_ticks", "start_speed_rad_s",
    "reference_slip", "reaching_time_s", "band_entry_s", "stop_time_s", "stop_distance_m", "slip_rms_true",
    "slip_rms_estimated", "slip_rms_low_speed_true", "slip_rms_fixed_true", "lock_fraction",
    "torque_variation_nm_per_s", "duty_variation_per_s", "lateness_us", "payload_sha256",
}  # fmt: skip


@pytest.fixture(scope="module")
def stop(command_path, tmp_path_factory):
    """Session of a run by the installed command, and its result card."""
    path = tmp_path_factory.mktemp("stop") / "stop.mcap"
    run = subprocess.run(
        [command_path, "run", "--board", "sim:", "--virtual", "--seed", "1", "--out", path, "--json"],
        capture_output=True, timeout=120, check=True,
    )  # fmt: skip
    return path, json.loads(run.stdout)


def test_a_stop_in_virtual_time_is_completed_and_replays_bit_for_bit(stop, inteco_abs):
    path, result = stop
    assert set(result) >= CARD_KEYS
    assert set(result["lateness_us"]) == {"p50", "p99", "p999", "max"}
    assert result["outcome"] == "completed"
    assert (result["overruns"], result["lost_ticks"], result["link_errors"]) == (0, 0, 0)
    assert result["start_speed_rad_s"] == pytest.approx(180.0, abs=0.5)
    replay = json.loads(inteco_abs("replay", path, "--json", check=0).stdout)
    assert replay["differing"] == 0
    assert replay["first"] is None
    assert replay["ticks"] == result["ticks"]
    assert replay["braking_ticks"] > 2000


def test_the_stop_is_the_published_one_with_brake_lag_and_a_10_ms_window(stop):
    _, result = stop
    # closed-loop table for a 10 ms window with lag: 1.406 s, 13.2 m, reached at 0.322 s, slip rms 0.0094; two ticks
    # of delay and an 8-bit PWM are in this stack and not in that table
    assert result["stop_time_s"] == pytest.approx(1.406, rel=0.01)
    assert result["stop_distance_m"] == pytest.approx(13.2, rel=0.01)
    assert result["reaching_time_s"] == pytest.approx(0.322, rel=0.02)
    assert result["slip_rms_true"] == pytest.approx(0.0094, rel=0.15)
    assert result["lock_fraction"] == 0.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_papers_euler_speed_degrades_at_low_speed(card, seed):
    window, euler = card(out="w.mcap", seed=seed), card("--estimator", "euler", out="e.mcap", seed=seed)
    assert window["slip_rms_true"] < 0.015
    assert 0.09 < euler["slip_rms_true"] < 0.15
    assert euler["slip_rms_low_speed_true"] > 0.12
    assert euler["stop_time_s"] > 1.3 * window["stop_time_s"]


@pytest.mark.long
def test_the_brake_limit_of_the_vendors_driver_delays_reaching(card):
    limited = card("--set", "guard.brake_limit=0.7", "--set", "board.pwm_mode=12-bit", "--set", "board.pwm_prescaler=2")
    # closed-loop table with lag and duty at most 0.7: reached at 0.833 s, stop in 1.416 s
    assert limited["reaching_time_s"] == pytest.approx(0.833, rel=0.05)
    assert limited["stop_time_s"] == pytest.approx(1.416, rel=0.01)


def test_info_shows_how_the_run_ended_and_its_settings(stop, main_here):
    path, result = stop
    info = json.loads(main_here("info", path, "--json", check=0).stdout)
    assert info["result"] == result
    assert info["metadata"]["session"]["outcome"] == "completed"
    assert info["metadata"]["controller"]["gain.Mk"] == "2.0"
    assert info["metadata"]["integrity"]["payload_sha256"] == result["payload_sha256"]
    assert info["attachments"]["config.toml"] > 0
    screen, everything = (main_here("info", path, *more, check=0).stdout for more in ((), ("--all",)))
    assert len(screen.splitlines()) <= 24
    assert f"{result['stop_time_s']:.3f} s" in screen
    assert "Mk=2.0" in screen
    assert "session.outcome" not in screen
    assert "session.outcome" in everything
    assert everything.startswith(screen.rpartition("--all prints")[0])


@pytest.mark.parametrize(
    "logic", [(), ("board.logic_version=0x0112", "board.numbering_pwm=-1")], ids=["0x0111", "0x0112"]
)
def test_the_first_usb_board_brakes_well_at_its_250_hz(card, main_here, logic):
    settings = ("profile=sim_usb", *logic, "board.verified_logic=0x0112" if logic else "board.verified_logic=0x0111")
    result = card(*(word for setting in settings for word in ("--set", setting)))
    assert result["outcome"] == "completed"
    assert result["stop_time_s"] == pytest.approx(1.416, rel=0.02)
    assert result["slip_rms_true"] < 0.025
    assert result["lock_fraction"] == 0.0
    assert json.loads(main_here("replay", "stop.mcap", "--json", check=0).stdout)["differing"] == 0


def test_without_an_output_the_session_lands_in_the_sessions_folder(main_here, tmp_path):
    for _ in range(2):
        run = main_here("run", "--virtual", "--set", "experiment.start_speed_rad_s=12", check=0)
        assert "COMPLETED" in run.stdout
    assert len(list((tmp_path / "sessions").glob("stop-*.mcap"))) == 2


@pytest.mark.long
def test_a_stop_in_real_time_with_a_real_boards_limits_keeps_its_pace(inteco_abs, real_stop):
    run = real_stop("--board", "sim:", "--set", "experiment.start_speed_rad_s=30")
    result = json.loads(run.stdout)
    assert result["outcome"] == "completed"
    assert (run.returncode == 3) == (result["overruns"] > 0)
    assert result["lateness_us"]["max"] > 0.0
    replay = json.loads(inteco_abs("replay", "stop.mcap", "--json", check=0).stdout)
    assert replay["differing"] == 0


def test_figures_are_drawn_with_the_run_and_from_the_file(card, main_here, tmp_path):
    card(*SLOW, "--figure", "stop.png")
    main_here("figure", "stop.mcap", "-o", "stop.pdf", check=0)
    assert (tmp_path / "stop.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "stop.pdf").read_bytes().startswith(b"%PDF")


def test_a_changed_gain_in_the_file_is_found_by_replay(card, main_here, tmp_path):
    card(*SLOW)
    data = (tmp_path / "stop.mcap").read_bytes()
    changed = data.replace(b"reference_slip = 0.2", b"reference_slip = 0.3", 1)
    assert changed != data
    (tmp_path / "changed.mcap").write_bytes(changed)
    run = main_here("replay", "changed.mcap")
    assert run.returncode == 1  # the checksum speaks first
    assert "damaged" in run.stderr


def test_ctrl_c_while_the_figure_is_drawn_says_that_the_session_is_whole(main_here, monkeypatch, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(import_module("inteco_abs.cli.run"), "draw", interrupted)
    quick = ("-q", "--set", "experiment.start_speed_rad_s=20")
    stop = main_here("run", "--virtual", *quick, "--out", "stop.mcap", "--figure", "stop.png", check=130)
    assert "interrupted while drawing; stop.mcap is complete: inteco-abs figure stop.mcap" in stop.stderr
    assert read_session(tmp_path / "stop.mcap").incomplete == ""


def test_ctrl_c_while_a_class_is_being_made_is_an_interrupt(main_here, monkeypatch):
    class Name:
        def __set_name__(self, _owner, _name):
            raise KeyboardInterrupt

    monkeypatch.setattr(
        import_module("inteco_abs.experiment"), "run_stop", lambda *_, **__: type("Loaded", (), {"name": Name()})
    )
    stop = main_here("run", "--virtual", "--out", "stop.mcap", check=130)
    assert "internal error" not in stop.stderr
