import pytest

from inteco_abs.errors import BoardError, LinkError

READ_ONLY = 'board.verified_by=""'


def test_a_board_open_for_reading_shows_all_its_fields(new_bench):
    bench = new_bench(READ_ONLY)
    with bench.board as board:
        values, raw = board.survey()
    version = bench.identity[0]
    assert values["logic_version"] == version
    assert {f"encoder{i}_count" for i in range(3)} <= values.keys()
    assert raw[:2] == version.to_bytes(2, "little")
    assert bench.only_read


def test_it_shows_counters_as_the_board_has_them(new_bench):
    bench = new_bench(READ_ONLY, "board.wheel_sign=-1")
    bench.device.show(wheel=-5, road=7)
    with bench.board as board:
        values, _ = board.survey(["encoder0_count", "encoder1_count"])
    assert values == {"encoder0_count": 7, "encoder1_count": -5}


def test_a_board_open_for_output_shows_what_it_does_and_is_not_disturbed(new_bench):
    bench = new_bench()
    with bench.board as board:
        bench.exchange(0.5, 0.25)
        sent = len(bench.settings_sent)
        values, _ = board.survey(["pwm0_width", "pwm1_width"])
        assert len(bench.settings_sent) == sent
        assert values == {"pwm0_width": 127, "pwm1_width": 63}
        assert not bench.exchange(0.5, 0.25).board_flags


def test_a_field_that_the_board_does_not_have_is_named(new_bench):
    with new_bench(READ_ONLY).board as board, pytest.raises(BoardError, match="encoder99_count"):
        board.survey(["encoder99_count"])


@pytest.mark.parametrize("change", [lambda answer: answer[:-1], lambda answer: answer[:3] + b"?" + answer[4:]])
def test_a_damaged_answer_gives_no_device_list(new_bench, change):
    bench = new_bench(READ_ONLY)
    with bench.board as board:
        bench.link.change_answer = change
        with pytest.raises(LinkError):
            board.survey()
