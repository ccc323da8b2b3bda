"""A run that keeps its wire, and our driver against that capture."""

import json

import pytest

QUICK = ("--set", "experiment.start_speed_rad_s=30", "--set", "experiment.hold_s=0.05")


@pytest.fixture
def captured(main_here, tmp_path):
    def stop(*arguments, check=0):
        main_here("run", *QUICK, *arguments, "--out", "x.mcap", "--record-wire", "x.jsonl", check=check)
        return tmp_path / "x.jsonl"

    return stop


def test_our_driver_writes_the_same_again_and_every_tick_is_there(captured, main_here):
    captured("--virtual")
    replay = json.loads(main_here("wire", "replay", "x.jsonl", "--json", check=0).stdout)
    assert (replay["differing"], replay["failed"], replay["ended"]) == (0, 0, "")
    ticks = json.loads(main_here("info", "x.mcap", "--json", check=0).stdout)["ticks"]
    assert ticks <= replay["exchanges"] <= ticks + 1
    shown = json.loads(main_here("wire", "show", "x.jsonl", "--json", check=0).stdout)
    assert shown["traffic"]["SEND"]["rate_hz"] == pytest.approx(2000, rel=0.01)


@pytest.mark.long
def test_another_wiring_is_found_by_its_words(captured, inteco_abs):
    captured("--virtual")
    run = inteco_abs("wire", "replay", "x.jsonl", "--set", "board.pwm_prescaler=60", check=4)
    assert "pwm0_prescaler" in run.stdout
    assert "captured 0x002C, ours 0x003C" in run.stdout
    assert "replayed to its end" in run.stdout


@pytest.mark.long
@pytest.mark.untraced
def test_a_run_in_real_time_keeps_its_wire_too_and_the_same_in_its_session(inteco_abs, tmp_path):
    inteco_abs("run", *QUICK, "--out", "x.mcap", "--record-wire", "x.jsonl", "--frames")
    inteco_abs("wire", "import", "x.mcap", "-o", "again.jsonl", check=0)
    assert (tmp_path / "again.jsonl").read_bytes() == (tmp_path / "x.jsonl").read_bytes()
    inteco_abs("validate", "x.mcap", check=0)
    replay = json.loads(inteco_abs("wire", "replay", "x.jsonl", "--json").stdout)
    assert replay["exchanges"] > 1000
    assert replay["differing"] == 0


@pytest.mark.long
def test_a_capture_of_another_kind_of_board_is_refused(captured, inteco_abs):
    captured("--virtual")
    run = inteco_abs("wire", "replay", "x.jsonl", "--set", "profile=sim_usb", check=2)
    assert "usb1-111" in run.stderr
    assert "usb2" in run.stderr


def test_a_capture_is_never_overwritten_and_nothing_runs(main_here, tmp_path):
    (tmp_path / "x.jsonl").write_text("precious")
    run = main_here("run", "--virtual", "--out", "x.mcap", "--record-wire", "x.jsonl", check=1)
    assert "never overwritten" in run.stderr
    assert not (tmp_path / "x.mcap").exists()
    assert (tmp_path / "x.jsonl").read_text() == "precious"


def test_a_capture_without_frames_is_refused(main_here, tmp_path):
    (tmp_path / "x.jsonl").write_text(
        '{"format": "inteco-abs wire", "version": 1, "board": "usb2", "recorded_by": "x", "clock": "x"}\n'
    )
    run = main_here("wire", "replay", "x.jsonl", check=1)
    assert "x.jsonl" in run.stderr
