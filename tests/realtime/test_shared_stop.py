"""When the loop believes that its guardian is gone, at any rate of the loop."""

import time

import pytest

from inteco_abs.realtime.failure_rules import LOOPS_WINDOW_NS
from inteco_abs.realtime.memory import Field
from inteco_abs.realtime.processes import loop as rt
from inteco_abs.realtime.processes.loop import SharedStop
from inteco_abs.signals import Reason

START_NS = 10**12
PERIODS_NS = [100_000, 500_000, 20_000_000]


@pytest.fixture
def stop(memory):
    memory.words[Field.GUARDIAN_BEAT_NS] = START_NS
    return SharedStop(memory)


@pytest.mark.parametrize("period_ns", PERIODS_NS)
def test_a_guardian_without_a_heartbeat_is_noticed_at_every_rate(stop, period_ns):
    # a little more than a period from one tick to the next, as on any computer
    reasons = [stop.wanted(START_NS + number * (period_ns + 1000)) for number in range(350_000_000 // period_ns)]
    assert reasons[0] is Reason.NONE
    assert reasons[-1] is Reason.GUARDIAN_LOST
    assert reasons.index(Reason.GUARDIAN_LOST) * (period_ns + 1000) > LOOPS_WINDOW_NS


@pytest.mark.parametrize("period_ns", PERIODS_NS)
def test_after_a_pause_of_the_whole_computer_the_guardian_gets_its_window_again(stop, memory, period_ns):
    assert stop.wanted(START_NS) is Reason.NONE
    awake_ns = START_NS + 900_000_000
    assert stop.wanted(awake_ns) is Reason.NONE
    assert stop.wanted(awake_ns + period_ns) is Reason.NONE
    memory.words[Field.GUARDIAN_BEAT_NS] = awake_ns + 5_000_000
    assert stop.wanted(awake_ns + 5_000_000 + period_ns) is Reason.NONE


@pytest.mark.parametrize(
    ("word", "reason"), [(Field.STOP, Reason.OPERATOR_STOP), (Field.GUARDIAN_STOP, Reason.RECORDER_LOST)]
)
def test_what_the_others_want_is_passed_on(stop, memory, word, reason):
    memory.words[word] = reason
    assert stop.wanted(START_NS) is reason


def test_suspended_computer_ends_the_run_at_its_first_tick(memory):
    memory.words[Field.GUARDIAN_BEAT_NS] = START_NS
    slept = [3_600_000_000_000]  # before this run
    stop = SharedStop(memory, lambda: slept[0])
    assert stop.wanted(START_NS) is Reason.NONE
    slept[0] += 20_000_000  # clocks are not read at the same instant
    assert stop.wanted(START_NS + 500_000) is Reason.NONE
    slept[0] += 2_000_000_000
    assert stop.wanted(START_NS + 1_000_000) is Reason.MISSED_EXCHANGES
    assert stop.wanted(START_NS + 1_500_000) is Reason.MISSED_EXCHANGES


def test_a_pause_between_the_two_clocks_is_not_a_suspension(monkeypatch):
    before_ns = rt.asleep_ns()
    monotonic_ns = time.monotonic_ns
    monkeypatch.setattr(time, "monotonic_ns", lambda: monotonic_ns() + 200_000_000)
    assert rt.asleep_ns() < before_ns
