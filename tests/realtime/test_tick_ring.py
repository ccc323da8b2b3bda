import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.realtime import RingReader, TickRing, ring_bytes
from inteco_abs.sessions import TICK, pack_tick

SIZE = 5


def pack(buffer, offset, number):
    struct.pack_into("<IB", buffer, offset, number, number % 251)


def record(number):
    return struct.pack("<IB", number, number % 251)


class Ring:
    """Both ends of a ring in private memory."""

    def __init__(self, capacity):
        self._ring = TickRing(pack, SIZE, capacity)
        self._reader = self._ring.reader()
        self.append = self._ring.append
        self.take = self._reader.take

    @property
    def written(self):
        assert self._ring.written == self._reader.written
        return self._ring.written


def ring_of(capacity):
    return Ring(capacity)


def test_a_full_ring_refuses_and_keeps_what_it_has():
    ring = ring_of(3)
    for number in range(3):
        ring.append(number)
    for _ in range(2):
        with pytest.raises(BufferError, match="3 records"):
            ring.append(99)
    assert ring.written == 3
    assert ring.take() == b"".join(map(record, range(3)))
    ring.append(4)
    assert ring.take() == record(4)


def test_what_was_taken_does_not_change_later():
    ring = ring_of(2)
    ring.append(1)
    taken = ring.take()
    for number in range(2, 8):
        ring.append(number)
        ring.take()
    assert taken == record(1)


def test_a_record_that_cannot_be_packed_does_not_count():
    ring = ring_of(3)
    ring.append(1)
    with pytest.raises(struct.error):
        ring.append(-1)
    assert ring.written == 1
    ring.append(2)
    assert ring.take() == record(1) + record(2)


@given(
    capacity=st.integers(1, 7),
    steps=st.lists(st.sampled_from(["append"] * 4 + ["take"]), max_size=80),
)
def test_it_behaves_as_a_bounded_list(capacity, steps):
    ring, waiting, written = ring_of(capacity), [], 0
    for number, step in enumerate(steps):
        if step == "take":
            assert ring.take() == b"".join(map(record, waiting))
            waiting.clear()
        elif len(waiting) == capacity:
            with pytest.raises(BufferError):
                ring.append(number)
        else:
            ring.append(number)
            waiting.append(number)
            written += 1
        assert ring.written == written
    assert ring.take() == b"".join(map(record, waiting))


def test_ticks_come_back_as_the_session_stores_them(scripted_loop):
    from inteco_abs.signals import Command

    run = scripted_loop([Command(0.25, 0.5)] * 5)
    run.loop.run()
    ring = TickRing(pack_tick, TICK.size, 3)
    reader = ring.reader()
    for tick in run.ticks:
        ring.append(tick)
        (row,) = TICK.array(reader.take())
        assert (row["tick"], row["time_ns"], row["drive"], row["brake"]) == (tick.tick, tick.time_ns, 0.25, 0.5)


def words_of(ring):
    return ring.memory.cast("Q")


@pytest.mark.parametrize("torn", ["front", "back"])
def test_a_torn_record_is_left_out(torn):
    ring = TickRing(pack, SIZE, 5)
    for number in range(3):
        ring.append(number)
    words = words_of(ring)
    places = [at for at in range(8, len(words)) if words[at] == 2]  # the second record's number, at both its ends
    assert len(places) == 2
    words[places[0 if torn == "front" else 1]] = 7
    reader = ring.reader()
    assert reader.take() == record(0) + record(2)


def test_a_reader_that_was_overtaken_gets_what_the_ring_still_holds():
    memory = bytearray(ring_bytes(SIZE, 4))
    ring, reader = TickRing(pack, SIZE, 4, memory), RingReader(memory, SIZE, 4)
    for number in range(4):
        ring.append(number)
    words_of(ring)[1] = 4  # as if another reader had taken them, so that the writer continues
    for number in range(4, 6):
        ring.append(number)
    words_of(ring)[1] = 0
    assert reader.take() == b"".join(map(record, (2, 3, 4, 5)))


def test_the_newest_record_is_seen_without_taking_it():
    ring = TickRing(pack, SIZE, 3)
    reader, screen = ring.reader(), ring.reader()
    assert screen.newest() is None
    ring.append(1)
    ring.append(2)
    assert screen.newest() == record(2)
    assert reader.take() == record(1) + record(2)
    assert screen.newest() == record(2)


def test_a_record_that_is_packed_but_not_published_does_not_count():
    ring = TickRing(pack, SIZE, 3)
    ring.append(1)
    words_of(ring)[0] = 0  # as after a death between packing and publishing
    assert ring.reader().take() == b""


@pytest.mark.parametrize("written", [0, 1, 3, 4, 7])
def test_releasing_the_oldest_held_record_gives_all_that_the_ring_still_holds(written):
    ring = TickRing(pack, SIZE, 3)
    reader = ring.reader()
    for number in range(written):
        ring.append(number)
        reader.take()
    again = ring.reader()
    assert again.held_from() == max(0, written - 3)
    again.release(again.held_from())
    assert again.take() == b"".join(map(record, range(max(0, written - 3), written)))


def test_at_most_so_many_records_are_taken_at_once():
    ring = TickRing(pack, SIZE, 5)
    for number in range(5):
        ring.append(number)
    reader = ring.reader()
    assert reader.take(2) == record(0) + record(1)
    assert reader.take(2) == record(2) + record(3)
    assert reader.taken == 4


def test_a_sample_skips_records_between_and_continues_where_it_ended():
    ring = TickRing(pack, SIZE, 100)
    for number in range(25):
        ring.append(number)
    reader = ring.reader()
    records, after = reader.sample(0, 10)
    assert (records, after) == (b"".join(map(record, (0, 10, 20))), 30)
    assert reader.sample(after, 10) == (b"", 30)
    for number in range(25, 31):
        ring.append(number)
    assert reader.sample(after, 10) == (record(30), 40)
    assert reader.taken == 0


@pytest.mark.parametrize("first", [0, 20])
def test_a_sample_begins_with_what_the_ring_still_holds(first):
    ring = TickRing(pack, SIZE, 10)
    reader = ring.reader()
    for number in range(35):
        ring.append(number)
        reader.release(number + 1)
    records, after = reader.sample(first, 4)
    assert (records, after) == (b"".join(map(record, (28, 32))), 36)


def test_the_room_is_what_can_be_appended_before_anything_is_taken():
    ring = TickRing(pack, SIZE, 4)
    reader = ring.reader()
    for left in (4, 3, 2, 1):
        assert reader.room == left
        ring.append(left)
    assert reader.room == 0
    reader.take(3)
    assert reader.room == 3


@pytest.mark.parametrize(("record_bytes", "words"), [(1, 1), (8, 1), (9, 2), (5, 1)])
def test_counters_take_64_bytes_and_each_record_whole_words_and_two_numbers(record_bytes, words):
    assert ring_bytes(record_bytes, 3) == 64 + 3 * 8 * (words + 2)


@pytest.mark.parametrize(("written", "taken", "spare", "first"), [
    (0, 0, 0.0, 0), (8, 8, 0.0, 0), (9, 9, 0.0, 1), (9, 1, 0.0, 1), (9, 9, 0.25, 3), (9, 2, 0.25, 2), (4, 4, 0.25, 0),
])  # fmt: skip
def test_what_the_ring_still_holds_begins_earlier_than_what_was_not_taken(written, taken, spare, first):
    ring = TickRing(pack, SIZE, 8)
    reader = ring.reader()
    for number in range(written):
        ring.append(number)
        if number < taken:
            reader.take()
    assert reader.held_from(spare) == first
    assert reader.look(first)[0] == b"".join(map(record, range(first, written)))


def test_a_ring_may_continue_where_another_has_ended():
    ring = TickRing(pack, SIZE, 2, first=7)
    for number in (7, 8):
        ring.append(number)
    reader = ring.reader()
    assert (reader.written, reader.held_from()) == (9, 7)
    assert reader.take() == record(7) + record(8)


@given(st.lists(st.tuples(st.integers(0, 90), st.booleans()), max_size=8), st.integers(100, 130))
def test_records_appended_and_taken_together_are_those_of_one_by_one(pieces, capacity):
    """Pieces of 64 records and more are copied by numpy, across the ring's end, too."""
    many, single, number = TickRing(pack, SIZE, capacity), Ring(capacity), 0
    for count, taken in pieces:
        if many.written + count - many.reader().taken <= capacity:
            many.extend(b"".join(map(record, range(number, number + count))))
            for each in range(number, number + count):
                single.append(each)
            number += count
        if taken:
            assert many.reader().take() == single.take()
    assert bytes(many.memory) == bytes(single._ring.memory)


def test_more_records_than_there_is_room_for_are_refused_together():
    ring = TickRing(pack, SIZE, 100)
    ring.extend(b"".join(map(record, range(60))))
    with pytest.raises(BufferError, match="60 records wait"):
        ring.extend(b"".join(map(record, range(41))))
    assert ring.written == 60


def test_a_record_that_is_overwritten_meanwhile_is_left_out_of_many():
    ring = TickRing(pack, SIZE, 100)
    ring.extend(b"".join(map(record, range(80))))
    words = ring.memory.cast("Q")
    words[8 + 3 * 30] += 1  # the number before record 30
    assert ring.reader().take() == b"".join(record(number) for number in range(80) if number != 30)
