import pytest

from inteco_abs.realtime.disk_watch import DiskWatch
from inteco_abs.realtime.memory import Field, Mailbox
from inteco_abs.signals import Reason

CAPACITY, RATE_HZ = 500, 100.0


class Said:
    """A screen that remembers."""

    def __init__(self):
        self.texts = []

    def show(self, snapshot):
        """Nothing."""

    def warn(self, text):
        self.texts.append(text)


class Watched:
    def __init__(self, memory, job):
        self.memory, self.words = memory, memory.words
        self.screen = Said()
        self._watch = DiskWatch(memory, job)
        self._ring = memory.tick_ring(lambda _buffer, _at, _record: None)

    def ticks(self, count):
        for _ in range(count):
            self._ring.append(None)
        return self.look()

    def look(self):
        self._watch.look(self.screen)
        return self

    def refuse(self, *texts):
        self.memory.post(Mailbox.TROUBLES, {"texts": texts, "file": "stop.mcap"})
        self.words[Field.TROUBLES] = len(texts)


@pytest.fixture
def watched(new_memory, job_of):
    memory = new_memory(CAPACITY, CAPACITY)
    return Watched(memory, job_of(memory, f"loop.rate_hz={RATE_HZ}"))


def test_each_trouble_is_said_once(watched):
    watched.look().refuse("first")
    watched.look().look()
    watched.refuse("first", "second", "third")
    watched.look().look()
    assert watched.screen.texts == ["first", "second", "third"]


def test_a_recorder_that_is_far_behind_is_said_once(watched):
    watched.ticks(200)
    assert watched.screen.texts == []
    watched.ticks(1).ticks(1)
    (text,) = watched.screen.texts
    assert "stop.mcap is slow" in text
    assert not watched.words[Field.STOP]


def test_a_recorder_that_has_written_is_not_behind(watched):
    watched.words[Field.SYNCED] = 150
    watched.ticks(300)
    assert watched.screen.texts == []


def test_a_disk_that_refuses_is_not_slow_too(watched):
    watched.refuse("it is full")
    watched.ticks(300)
    assert watched.screen.texts == ["it is full"]


def test_run_without_room_for_its_ticks_ends_while_it_can_still_stop(watched):
    watched.ticks(CAPACITY - int(RATE_HZ))
    assert not watched.words[Field.STOP]
    watched.ticks(1)
    assert watched.words[Field.STOP] == Reason.RECORDER_LOST


def test_a_run_whose_rig_states_have_no_room_left_is_ended_too(watched):
    states = watched.memory.truth_ring(lambda _buffer, _at, _record: None)
    for _ in range(CAPACITY - int(RATE_HZ) + 1):
        states.append(None)
    watched.look()
    assert watched.words[Field.STOP] == Reason.RECORDER_LOST


def test_ticks_that_were_taken_make_room(watched):
    watched.ticks(300)
    watched.memory.tick_reader().take()
    watched.ticks(300)
    assert not watched.words[Field.STOP]


def test_why_a_run_ends_already_stays(watched):
    watched.words[Field.STOP] = Reason.OPERATOR_STOP
    watched.ticks(CAPACITY)
    assert watched.words[Field.STOP] == Reason.OPERATOR_STOP
