import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb2 import decode_read
from inteco_abs.mock_board import Cable

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

ROAD, WHEEL = 0b01, 0b10


def counts(mock):
    values = decode_read(mock.read())
    return values["encoder0_count"], values["encoder1_count"]


def turn(mock, road_turns=0.0, wheel_turns=0.0):
    mock.device.plant.road_angle += road_turns * math.tau
    mock.device.plant.wheel_angle += wheel_turns * math.tau


@pytest.mark.parametrize("per_turn", [2048, 4096])
def test_a_turn_has_as_many_counts_as_configured(new_mock, per_turn):
    mock = new_mock(f"encoders.counts_per_turn={per_turn}")
    road, wheel = counts(mock)
    turn(mock, road_turns=3.0, wheel_turns=-2.0)
    assert counts(mock) == (road + 3 * per_turn, wheel - 2 * per_turn)
    turn(mock, road_turns=0.25, wheel_turns=0.5)
    assert counts(mock) == (road + 3 * per_turn + per_turn // 4, wheel - 2 * per_turn + per_turn // 2)


@given(moved=st.integers(-(2**34), 2**34))
@example(moved=2**31)
@example(moved=-(2**32))
def test_counters_have_32_bits_and_wrap_in_both_directions(new_mock, moved):
    mock = new_mock()
    road, wheel = counts(mock)
    turn(mock, road_turns=moved / 2048, wheel_turns=-moved / 2048)
    answer = mock.read()
    assert int.from_bytes(answer[106:110], "little") == (road + moved) % 2**32
    assert int.from_bytes(answer[110:114], "little") == (wheel - moved) % 2**32
    assert all(-(2**31) <= count < 2**31 for count in counts(mock))


def test_every_count_between_two_angles_is_met_once(mock):
    start = counts(mock)[0]
    met = []
    for _ in range(200):
        turn(mock, road_turns=1 / 2048 / 4)
        met.append(counts(mock)[0] - start)
    assert met == sorted(met)
    assert set(range(1, 50)) <= set(met) <= set(range(51))


@pytest.mark.parametrize("bit", [ROAD, WHEEL])
def test_a_reset_bit_holds_its_counter_at_zero_as_long_as_it_is_set(mock, bit):
    which = bit >> 1
    other_start = counts(mock)[1 - which]
    mock.send(encoder_reset=bit)
    for turned in (1, 2, 3):
        turn(mock, 1.0, 1.0)
        now = counts(mock)
        assert now[which] == 0
        assert now[1 - which] == other_start + 2048 * turned


def test_a_released_counter_counts_from_zero(mock):
    mock.send(encoder_reset=ROAD | WHEEL)
    turn(mock, 5.3, -1.7)
    mock.send(encoder_reset=0)
    assert counts(mock) == (0, 0)
    turn(mock, 1.0, -1.0)
    assert counts(mock) == (2048, -2048)


def test_a_reset_is_not_an_edge_that_has_to_be_cleared_first(mock):
    mock.send(encoder_reset=ROAD)
    mock.send(encoder_reset=ROAD, pwm0_width=3)
    turn(mock, 1.0)
    mock.send(encoder_reset=0, pwm0_width=3)
    turn(mock, 1.0)
    mock.send(encoder_reset=0, pwm0_width=4)
    assert counts(mock)[0] == 2048
    mock.send(encoder_reset=ROAD, pwm0_width=4)
    assert counts(mock)[0] == 0


def test_reset_bits_of_other_encoders_change_nothing(mock):
    before = counts(mock)
    mock.send(encoder_reset=0b11111100)
    mock.send(encoder_reset=0)
    assert counts(mock) == before


def test_encoders_without_a_wheel_stand_still(mock):
    turn(mock, 10.0, 10.0)
    values = decode_read(mock.read())
    assert {values[f"encoder{channel}_count"] for channel in range(2, 8)} == {0}


def test_the_cable_says_which_encoders_the_wheels_are_on(new_mock):
    mock = new_mock(cable=Cable(road_encoder=6, wheel_encoder=2))
    mock.send(encoder_reset=0b01000100)
    mock.send(encoder_reset=0)
    turn(mock, 2.0, 1.0)
    values = decode_read(mock.read())
    assert [values[f"encoder{channel}_count"] for channel in range(8)] == [0, 0, 2048, 0, 0, 0, 4096, 0]


@given(turns=st.floats(-3.0, 3.0))
def test_a_wheel_that_counts_down_passes_the_edges_of_one_that_turns_the_other_way(new_mock, turns):
    forwards, backwards = new_mock(cable=Cable()), new_mock(cable=Cable(road_sign=-1))
    turn(forwards, road_turns=turns)
    turn(backwards, road_turns=-turns)
    assert counts(forwards) == counts(backwards)


def test_both_wheels_count_up_when_driven(mock):
    before = counts(mock)
    mock.send(pin_mode=0b100, pwm0_width=255)
    mock.run(0.3)
    road, wheel = counts(mock)
    assert road - before[0] > 50
    assert wheel - before[1] > 50
