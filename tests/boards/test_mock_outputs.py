import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.mock_board import Cable

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

ALL_PINS = (1 << 26) - 1
BOTH = 0b100100
masks = st.integers(0, ALL_PINS)


@given(mode=masks, direction=masks)
def test_a_width_reaches_its_motor_exactly_when_its_own_pin_is_pwm_and_output(new_mock, mode, direction):
    mock = new_mock()
    mock.send(pin_mode=mode, pin_direction=direction, pwm0_width=255, pwm1_width=255)
    on = mode & ~direction
    assert mock.device.duties == (float(on >> 2 & 1), float(on >> 5 & 1))


@pytest.mark.parametrize(
    ("settings", "turns"),
    [
        ({"pin_mode": BOTH}, True),
        ({"pin_mode": 0}, False),
        ({"pin_mode": ALL_PINS & ~0b100}, False),
        ({"pin_mode": BOTH, "pin_direction": 0b100}, False),
        ({"pin_mode": BOTH, "pin_direction": ALL_PINS & ~0b100}, True),
    ],
)
def test_the_wheels_turn_only_then(mock, settings, turns):
    mock.send(pwm0_width=255, **settings)
    mock.run(0.5)
    assert (mock.device.plant.road_speed > 1.0) is turns
    assert (mock.device.plant.wheel_speed > 1.0) is turns


def test_the_brake_holds_only_then(mock):
    mock.send(pwm1_width=255, pin_mode=0b100)
    mock.run(0.2)
    assert mock.device.plant.brake_torque == 0.0
    mock.send(pwm1_width=255, pin_mode=BOTH)
    mock.run(0.2)
    assert mock.device.plant.brake_torque > 1.0


def test_pwm_channels_without_a_motor_move_nothing(mock):
    mock.send(pin_mode=ALL_PINS, **{f"pwm{channel}_width": 255 for channel in range(2, 8)})
    mock.run(0.2)
    assert mock.device.duties == (0.0, 0.0)
    assert mock.device.plant.road_speed == 0.0


@pytest.mark.parametrize(("drive", "brake"), [(1, 0), (3, 6), (7, 2)])
def test_the_cable_says_which_channels_the_motors_are_on(new_mock, drive, brake):
    mock = new_mock(cable=Cable(drive_pwm=drive, brake_pwm=brake))
    pins = 1 << 3 * drive + 2 | 1 << 3 * brake + 2
    mock.send(pin_mode=pins, **{f"pwm{drive}_width": 255, f"pwm{brake}_width": 51})
    assert mock.device.duties == (1.0, 0.2)
    mock.send(pin_mode=pins, **{f"pwm{drive}_width": 51, f"pwm{brake}_width": 0})
    assert mock.device.duties == (0.2, 0.0)


@pytest.mark.parametrize(("mode", "full"), [(0, 255), (1, 4095)])
def test_a_duty_is_a_whole_number_of_steps_of_the_mode(mock, mode, full):
    duties = set()
    for width in range(full + 1):
        mock.send(pin_mode=BOTH, pwm0_mode=mode, pwm0_width=width, pwm1_mode=mode, pwm1_width=full - width)
        drive, brake = mock.device.duties
        assert (drive * full, brake * full) == (pytest.approx(width, abs=1e-9), pytest.approx(full - width, abs=1e-9))
        duties.add(drive)
    assert len(duties) == full + 1
    assert min(duties) == 0.0
    assert max(duties) == 1.0


def test_each_channel_has_its_own_mode(mock):
    mock.send(pin_mode=BOTH, pwm0_mode=1, pwm0_width=255, pwm1_mode=0, pwm1_width=255)
    assert mock.device.duties == (255 / 4095, 1.0)


@given(prescaler=st.integers(0, 65535))
def test_the_prescaler_does_not_change_the_duty(new_mock, prescaler):
    mock = new_mock()
    mock.send(pin_mode=BOTH, pwm0_width=102, pwm0_prescaler=prescaler)
    assert mock.device.duties == (0.4, 0.0)


def test_outputs_stay_on_when_the_host_falls_silent(mock):
    mock.send(pin_mode=BOTH, pwm0_width=255)
    mock.run(1.0)
    assert mock.device.duties == (1.0, 0.0)
    assert mock.device.plant.road_speed > 20.0


def test_after_power_up_the_outputs_are_off(mock):
    assert mock.device.duties == (0.0, 0.0)
