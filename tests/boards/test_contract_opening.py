from contextlib import suppress

import pytest

from inteco_abs.errors import BoardError, LinkError, ReadOnlyError, UnsafeError
from inteco_abs.signals import Command


def widths(bench, settings):
    return [settings[f"pwm{channel}_width"] for channel in range(bench.channels)]


class TestOpening:
    def test_identifying_only_reads(self, new_bench, both_on):
        bench = new_bench(earlier=both_on)
        bench.board.identify()
        assert bench.only_read
        assert bench.device.duties == (1.0, 1.0)

    def test_the_identity_is_what_the_board_says_of_itself(self, new_bench):
        version, name, date = new_bench.identity
        identity = new_bench().board.identify()
        assert identity[:3] == (version, name, date) == new_bench.identity
        assert not identity.read_only_because
        shown = f"logic 0x{version:04X}" + (f" {name!r}" if name else "") + (f" of {date}" if date else "")
        assert str(identity) == shown
        facts = {"logic_version": f"0x{version:04X}", "application_name": name, "synthesis_date": date}
        assert identity.facts() == facts

    def test_the_identity_is_known_after_entering(self, new_bench):
        bench = new_bench()
        assert bench.board.identity is None
        with bench.board as board:
            assert board is bench.board
            assert board.identity == board.identify()

    def test_an_answer_to_an_earlier_program_is_dropped(self, new_bench):
        bench = new_bench()
        bench.device.show(0, 0)
        bench.read_along()
        with bench.board:
            bench.device.show(70, 30)
            sample = bench.exchange()
        assert (sample.wheel_count, sample.road_count) == (70, 30)

    def test_entering_reads_before_it_writes(self, new_bench):
        bench = new_bench()
        with bench.board:
            assert bench.acts[0] == "read"
            assert bench.settings_sent

    def test_the_first_thing_written_is_safe(self, new_bench):
        bench = new_bench()
        with bench.board:
            assert not any(widths(bench, bench.settings_sent[0]))
            assert bench.device.duties == (0.0, 0.0)

    def test_outputs_left_on_by_an_earlier_program_are_off_once_the_board_is_open(self, new_bench, both_on):
        bench = new_bench(earlier=both_on)
        with bench.board:
            assert bench.device.duties == (0.0, 0.0)
            assert not any(any(widths(bench, sent)) for sent in bench.settings_sent)

    def test_an_open_board_has_seen_no_errors(self, new_bench):
        with new_bench().board as board:
            assert board.link_errors == 0
            assert board.last_error is None

    def test_a_link_that_fails_at_any_moment_of_the_opening_lets_it_fail_closed(self, new_bench):
        moments = 0
        while not opens_although_the_link_fails_at(bench := new_bench(), moments):
            assert bench.device.duties == (0.0, 0.0)
            moments += 1
        assert moments >= 3

    def test_from_the_first_write_on_an_opening_that_fails_leaves_safe_behind(self, new_bench, both_on):
        ends, moments = [], 0
        while not opens_although_the_link_fails_at(bench := new_bench(earlier=both_on), moments):
            assert bench.device.duties == ((0.0, 0.0) if bench.settings_sent else (1.0, 1.0))
            ends.append(bench.device.duties)
            moments += 1
        assert set(ends) == {(0.0, 0.0), (1.0, 1.0)}

    def test_a_board_that_does_not_answer_is_a_link_error(self, new_bench):
        bench = new_bench()
        bench.unplug()
        with pytest.raises(LinkError, match="unplugged"):
            bench.board.__enter__()
        assert bench.link.closed
        assert not bench.acts

    def test_board_that_keeps_outputs_on_is_refused_with_the_emergency_switch(self, new_bench, both_on):
        bench = new_bench(earlier=both_on)
        bench.ignore_commands()
        with pytest.raises(UnsafeError, match="emergency switch"):
            bench.board.__enter__()
        assert bench.front_end.ignored
        assert bench.link.closed

    def test_an_exchange_on_a_board_that_was_never_opened_is_refused(self, new_bench):
        bench = new_bench()
        with pytest.raises(BoardError, match="not open") as refusal:
            bench.board.exchange(Command(1.0, 1.0))
        assert not isinstance(refusal.value, ReadOnlyError | LinkError)
        assert not bench.acts

    def test_an_exchange_on_a_closed_board_is_refused(self, new_bench):
        bench = new_bench()
        with bench.board:
            bench.exchange(1.0)
        acts = bench.acts
        with pytest.raises(BoardError, match="not open"):
            bench.board.exchange(Command(1.0, 1.0))
        assert bench.acts == acts
        assert bench.device.duties == (0.0, 0.0)

    def test_an_exchange_after_a_failed_opening_is_refused(self, new_bench):
        bench = new_bench()
        bench.ignore_commands()
        with pytest.raises(BoardError):
            bench.board.__enter__()
        with pytest.raises(BoardError, match="not open"):
            bench.board.exchange(Command(1.0, 1.0))

    def test_safe_is_not_promised_for_a_board_that_is_not_open(self, new_bench):
        bench = new_bench()
        with pytest.raises(BoardError):
            bench.board.make_safe()
        assert not bench.settings_sent


def opens_although_the_link_fails_at(bench, moment):
    reached = bench.strike({moment: LinkError("no answer")})
    with suppress(LinkError):
        bench.board.__enter__()
        assert reached in ([], [0])  # 0: there was nothing left over to be read, which is not a failure
        return not reached
    assert reached
    assert bench.link.closed
    with pytest.raises(BoardError, match="not open"):
        bench.board.exchange(Command(1.0, 1.0))
    return False
