"""Hands at the simulated rig: on its wheels, on its switch, and at its plugs."""

import pytest

from firmware_protocol.rtdac_usb2 import decode_read
from inteco_abs.config import load_config
from inteco_abs.errors import ConfigError


def counts(mock, *channels):
    values = decode_read(mock.read())
    return [values[f"encoder{channel}_count"] for channel in channels]


def moved(mock, duration_s, *channels):
    before = counts(mock, *channels)
    mock.run(duration_s)
    return [after - start for after, start in zip(counts(mock, *channels), before, strict=True)]


@pytest.mark.parametrize(("which", "expected"), [("road", [20480, 0]), ("wheel", [0, 20480])])
def test_a_wheel_turned_with_the_lever_lifted_turns_alone(mock, which, expected):
    mock.device.turn(which, 10, 2.0)
    assert moved(mock, 3.0, 0, 1) == pytest.approx(expected, abs=1)


def test_with_the_lever_down_the_rims_roll_on_each_other(mock):
    mock.device.turn("wheel", 10, 2.0, lifted=False)
    road, wheel = moved(mock, 3.0, 0, 1)
    assert wheel == pytest.approx(20480, abs=1)
    assert road == pytest.approx(20480 * 0.0995 / 0.099, abs=1)


def test_a_hand_moves_evenly_and_stops(mock):
    mock.device.turn("road", 10, 2.0)
    assert moved(mock, 1.0, 0) == pytest.approx([10240], abs=1)
    assert moved(mock, 1.0, 0) == pytest.approx([10240], abs=1)
    assert moved(mock, 1.0, 0) == [0]


def test_the_physics_continue_as_if_no_hand_had_been_there(new_mock):
    turned, alone = new_mock(), new_mock()
    turned.device.turn("road", 10, 0.1)
    for mock in (turned, alone):
        mock.run(0.2)
        mock.send(pin_mode=0b100, pwm0_width=255)
        mock.run(0.3)
    assert turned.device.plant.road_speed == alone.device.plant.road_speed > 0.0


def test_without_power_no_width_moves_the_rig_and_with_it_again_the_same_one_does(mock):
    mock.device.power(on=False)
    mock.send(pin_mode=0b100, pwm0_width=255)
    assert mock.device.duties == (0.0, 0.0)
    assert moved(mock, 0.3, 0, 1) == [0, 0]
    mock.device.power(on=True)
    assert mock.device.duties == (1.0, 0.0)
    assert moved(mock, 0.3, 0)[0] > 50


def test_the_configuration_wires_the_rig_regardless_of_the_profile(new_mock):
    mock = new_mock(
        "simulation.road_encoder=5",
        "simulation.wheel_encoder=2",
        "simulation.wheel_sign=-1",
        "simulation.counts_per_turn=1000",
        "encoders.counts_per_turn=4096",
    )
    mock.device.turn("wheel", 3, 1.0, lifted=False)
    road, wheel, *others = moved(mock, 2.0, 5, 2, 0, 1)
    assert wheel == pytest.approx(-3000, abs=1)
    assert road == pytest.approx(3015, abs=1)
    assert others == [0, 0]


def test_encoders_are_as_the_profile_says_by_default(new_mock):
    mock = new_mock("encoders.counts_per_turn=4096")
    mock.device.turn("road", 1, 0.5)
    assert moved(mock, 1.0, 0) == pytest.approx([4096], abs=1)


@pytest.mark.parametrize(
    ("setting", "problem"),
    [("simulation.road_encoder=1", "another encoder"), ("simulation.brake_pwm=0", "another PWM channel")],
)
def test_two_plugs_do_not_fit_into_one_socket(setting, problem):
    with pytest.raises(ConfigError, match=problem):
        load_config(settings=[setting])
