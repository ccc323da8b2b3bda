"""Populations that are described in TOML, and the one that is shipped so."""

from dataclasses import asdict, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest

from inteco_abs.errors import ConfigError
from inteco_abs.population_file import read_population
from inteco_abs.rig import POPULATIONS, RigVariation, draw, is_described
from inteco_abs.rig.population import WILD

MANY = range(1000)


def test_what_is_not_said_stays_the_bases():
    rig = draw('base = "hard"\n[rig]\nload_ripple = 0.02\n', 7)
    assert rig == replace(draw("hard", 7), load_ripple=0.02)


def test_without_a_base_it_is_the_published_rig():
    rig = draw("[rig]\nbrake_fade_per_kj = 1\n", 3)
    assert rig == replace(
        RigVariation(brake_fade_per_kj=1.0),
        wheel_encoder=rig.wheel_encoder,
        road_encoder=rig.road_encoder,
        command_delay_ticks=1,
        seed=3,
    )


def test_a_range_is_spread_evenly_from_end_to_end():
    text = "[rig]\nbrake_dead_time_s = [0.01, 0.03]\n"
    shares = [(draw(text, seed).brake_dead_time_s - 0.01) / 0.02 for seed in MANY]
    assert kstest(shares, "uniform").pvalue > 0.001


def test_whole_numbers_have_both_ends():
    text = "[rig]\ncommand_delay_ticks = [1, 3]\n"
    found = [draw(text, seed).command_delay_ticks for seed in MANY]
    assert [found.count(ticks) for ticks in (1, 2, 3)] == [pytest.approx(333, abs=60)] * 3


def test_a_factor_is_of_the_bases_number():
    text = 'base = "hard"\n[parameters]\nr1 = { factor = [0.96, 1.04] }\nJ1 = { factor = 2 }\n'
    rigs = [draw(text, seed) for seed in range(100)]
    assert min(rig.parameters.r1 for rig in rigs) < 0.0995 * 0.97
    assert max(rig.parameters.r1 for rig in rigs) > 0.0995 * 1.03
    assert all(rig.parameters.J1 == 2.0 * draw("hard", rig.seed).parameters.J1 for rig in rigs)


def test_a_share_of_the_draws_has_it_and_texts_are_chosen_from():
    text = '[rig]\nroad = { any = ["snow", "ice"], share = 0.5 }\n'
    found = [draw(text, seed).road for seed in MANY]
    assert [found.count(road) for road in ("", "snow", "ice")] == [pytest.approx(n, abs=60) for n in (500, 250, 250)]


def test_the_encoders_are_drawn_independently():
    rig = draw("[encoders]\neccentricity_counts = [0, 5]\n", 1)
    assert rig.wheel_encoder.eccentricity_counts != rig.road_encoder.eccentricity_counts


def test_the_lag_may_be_none():
    assert draw("[rig]\nbrake_lag_s = 0\n", 1).parameters.c31 == float("inf")
    assert draw("[rig]\nbrake_lag_s = 0.1\n", 1).parameters.c31 == 10.0


def test_another_key_changes_no_other_number():
    one, two = (draw(f"[rig]\nload_ripple = [0, 0.1]\n{more}", 5) for more in ("", "supply_sag = [0, 0.1]\n"))
    assert two == replace(one, supply_sag=two.supply_sag)
    assert two.supply_sag > 0.0


@given(st.integers(0, (1 << 64) - 1))
def test_every_wild_rig_is_possible_and_reproducible(seed):
    rig = draw("wild", seed)
    assert rig == draw(WILD, seed)
    assert rig.seed == seed
    assert 0.0 <= rig.brake_dead_time_s <= 0.05
    assert 0.0 <= 1.0 / rig.parameters.c31 <= 0.1
    assert abs(rig.parameters.r1 / 0.0995 - 1.0) <= 0.0401


def test_wild_draws_every_defect_that_a_rig_can_have():
    rigs = [asdict(draw("wild", seed)) for seed in range(100)]
    same = {name for name in rigs[0] if all(rig[name] == rigs[0][name] for rig in rigs)}
    assert same == {
        *("brake_map", "brake_duty_cap", "brake_pwm_steps", "command_delay_ticks"),
        *("road", "later_road", "later_road_after_s"),
        "brake_release_delay_s",  # of no rig is it known; `release` over `rise` is drawn
    }


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[rig]\nbrake_dead_tim_s = 3", r"rig.brake_dead_tim_s: unknown key; did you mean brake_dead_time_s\?"),
        ("[rig]\nseed = 3", "rig.seed: unknown key"),
        ("[rig]\nbrake_dead_time_s = [0, 3]", "rig.brake_dead_time_s: brake_dead_time_s = 3: must be in 0..0.2"),
        ("[rig]\nbrake_lag_s = [0, 3]", "rig.brake_lag_s: 3: must be in 0..1 s"),
        ("[rig]\nload_ripple = [0.2, 0.1]", "the lower end comes first"),
        ("[rig]\nload_ripple = true", "must be a number, a text"),
        ("[rig]\nload_ripple = [0.1, 0.2, 0.3]", "must be a number, a text"),
        ("[rig]\nload_ripple = { value = 0.1, share = 2 }", "share = 2: must be above 0, and at most 1"),
        ("[rig]\nload_ripple = { share = 0.5 }", "must have one of any, factor, range, value"),
        ("[rig]\ncommand_delay_ticks = 1.5", "1.5: must be a whole number"),
        ('[rig]\nroad = ["", "mud"]', "rig.road: road = 'mud': must be one of"),
        ("[parameters]\nr1 = { factor = [-1, 1] }", "parameters.r1: -1: must be above 0"),
        ("[parameters]\nr1 = 99.5", "parameters.r1: 99.5: must be above 0, and at most 100 times the base's 0.0995"),
        ("[encoders]\ncounts_per_turn = [300, 500]", "all rigs of a population have the same discs"),
        ('base = "soft"\n', "base = 'soft': must be one of published, nominal"),
        ("[rigs]\na = 1", "rigs: must be base or one of the tables rig, parameters"),
        ("rig = 3\n", r"rig: must be a table, as \[rig\]"),
        ("[rig\n", "at line 1"),
        ("base = []\n", r"base = \[\]: must be one of published"),
        ("base = { a = 1 }\n", "base = .*: must be one of published"),
        (f"[rig]\nload_ripple = 1{'0' * 400}", "rig.load_ripple: 10*: must be a number"),
        (f"[rig]\nload_ripple = {{ value = 0.1, share = 1{'0' * 400} }}", "must be above 0, and at most 1"),
        ('[rig]\nload_ripple = "a"', "rig.load_ripple: 'a': must be a number"),
        ('[rig]\ncommand_delay_ticks = ["a", "b"]', "rig.command_delay_ticks: 'a': must be a number"),
        ('[rig]\nbrake_lag_s = "a"', "rig.brake_lag_s: 'a': must be a number"),
        ('[parameters]\nr1 = "a"', "parameters.r1: 'a': must be a number"),
        ("[rig]\nroad = { factor = 2 }", "rig.road: 2: must be a text"),
        ("[rig]\nbrake_map = { factor = 1 }", "rig.brake_map: 1: must be a text"),
        ("[rig]\nroad = [0.1, 0.2]", "rig.road: 0.1: must be a text"),
        ("a = " + "[" * 40_000, "is nested too deeply"),
        ("[rig]\nbrake_lag_s = 0.1\n[parameters]\nc31 = 50", "both are the brake's lag; give one of them"),
        ("[wheel_encoder]\ncounts_per_turn = 4096", "4096 and 2048: must be the same; write it into .encoders."),
    ],
)
def test_an_error_names_its_key(text, says):
    with pytest.raises(ValueError, match=says):
        draw(text, 0)


def test_a_text_is_distinguished_from_a_name():
    assert not any(map(is_described, POPULATIONS))
    assert is_described(WILD)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a lab.toml", b"", "its name must be of letters"),
        ("hard.toml", b"", "hard is a shipped population; give the file another name"),
        ("lab.toml", b"\xff", "lab.toml: .*utf-8"),
        ("lab.toml", b"#" * 100_001, "must have at most 100000 bytes"),
        ("lab.toml", b"[rig]\nroad = 3", "lab.toml: rig.road"),
        ("none.toml", None, "none.toml: No such file"),
    ],
)
def test_a_file_that_cannot_be_used_is_named(tmp_path, name, content, says):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(ConfigError, match=says):
        read_population(str(tmp_path / name), "--rigs")
