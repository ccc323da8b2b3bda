import itertools
import os
import re
import sys
from types import SimpleNamespace

import pytest

from inteco_abs.errors import BoardError, LinkError
from inteco_abs.host import latency
from inteco_abs.host.latency import (
    WakeUps,
    examine_wake_ups,
    judge_round_trips,
    judge_settings,
    judge_wake_ups,
    wake_ups,
)
from inteco_abs.realtime import Beat, VirtualClock
from inteco_abs.realtime import round_trips as round_trips_module
from inteco_abs.realtime.round_trips import Quantiles, quantiles, round_trips
from inteco_abs.realtime.tuning import Setting
from inteco_abs.signals import BoardFlags, Command

GRANTED = Setting("scheduler", "SCHED_FIFO 80")
NO_MEMORY = Setting("memory", "default", "Cannot allocate memory: raise memlock")
NO_SCHEDULER = Setting("scheduler", "default", "Operation not permitted: raise rtprio")


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        ([7.0], (7.0, 7.0, 7.0, 7.0)),
        ([2.0, 1.0], (1.0, 2.0, 2.0, 2.0)),
        (range(1, 1001), (500, 990, 999, 1000)),
        (range(1, 1002), (501, 991, 1000, 1001)),
        (range(10_000, 0, -1), (5000, 9900, 9990, 10_000)),
    ],
)
def test_quantiles_are_times_that_were_measured(times, expected):
    assert quantiles(times) == expected


def test_in_virtual_time_nothing_is_late():
    assert wake_ups(VirtualClock(500_000), 100) == ([0] * 100, 0)


class LateClock:
    """Beats late by these ns after these skipped periods; `asked` counts the calls."""

    def __init__(self, *beats):
        self.asked = 0
        self._beats = beats
        self._now_ns = 0

    def now_ns(self):
        return self._now_ns

    def __iter__(self):
        for late_ns, skipped in self._beats:
            self.asked += 1
            self._now_ns += 1_000_000_000
            yield Beat(self._now_ns - late_ns, skipped)


def test_every_beat_has_its_lateness_and_a_missed_period_counts_as_a_period():
    clock = LateClock((70, 0), (1_080_000, 0), (80_000, 2), (5, 0), (6, 0))
    assert wake_ups(clock, 6) == ([70, 1_080_000, 80_000, 5], 2)
    assert clock.asked == 4


def test_a_long_gap_ends_the_test_too():
    assert wake_ups(LateClock((0, 0), (9, 1000), (0, 0)), 100) == ([0, 9], 1000)


def test_the_test_reports_the_settings_granted_here_and_its_duration():
    settings, wakes = examine_wake_ups(0.2)
    assert (settings.name, wakes.name) == ("loop settings", "wake-ups")
    if settings.verdict == "green":
        assert re.findall(r"affinity|memory|scheduler|garbage", settings.found) == [
            "affinity", "memory", "scheduler", "garbage"
        ]  # fmt: skip
    else:
        assert settings.found.startswith("refused: ")
    missed, periods = map(int, re.search(r"(\d+) of (\d+) periods missed", wakes.found).groups())
    assert periods >= 400
    assert missed < periods


def test_the_test_leaves_this_process_as_it_was():
    before = os.sched_getscheduler(0), os.sched_getaffinity(0)
    examine_wake_ups(0.2)
    assert (os.sched_getscheduler(0), os.sched_getaffinity(0)) == before


@pytest.mark.parametrize(
    ("script", "found"),
    [
        ("exit 1", "exit code 1, no message"),
        ("echo first >&2; echo 'no such module' >&2; exit 3", "exit code 3, no such module"),
        ("kill -XCPU $$", "killed by SIGXCPU"),
        ("exec sleep 20", "timed out"),
    ],
)
def test_a_test_that_does_not_finish_is_red_and_says_how_it_ended(tmp_path, monkeypatch, script, found):
    python = tmp_path / "python"
    python.write_text(f"#!/bin/sh\n{script}\n")
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    monkeypatch.setattr(latency, "_START_S", 1.0)
    (finding,) = examine_wake_ups(0.2)
    assert (finding.name, finding.verdict) == ("wake-ups", "red")
    assert found in finding.found


def test_a_python_that_cannot_be_started_is_red(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    (finding,) = examine_wake_ups(0.2)
    assert finding.verdict == "red"
    assert "/nowhere/python" in finding.found


@pytest.mark.parametrize(
    ("settings", "verdict", "found", "fixes"),
    [
        ([GRANTED, Setting("memory", "locked")], "green", "scheduler SCHED_FIFO 80, memory locked", 0),
        ([GRANTED, NO_MEMORY], "amber", "refused: memory", 1),
        ([NO_SCHEDULER, NO_MEMORY], "red", "refused: scheduler, memory", 2),
    ],
)
def test_what_the_loop_was_refused_is_reported_with_its_fix(settings, verdict, found, fixes):
    judgement = judge_settings(settings)
    assert judgement.verdict == verdict
    assert found in judgement.found
    assert len(judgement.fix.splitlines()) == fixes
    if fixes:
        assert "memory: Cannot allocate memory: raise memlock" in judgement.fix


@pytest.mark.parametrize(
    ("p999", "missed", "verdict"),
    [
        (149.9, 0, "green"),
        (149.9, 4, "green"),
        (149.9, 5, "amber"),
        (150.0, 0, "amber"),
        (9000.0, 100, "amber"),
        (149.9, 101, "red"),
        (9000.0, 101, "red"),
    ],
)
def test_wake_ups_are_judged_by_their_tail_and_by_what_was_missed(p999, missed, verdict):
    judgement = judge_wake_ups(WakeUps([], Quantiles(1.0, 20.0, p999, 9999.0), 10_000 - missed, missed))
    assert judgement.verdict == verdict
    assert f"late p50 1.0, p99 20.0, p99.9 {p999:.1f}, max 9999.0 us; {missed} of 10000" in judgement.found
    assert "one test of 5 s on this computer now" in judgement.found
    assert bool(judgement.fix) == (verdict != "green")


class TimedBoard:
    """Answers after the given times, us; a negative one is an exchange that failed."""

    last_error = LinkError("the cable is unplugged")

    def __init__(self, fake_time, answers_us):
        self.commands = []
        self._fake_time = fake_time
        self._answers_us = iter(answers_us)

    def begin(self):
        pass

    def exchange(self, command):
        self.commands.append(command)
        answer_us = next(self._answers_us)
        self._fake_time.spend(abs(answer_us) * 1000)
        return SimpleNamespace(board_flags=BoardFlags.STALE if answer_us < 0 else BoardFlags.SLOW)


def test_a_round_trip_is_one_exchange_of_safe(fake_time, monkeypatch):
    monkeypatch.setattr(round_trips_module, "time", fake_time)
    board = TimedBoard(fake_time, [200, 300, -900, 250])
    assert round_trips(board, 4) == pytest.approx([200.0, 300.0, 250.0], abs=0.2)
    assert board.commands == [Command.SAFE] * 4


def test_a_board_that_no_longer_answers_is_not_asked_for_ever(fake_time, monkeypatch):
    monkeypatch.setattr(round_trips_module, "time", fake_time)
    board = TimedBoard(fake_time, itertools.chain([-9, -9, -9, 1], itertools.repeat(-9)))
    with pytest.raises(BoardError, match="does not answer: the cable is unplugged"):
        round_trips(board, 1000)
    assert len(board.commands) == 24


def test_round_trips_of_the_mock_board_leave_it_safe(new_stack):
    stack = new_stack()
    with stack.board as board:
        times_us = round_trips(board, 50)
        assert stack.device.duties == (0.0, 0.0)
        assert board.link_errors == 0
    assert len(times_us) == 50
    assert all(time_us > 0.0 for time_us in times_us)


@pytest.mark.parametrize(
    ("times_us", "count", "verdict"),
    [
        ([399.0] * 1000, 1000, "green"),
        ([399.0] * 999 + [9999.0], 1000, "green"),
        ([400.0] * 1000, 1000, "amber"),
        ([399.0] * 999, 1000, "amber"),
        ([499.0] * 1000, 1000, "amber"),
        ([500.0] * 1000, 1000, "red"),
        ([399.0] * 990 + [500.0] * 10, 1000, "amber"),
        ([399.0] * 989 + [500.0] * 11, 1000, "red"),
        ([399.0] * 990, 1000, "amber"),
        ([399.0] * 989, 1000, "red"),
        ([], 1000, "red"),
    ],
)
def test_round_trips_are_judged_against_the_period(times_us, count, verdict):
    judgement = judge_round_trips(times_us, count, 500.0)
    assert judgement.verdict == verdict
    assert bool(judgement.fix) == (verdict != "green")
    if times_us:
        assert f"{count - len(times_us)} of {count} exchanges failed; the period is 500 us" in judgement.found
