"""Gains that change while the loop runs, by requests through shared memory."""

import threading
from contextlib import contextmanager
from itertools import pairwise

import pytest

from inteco_abs.analysis import replay_session
from inteco_abs.config import load_config
from inteco_abs.control import GainChange, build_pipeline, gains_to_change
from inteco_abs.errors import AbsError
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.realtime import ChangeTable, Field, GainChanges, RunMemory, Tuner, gain_changes
from inteco_abs.sessions import TICK, changes_among, read_session

DECLARED = ("Mk", "Mq", "lag_s")


class Bench:
    """A loop on the mock board, whose gains a `tuner` changes through a memory of this process."""

    def __init__(self, stack):
        self.stack = stack
        self.memory = RunMemory.private(TICK.size, 1)
        self.table = ChangeTable(self.memory, DECLARED)
        self.pipeline = build_pipeline(stack.config)
        self.gains = gains_to_change(self.pipeline, stack.config)
        changes = GainChanges(stack.config, self.pipeline, self.gains, self.table.record, self.table)
        self.loop = stack.loop(self.pipeline, changes)
        self.tuner = Tuner()

    def ask(self, gain, value):
        """Ask past all checks, let the loop run a tick, and return its answer."""
        number = self.memory.ask_change(gain, value)
        self.loop.run(1)
        assert self.memory.words[Field.CHANGES_ANSWERED] == number
        return self.memory.words[Field.ANSWER_TICK]

    def connected(self):
        return self.tuner.connected(self.memory, self.gains, DECLARED)

    @contextmanager
    def turning(self):
        """The loop runs, in a thread."""
        over = threading.Event()

        def turn():
            while not over.wait(0.0002):
                self.loop.run(1)
                self.stack.rows()  # so that the ring has room

        thread = threading.Thread(target=turn)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()


@pytest.fixture
def bench(new_stack):
    stack = new_stack()
    with stack.board:
        made = Bench(stack)
        made.loop.run(1)
        yield made


def test_a_request_is_answered_with_the_tick_that_has_it_first(bench):
    assert bench.ask(1, 5.0) == 1
    assert bench.ask(0, 0.3) == 2
    bench.loop.run(3)
    assert bench.ask(1, 6.0) == 6
    assert bench.table.changes() == [
        GainChange(1, "Mk", 5.0), GainChange(2, "reference_slip", 0.3), GainChange(6, "Mk", 6.0)
    ]  # fmt: skip
    assert bench.table.changes(2) == [GainChange(6, "Mk", 6.0)]
    assert (bench.pipeline.machine.controller.k.Mk, bench.pipeline.reference_slip) == (6.0, 0.3)


@pytest.mark.parametrize(
    ("gain", "value"), [(1, 1001.0), (1, -0.1), (1, float("nan")), (0, 1.0), (0, 0.0), (4, 1.0), (-1, 1.0), (99, 1.0)]
)
def test_the_loop_refuses_by_itself_what_is_out_of_range_and_changes_nothing(bench, gain, value):
    before = bench.pipeline.machine.controller.k
    assert bench.ask(gain, value) == -1
    assert bench.pipeline.machine.controller.k is before
    assert bench.pipeline.reference_slip == 0.2
    assert bench.table.changes() == []


def test_after_the_last_change_for_which_there_is_room_all_are_refused(bench, monkeypatch):
    monkeypatch.setattr(gain_changes, "MOST_CHANGES", 3)
    assert [bench.ask(1, value) for value in (1.0, 2.0, 3.0, 4.0, 5.0)] == [1, 2, 3, -1, -1]
    assert len(bench.table.changes()) == 3


def test_a_tuner_changes_what_the_run_can_change_and_knows_the_values_in_force(bench):
    with bench.connected():
        with bench.turning():
            first, second = bench.tuner.change("Mk", 5), bench.tuner.change("reference_slip", 0.3)
        assert 0 < first < second
        assert [gain.name for gain in bench.tuner.gains] == ["reference_slip", *DECLARED]
        assert bench.tuner.values == {"reference_slip": 0.3, "Mk": 5.0, "Mq": 1.0, "lag_s": 0.0}
    assert bench.tuner.values["Mk"] == 5.0


def test_many_threads_change_gains_one_after_the_other(bench):
    ticks = []

    def change(name):
        ticks.extend(bench.tuner.change(name, 0.01 * (number + 1)) for number in range(5))

    with bench.connected(), bench.turning():
        threads = [threading.Thread(target=change, args=(name,)) for name in ("reference_slip", *DECLARED)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    found = [each.tick for each in bench.table.changes()]
    assert sorted(ticks) == found
    assert len(found) == 20
    assert all(one < other for one, other in pairwise(found))


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("Mk", 1001, "must be in 0..1000 1/s"),
        ("Mk", float("nan"), "must be in 0..1000 1/s"),
        ("Mk", "fast", "must be a number"),
        ("Mkk", 5, "did you mean Mk"),
        ("guard.brake_limit", 1.0, "the guard's limits cannot change while a run lasts"),
    ],
)
def test_what_cannot_be_is_refused_where_it_is_asked_and_never_reaches_the_loop(bench, name, value, problem):
    with bench.connected(), pytest.raises(AbsError) as error:
        bench.tuner.change(name, value)
    assert problem in str(error.value)
    assert bench.memory.words[Field.CHANGES_ASKED] == 0


def test_without_a_run_and_with_a_loop_that_has_ended_the_tuner_says_so(bench, monkeypatch):
    with pytest.raises(AbsError, match="no run is under way"):
        bench.tuner.change("Mk", 5.0)
    monkeypatch.setattr(gain_changes, "_ANSWER_S", 0.01)
    with bench.connected(), pytest.raises(AbsError, match="the loop does not answer"):
        bench.tuner.change("Mk", 5.0)


def test_virtual_time_has_no_tuner(tmp_path):
    with pytest.raises(AbsError, match=r"plan it, with experiment\.changes"):
        run_stop(load_config(), Plan(tmp_path / "stop.mcap"), tuner=Tuner())


@pytest.mark.long
@pytest.mark.untraced
def test_a_run_in_real_time_records_each_change_with_its_tick_and_replays(tmp_path):
    settings = ["experiment.start_speed_rad_s=40.0", 'experiment.changes=["Mq=2@brake+20ms"]']
    config, tuner, answers, over = load_config(settings=settings), Tuner(), [], threading.Event()

    def person():
        while not answers and not over.wait(0.01):
            try:
                answers.append(tuner.change("Mk", 7.0))
            except AbsError:
                continue
        for number in range(500):
            try:
                answers.append(tuner.change("reference_slip", 0.1 + 0.01 * (number % 20)))
            except AbsError:
                return

    thread = threading.Thread(target=person)
    thread.start()
    try:
        result = run_stop(config, Plan(tmp_path / "stop.mcap", virtual=False), tuner=tuner)
    finally:
        over.set()
        thread.join()
    assert result.outcome == "completed"
    session = read_session(tmp_path / "stop.mcap")
    asked = [each.tick for each in changes_among(session.parameters) if each.name != "Mq"]
    assert asked == answers
    assert len(asked) > 10
    assert replay_session(session, build_pipeline(config)).differing == 0
