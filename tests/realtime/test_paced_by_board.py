"""The board's tick paces the loop: the same decisions from the same samples."""

import pytest

from firmware_protocol.open_board import COMMAND, REPORT
from inteco_abs.boards import InProcessLink, board_behind
from inteco_abs.config import load_config
from inteco_abs.control import build_pipeline
from inteco_abs.errors import BoardError, NoAnswerError
from inteco_abs.mock_board import Device, front_end_of
from inteco_abs.realtime import Loop, StopFlag, VirtualClock
from inteco_abs.realtime.clock import AwaitedClock
from inteco_abs.realtime.loop import detail_of
from inteco_abs.signals import Reason

QUICK = ("loop.rate_hz=500", "experiment.start_speed_rad_s=15", "experiment.idle_s=0.01", "experiment.hold_s=0.02")
OF_THE_CLOCK = ("late_us", "io_us", "busy_us", "skipped")


class Rows(list):
    """A ring that keeps ticks as they are."""


def stop(*settings, profile="sim_open", length=None, faults=lambda _device, _link: None):
    """The ticks of a short stop in virtual time, in slices of `length`."""
    config = load_config(settings=[*QUICK, *settings], profile=profile)
    clock = VirtualClock(config.period_ns)
    device = Device(config, clock.now_ns)
    link = InProcessLink(front_end_of(device))
    faults(device, link)
    board, pipeline, rows = board_behind(link, config, clock.now_ns), build_pipeline(config), Rows()
    with board:
        loop = Loop(board, pipeline, clock, rows, StopFlag(), paced_by_board=config.loop.pace == "board")
        while not loop.run(length):
            pass
    assert device.duties == (0.0, 0.0)
    return (
        [tick._replace(**dict.fromkeys(OF_THE_CLOCK, 0)) for tick in rows],
        pipeline.reason,
        detail_of(pipeline, board),
    )


@pytest.fixture(scope="module")
def by_computer():
    return stop()


@pytest.mark.parametrize("length", [None, 7])
def test_the_decisions_are_those_of_a_loop_that_the_computer_paces(by_computer, length):
    assert stop('loop.pace="board"', length=length) == by_computer
    assert len(by_computer[0]) > 300


def test_a_lost_report_gives_the_decisions_of_a_lost_answer():
    def lose(_device, link):
        read, reports = link.read, iter(range(1_000_000))

        def received(length):
            frame = read(length)
            if frame[1] == REPORT.kind and next(reports) == 200:
                raise NoAnswerError("it was lost")
            return frame

        link.read = received

    by_board, by_computer = (stop(f'loop.pace="{pace}"', faults=lose) for pace in ("board", "computer"))
    assert by_board == by_computer
    assert [tick.tick for tick in by_board[0] if tick.board_flags] == [199]


def test_a_trip_ends_the_run_with_its_reason():
    def deaf(device, link):
        write, count = link.write, iter(range(1_000_000))
        link.write = lambda data: (
            None if data[1] == COMMAND.kind and next(count) > 100 and device.duties != (0.0, 0.0) else write(data)
        )

    settings = ('loop.pace="board"', "board.watchdog_ms=10", "guard.missed_in_a_row=20", "guard.bucket_limit=500")
    _, reason, detail = stop(*settings, faults=deaf)
    assert reason is Reason.MISSED_EXCHANGES
    assert detail == "the board has switched its outputs off, as no command had come for 10 ms"


def test_a_board_without_a_tick_refuses_before_anything_moves():
    with pytest.raises(BoardError, match=r"no tick: set loop\.pace to computer"):
        stop('loop.pace="board"', profile="sim_usb2")


def test_its_clock_waits_for_nothing():
    beats = iter(AwaitedClock())
    first, second = next(beats), next(beats)
    assert first.deadline_ns <= second.deadline_ns <= AwaitedClock().now_ns()
    assert first.skipped == second.skipped == 0
