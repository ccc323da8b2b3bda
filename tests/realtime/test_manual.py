"""What the panel's process does with requests: in virtual time, with the real board, guard and shared memory."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from manual_bench import Bench

from firmware_protocol.rtdac_usb2 import READ_REQUEST
from inteco_abs.config import load_config, parse_config, profiles
from inteco_abs.errors import ConfigError, LinkError, UnsafeError
from inteco_abs.experiment import manual_control
from inteco_abs.realtime.memory import Field
from inteco_abs.realtime.processes.manual import HELD_NS, RATE_HZ, read_all, slowed
from inteco_abs.signals import BoardFlags, Command, Reason

PERIOD_NS = round(1e9 / RATE_HZ)
OFF = (0.0, 0.0)


@pytest.fixture
def bench(new_memory):
    def make(*settings, **options):
        return Bench(new_memory(5000), *settings, **options)

    return make


@pytest.mark.parametrize("profile", profiles())
@pytest.mark.parametrize("window_s", [0.001, 0.1])
def test_any_configuration_slowed_down_is_one_that_another_process_can_read(profile, window_s):
    config = load_config(settings=["loop.rate_hz=1000", f"estimator.window_s={window_s}"], profile=profile)
    slow = slowed(config)
    assert parse_config(slow.to_toml()) == slow
    assert slow.loop.rate_hz == RATE_HZ


def test_slowed_down_limits_in_exchanges_are_within_a_real_boards_ceilings_there():
    fast = ["guard.missed_in_a_row=50", "guard.bucket_limit=200"]
    for profile, limits in (("usb2_generic_0103", (4, 30)), ("sim_usb2", (50, 200))):
        guard = slowed(load_config(settings=fast, profile=profile)).guard
        assert (guard.missed_in_a_row, guard.bucket_limit) == limits


def test_outputs_by_hand_of_a_real_board_take_limits_that_one_may_have():
    config = load_config(settings=["guard.silence_s=0.5"], profile="usb2_generic_0103")
    with pytest.raises(ConfigError, match=r"guard\.silence_s: 0\.5: on a real board at most 0\.1"):
        manual_control(config, "usb2:", outputs=True).__enter__()


def test_with_no_key_nothing_is_ever_put_out(bench):
    with bench() as rig:
        assert set(rig.beats(1.0)) == {OFF}


def test_the_request_is_put_out_while_the_key_is_held(bench):
    with bench() as rig:
        drive, brake = rig.beats(0.3, Command(0.4, 0.2))[-1]
        assert (drive, brake) == pytest.approx((0.4, 0.2), abs=1 / 255)


def test_half_a_second_after_the_last_key_the_outputs_are_off(bench):
    with bench() as rig:
        rig.beats(0.3, Command(0.4, 0.0))
        after = rig.beats(1.0)
        on = sum(duties != OFF for duties in after)
        assert on * PERIOD_NS <= HELD_NS + PERIOD_NS
        assert set(after[on:]) == {OFF}


def test_another_key_takes_them_away_two_beats_later_at_most(bench):
    with bench() as rig:
        rig.beats(0.3, Command(0.4, 0.0))
        rig.side.request.take_away()
        assert set(rig.beats(0.5)[1:]) == {OFF}


@given(
    now_ns=st.integers(0, 2**60),
    seen_ns=st.integers(1, 2**60),
    drive=st.integers(0, 100),
    brake=st.integers(0, 100),
)
def test_a_request_counts_for_half_a_second_and_is_passed_on_to_a_millionth(requests, now_ns, seen_ns, drive, brake):
    requests.keep_on(Command(drive / 100, brake / 100), seen_ns)
    for at_ns in (now_ns, seen_ns, seen_ns + HELD_NS - 1, seen_ns + HELD_NS):
        requested = requests.at(at_ns)
        if abs(at_ns - seen_ns) < HELD_NS:
            assert requested == pytest.approx((drive / 100, brake / 100), abs=1e-6)
        else:
            assert requested is Command.SAFE


@pytest.fixture(scope="session")
def requests():
    from inteco_abs.realtime.processes.manual import HeldRequest

    class Memory:
        words = memoryview(bytearray(8 * len(Field))).cast("q")

    return HeldRequest(Memory())


def test_the_guard_has_the_last_word_on_the_duty(bench):
    with bench() as rig:
        assert rig.beats(0.2, Command(0.0, 1.0))[-1][1] == pytest.approx(0.7, abs=1 / 255)


def test_what_the_guard_has_taken_away_no_key_brings_back(bench):
    with bench("guard.over_speed_rad_s=20.0", "experiment.start_speed_rad_s=15.0") as rig:
        rig.beats(4.0, Command(1.0, 0.0))
        assert set(rig.beats(0.5, Command(1.0, 0.0))) == {OFF}
        assert rig.side.ticks()[-1]["reason"] == Reason.OVER_SPEED


def test_a_drive_that_does_not_turn_the_road_is_taken_away(bench):
    with bench() as rig:
        rig.device.power(on=False)
        rig.beats(1.0, Command(0.5, 0.0))
        assert rig.side.ticks()[-1]["reason"] == Reason.ROAD_ENCODER_FROZEN
        rig.device.power(on=True)
        assert rig.device.duties == OFF


def test_an_interrupt_ends_it_with_outputs_off(bench):
    with bench() as rig:
        rig.beats(0.3, Command(0.4, 0.0))
        rig.stop.request()
        assert not rig.beat()
        assert rig.device.duties == OFF
    assert rig.side.ticks()[-1]["stop_request"] == Reason.OPERATOR_STOP


def test_leaving_in_mid_drive_leaves_the_outputs_off(bench):
    rig = bench()

    def drive_and_leave():
        with rig:
            rig.beats(0.3, Command(0.4, 0.0))
            assert rig.device.duties != OFF
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        drive_and_leave()
    assert rig.device.duties == OFF


def test_a_board_that_stops_answering_is_not_shown_as_safe(bench):
    rig = bench()

    def drive_and_lose_it():
        with rig:
            rig.beats(0.3, Command(0.4, 0.0))
            rig.link.dead = True
            rig.beats(0.3, Command(0.4, 0.0))

    with pytest.raises(UnsafeError, match="emergency switch"):
        drive_and_lose_it()
    reasons = rig.side.ticks()["reason"].tolist()
    assert reasons[-1] == Reason.MISSED_EXCHANGES


def test_two_lost_answers_are_tolerated(bench):
    with bench() as rig:
        rig.beats(0.3, Command(0.4, 0.0))
        rig.link.dead = True
        rig.beats(0.02, Command(0.4, 0.0))
        rig.link.dead = False
        assert rig.beats(0.3, Command(0.4, 0.0))[-1] != OFF
        assert (rig.side.ticks()["board_flags"] != 0).sum() == 2


class TestLooks:
    def test_a_usb_board_is_read_as_a_whole_once_asked_and_only_with_outputs_off(self, bench):
        with bench() as rig:
            rig.beats(0.3, Command(0.4, 0.0))
            rig.side.ask()
            rig.beats(0.3, Command(0.4, 0.0))
            assert not rig.side.answered
            rig.side.request.take_away()
            rig.beats(0.05)
            assert rig.side.answered
            assert rig.side.look["values"]["pwm0_prescaler"] == rig.config.board.pwm_prescaler
            assert len(bytes.fromhex(rig.side.look["raw"])) == 504

    def test_the_pci_board_reports_its_alarms_while_it_drives(self, bench):
        with bench(profile="sim_pci") as rig:
            rig.side.ask()
            rig.beats(0.3, Command(0.4, 0.0))
            assert rig.side.answered
            assert {"supply", "temperature"} <= {name for name, *_ in rig.side.look["readings"]}

    def test_a_look_that_fails_says_why_and_ends_nothing(self, bench):
        with bench() as rig:
            rig.link.dead = True
            assert "no answer" in read_all(rig.board)["problem"]
            rig.link.dead = False
            assert rig.beats(0.1, Command(0.4, 0.0))[-1] != OFF


WATCHING = 'board.read_only="the panel only watches"'


class TestWatching:
    def test_only_requests_are_written(self, bench):
        with bench(WATCHING) as rig:
            assert set(rig.beats(0.3, Command(1.0, 1.0))) == {OFF}
            assert set(rig.link.written) == {READ_REQUEST}

    @pytest.mark.parametrize(("which", "column"), [("wheel", "wheel_count"), ("road", "road_count")])
    def test_turns_by_hand_are_counted_with_the_profiles_sign(self, bench, which, column):
        wiring = (WATCHING, f"board.{which}_sign=-1", f"simulation.{which}_sign=-1")
        with bench(*wiring) as rig:
            rig.beats(0.01)
            rig.device.turn(which, 10, 1.0)
            rig.beats(1.2)
            counts = rig.side.ticks()[-1][column]
            assert counts == pytest.approx(10 * rig.config.encoders.counts_per_turn, abs=5)

    def test_lost_answers_are_flagged_and_a_hundred_of_them_end_it(self, bench):
        with bench(WATCHING) as rig:
            rig.link.dead = True
            rig.beats(0.99)
            assert set(rig.side.ticks()["board_flags"].tolist()) == {BoardFlags.STALE}
            with pytest.raises(LinkError):
                rig.beat()

    def test_it_ends_on_request(self, bench):
        with bench(WATCHING) as rig:
            rig.stop.request()
            assert not rig.beat()
