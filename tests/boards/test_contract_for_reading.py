"""`Board.reading`: reads everything and writes nothing, with or without a sign-off."""

import pytest

from inteco_abs.errors import BoardError, LinkError, ReadOnlyError
from inteco_abs.signals import Command


def test_a_trusted_board_is_read_and_nothing_is_written_to_it(new_bench, both_on):
    bench = new_bench(earlier=both_on)
    before = dict(bench.device.settings)
    with bench.board.reading() as board:
        assert board.require_writable()[:3] == bench.identity
        board.survey()
        board.survey(["encoder0_count"])
    assert bench.only_read
    assert bench.device.settings == before
    assert bench.device.duties == (1.0, 1.0)
    assert bench.link.closed


def test_an_output_is_refused_while_a_trusted_board_is_read(new_bench):
    bench = new_bench()
    with bench.board.reading() as board:
        with pytest.raises(BoardError, match="not open"):
            board.exchange(Command(1.0, 1.0))
        with pytest.raises(BoardError, match="not open"):
            board.make_safe()
    assert bench.only_read


def test_a_board_that_is_not_trusted_says_so_as_it_does_to_a_run(new_bench):
    settings, words = new_bench.untrusted["an unsigned profile"]
    bench = new_bench(*settings)
    with bench.board.reading() as board, pytest.raises(ReadOnlyError) as refusal:
        board.require_writable()
    assert all(word in str(refusal.value) for word in words)
    assert bench.only_read


@pytest.mark.parametrize("way_out", [ValueError(), KeyboardInterrupt()], ids=lambda error: type(error).__name__)
def test_nothing_is_written_when_an_exception_ends_the_reading(new_bench, way_out):
    bench = new_bench()
    with pytest.raises(type(way_out)), bench.board.reading():
        raise way_out
    assert bench.only_read
    assert bench.link.closed


def test_a_board_that_does_not_answer_is_released(new_bench):
    bench = new_bench()
    bench.unplug()
    with pytest.raises(LinkError), bench.board.reading():
        pass
    assert bench.link.closed
