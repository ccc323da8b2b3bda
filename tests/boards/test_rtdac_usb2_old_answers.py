"""Answers that come late, twice or not at all: none may be taken for the answer to a later request."""

from contextlib import suppress

import pytest
from benches import LateByMany
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.boards import Link
from inteco_abs.errors import LinkError, UnsafeError
from inteco_abs.signals import BoardFlags


class OldAnswers(Link):
    """Between a board and its link: holds answers back, repeats or loses them."""

    def __init__(self, link):
        self._link = link
        self._arrived = []
        self.late = self.twice = self.lost = 0
        self._newest = b""

    def repeat(self, times):
        """Have the newest answer come so often before the next one."""
        self._arrived += [self._newest] * times

    def write(self, data):
        self._link.write(data)

    def read(self, length):
        if not self._arrived:
            self._newest = self._link.read(length)
            self._arrived.append(self._newest)
            if self.lost:
                self.lost -= 1
                self._arrived.pop()
            elif self.late:
                self.late -= 1
                raise LinkError("not yet")
            elif self.twice:
                self.twice -= 1
                self._arrived *= 2
        if not self._arrived:
            raise LinkError("no answer")
        return self._arrived.pop(0)

    def discard(self, length):
        """Nothing has arrived yet: what is late comes after this."""

    def close(self):
        self._link.close()


KNOWN_BY = {
    "a number": (),
    "the board's clock": ("board.numbering_pwm=-1", "board.timer=0"),
}


@pytest.fixture(params=KNOWN_BY.values(), ids=KNOWN_BY)
def old(new_usb2_bench, request):
    bench = new_usb2_bench(*request.param)
    link = bench.board._link = OldAnswers(bench.link)  # the one place where a link can be slipped in
    return bench, link


@pytest.mark.parametrize("fault", ["late", "twice", "lost"])
@pytest.mark.parametrize("times", [1, 3])
def test_the_sample_after_it_is_not_an_exchange_old(old, fault, times):
    bench, link = old
    with bench.board:
        start = bench.device.counts()
        for _ in range(50):
            bench.exchange(1.0)
        setattr(link, fault, times)
        for _ in range(20):
            sample = bench.exchange(1.0)
        road, wheel = bench.device.counts()
    assert getattr(link, fault) == 0
    assert sample.board_flags is BoardFlags.NONE
    assert (sample.road_count, sample.wheel_count) == (road - start[0], wheel - start[1])


@pytest.mark.parametrize(("times", "flags"), [(99, BoardFlags.NONE), (100, BoardFlags.STALE)])
def test_old_answers_are_dropped_until_there_are_a_hundred_of_them(old, times, flags):
    bench, link = old
    with bench.board:
        bench.exchange(1.0)
        link.repeat(times)
        assert bench.exchange(1.0).board_flags is flags


@pytest.mark.parametrize("exchanges", [1, 2, 3, 4, 80])
def test_answers_that_all_come_late_are_never_mistaken_for_fresh(old, exchanges):
    bench, _ = old
    link = bench.board._link = LateByMany(bench.link)
    with suppress(UnsafeError), bench.board:  # an answer to the SAFE before confirms as well
        for _ in range(2 * exchanges + 10):
            assert bench.exchange(1.0).board_flags is BoardFlags.NONE  # an even duty: its echo proves nothing
        link.begin(exchanges)
        for _ in range(10):
            assert bench.exchange(1.0).board_flags is BoardFlags.STALE


@pytest.mark.untraced
@given(faults=st.lists(st.sampled_from([None, "late", "twice", "lost"]), max_size=30))
@pytest.mark.parametrize("wiring", KNOWN_BY.values(), ids=KNOWN_BY)
def test_every_good_sample_is_of_its_own_exchange(new_usb2_bench, wiring, faults):
    bench = new_usb2_bench(*wiring)
    link = bench.board._link = OldAnswers(bench.link)
    with bench.board:
        start = bench.device.counts()
        for fault in faults:
            if fault:
                setattr(link, fault, 1)
            sample = bench.exchange(1.0)
            road, wheel = bench.device.counts()
            if sample.board_flags is BoardFlags.NONE:
                assert (sample.road_count, sample.wheel_count) == (road - start[0], wheel - start[1])


def test_without_number_and_clock_a_repeated_answer_is_mistaken_for_the_next_one(new_usb2_bench):
    """Why the number is there."""
    bench = new_usb2_bench("board.numbering_pwm=-1")
    link = bench.board._link = OldAnswers(bench.link)
    with bench.board:
        start = bench.device.counts()
        for _ in range(400):
            bench.exchange(1.0)
        link.twice = 1
        for _ in range(20):
            sample = bench.exchange(1.0)
        road, _ = bench.device.counts()
    assert sample.board_flags is BoardFlags.NONE
    assert sample.road_count < road - start[0]
