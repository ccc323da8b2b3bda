"""Whole stops at 2 kHz with the limits of a real board, while answers are lost or late by 3 ms; in virtual time."""

import random
from collections import deque

import pytest

from inteco_abs.boards import InProcessLink, Link, board_behind
from inteco_abs.config import load_config
from inteco_abs.control import build_pipeline
from inteco_abs.errors import NoAnswerError
from inteco_abs.format import TICK, pack_tick
from inteco_abs.mock_board import Device, front_end_of
from inteco_abs.realtime import Loop, StopFlag, TickRing, VirtualClock
from inteco_abs.signals import BoardFlags, Reason

REAL = load_config(profile="usb2_generic_0103").guard
SETTINGS = (
    f"guard.missed_in_a_row={REAL.missed_in_a_row}",
    f"guard.bucket_limit={REAL.bucket_limit}",
    "experiment.start_speed_rad_s=100",
)
ANSWER_NS = 150_000
AT_ONCE_NS = 250_000
LATE_NS = 3_000_000


class BusyBus(Link):
    """A bus on which answers take their time, `draw()` of them "lost" or "late"; they never overtake each other."""

    def __init__(self, device, clock, draw):
        self._board = InProcessLink(front_end_of(device))
        self._clock = clock
        self._draw = draw
        self._coming = deque()
        self._free_ns = 0

    def write(self, data):
        self._board.write(data)
        if len(data) > 4:
            return
        answer, fate = self._board.read(504), self._draw()
        if fate == "lost":
            return
        self._free_ns = max(self._free_ns, self._clock.now_ns() + ANSWER_NS + (LATE_NS if fate == "late" else 0))
        self._coming.append((self._free_ns, answer))

    def read(self, _length):
        return self._read(round(self.timeout_s * 1e9))

    def close(self):
        self._board.close()

    def _read_waiting(self, _length):
        return self._read(AT_ONCE_NS)

    def _read(self, timeout_ns):
        now_ns = self._clock.now_ns()
        if not self._coming or self._coming[0][0] > now_ns + timeout_ns:
            self._clock.pass_ns(timeout_ns)
            raise NoAnswerError("the board did not answer in time")
        at_ns, answer = self._coming.popleft()
        self._clock.pass_ns(max(0, at_ns - now_ns))
        return answer


class Ride:
    """A stop over such a bus, and its result."""

    def __init__(self, draw, *settings):
        config = load_config(settings=[*SETTINGS, *settings])
        clock = VirtualClock(config.period_ns)
        device = Device(config, clock.now_ns)
        self.fates = []
        self.began = False

        def fate():
            self.fates.append(draw(self, clock.now_ns()) if self.began else "")
            return self.fates[-1]

        self.board = board_behind(BusyBus(device, clock, fate), config, clock.now_ns)
        pipeline = build_pipeline(config)
        ring = TickRing(pack_tick, TICK.size, 100_000)
        loop = Loop(self.board, pipeline, clock, ring, StopFlag())
        with self.board:
            self.began = True
            while not loop.run(1000):
                pass
            self.began = False  # SAFE is not what is tried here
        self.reason = pipeline.reason
        self.ticks = TICK.array(ring.reader().take())
        self.duties = device.duties


def at_random(seed, **one_in):
    drawn = random.Random(seed)
    return lambda _ride, _now_ns: next((fate for fate, most in one_in.items() if drawn.random() < 1.0 / most), "")


NUMBERED, DATED = "board.numbering_pwm=7", "board.timer=0"
NOT_NUMBERED = "board.numbering_pwm=-1"


@pytest.mark.parametrize("frames", [(NUMBERED,), (NOT_NUMBERED, DATED)], ids=" ".join)
@pytest.mark.parametrize(
    "one_in",
    [{"lost": 500, "late": 500}, *(pytest.param({one: 500}, marks=pytest.mark.long) for one in ("lost", "late"))],
    ids=" and ".join,
)
def test_stop_at_2_khz_survives_and_counts_1_answer_in_500_lost_or_late(frames, one_in):
    ride = Ride(at_random(1, **one_in), *frames)
    assert ride.reason is Reason.NONE
    assert ride.duties == (0.0, 0.0)
    stale = ride.ticks["board_flags"] & BoardFlags.STALE != 0
    failed = sum(bool(fate) for fate in ride.fates)
    assert failed > 10
    assert failed <= int(stale.sum()) == ride.board.link_errors
    assert ride.ticks["tick"].tolist() == list(range(len(ride.ticks)))


@pytest.mark.parametrize("fate", ["lost", "late"])
def test_one_alone_costs_few_ticks_and_the_next_ones_are_good(fate):
    ride = Ride(lambda ride, _now_ns: fate if len(ride.fates) == 1000 else "", NUMBERED)
    stale = ride.ticks["board_flags"] & BoardFlags.STALE != 0
    assert int(stale.sum()) == {"lost": 1, "late": 3}[fate]
    dt_s = ride.ticks["dt_s"]
    assert dt_s.max() < {"lost": 0.0015, "late": 0.0035}[fate]


def test_what_does_not_recover_is_ended_by_the_guard():
    ride = Ride(lambda ride, _now_ns: "lost" if len(ride.fates) > 1000 else "", NUMBERED)
    assert ride.reason is Reason.MISSED_EXCHANGES
    stale = ride.ticks[ride.ticks["board_flags"] & BoardFlags.STALE != 0]
    assert len(stale) * 0.001 < 0.015


def test_an_answer_in_three_that_is_lost_is_more_than_the_bucket_holds():
    ride = Ride(lambda ride, _now_ns: "lost" if len(ride.fates) > 1000 and len(ride.fates) % 3 == 0 else "", NUMBERED)
    assert ride.reason is Reason.MISSED_EXCHANGES
