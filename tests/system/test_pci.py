"""The rig on the mock of the RT-DAC4/PCI: as on the other boards, by another wire."""

import json

import pytest
from live import LiveRun, safe_after_ns

pytestmark = pytest.mark.xdist_group("real time")

PCI = ("--set", "profile=sim_pci")
QUICK = ("--set", "experiment.start_speed_rad_s=30", "--set", "experiment.hold_s=0.1")
GENEROUS_NS = 2_000_000_000
TURNING = 400


@pytest.mark.long
def test_a_stop_in_real_time_with_a_real_boards_limits_is_completed_and_replays(inteco_abs, real_stop):
    card = json.loads(real_stop(*PCI, *QUICK).stdout)
    assert (card["outcome"], card["lost_ticks"]) == ("completed", 0)
    assert json.loads(inteco_abs("replay", "stop.mcap", "--json", check=0).stdout)["differing"] == 0
    facts = json.loads(inteco_abs("info", "stop.mcap", "--json", check=0).stdout)["metadata"]
    assert facts["rig"]["logic_version"] == "0x050F"
    assert facts["rig"]["application_name"] == ""


@pytest.mark.long
def test_a_loop_that_is_killed_leaves_safe_behind(command_path, tmp_path, untraced):
    run = LiveRun(command_path, tmp_path, untraced, *PCI)
    try:
        run.until_tick(TURNING)
        killed_ns = run.kill("loop")
        code, card, message = run.end()
        assert code == 5, message
        assert (card["outcome"], card["lost_ticks"]) == ("aborted", 0)
        assert "the guardian made its board safe in" in message
        assert safe_after_ns(run.session(), killed_ns) < GENEROUS_NS
    finally:
        run.destroy()


@pytest.mark.long
def test_without_a_board_the_command_names_where_it_searched(inteco_abs, tmp_path):
    run = inteco_abs("run", "--board", "pci:7f:1f.7", "--out", "stop.mcap")
    assert run.returncode == 1
    assert "no RT-DAC4/PCI board (10b5:2497) at 7f:1f.7: is it in its slot?" in run.stderr
    assert not (tmp_path / "stop.mcap").exists()
