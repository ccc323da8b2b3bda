import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.realtime import TickRing
from inteco_abs.sessions import TICK, pack_tick

SIZE = 5


def pack(buffer, offset, number):
    struct.pack_into("<IB", buffer, offset, number, number % 251)


def record(number):
    return struct.pack("<IB", number, number % 251)


def ring_of(capacity):
    return TickRing(pack, SIZE, capacity)


def test_records_come_out_in_the_order_they_went_in():
    ring = ring_of(10)
    for number in range(7):
        ring.append(number)
    assert ring.take() == b"".join(map(record, range(7)))


def test_nothing_is_taken_from_an_empty_ring():
    ring = ring_of(3)
    assert ring.take() == b""
    ring.append(1)
    ring.take()
    assert ring.take() == b""


def test_a_record_is_taken_once():
    ring = ring_of(10)
    ring.append(1)
    ring.append(2)
    assert ring.take() == record(1) + record(2)
    ring.append(3)
    assert ring.take() == record(3)


@pytest.mark.parametrize("first", range(1, 5))
def test_records_come_out_in_order_across_the_end_of_the_memory(first):
    ring = ring_of(4)
    for number in range(first):
        ring.append(number)
    ring.take()
    for number in range(10, 14):
        ring.append(number)
    assert ring.take() == b"".join(map(record, range(10, 14)))


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


def test_a_record_that_cannot_be_packed_is_no_record():
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
    for tick in run.ticks:
        ring.append(tick)
        (row,) = TICK.array(ring.take())
        assert (row["tick"], row["time_ns"], row["drive"], row["brake"]) == (tick.tick, tick.time_ns, 0.25, 0.5)
