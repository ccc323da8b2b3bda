"""Each kind of fault has its effect on each kind of board, and the stop ends as required."""

import pytest

from inteco_abs.boards import InProcessLink, board_behind
from inteco_abs.errors import ConfigError
from inteco_abs.mock_board import FaultyDevice, FaultyFrontEnd, Schedule, front_end_of, parse_faults
from inteco_abs.mock_board.faults.kinds import KINDS, ON_THE_HOST, ON_THE_RIG, ON_THE_WIRE
from inteco_abs.signals import BoardFlags, Phase, Reason
from tests.faults.stage import configured, ride

R = Reason
ONCE = {
    # one bad exchange: noticed as one that failed, and the stop goes on
    "lose": "", "lose-command": "", "overdue": "", "swap": "", "stale": "", "cut=9": "",
}  # fmt: skip
FOR_GOOD = ("identity", "stall", "unplug")
ENDS = {
    "road-stuck": {R.ROAD_ENCODER_FROZEN},
    "road-dither": {R.ROAD_ENCODER_FROZEN},
    "road-reversed": {R.ROAD_BACKWARDS, R.COUNT_JUMP},
    "road-noisy=60": {R.COUNT_JUMP, R.ENCODERS_DISAGREE, R.ROAD_BACKWARDS, R.OVER_SPEED, R.ROAD_ENCODER_FROZEN},
    "road-jump=2000": {R.COUNT_JUMP},
    "road-jump=-2000": {R.COUNT_JUMP},
    "wheel-reversed": {R.ENCODERS_DISAGREE},
    "wheel-jump=2000": {R.COUNT_JUMP},
    "wheel-noisy=60": {R.COUNT_JUMP, R.ENCODERS_DISAGREE, R.OVER_SPEED},
    "drive-dead": {R.ROAD_ENCODER_FROZEN, R.RUN_UP_IMPLAUSIBLE, R.SPIN_UP_TIMEOUT},
    "power-off": {R.ROAD_ENCODER_FROZEN, R.RUN_UP_IMPLAUSIBLE, R.SPIN_UP_TIMEOUT},
    "supply=12.2": {R.ROAD_ENCODER_FROZEN, R.RUN_UP_IMPLAUSIBLE, R.SPIN_UP_TIMEOUT},
    "heat=80.1": {R.ROAD_ENCODER_FROZEN, R.RUN_UP_IMPLAUSIBLE, R.SPIN_UP_TIMEOUT},
    "reset=zero": {R.COUNT_JUMP},
    "reset=held": {R.COUNT_JUMP},
    "reset=random": {R.COUNT_JUMP},
}


def happened(result):
    assert all(result.times.values()), result.times
    return result


def failed_exchanges(result):
    return sum(bool(tick.board_flags & BoardFlags.STALE) for tick in result.ticks)


def test_without_a_fault_the_stop_is_whole(short):
    result = ride(short)
    assert (result.reason, result.refused, result.duties) == (R.NONE, None, (0.0, 0.0))
    assert {Phase.SPIN_UP, Phase.BRAKING, Phase.DONE} <= result.phases
    assert failed_exchanges(result) == 0


@pytest.mark.parametrize("name", ONCE)
@pytest.mark.parametrize("event", [pytest.param("drive+40ms", marks=pytest.mark.long), "brake+20ms"])
def test_one_bad_exchange_is_noticed_and_tolerated(short, name, event):
    result = happened(ride(short, [f"{name}@{event}"]))
    assert (result.reason, result.refused, result.duties) == (R.NONE, None, (0.0, 0.0))
    assert failed_exchanges(result) >= 1 or name == "lose-command"


@pytest.mark.parametrize("name", ["twice", "late=1", "supply=12.3", "heat=80"])
def test_harmless_faults_are_tolerated(short, name):
    result = happened(ride(short, [f"{name}@drive+40ms"]))
    assert (result.reason, result.refused, result.duties) == (R.NONE, None, (0.0, 0.0))


@pytest.mark.parametrize("name", FOR_GOOD)
@pytest.mark.parametrize("event", ["drive+40ms", "brake+20ms"])
def test_lost_board_ends_the_run_in_four_exchanges_with_a_warning(short, name, event):
    if short.board.kind == "pci" and name == "identity":
        with pytest.raises(ConfigError, match="no answer of such a board identifies it"):
            ride(short, [f"{name}@{event}"])
        return
    result = happened(ride(short, [f"{name}@{event}"]))
    assert result.reason is R.MISSED_EXCHANGES
    assert result.unsafe
    assert failed_exchanges(result) == 4


@pytest.mark.parametrize("name", ENDS)
def test_a_fault_of_the_rig_ends_the_run_with_its_reason_and_outputs_off(short, name):
    result = happened(ride(short, [f"{name}@drive+60ms"]))
    assert result.reason in ENDS[name]
    assert result.refused is None
    assert result.duties == (0.0, 0.0)


@pytest.mark.parametrize("fault", ["supply=0", "supply=10.5", "heat=-40", "heat=95", "heat=150", "alarm=5"])
def test_what_the_board_measures_is_reported_by_its_driver(fault):
    config, (name, value) = configured(profile="sim_pci"), fault.split("=")
    schedule = Schedule(parse_faults([f"{fault}@start"]), lambda: 0, 0)
    device = FaultyDevice(config, lambda: 0, schedule=schedule)
    with board_behind(
        InProcessLink(FaultyFrontEnd(front_end_of, device, pytest.fail, pytest.fail)), config, lambda: 0
    ) as board:
        shown = {reading.name: reading.value for reading in board.readings()}
    assert shown["supply"] == pytest.approx(float(value) if name == "supply" else 24.0, abs=0.01)
    assert shown["temperature"] == pytest.approx(float(value) if name == "heat" else 21.0, abs=0.2)
    flags = [shown["alarm_bit0"], shown["alarm_supply"], shown["alarm_bit2"]]
    assert flags == ([0, 1, 0] if name == "alarm" else [1, 1, 1])


def test_second_program_repeating_an_old_command_is_noticed_with_a_warning(short):
    result = happened(ride(short, ["master@brake+20ms"]))
    assert result.reason is R.MISSED_EXCHANGES
    # a bus shows its last write, by any program; writes of another program after the reading stay unseen
    assert result.unsafe or result.duties == (0.0, 0.0) or short.board.kind == "pci"


def test_a_computer_that_stood_still_ends_the_run_at_its_first_tick_afterwards(short):
    result = happened(ride(short, ["pause=50@drive+60ms"]))
    assert result.reason is R.MISSED_EXCHANGES
    assert result.refused is None
    assert result.duties == (0.0, 0.0)
    assert result.reaction_ticks <= 50e6 / short.period_ns + 2


@pytest.mark.parametrize("event", ["drive+60ms", "brake"])
def test_a_computer_that_has_slept_takes_the_power_away_with_its_first_answer(short, event):
    result = happened(ride(short, [f"sleep=500@{event}"]))
    assert result.reason in {R.COUNT_JUMP, R.OVER_SPEED}
    assert result.refused is None
    assert result.duties == (0.0, 0.0)
    assert result.reaction_ticks <= 500e6 / short.period_ns + 2


def test_a_slow_exchange_is_flagged_and_many_end_the_run(short):
    once = happened(ride(short, ["late=5@drive+60ms"]))
    assert any(tick.board_flags & BoardFlags.SLOW for tick in once.ticks)
    many = happened(ride(short, ["late=5@drive+60ms/1s"]))
    assert many.reason is R.MISSED_EXCHANGES
    assert many.duties == (0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "moves"),
    [
        ("brake-stuck=1", "wheel"),
        pytest.param("brake-weak=0.1", "brake", marks=pytest.mark.long),
        pytest.param("brake-dead", "brake", marks=pytest.mark.long),
        pytest.param("drive-stuck=1", "drive", marks=pytest.mark.long),
    ],
)
def test_motors_get_what_the_fault_gives_them(name, moves):
    config = configured("experiment.start_speed_rad_s=10")
    event = "brake" if moves == "brake" else "drive"
    result, healthy = happened(ride(config, [f"{name}@{event}"])), ride(config)
    if moves == "brake":
        assert len(result.ticks) > len(healthy.ticks)
        assert max(truth.brake_torque_nm for truth in result.truths) < 1.0
    elif moves == "wheel":
        assert max(truth.road_speed_rad_s for truth in result.truths) < 5.0
        assert result.reason is R.ROAD_ENCODER_FROZEN
    else:
        assert max(t.road_speed_rad_s for t in result.truths) > max(t.road_speed_rad_s for t in healthy.truths)


def test_the_seed_makes_what_is_random_the_same_again(short):
    first, again, other = (ride(short, ["corrupt@drive+20ms/#40"], seed) for seed in (1, 1, 2))
    assert first.ticks == again.ticks
    assert first.ticks != other.ticks


def test_every_kind_is_tried_here():
    tried = {name.partition("=")[0] for name in (*ONCE, *FOR_GOOD, *ENDS)} | {
        "twice", "late", "master", "pause", "sleep", "corrupt", "alarm",
        "brake-stuck", "brake-dead", "brake-weak", "drive-stuck",
    }  # fmt: skip
    elsewhere = {
        "corrupt-command",
        "splice",
        "road-slips",
        "wheel-slips",
        "wheel-stuck",
        "wheel-dither",
        "encoders-swapped",
        "watchdog-stuck",  # tests/realtime/test_watchdog.py
        *ON_THE_HOST,
    }
    assert tried | elsewhere == set(KINDS) == set(ON_THE_WIRE) | set(ON_THE_RIG) | set(ON_THE_HOST)
