import pytest
from hypothesis import given
from hypothesis import strategies as st

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

PINS = {"pin_mode": 0b100100}


def life(mock, commands):
    """Every answer of the mock while it is driven."""
    answers = [mock.read()]
    for drive, brake, elapsed_ns in commands:
        mock.send(**PINS, pwm0_width=drive, pwm1_width=brake)
        answers.append(mock.read())
        mock.clock.advance(elapsed_ns)
        answers.append(mock.read())
    return answers


lives = st.lists(st.tuples(st.integers(0, 255), st.integers(0, 255), st.integers(0, 3_000_000)), max_size=15)


@given(commands=lives, seed=st.integers(0, 2**64))
def test_the_same_seed_gives_the_same_answers_to_the_last_bit(new_mock, commands, seed):
    assert life(new_mock(seed=seed), commands) == life(new_mock(seed=seed), commands)


def test_different_seeds_power_up_with_different_counters(new_mock):
    counters = {new_mock(seed=seed).read()[106:114] for seed in range(50)}
    assert len(counters) == 50


def test_different_seeds_stop_the_wheels_at_different_places_between_two_edges(new_mock):
    paths = set()
    for seed in range(20):
        mock = new_mock(seed=seed)
        mock.send(**PINS, encoder_reset=0b11)
        mock.send(**PINS, encoder_reset=0)
        paths.add(b"".join(life(mock, [(255, 0, 20_000_000)] * 6)))
    assert len(paths) > 10


def test_a_seed_changes_nothing_about_the_physics(new_mock):
    speeds = set()
    for seed in range(5):
        mock = new_mock(seed=seed)
        life(mock, [(255, 0, 100_000_000)])
        speeds.add((mock.device.plant.road_speed, mock.device.plant.wheel_speed))
    assert len(speeds) == 1


def test_time_moves_only_with_the_clock(mock):
    mock.send(**PINS, pwm0_width=255)
    mock.run(0.3)
    plant = mock.device.plant
    before, answer = (plant.time_s, plant.road_angle, plant.road_speed, plant.brake_torque), mock.read()
    for width in (255, 254, 255, 255):
        for _ in range(10):
            mock.send(**PINS, pwm0_width=width)
            last = mock.read()
    assert (plant.time_s, plant.road_angle, plant.road_speed, plant.brake_torque) == before
    assert last == answer


def test_the_rig_catches_up_with_the_clock_whenever_it_is_read_or_written(mock):
    plant, total = mock.device.plant, 0
    for elapsed_ns, look in [(500_000, mock.read), (123, mock.read), (10**7, lambda: mock.send(**PINS, pwm0_width=9))]:
        mock.clock.advance(elapsed_ns)
        total += elapsed_ns
        look()
        assert round(plant.time_s * 1e9) == total


def test_how_often_the_rig_is_looked_at_does_not_matter(new_mock):
    ends = []
    for looks in (1, 20):
        mock = new_mock()
        mock.send(**PINS, pwm0_width=255)
        for _ in range(looks):
            mock.clock.advance(200_000_000 // looks)
            mock.read()
        ends.append((round(mock.device.plant.road_speed, 9), round(mock.device.plant.road_angle, 9)))
    assert ends[0] == ends[1]
    assert ends[0][0] > 5.0


def test_a_clock_that_goes_back_moves_nothing(mock):
    mock.send(**PINS, pwm0_width=255)
    mock.run(0.1)
    before = mock.read()
    mock.clock.advance(-50_000_000)
    assert mock.read() == before


def test_the_truth_is_shown_at_every_write_with_the_duties_that_it_makes(new_mock):
    truths = []
    mock = new_mock(observe=truths.append)
    start = mock.clock.time_ns
    for width in (255, 255, 128, 0):  # the first settles the settings, the second repeats it, the others change widths
        mock.send(**PINS, pwm0_width=width)
        mock.clock.advance(300_000_000)
        mock.read()
    assert [truth.time_ns - start for truth in truths] == [0, 300_000_000, 600_000_000, 900_000_000]
    speeds = [truth.road_speed_rad_s for truth in truths]
    assert speeds[0] == 0.0
    assert speeds[1] > 5.0
    assert speeds == sorted(speeds)
    plant = mock.device.plant
    mock.send(**PINS, pwm0_width=255)
    assert truths[-1][1:5] == (plant.wheel_speed, plant.road_speed, plant.slip, plant.brake_torque)
    assert [truth.drive for truth in truths] == [1.0, 1.0, 128 / 255, 0.0, 1.0]
    assert {truth.brake for truth in truths} == {0.0}
