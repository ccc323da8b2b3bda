"""Step 4: the result of ten turns by hand, and the messages when they are not clear."""

import pytest

from inteco_abs.commissioning.hand_turning import Unclear, counts_per_turn, judge
from inteco_abs.config import load_config
from inteco_abs.errors import CommissioningError


def hands(lab, *moves):
    """What the hands do at each request, one after the other: a wheel, its turns, and whether the lever is lifted."""
    queue = list(moves)

    def turn(_asked):
        which, turns, lifted = queue.pop(0)
        if which:
            lab.rig.device.turn(which, turns, 5.0, lifted=lifted)

    lab.rig.hand = turn


@pytest.fixture
def at_wheels(lab):
    """A lab before step 4, whose hands and answers are given."""

    def prepare(answers, *moves, settings=()):
        lab.done_until("wheels", settings)
        procedure = lab.session("", *answers)
        hands(lab, *moves)
        return procedure

    return prepare


UPPER, LOWER = ("wheel", 10, True), ("road", 10, True)
AGAIN = {
    "nothing moved": (("", 0, True), "no encoder channel counted"),
    "the lever was not lifted": (("wheel", 10, False), "channels 0, 1 counted together"),
}


@pytest.mark.parametrize("mistake", AGAIN)
def test_a_mistake_is_reported_and_the_wheel_is_turned_again(lab, at_wheels, mistake):
    move, complaint = AGAIN[mistake]
    at_wheels(["", "", ""], move, UPPER, LOWER).go(only="wheels")
    assert lab.operator.heard(complaint)
    assert lab.draft.config.board.wheel_encoder == 1


@pytest.mark.parametrize("mistake", AGAIN)
def test_three_mistakes_end_the_step_and_leave_the_draft(lab, at_wheels, mistake):
    move, complaint = AGAIN[mistake]
    procedure = at_wheels(["", "", ""], move, move, move)
    before = lab.file.read_text()
    with pytest.raises(CommissioningError, match=complaint):
        procedure.go(only="wheels")
    assert lab.file.read_text() == before


def test_the_same_wheel_twice_is_noticed(lab, at_wheels):
    at_wheels(["", "", ""], UPPER, UPPER, LOWER).go(only="wheels")
    assert lab.operator.heard("channel 1 is the upper wheel's: turn the lower wheel")


def test_a_wheel_turned_backwards_is_asked_about_and_turned_again(lab, at_wheels):
    at_wheels(["", "no", "", ""], ("wheel", -10, True), UPPER, LOWER).go(only="wheels")
    assert lab.draft.config.board.wheel_sign == 1


def test_an_encoder_that_counts_down_gets_its_sign(lab, at_wheels):
    at_wheels(["", "yes", ""], ("wheel", -10, True), LOWER).go(only="wheels")
    board = lab.draft.config.board
    assert (board.wheel_sign, board.road_sign) == (-1, 1)


def test_after_a_wrong_answer_the_question_is_repeated(lab, at_wheels):
    at_wheels(["", "maybe", "yes", ""], ("wheel", -10, True), LOWER).go(only="wheels")
    assert lab.operator.heard("must be yes or no")


def test_a_little_more_than_ten_turns_is_ten_turns(lab, at_wheels):
    at_wheels(["", ""], ("wheel", 10.3, True), ("road", 9.8, True)).go(only="wheels")
    assert lab.draft.config.encoders.counts_per_turn == 4096


def test_wrong_turns_are_asked_about(lab, at_wheels):
    at_wheels(["", "seven", "7", ""], ("wheel", 7, True), LOWER).go(only="wheels")
    assert lab.operator.heard("must be a number of turns")
    assert lab.draft.config.encoders.counts_per_turn == 4096


def test_half_the_turns_look_like_half_the_counts_and_are_asked_about(lab, at_wheels):
    at_wheels(["", "5", ""], ("wheel", 5, True), LOWER).go(only="wheels")
    assert lab.operator.heard("2048 counts per turn, and the profile says 4096")
    assert lab.draft.config.encoders.counts_per_turn == 4096


def test_an_unusual_number_is_kept_if_the_person_insists(lab, at_wheels):
    settings = ["simulation.counts_per_turn=1000"]
    at_wheels(["", "10", "yes", "", "10", "yes"], UPPER, LOWER, settings=settings).go(only="wheels")
    assert load_config(profile=str(lab.file)).encoders.counts_per_turn == 1000


def test_an_unusual_number_that_is_not_certain_is_counted_again(lab, at_wheels):
    at_wheels(["", "8", "no", "", ""], ("wheel", 6, True), UPPER, LOWER).go(only="wheels")
    assert lab.draft.config.encoders.counts_per_turn == 4096


def test_two_different_numbers_are_refused(at_wheels):
    with pytest.raises(CommissioningError, match="4096 counts per turn on the upper wheel, 2048 on the lower"):
        at_wheels(["", "", "10"], UPPER, ("road", 5, True)).go(only="wheels")


def test_what_was_found_is_confirmed_with_its_day(lab, at_wheels):
    at_wheels(["", ""], UPPER, LOWER).go(only="wheels")
    evidence = lab.draft.config.board.evidence
    for key in ("road_encoder", "wheel_encoder", "road_sign", "wheel_sign", "counts_per_turn"):
        assert evidence[key].status == "confirmed"
        assert evidence[key].source.startswith("turned by hand on 20")


def test_wheels_that_never_rest_end_the_step(lab, at_wheels):
    procedure = at_wheels([""])
    lab.rig.hand = lambda _which: lab.rig.device.turn("wheel", 400, 1000.0)
    with pytest.raises(CommissioningError, match="is a motor on"):
        procedure.go(only="wheels")


def test_another_board_than_the_drafts_is_refused(lab, at_wheels):
    procedure = at_wheels([""], UPPER)
    lab.rig.change_answer = lambda answer: answer[:2] + b"X" + answer[3:]  # its name
    with pytest.raises(CommissioningError, match="not the one that the draft was begun with"):
        procedure.go(only="wheels")


class TestJudging:
    def test_a_lever_that_moves_a_little_does_not_matter(self):
        assert judge({0: 40960, 1: 0, 2: 400}, {0: 41000, 1: 0, 2: 800}) == (0, 40960)

    def test_turning_to_and_fro_is_refused(self):
        with pytest.raises(Unclear, match="back and forth"):
            judge({0: 20000, 1: 0}, {0: 60000, 1: 0})

    @pytest.mark.parametrize(("counts", "found"), [(20480, 2048), (-40960, 4096), (30000, None), (21400, None)])
    def test_the_nearest_usual_number_within_four_percent(self, counts, found):
        assert counts_per_turn(counts) == found
