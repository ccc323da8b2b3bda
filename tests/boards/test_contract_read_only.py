import pytest

from inteco_abs.errors import BoardError, ReadOnlyError

UNTRUSTED = ("another logic version", "another application name", "no application name known", "an unsigned profile")


@pytest.fixture(params=UNTRUSTED)
def untrusted(request, new_bench, both_on):
    settings, words = new_bench.untrusted[request.param]
    return new_bench(*settings, earlier=both_on), words


class TestReadOnly:
    def test_the_identity_says_why(self, untrusted):
        bench, words = untrusted
        with bench.board as board:
            assert board.identity[:3] == bench.identity
            for word in words:
                assert word in board.identity.read_only_because

    def test_an_exchange_is_refused_and_says_why(self, untrusted):
        bench, words = untrusted
        with bench.board, pytest.raises(ReadOnlyError) as refusal:
            bench.exchange(0.0, 0.0)
        for word in words:
            assert word in str(refusal.value)

    def test_only_read_requests_are_written_from_opening_to_closing(self, untrusted):
        bench, _ = untrusted
        before = dict(bench.device.settings)
        with bench.board as board:
            board.identify()
            for _ in range(3):
                with pytest.raises(ReadOnlyError):
                    bench.exchange(1.0, 1.0)
        assert bench.only_read
        assert bench.link.closed
        assert bench.device.settings == before

    def test_a_user_is_warned_of_outputs_that_an_earlier_program_left_on(self, untrusted):
        bench, _ = untrusted
        with bench.board as board, pytest.raises(ReadOnlyError, match="emergency switch"):
            bench.exchange(0.0, 0.0)
        assert "emergency switch" in board.identity.read_only_because
        assert bench.device.duties == (1.0, 1.0)

    @pytest.mark.parametrize("way_out", [ValueError(), KeyboardInterrupt()], ids=lambda error: type(error).__name__)
    def test_nothing_is_written_when_an_exception_ends_it(self, untrusted, way_out):
        bench, _ = untrusted
        with pytest.raises(type(way_out)), bench.board:
            raise way_out
        assert bench.only_read
        assert bench.link.closed

    def test_asking_for_safe_writes_nothing_either(self, untrusted):
        bench, _ = untrusted
        with bench.board, pytest.raises(BoardError):
            bench.board.make_safe()
        assert bench.only_read

    def test_nothing_is_reported_of_outputs_that_are_off(self, new_bench):
        with new_bench('board.verified_by=""').board as board:
            assert "emergency switch" not in board.identity.read_only_because

    def test_the_shipped_profile_of_the_real_board_opens_the_mock_for_reading_only(self, new_bench):
        bench = new_bench(f"profile={new_bench.real_profile}")
        with bench.board as board:
            assert board.identity.read_only_because
        assert bench.only_read
