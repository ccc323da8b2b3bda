import json
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb2 import decode_read
from inteco_abs.config import load_config, parse_config
from inteco_abs.errors import ConfigError
from inteco_abs.mock_board import Cable, Device, drawn_facts, rig_check, simulated_rig
from inteco_abs.population_file import rig_settings
from inteco_abs.rig import POPULATIONS, Encoder, EncoderVariation, Plant, draw, settled_torque

RIG = "simulation.rig=hard:17"
PINS = {"pin_mode": 0b100100}
COMMANDS = [(255, 0, 200), (0, 140, 25), (0, 200, 35), (0, 97, 20), (80, 255, 40), (0, 0, 20)]
"""Widths of drive and brake, and for how many exchanges of 1 ms."""


def counts(mock):
    values = decode_read(mock.read())
    return values["encoder0_count"], values["encoder1_count"]


def exchanges(mock):
    """Drive and brake, and read as a loop does: counts of road and wheel after each write."""
    for drive, brake, times in COMMANDS:
        for _ in range(times):
            mock.send(**PINS, pwm0_width=drive, pwm1_width=brake)
            yield counts(mock)
            mock.clock.advance(1_000_000)


def since_the_first(readings):
    start = readings[0]
    return [tuple(now - then for now, then in zip(reading, start, strict=True)) for reading in readings]


@pytest.mark.untraced
@pytest.mark.parametrize("name", ["hard:17", "rough:0", "slow:3", "capped:8", "nominal:1"])
def test_the_plant_is_the_drawn_one_with_each_command_from_the_instant_of_its_write(new_mock, name):
    truths = []
    mock = new_mock(f"simulation.rig={name}", observe=truths.append)
    list(exchanges(mock))
    population, seed = name.split(":")
    plant, states = Plant(draw(population, int(seed)), 0.0, 0.0), []
    for drive, brake, times in COMMANDS:
        for _ in range(times):
            states.append((plant.wheel_speed, plant.road_speed, plant.slip, plant.brake_torque))
            plant.advance(drive / 255, brake / 255, 0.001)
    assert [truth[1:5] for truth in truths] == states
    assert max(state[1] for state in states) > 7.0
    assert max(state[3] for state in states) > 2.0


def test_counts_are_those_of_the_rigs_encoders_reading_by_reading(new_mock):
    mock = new_mock(RIG)
    rig, road, wheel, readings = draw("hard", 17), [], [], []
    encoders = Encoder(rig, wheel=False), Encoder(rig, wheel=True)
    for reading in exchanges(mock):
        readings.append(reading)
        road.append(encoders[0].read(mock.device.plant.road_angle, mock.device.plant.road_speed))
        wheel.append(encoders[1].read(mock.device.plant.wheel_angle, mock.device.plant.wheel_speed))
    assert since_the_first(readings) == since_the_first(list(zip(road, wheel, strict=True)))
    smooth = replace(rig, road_encoder=EncoderVariation(), wheel_encoder=EncoderVariation())
    ideal = Encoder(smooth, wheel=False)
    assert {road[i] - ideal.read(0.0, 0.0) for i in range(5)} != {0}  # it is the noise that is compared


def test_each_reading_has_noise_of_its_own_also_at_one_instant(new_mock):
    mock = new_mock(RIG)
    at_rest = [counts(mock) for _ in range(400)]
    for wheel in zip(*at_rest, strict=True):
        assert 2 <= len(set(wheel)) <= 5
        assert max(wheel) - min(wheel) <= 4
    assert len(set(at_rest)) > len({road for road, _ in at_rest})


@pytest.mark.untraced
def test_another_power_up_of_the_same_rig_has_other_noise_and_the_same_physics(new_mock):
    mocks = [new_mock(RIG, seed=seed) for seed in (0, 1, 2**64 + 1)]
    paths = [since_the_first(list(exchanges(mock))) for mock in mocks]
    assert paths[0] != paths[1]
    assert paths[1] == paths[2]  # 64 bits of the seed count
    assert len({(mock.device.plant.road_angle, mock.device.plant.wheel_angle) for mock in mocks}) == 1


@pytest.mark.untraced
def test_an_encoder_the_other_way_round_counts_down(new_mock):
    ways = [new_mock(RIG, cable=Cable(road_sign=sign)) for sign in (1, -1)]
    forwards, backwards = (since_the_first(list(exchanges(mock))) for mock in ways)
    assert [(-road, wheel) for road, wheel in backwards] == forwards
    assert forwards[-1][0] > 200


def test_a_released_counter_counts_from_what_the_encoder_showed_then(new_mock):
    mock = new_mock(RIG)
    mock.send(encoder_reset=0b11)
    assert counts(mock) == (0, 0)
    mock.send(encoder_reset=0)
    mock.device.plant.road_angle += 3.0 * math.tau
    road, wheel = counts(mock)
    assert abs(road - 3 * 2048) <= 4
    assert abs(wheel) <= 4


def test_counters_wrap_with_32_bits(new_mock):
    mock = new_mock(RIG)
    mock.device.plant.road_angle += 2**31 / 2048 * math.tau
    before = counts(mock)[0]
    mock.device.plant.road_angle += 2**31 / 2048 * math.tau
    assert abs((counts(mock)[0] - before) % 2**32 - 2**31) <= 4


@given(width=st.integers(0, 255))
def test_a_step_of_the_8_bit_pwm_is_a_step_of_the_rigs(new_mock, width):
    mock = new_mock(RIG)
    mock.send(**PINS, pwm1_width=width)
    rig = replace(draw("hard", 17), brake_pwm_steps=0)
    duty = mock.device.duties[1]
    assert settled_torque(duty, draw("hard", 17)) == pytest.approx(settled_torque(width / 255, rig), abs=1e-9)


@given(width=st.integers(0, 4095))
def test_rig_takes_255_steps_of_the_12_bit_pwm_rounded_down(new_mock, width):
    mock = new_mock(RIG, "board.pwm_mode=12-bit")
    mock.send(**PINS, pwm1_mode=1, pwm1_width=width)
    rig = replace(draw("hard", 17), brake_pwm_steps=0)
    wanted = settled_torque(width * 255 // 4095 / 255, rig)
    assert settled_torque(mock.device.duties[1], draw("hard", 17)) == pytest.approx(wanted, abs=1e-9)


# which rig


def mistakes(*settings):
    with pytest.raises(ConfigError) as caught:
        load_config(settings=settings, checks=[rig_check])
    return {mistake.path: mistake.problem for mistake in caught.value.mistakes}


@pytest.mark.parametrize("population", POPULATIONS)
def test_every_population_passes_the_check_with_every_seed(population):
    for seed in (0, 17, 2**64 - 1):
        config = load_config(settings=[f"simulation.rig={population}:{seed}"], checks=[rig_check])
        assert config.simulation.rig == f"{population}:{seed}"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("hrd:17", ["'hrd:17'", "'hrd'", "did you mean hard?"]),
        ("17", ["'17'", "hard:17", "capped, hard, late, nominal, rough, slow, wild"]),
        (":17", ["':17'", "hard:17"]),
        ("hard", ["'hard'", "seed", "hard:17"]),
        ("slow:", ["seed", "slow:17"]),
        ("hard:-1", ["0..2^64-1"]),
        ("hard:1.5", ["0..2^64-1"]),
        ("hard:1_7", ["0..2^64-1"]),
        ("hard:\u0661", ["0..2^64-1"]),
        (f"hard:{2**64}", ["0..2^64-1"]),
        (f"hard:{'9' * 5000}", ["0..2^64-1"]),
    ],
)
def test_an_unknown_rig_is_refused_with_an_explanation(name, words):
    problem = mistakes(f'simulation.rig="{name}"')["simulation.rig"]
    assert all(word in problem for word in words)
    assert len(problem) < 300


def test_a_rig_of_a_file_is_drawn_from_the_text_in_the_configuration(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text('base = "hard"\n[rig]\nsupply_sag = 0.1\n')
    settings = [f"{key}={json.dumps(value)}" for key, value in rig_settings(f"{file}:17", "--rig").items()]
    file.unlink()
    config = load_config(settings=settings, checks=[rig_check])
    assert config.simulation.rig == "lab:17"
    assert simulated_rig(parse_config(config.to_toml())) == replace(draw("hard", 17), supply_sag=0.1)
    assert drawn_facts(config)["supply_sag"] == "0.1"


def test_a_text_that_describes_no_population_is_a_mistake_of_its_key():
    found = mistakes(RIG, 'simulation.population="[rig]\\nsupply_sag = 3"')
    assert found == {"simulation.population": "rig.supply_sag: supply_sag = 3: must be in 0..0.5"}


def test_a_draw_that_a_factor_makes_impossible_is_named():
    text = 'base = "hard"\\n[rig]\\nbrake_dead_time_s = { factor = 14 }'.replace('"', '\\"')
    found = mistakes("simulation.rig=lab:1", f'simulation.population="{text}"')
    assert "'lab:1': this draw is impossible: brake_dead_time_s = 0.2" in found["simulation.rig"]


def test_a_value_that_is_not_text_is_left_to_the_configuration():
    assert mistakes("simulation.rig=17") == {"simulation.rig": "17: must be text"}


def test_what_describes_the_published_rig_does_not_go_with_a_drawn_one():
    found = mistakes(RIG, "simulation.parameters=table", "simulation.brake_rate_per_s=30.0")
    assert found.keys() == {"simulation.parameters", "simulation.brake_rate_per_s"}
    assert "hard:17 has its own" in found["simulation.parameters"]


def test_a_host_that_assumes_other_encoders_gets_the_setting_to_change():
    assert "set this to 2048" in mistakes(RIG, "encoders.counts_per_turn=4096")["encoders.counts_per_turn"]
    assert "has 2048" in mistakes(RIG, "simulation.counts_per_turn=4096")["simulation.counts_per_turn"]


def test_a_host_may_assume_other_encoders_if_the_configuration_says_so(new_mock):
    mock = new_mock(RIG, "encoders.counts_per_turn=4096", "simulation.counts_per_turn=2048")
    before = counts(mock)[0]
    mock.device.plant.road_angle += math.tau
    assert abs(counts(mock)[0] - before - 2048) <= 4


def test_a_device_refuses_what_no_check_has_seen():
    with pytest.raises(ConfigError, match="did you mean rough"):
        Device(load_config(settings=["simulation.rig=rogh:1"]), lambda: 0)


def test_facts_of_a_drawn_rig_are_all_in_which_it_differs():
    rig = draw("rough", 5)
    facts = drawn_facts(load_config(settings=["simulation.rig=rough:5"]))
    assert facts["parameters.J1"] == repr(rig.parameters.J1)
    assert facts["load_ripple"] == repr(rig.load_ripple)
    assert facts["brake_map"] == "measured"
    assert facts["road_encoder.jitter_counts"] == "0.3"
    assert facts.keys().isdisjoint({"parameters.r1", "brake_duty_cap", "seed", "command_delay_ticks"})


def test_the_published_rig_has_no_facts_of_its_own():
    assert drawn_facts(load_config()) == {}
