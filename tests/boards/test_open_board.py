"""What an open board does by itself, and its driver's part: arming, watchdog, tick."""

import pytest
from benches_open import OpenBench

from firmware_protocol.open_board import ARM, CLEAR, COMMAND, DISARM, QUERY, REPORT, State, Trip, decode, sealed
from inteco_abs.boards import check_pace
from inteco_abs.config import load_config
from inteco_abs.errors import BoardError, ConfigError, LinkError, UnsafeError
from inteco_abs.signals import BoardFlags, Command

MS = 1_000_000
DRIVE = Command(0.4, 0.2)


@pytest.fixture
def bench():
    return OpenBench()


def wait(bench, ms):
    bench.clock.advance(round(ms * MS))
    bench.device.catch_up()


def kinds(bench):
    return [decode(message)[0].name for message in bench.link.written]


def status(bench):
    """The board's STATUS, asked for by hand."""
    bench.front_end.bulk_out(QUERY.encode(sequence=77))
    while True:
        message, values = decode(bench.front_end.bulk_in(60))
        if values["sequence"] == 77 and message is not REPORT:
            return values


class TestArming:
    def test_exchanges_without_a_width_do_not_arm(self, bench):
        with bench.board:
            for _ in range(3):
                assert bench.exchange().board_flags is BoardFlags.NONE
            assert status(bench)["state"] == State.CONFIGURED
            wait(bench, 10_000)
            assert bench.exchange().board_flags is BoardFlags.NONE

    def test_the_first_width_arms_once(self, bench):
        with bench.board:
            for _ in range(3):
                bench.exchange(*DRIVE)
            assert kinds(bench).count("ARM") == 1
            assert status(bench)["state"] == State.ARMED

    def test_without_the_challenges_answer_nothing_is_energised(self, bench):
        with bench.board:
            challenge = status(bench)["challenge"]
            bench.front_end.bulk_out(ARM.encode({"answer": challenge}))
            bench.front_end.bulk_out(COMMAND.encode({"width0": 9, "width1": 9}))
            assert status(bench)["state"] == State.CONFIGURED
            assert bench.device.duties == (0.0, 0.0)

    def test_a_lost_answer_to_arm_does_not_lock_the_board(self, bench):
        with bench.board:
            before = len(bench.link.written)
            bench.link.change_answer = lambda answer: answer if len(bench.link.written) == before + 1 else b""
            assert bench.exchange(*DRIVE).board_flags is BoardFlags.STALE
            assert kinds(bench)[-1] == "ARM"
            bench.link.change_answer = bytes
            assert bench.exchange(*DRIVE).board_flags is BoardFlags.NONE
            assert bench.device.duties != (0.0, 0.0)

    def test_a_low_stop_input_is_named(self):
        bench = OpenBench("board.stop_pins=[3]")
        with bench.board as board:
            assert bench.exchange(*DRIVE).board_flags is BoardFlags.STALE
            assert "refuses ARM: a stop input is low" in str(board.last_error)
        assert bench.device.duties == (0.0, 0.0)


class TestWatchdog:
    @pytest.mark.parametrize("watchdog_ms", [2, 20, 100])
    def test_outputs_go_off_when_no_command_comes(self, watchdog_ms):
        bench = OpenBench(f"board.watchdog_ms={watchdog_ms}")
        with bench.board:
            bench.exchange(*DRIVE)
            wait(bench, watchdog_ms - 0.001)
            assert bench.device.duties != (0.0, 0.0)
            wait(bench, 0.001)
            assert bench.device.duties == (0.0, 0.0)

    @pytest.mark.parametrize(("rate_hz", "watchdog_ms"), [(2000, 20), (250, 20), (100, 40), (50, 80)])
    def test_it_lasts_four_periods_of_a_slow_loop(self, rate_hz, watchdog_ms):
        bench = OpenBench("board.watchdog_ms=20", f"loop.rate_hz={rate_hz}", "estimator.window_s=0.05")
        with bench.board:
            assert status(bench)["watchdog_ms"] == watchdog_ms

    def test_a_trip_is_reported_with_its_reason_and_stays(self, bench):
        with bench.board as board:
            bench.exchange(*DRIVE)
            good = bench.exchange(*DRIVE)
            wait(bench, 101)
            for _ in range(3):
                sample = bench.exchange(*DRIVE)
                assert sample.board_flags is BoardFlags.STALE
                assert (sample.wheel_count, sample.road_count) == (good.wheel_count, good.road_count)
                assert "switched its outputs off, as no command had come for 100 ms" in str(board.last_error)
            assert bench.device.duties == (0.0, 0.0)
            board.make_safe()
            assert bench.exchange(*DRIVE).board_flags is BoardFlags.STALE
        assert kinds(bench).count("CLEAR") == 0

    def test_entering_again_clears_a_trip(self, bench):
        with bench.board:
            bench.exchange(*DRIVE)
            wait(bench, 101)
        bench.plug_in()
        with bench.board:
            assert kinds(bench).count("CLEAR") == 1
            assert bench.exchange(*DRIVE).board_flags is BoardFlags.NONE
            assert status(bench)["trip"] == Trip.WATCHDOG  # of before

    def test_no_question_feeds_it(self, bench):
        with bench.board:
            bench.exchange(*DRIVE)
            for _ in range(11):
                wait(bench, 10)
                status(bench)
            assert bench.device.duties == (0.0, 0.0)

    def test_a_command_that_is_refused_does_not_feed_it_either(self, bench):
        with bench.board:
            bench.exchange(*DRIVE)
            for _ in range(11):
                wait(bench, 10)
                bench.front_end.bulk_out(COMMAND.encode({"width0": 256}))
            assert status(bench)["refused"] == 11
            assert bench.device.duties == (0.0, 0.0)

    def test_a_dead_host_leaves_nothing_on_without_a_rescue(self, bench):
        bench.board.__enter__()
        bench.exchange(*DRIVE)
        bench.die()
        wait(bench, 100)
        assert bench.device.duties == (0.0, 0.0)

    def test_a_reset_is_named(self, bench):
        with bench.board as board:
            bench.exchange(*DRIVE)
            bench.front_end.front_end = type(bench.front_end.front_end)(bench.device)
            bench.device.write({"pwm0_width": 0, "pwm1_width": 0})
            bench.exchange(*DRIVE)
            assert "it was reset, or another program has disarmed it" in str(board.last_error)

    def test_what_it_counts_can_be_read(self, bench):
        with bench.board as board:
            bench.exchange(*DRIVE)
            wait(bench, 101)
            found = {reading.name: reading.value for reading in board.readings()}
        assert (found["state"], found["trip"], found["trips"]) == (State.TRIPPED, Trip.WATCHDOG, 1.0)


class Paced:
    """A board whose tick paces, by hand."""

    def __init__(self, *settings):
        self.bench = OpenBench(*settings)
        self.board = self.bench.board
        self.period_ns = self.bench.config.period_ns

    def __enter__(self):
        self.board.__enter__()
        self.board.start_pacing()
        return self

    def __exit__(self, *error):
        self.board.__exit__(*error)

    def pass_periods(self, periods):
        self.bench.clock.advance(round(periods * self.period_ns))
        self.bench.device.catch_up()

    def tick(self, *command, periods=1.0):
        self.pass_periods(periods)
        sample = self.board.report()
        self.board.answer(Command(*command) if command else Command.SAFE)
        return sample


class TestTick:
    def test_a_command_acts_from_the_next_instant_on(self):
        with Paced() as paced:
            paced.tick(1.0, 0.0)
            assert paced.bench.device.duties == (0.0, 0.0)
            paced.pass_periods(0.999)
            assert paced.bench.device.duties == (0.0, 0.0)
            paced.pass_periods(0.001)
            assert paced.bench.device.duties == (1.0, 0.0)
            assert paced.board.report().board_flags is BoardFlags.NONE

    def test_samples_have_the_boards_times_however_late_they_are_read(self):
        with Paced() as paced:
            samples = [paced.tick(0.5, 0.0, periods=1.0)]
            samples += [paced.tick(0.5, 0.0, periods=periods) for periods in (1.3, 0.9, 0.8, 1.0)]
            late_us = paced.board.late_ns * 1e-3
        assert [round(s.dt_s * 1e9) for s in samples] == [paced.period_ns] * 5
        assert {s.board_flags for s in samples} == {BoardFlags.NONE}
        assert late_us == pytest.approx(0.0, abs=1.0)

    def test_the_first_sample_is_one_period_after_the_start(self):
        with Paced() as paced:
            start_ns = paced.bench.clock.time_ns
            sample = paced.tick()
        assert sample.tick == 0
        assert abs(sample.time_ns - start_ns - paced.period_ns) < 1000  # the board's microsecond

    def test_a_pause_skips_to_the_newest_report(self):
        with Paced() as paced:
            paced.tick()
            before = paced.tick(0.5, 0.0)
            sample = paced.tick(0.5, 0.0, periods=7.2)
            assert paced.board.skipped == 6
            assert sample.tick == before.tick + 1
            assert round(sample.dt_s * 1e9) == 7 * paced.period_ns
            assert paced.tick(0.5, 0.0, periods=0.8).board_flags is BoardFlags.NONE
            assert paced.board.skipped == 0

    def test_a_late_command_does_not_act_and_makes_the_next_sample_slow(self):
        with Paced() as paced:
            paced.tick()
            paced.tick(0.5, 0.0)
            paced.pass_periods(1.0)
            assert paced.board.report().board_flags is BoardFlags.NONE
            paced.pass_periods(1.0)  # its answer comes after the next instant
            paced.board.answer(Command(1.0, 0.0))
            assert paced.board.report().board_flags is BoardFlags.SLOW
            paced.pass_periods(1.0)
            assert paced.bench.device.duties == (127 / 255, 0.0)
            assert status(paced.bench)["late"] == 2
            assert status(paced.bench)["refused"] == 1

    def test_late_commands_alone_trip_it(self):
        with Paced("board.watchdog_ms=5") as paced:
            paced.tick()
            paced.tick(0.5, 0.0)
            for _ in range(10):
                paced.pass_periods(1.0)
                paced.bench.front_end.bulk_out(COMMAND.encode({"width0": 9}, sequence=250))
            assert paced.bench.device.duties == (0.0, 0.0)
            assert status(paced.bench)["state"] == State.TRIPPED

    def test_a_trip_is_in_the_next_report(self):
        with Paced("board.watchdog_ms=2") as paced:
            paced.tick()
            paced.tick(0.5, 0.0)
            paced.pass_periods(5)
            assert paced.bench.device.duties == (0.0, 0.0)
            assert paced.board.report().board_flags is BoardFlags.STALE
            assert "as no command had come for 2 ms" in str(paced.board.last_error)

    def test_a_lost_report_is_stale_and_the_next_one_is_good(self):
        with Paced() as paced:
            paced.tick()
            good = paced.tick(0.5, 0.0)
            paced.pass_periods(1.0)
            paced.bench.front_end.bulk_in(60)
            stale = paced.board.report()
            paced.board.answer(Command(0.5, 0.0))
            assert stale.board_flags is BoardFlags.STALE
            assert (stale.wheel_count, stale.road_count) == (good.wheel_count, good.road_count)
            sample = paced.tick(0.5, 0.0)
            assert sample.board_flags is BoardFlags.NONE
            assert [round(one.dt_s * 1e9) for one in (stale, sample)] == [paced.period_ns] * 2

    def test_a_damaged_report_is_stale(self):
        with Paced() as paced:
            paced.tick()
            paced.bench.link.change_next_answer = lambda answer: answer[:-1] + bytes([answer[-1] ^ 1])
            assert paced.tick().board_flags is BoardFlags.STALE
            assert paced.tick().board_flags is BoardFlags.NONE

    def test_another_masters_widths_are_noticed(self):
        with Paced() as paced:
            paced.tick()
            paced.tick(0.5, 0.0)
            tampered = sealed(COMMAND.encode({"width0": 3}, sequence=1))
            paced.bench.front_end.bulk_out(tampered)
            assert paced.tick(0.5, 0.0).board_flags is BoardFlags.STALE
            assert "another program" in str(paced.board.last_error)

    def test_a_clock_that_drifts_is_not_taken_for_lateness(self):
        with Paced() as paced:
            for _ in range(4000):
                paced.tick(0.5, 0.0, periods=1.0001)  # the board's crystal is 100 ppm slower
            assert paced.board.late_ns < 20_000
            assert paced.board.link_errors == 0

    def test_a_cable_that_is_pulled_is_stale_at_once(self):
        paced = Paced().__enter__()
        paced.tick()
        paced.bench.unplug()
        paced.board.answer(Command.SAFE)
        assert paced.board.report().board_flags is BoardFlags.STALE
        assert isinstance(paced.board.last_error, LinkError)
        with pytest.raises(UnsafeError, match="emergency switch"):
            paced.__exit__(None, None, None)

    def test_disarm_ends_it(self):
        bench = None
        with Paced() as paced:
            bench = paced.bench
            paced.tick()
            paced.tick(0.5, 0.5)
            paced.pass_periods(1)
            assert bench.device.duties != (0.0, 0.0)
            paced.board.make_safe()
            assert bench.device.duties == (0.0, 0.0)
            assert bench.device.due_ns < 0
            assert paced.board.report().board_flags is BoardFlags.STALE
        assert [kind for kind in kinds(bench) if kind in {"DISARM", "CLEAR"}].count("DISARM") == 4
        assert DISARM.encode(sequence=bench.link.written[-2][3]) == bench.link.written[-2]
        assert CLEAR.kind not in {message[1] for message in bench.link.written}

    def test_a_duty_out_of_range_is_refused(self):
        with Paced() as paced:
            paced.tick()
            with pytest.raises(BoardError, match="duties must be in"):
                paced.board.answer(Command(1.1, 0.0))


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        (["profile=sim_usb2"], "loop.pace.*RT-DAC/USB2 has no tick"),
        (
            ["profile=sim_open", "loop.rate_hz=1999"],
            r"loop.rate_hz: 1999: the tick of open board has the rates 100, 125",
        ),
        (["profile=sim_open", "loop.rate_hz=5000"], "loop.rate_hz: 5000"),
    ],
)
def test_a_pace_that_the_board_does_not_have_is_refused_with_those_it_has(settings, problem):
    with pytest.raises(ConfigError, match=f"(?s){problem}"):
        check_pace(load_config(settings=[*settings, 'loop.pace="board"']))


@pytest.mark.parametrize(
    ("setting", "problem"),
    [
        ("board.brake_pwm=2", "board.brake_pwm: 2: the open board has channels 0..1"),
        ("board.wheel_encoder=2", "board.wheel_encoder: 2: the open board has channels 0..1 in its reports"),
        ("board.timer=0", "board.timer: 0: the open board has its own; leave it out"),
        ("board.constants={w3=1}", "board.constants.*no such settings"),
    ],
)
def test_a_wiring_that_the_board_does_not_have_is_refused(setting, problem):
    with pytest.raises(ConfigError, match=problem):
        OpenBench(setting)
