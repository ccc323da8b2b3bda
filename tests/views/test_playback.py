"""The place of a playback, and its keys."""

import pytest

from inteco_abs.views.playback import FASTEST, SLOWEST, Playback

LEFT, RIGHT, HOME, END = b"\x1b[D", b"\x1b[C", b"\x1b[H", b"\x1b[F"


@pytest.fixture
def playback():
    return Playback(10.0, from_s=4.0)


def test_it_goes_on_with_the_time_at_its_speed_up_to_the_end(playback):
    playback.advance(0.5, 9.0)
    assert playback.position_s == 4.5
    playback.speed = 4.0
    playback.advance(0.5, 9.0)
    assert playback.position_s == 6.5
    assert not playback.at_end
    playback.advance(2.0, 9.0)
    assert (playback.position_s, playback.at_end) == (10.0, True)


def test_a_step_is_at_most_as_long_as_can_be_read(playback):
    playback.speed = FASTEST
    playback.advance(1.0, 2.0)
    assert playback.position_s == 6.0


@pytest.mark.parametrize(
    ("keys", "position_s"),
    [
        (RIGHT, 5.0), (LEFT, 3.0), (b"\x1bOD\x1bOD", 2.0), (LEFT * 9, 0.0), (RIGHT * 9, 10.0), (HOME, 0.0), (b"0", 0.0),
        (END, 10.0), (b".", 4.01), (b",", 3.99), (b"x\x1b[5~\x1b[A\xff\x00", 4.0), (b"\x1b", 4.0), (b"", 4.0),
    ],
)  # fmt: skip
def test_keys_lead_to_places_within_the_session(playback, keys, position_s):
    playback.press(keys)
    assert playback.position_s == pytest.approx(position_s, abs=1e-12)
    assert not playback.left


def test_space_pauses_and_goes_on_and_steps_pause(playback):
    playback.press(b" ")
    playback.advance(1.0, 9.0)
    assert (playback.position_s, str(playback)) == (4.0, "of 10.0 s, 1x, paused")
    playback.press(b" ")
    assert str(playback) == "of 10.0 s, 1x"
    playback.press(b".")
    assert playback.paused


def test_space_at_the_end_begins_again(playback):
    playback.press(END)
    assert str(playback) == "of 10.0 s, 1x, ended"
    playback.press(b" ")
    assert (playback.position_s, playback.paused) == (0.0, False)


def test_the_speed_stays_in_its_range(playback):
    playback.press(b"]]")
    assert playback.speed == 4.0
    playback.press(b"]" * 40)
    assert playback.speed == FASTEST
    playback.press(b"[" * 40)
    assert playback.speed == SLOWEST


def test_q_leaves(playback):
    playback.press(b" q")
    assert (playback.left, playback.paused) == (True, True)


def test_a_place_that_was_sought_differs_from_one_that_was_played(playback):
    playback.advance(1.0, 9.0)
    playback.press(b"]")
    assert not playback.jumped
    playback.press(RIGHT)
    assert playback.jumped
