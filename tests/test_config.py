import math
import tomllib
from dataclasses import FrozenInstanceError, asdict
from pathlib import Path

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.config import DEFAULT_PROFILE, RigConfig, load_config, parse_config, profiles, trusted_config
from inteco_abs.control import control_check
from inteco_abs.errors import AbsError, ConfigError, ConfigIssue


def mistakes(*settings: str, file: Path | None = None) -> dict[str, str]:
    with pytest.raises(ConfigError) as caught:
        load_config(file, settings)
    found = {mistake.path: mistake.problem for mistake in caught.value.mistakes}
    assert len(found) == len(caught.value.mistakes), "a key is reported twice"
    return found


@pytest.fixture
def written(tmp_path):
    def write(content: str | bytes) -> Path:
        file = tmp_path / "rig.toml"
        file.write_bytes(content.encode() if isinstance(content, str) else content)
        return file

    return write


# what is loaded


def test_the_defaults_are_the_simulated_rig_of_the_paper():
    config = load_config()
    assert config.profile == DEFAULT_PROFILE == "sim_usb2"
    assert config.encoders.counts_per_turn == 2048
    assert config.loop.rate_hz == 2000.0
    assert config.period_ns == 500_000
    assert config.experiment.start_speed_rad_s == 180.0
    assert config.controller.reference_slip == 0.2
    assert config.guard.brake_limit == 1.0
    assert config.guard.over_speed_rad_s == 245.0


def test_the_defaults_that_no_profile_sets():
    config = load_config(settings=["profile=usb2_generic_0103"])
    assert asdict(config.experiment) == {
        "idle_s": 0.05,
        "drive_duty": 1.0,
        "start_speed_rad_s": 178.0,
        "stop_speed_rad_s": 0.5,
        "hold_s": 0.5,
        "stops": 1,
        "changes": None,
        "spin_up_timeout_s": 20.0,
        "braking_timeout_s": 10.0,
    }
    assert asdict(config.guard) == {
        "brake_limit": 0.7,
        "drive_limit": 1.0,
        "over_speed_rad_s": 245.0,
        "missed_in_a_row": 20,
        "bucket_limit": 60,
        "silence_s": 0.05,
        "run_up_factor": 1.5,
    }
    assert (config.estimator.name, config.estimator.window_s) == ("moving-window", 0.010)
    assert (config.controller.name, config.controller.hold_below_rad_s) == ("reaching-law", 5.0)
    assert (config.simulation.parameters, config.simulation.brake_rate_per_s) == ("mask", 20.37)
    board = config.board
    assert (board.drive_pwm, board.brake_pwm, board.road_encoder, board.wheel_encoder) == (0, 1, 0, 1)
    assert (board.road_sign, board.wheel_sign) == (1, 1)
    assert (board.pwm_mode, board.pwm_prescaler, board.pwm_pins) == ("8-bit", 44, [2, 5])


def test_every_shipped_profile_loads_and_passes_the_checks():
    assert DEFAULT_PROFILE in profiles()
    for name in profiles():
        config = load_config(settings=[f"profile={name}"], checks=[control_check()])
        assert config.profile == name


def test_the_profile_of_a_real_board_is_strict_and_unsigned():
    config = load_config(settings=["profile=usb2_generic_0103"])
    assert config.board.verified_by == ""
    assert config.guard.brake_limit == 0.7
    assert (config.guard.missed_in_a_row, config.guard.bucket_limit) == (20, 60)


@pytest.mark.parametrize("name", [name for name in profiles() if not name.startswith(("sim_", "usb2_tras"))])
def test_guard_of_a_real_board_tolerates_3_ms_and_trips_before_a_hang_counts(name):
    config = load_config(settings=[f"profile={name}"])
    in_a_row_s = config.guard.missed_in_a_row / config.loop.rate_hz
    assert 0.006 < in_a_row_s <= config.guard.silence_s / 2
    assert config.guard.bucket_limit / 3 >= config.guard.missed_in_a_row


def test_settings_precede_file_then_profile_then_defaults(written):
    file = written("profile = 'usb2_generic_0103'\n[guard]\nbrake_limit = 0.5\nover_speed_rad_s = 200.0\n")
    config = load_config(file, ["guard.over_speed_rad_s=198"])
    assert config.guard.over_speed_rad_s == 198.0
    assert config.guard.brake_limit == 0.5
    assert config.encoders.counts_per_turn == 4096
    assert config.guard.drive_limit == 1.0


def test_a_file_that_sets_one_key_of_a_section_leaves_the_others_to_the_profile(written):
    config = load_config(written("[guard]\nover_speed_rad_s = 200.0\n"))
    assert config.guard.brake_limit == 1.0
    assert config.guard.missed_in_a_row == 200


def test_a_file_of_comments_is_the_defaults(written):
    assert load_config(written("# nothing is different here\n")) == load_config()


def test_a_profile_may_be_a_file(tmp_path):
    profile = tmp_path / "lab.toml"
    profile.write_text('[board]\nlogic_version = 7\napplication_names = ["MYRIG"]\n', encoding="utf-8")
    config = load_config(settings=[f"profile={profile}"])
    assert config.board.application_names == ["MYRIG"]
    assert config.board.logic_version == 7
    assert config.profile == str(profile)
    assert config.guard.brake_limit == 0.7


def test_whole_numbers_are_accepted_where_a_number_is_meant_and_become_one():
    limit = load_config(settings=["guard.over_speed_rad_s=200"]).guard.over_speed_rad_s
    assert (limit, type(limit)) == (200.0, float)


def test_a_configuration_cannot_be_changed():
    config = load_config()
    with pytest.raises(FrozenInstanceError):
        config.guard.brake_limit = 0.9


@pytest.mark.parametrize(("rate_hz", "period_ns"), [(2000, 500_000), (50, 20_000_000), (3000, 333_333)])
def test_the_period_is_the_nearest_whole_nanosecond(rate_hz, period_ns):
    assert load_config(settings=[f"loop.rate_hz={rate_hz}", "estimator.window_s=0.02"]).period_ns == period_ns


# round trip


def assert_survives(config: RigConfig) -> None:
    text = config.to_toml()
    assert parse_config(text) == trusted_config(text) == config
    assert parse_config(text).to_toml() == text


@pytest.mark.parametrize("name", profiles())
def test_the_effective_configuration_of_every_profile_survives_its_text(name):
    assert_survives(load_config(settings=[f"profile={name}"]))


@pytest.mark.untraced
@given(
    brake_limit=st.floats(0.0, 1.0, exclude_min=True),
    window_s=st.floats(0.001, 0.5),
    start=st.floats(10.5, 220.0),
    counts=st.integers(256, 1_000_000),
    verified_by=st.text(st.characters(exclude_categories=["Cs"])),
    gains=st.dictionaries(
        st.text(st.characters(exclude_categories=["Cs"])), st.floats(allow_nan=False, allow_infinity=False)
    ),
)
def test_any_valid_configuration_survives_its_text(brake_limit, window_s, start, counts, verified_by, gains):
    table = tomllib.loads(load_config().to_toml())
    table["guard"]["brake_limit"] = brake_limit
    table["estimator"]["window_s"] = window_s
    table["experiment"]["start_speed_rad_s"] = start
    table["encoders"]["counts_per_turn"] = counts
    table["board"]["verified_by"] = verified_by
    table["controller"]["gains"] = gains
    config = parse_config(tomli_w.dumps(table))
    assert config.guard.brake_limit == brake_limit
    assert config.controller.gains == gains
    assert_survives(config)


def test_a_stored_configuration_without_a_newer_key_decides_as_before_it():
    table = tomllib.loads(load_config(settings=["controller.name=predictive-reaching"]).to_toml())
    assert (table["guard"].pop("run_up_factor"), table["estimator"].pop("longest_dead_time_s")) == (1.5, 0.2)
    older = parse_config(tomli_w.dumps(table))
    assert (older.guard.run_up_factor, older.estimator.longest_dead_time_s) == (None, 0.06)
    assert older.controller.gains == {"release_share": 0.0, "swing_band": 0.0}
    assert_survives(older)


def test_a_stored_configuration_does_not_depend_on_a_profile_file(tmp_path):
    profile = tmp_path / "lab.toml"
    profile.write_text('[board]\nlogic_version = 7\napplication_names = ["MYRIG"]\n', encoding="utf-8")
    text = load_config(settings=[f"profile={profile}"]).to_toml()
    profile.unlink()
    assert parse_config(text).board.logic_version == 7


def test_the_effective_configuration_can_be_used_as_a_file_again(written):
    config = load_config(settings=["guard.brake_limit=0.6", "controller.gains.Mk=10", "loop.rate_hz=1000"])
    assert load_config(written(config.to_toml())) == config


def test_a_stored_configuration_with_mistakes_is_refused_with_all_of_them():
    with pytest.raises(ConfigError) as caught:
        parse_config("[guard]\nbrake_limit = 2.0\n[loop]\nrte_hz = 1.0\n")
    assert {mistake.path for mistake in caught.value.mistakes} == {"board", "guard.brake_limit", "loop.rte_hz"}


def test_a_stored_configuration_that_is_not_toml_is_refused():
    with pytest.raises(ConfigError, match="is not TOML"):
        parse_config("guard = [")


def test_a_stored_configuration_passes_the_checks_too():
    text = load_config(settings=["controller.name=mine"]).to_toml()
    with pytest.raises(ConfigError, match="no controller 'mine'"):
        parse_config(text, checks=[control_check()])


# every mistake at once, in words


def test_five_mistakes_are_reported_with_key_value_and_allowed_range(written):
    file = written(
        """
        profile = "sim_usb2"
        [guard]
        brake_limit = 1.5
        missed_in_arow = 4
        [encoders]
        counts_per_turn = 2048
        [experiment]
        start_speed_rad_s = nan
        hold_s = true
        [board]
        drive_pwm = "0"
        """
    )
    assert mistakes(file=file) == {
        "guard.brake_limit": "1.5: must be a number above 0 and at most 1",
        "guard.missed_in_arow": "unknown key; did you mean missed_in_a_row?",
        "experiment.start_speed_rad_s": "nan: must be a number at least 10 and at most 240 rad/s",
        "experiment.hold_s": "true: must be a number at least 0 and at most 10 s",
        "board.drive_pwm": "'0': must be a whole number at least 0 and at most 7; write it without quotes",
    }


def test_error_lists_every_mistake_and_says_that_nothing_was_started():
    with pytest.raises(ConfigError) as caught:
        load_config(settings=["guard.brake_limit=2", "experiment.hold_s=11"])
    first, *others = str(caught.value).splitlines()
    assert first == "the configuration has 2 mistakes; nothing was started:"
    assert others == [
        "  experiment.hold_s: 11: must be a number at least 0 and at most 10 s",
        "  guard.brake_limit: 2: must be a number above 0 and at most 1",
    ]


def test_a_single_mistake_is_called_one():
    with pytest.raises(ConfigError, match=r"^the configuration has a mistake; nothing was started:\n  guard\."):
        load_config(settings=["guard.brake_limit=2"])


@pytest.mark.parametrize("path", ["--sort", "--set guard.brake_limit", "FILE"])
def test_a_mistake_in_an_option_or_argument_is_one_of_the_command_line(path):
    assert str(ConfigError([ConfigIssue(path, "x")])).startswith(
        "the command line has a mistake; nothing was started:\n"
    )
    mixed = ConfigError([ConfigIssue(path, "x"), ConfigIssue("guard.brake_limit", "x")])
    assert str(mixed).startswith("the configuration has 2 mistakes;")


def test_a_wrong_configuration_is_wrong_usage():
    with pytest.raises(AbsError) as caught:
        load_config(settings=["guard.brake_limit=2"])
    assert caught.value.exit_code == 2


def test_mistakes_of_settings_file_profile_and_checks_come_together(written):
    file = written("profile = 'sim_usb22'\n[guard]\nbrake_limit = 2.0\n")
    with pytest.raises(ConfigError) as caught:
        load_config(file, ["oops", "controller.name=reaching_law"], [control_check()])
    found = {mistake.path for mistake in caught.value.mistakes}
    assert found == {"--set oops", "profile", "guard.brake_limit", "controller.name"}


def test_a_check_sees_the_merged_table_and_its_mistakes_count():
    def check(table):
        yield ConfigIssue("guard.brake_limit", f"{table['guard']['brake_limit']} of {table['board']['logic_version']}")

    with pytest.raises(ConfigError) as caught:
        load_config(settings=["guard.brake_limit=0.25"], checks=[check])
    assert caught.value.mistakes == (ConfigIssue("guard.brake_limit", "0.25 of 259"),)


@pytest.mark.parametrize(
    ("setting", "path", "nearest"),
    [
        ("gaurd.brake_limit=1", "gaurd", "guard"),
        ("guard.brake_limt=1", "guard.brake_limt", "brake_limit"),
        ("guard.overspeed_rad_s=1", "guard.overspeed_rad_s", "over_speed_rad_s"),
        ("controller.refrence_slip=0.1", "controller.refrence_slip", "reference_slip"),
        ("board.road_enc=1", "board.road_enc", "road_encoder"),
        ("profil=sim_usb2", "profil", "profile"),
    ],
)
def test_an_unknown_key_is_named_with_the_nearest_known_one(setting, path, nearest):
    assert mistakes(setting) == {path: f"unknown key; did you mean {nearest}?"}


def test_an_unknown_key_near_nothing_gets_the_known_ones():
    assert mistakes("loop.zzz=1") == {"loop.zzz": "unknown key; known: compiled, pace, rate_hz, ring_s"}


@pytest.mark.parametrize("value", ["true", "false", "nan", "-nan", "inf", "-inf", "1e400", "[0.7]", "1979-05-27", ""])
def test_an_unusable_number_is_refused_with_its_value_and_the_range(value):
    seen = {"": "''", "-nan": "nan", "1e400": "inf"}.get(value, value)
    assert mistakes(f"guard.brake_limit={value}") == {
        "guard.brake_limit": f"{seen}: must be a number above 0 and at most 1"
    }


@pytest.mark.parametrize("value", ["true", "2.0", "nan", "1001", "-1"])
def test_an_unusable_whole_number_is_refused_with_its_value_and_the_range(value):
    assert mistakes(f"guard.missed_in_a_row={value}") == {
        "guard.missed_in_a_row": f"{value}: must be a whole number at least 1 and at most 1000"
    }


@pytest.mark.parametrize(
    "setting",
    [
        pytest.param(f"{key}={'1' * digits}", id=f"{key} with {digits} digits")
        for key in ("experiment.start_speed_rad_s", "guard.bucket_limit", "controller.gains.Mk")
        for digits in (400, 5000)
    ],
)
def test_a_number_too_large_for_any_computer_is_a_mistake_like_another(setting):
    with pytest.raises(ConfigError):
        load_config(settings=[setting], checks=[control_check()])


@pytest.mark.parametrize("key", ["estimator.name", "controller.name", "board.verified_by"])
def test_what_is_not_text_is_refused(key):
    assert mistakes(f"{key}=3") == {key: "3: must be text"}


def test_a_profile_that_is_not_text_is_reported_once():
    assert list(mistakes("profile=3")) == ["profile"]


@pytest.mark.parametrize(
    ("setting", "path", "allowed"),
    [
        ("board.road_sign=2", "board.road_sign", ["1", "-1"]),
        ("board.road_sign=0", "board.road_sign", ["1", "-1"]),
        ("board.pwm_mode=8bit", "board.pwm_mode", ["8-bit", "12-bit"]),
        ("model.parameters=masc", "model.parameters", ["mask", "table"]),
        ("board.pwm_pins=[2, 26]", "board.pwm_pins.1", ["25"]),
    ],
)
def test_a_choice_out_of_a_few_names_them(setting, path, allowed):
    found = mistakes(setting)
    assert list(found) == [path]
    assert all(choice in found[path] for choice in allowed)


@pytest.mark.parametrize(
    ("key", "inside", "outside"),
    [
        ("board.logic_version", [0, 65535], [-1, 65536]),
        ("board.drive_pwm", [0, 6], [-1, 8]),
        ("board.brake_pwm", [1, 6], [-1, 8]),
        ("board.pwm_prescaler", [0, 65535], [-1, 65536]),
        ("board.road_encoder", [0, 11], [-1, 12]),
        ("board.wheel_encoder", [1, 11], [-1, 12]),
        ("board.road_sign", [1, -1], [0, 2]),
        ("board.wheel_sign", [1, -1], [0, 2]),
        ("encoders.counts_per_turn", [256, 1000000], [255, 1000001]),
        ("loop.rate_hz", [50.0, 10000.0], [49.9, 10001.0]),
        ("experiment.idle_s", [0.01, 10.0], [0.009, 10.1]),
        ("experiment.drive_duty", [0.2, 1.0], [0.0, 0.199, 1.001]),
        ("experiment.start_speed_rad_s", [10.0, 220.0], [9.9, 240.1]),
        ("experiment.stop_speed_rad_s", [1e-9, 10.0], [0.0, 10.1]),
        ("experiment.hold_s", [0.0, 10.0], [-0.001, 10.1]),
        ("experiment.spin_up_timeout_s", [0.1, 120.0], [0.09, 121.0]),
        ("experiment.braking_timeout_s", [0.1, 120.0], [0.09, 121.0]),
        ("estimator.window_s", [0.02, 0.5], [0.0, 0.51]),
        ("controller.reference_slip", [0.001, 0.999], [0.0, 1.0]),
        ("controller.hold_below_rad_s", [0.0, 100.0], [-0.1, 100.1]),
        ("guard.brake_limit", [1e-9, 1.0], [0.0, -0.1, 1.001]),
        ("guard.drive_limit", [0.2, 1.0], [0.0, 0.199, 1.001]),
        ("guard.over_speed_rad_s", [201.0, 245.0], [19.9, 245.1]),
        ("guard.missed_in_a_row", [1, 1000], [0, 1001]),
        ("guard.bucket_limit", [3, 3000], [2, 3001]),
        ("simulation.brake_rate_per_s", [1.0, 1e6], [0.9, 1e7]),
    ],
)
def test_ranges_include_their_edges_and_nothing_beyond(key, inside, outside):
    section, _, name = key.partition(".")
    others = ["estimator.window_s=0.02"] if section == "loop" else []
    for value in inside:
        assert getattr(getattr(load_config(settings=[*others, f"{key}={value}"]), section), name) == value
    for value in outside:
        assert list(mistakes(*others, f"{key}={value}")) == [key]


def test_an_over_speed_limit_may_be_as_low_as_20_rad_s():
    settings = ["experiment.start_speed_rad_s=15", "guard.over_speed_rad_s=20"]
    assert load_config(settings=settings).guard.over_speed_rad_s == 20.0


def test_the_over_speed_limit_can_only_be_lowered():
    assert "at most 245" in mistakes("guard.over_speed_rad_s=300")["guard.over_speed_rad_s"]


# --set


@pytest.mark.parametrize(
    ("setting", "section", "key", "value"),
    [
        ("guard.brake_limit=0.7", "guard", "brake_limit", 0.7),
        ("guard.brake_limit = 0.7", "guard", "brake_limit", 0.7),
        (" guard.brake_limit=7e-1", "guard", "brake_limit", 0.7),
        ("board.logic_version=0x0103", "board", "logic_version", 0x0103),
        ("board.logic_version=1_000", "board", "logic_version", 1000),
        ("controller.name=relay", "controller", "name", "relay"),
        ('controller.name="relay"', "controller", "name", "relay"),
        ("controller.name=my controller.py:Class", "controller", "name", "my controller.py:Class"),
        ("controller.name=a=b", "controller", "name", "a=b"),
        ("board.verified_by=", "board", "verified_by", ""),
        ("board.pwm_pins=[1, 2]", "board", "pwm_pins", [1, 2]),
        ("controller.gains.Mk=10", "controller", "gains", {"Mk": 10.0}),
        ("controller.gains={Mk = 10, Mq = 4.0}", "controller", "gains", {"Mk": 10.0, "Mq": 4.0}),
    ],
)
def test_a_setting_is_a_toml_value_or_a_bare_word(setting, section, key, value):
    assert getattr(getattr(load_config(settings=[setting]), section), key) == value


def test_the_last_of_several_settings_of_a_key_wins():
    assert load_config(settings=["guard.brake_limit=5", "guard.brake_limit=0.6"]).guard.brake_limit == 0.6


def test_settings_of_one_section_add_up():
    config = load_config(settings=["controller.gains.Mk=10", "controller.gains.Mq=4"])
    assert config.controller.gains == {"Mk": 10.0, "Mq": 4.0}


@pytest.mark.parametrize("setting", ["guard.brake_limit", "", "=0.7", "guard.=1", ".brake_limit=1", "guard..x=1"])
def test_a_setting_without_key_or_equals_sign_is_shown_with_an_example(setting):
    assert mistakes(setting) == {f"--set {setting}": "must look like guard.brake_limit=0.7"}


def test_a_setting_below_a_value_is_refused(written):
    found = mistakes("profile.name=1", file=written("profile = 'sim_usb2'\n"))
    assert found == {"--set profile.name=1": "profile is a value, not a section"}


def test_a_setting_that_carries_a_second_line_is_not_mistaken_for_its_first():
    assert "guard.brake_limit" in str(mistakes("guard.brake_limit=0.7\nover_speed_rad_s=100"))


# contradictions


@pytest.mark.parametrize(
    ("settings", "path", "other"),
    [
        (["guard.over_speed_rad_s=180"], "experiment.start_speed_rad_s", "guard.over_speed_rad_s"),
        (["guard.over_speed_rad_s=100"], "experiment.start_speed_rad_s", "guard.over_speed_rad_s"),
        (
            ["experiment.start_speed_rad_s=10", "experiment.stop_speed_rad_s=10"],
            "experiment.stop_speed_rad_s",
            "experiment.start_speed_rad_s",
        ),
        (["estimator.window_s=0.0004"], "estimator.window_s", "period"),
        (["estimator.window_s=0.015", "loop.rate_hz=50"], "estimator.window_s", "period"),
        (["board.brake_pwm=0"], "board.brake_pwm", "PWM channel"),
        (["board.drive_pwm=1"], "board.brake_pwm", "PWM channel"),
        (["board.drive_pwm=5", "board.brake_pwm=5"], "board.brake_pwm", "PWM channel"),
        (["board.wheel_encoder=0"], "board.wheel_encoder", "encoder"),
        (["board.road_encoder=1"], "board.wheel_encoder", "encoder"),
    ],
)
def test_values_that_contradict_each_other_are_refused_with_both_names(settings, path, other):
    found = mistakes(*settings)
    assert list(found) == [path]
    assert other in found[path]


def test_values_that_just_do_not_contradict_each_other_are_accepted():
    load_config(settings=["guard.over_speed_rad_s=200.1"])
    load_config(settings=["estimator.window_s=0.0005"])
    load_config(settings=["board.drive_pwm=1", "board.brake_pwm=0"])
    load_config(settings=["estimator.window_s=0.02", "loop.rate_hz=50"])


def test_contradictions_are_reported_together_with_other_mistakes():
    found = mistakes("guard.over_speed_rad_s=100", "board.brake_pwm=0", "guard.brake_limit=9")
    assert set(found) == {"experiment.start_speed_rad_s", "board.brake_pwm", "guard.brake_limit"}


@pytest.mark.parametrize(
    "setting",
    [
        "experiment.start_speed_rad_s='fast'",
        "experiment.start_speed_rad_s=300",
        "guard.over_speed_rad_s=inf",
        "guard.over_speed_rad_s=19.9",
        "loop.rate_hz=1",
        "loop.rate_hz=true",
        "board.drive_pwm=true",
    ],
)
def test_an_invalid_value_is_not_also_reported_as_a_contradiction(setting):
    assert list(mistakes(setting)) == [setting.partition("=")[0]]


@pytest.mark.parametrize("section", ["guard", "experiment", "board", "loop", "estimator", "controller", "simulation"])
@pytest.mark.parametrize("value", ["5", "true", "word", "[1]"])
def test_a_section_that_is_a_value_is_a_mistake_not_a_crash(section, value):
    assert section in mistakes(f"{section}={value}")


# profiles and files


def test_an_unknown_profile_is_named_with_the_nearest():
    assert mistakes("profile=sim_usb22") == {
        "profile": "'sim_usb22' is not a shipped profile or a .toml file; did you mean sim_usb2?"
    }


def test_a_profile_file_with_mistakes_is_like_any_other(tmp_path):
    profile = tmp_path / "lab.toml"
    profile.write_text("[board]\nlogic_version = -1\n[guard]\nbrake_limt = 1.0\n", encoding="utf-8")
    assert mistakes(f"profile={profile}") == {
        "board.logic_version": "-1: must be a whole number at least 0 and at most 65535",
        "guard.brake_limt": "unknown key; did you mean brake_limit?",
    }


@pytest.mark.parametrize(
    ("content", "line"), [("[guard\n", 1), ("a = 1\nb =\n", 2), ("a = 1\na = 2\n", 2), ("[a]\n[a]\n", 2)]
)
def test_what_is_not_toml_is_named_with_its_line(written, content, line):
    file = written(content)
    found = mistakes(file=file)
    assert list(found) == [str(file)]
    assert found[str(file)].startswith("is not TOML: ")
    assert f"line {line}" in found[str(file)]


def test_a_file_nested_beyond_reason_is_a_mistake_not_a_crash(written):
    file = written("a = " + "[" * 100_000)
    assert list(mistakes(file=file)) == [str(file)]


def test_a_file_that_is_far_too_large_is_not_read(written):
    file = written(b"#" * 1_000_001)
    assert mistakes(file=file) == {str(file): "is larger than 1000000 bytes; is it a configuration?"}


def test_a_file_of_the_largest_size_is_read(written):
    assert load_config(written(b"#" * 1_000_000)) == load_config()


def test_numbers_keep_their_last_digit_through_the_text():
    third = math.nextafter(1.0 / 3.0, 1.0)
    assert parse_config(load_config(settings=[f"guard.brake_limit={third!r}"]).to_toml()).guard.brake_limit == third


# what a message says of type, range, unit and place


@pytest.mark.parametrize(
    ("setting", "must_be"),
    [
        ("loop.rate_hz=abc", "must be a number at least 50 and at most 10000 Hz"),
        ("estimator.window_s=true", "must be a number above 0 and at most 0.5 s"),
        ("guard.run_up_factor=abc", "must be a number at least 1.1 and at most 10"),
        ("board.simulated=1", "must be true or false"),
        ("board.verified_on=3", "must be a date such as 2026-01-31"),
        ("board.pwm_mode=8", 'must be one of "8-bit", "12-bit"'),
        ("board.pwm_pins=x", "must be a list of values, each a whole number at least 0 and at most 25"),
        ("board.pwm_pins.0=x", "must be a list of values, each a whole number at least 0 and at most 25"),
        ("board.pwm_pins=[99]", "must be a whole number at least 0 and at most 25"),
        ("board.application_names=[1]", "must be text"),
        ("board.constants=3", "must be a table of values, each a whole number at least 0 and at most 4294967295"),
        ("board.constants.w31=-1", "must be a whole number at least 0 and at most 4294967295"),
        ("board.evidence=3", "must be a table of values, each a section"),
        ("model.identified.J1=abc", "must be a number above 0 and at most 1000000"),
        ("model.identified.brake_duties=[0.5]", "must be a list of at least 2 values, each a number at least 0"),
        ("model.identified.brake_torques_nm=[0,true]", "must be a number at least 0 and at most 100"),
        ("board.numbering_pins=[1,2,3,4,5,6,7,8,9]", "must be a list of at most 8 values, each a whole number"),
        ("controller.gains=3", "must be a table of values, each a number"),
        ("controller.gains.Mk=abc", "'abc': must be a number in 0..1000 1/s (prop"),
        ("controller.gains.Mk=true", "true: must be a number in 0..1000 1/s"),
        ("controller.gains.Mk=nan", "nan: must be a number in 0..1000 1/s"),
        ("controller.gains.lag_s=10ms", "'10ms': must be a number in 0..0.2 s (lag"),
        (f"controller.gains.Mk=0x{'f' * 4000}", "absurdly many digits: must be a number in 0..1000 1/s"),
    ],
    ids=lambda text: text[:40],
)  # fmt: skip
def test_a_value_of_a_wrong_type_gets_an_error_with_type_range_and_unit(setting, must_be):
    with pytest.raises(ConfigError) as caught:
        load_config(settings=[setting], checks=[control_check()])
    assert must_be in str(caught.value)


@pytest.mark.parametrize(
    ("text", "key", "line"),
    [
        ("[guard]\n\n# limit\nbrake_limit = 9\n", "guard.brake_limit", 4),
        ("guard.brake_limit = 9", "guard.brake_limit", 1),
        ("\r\n[guard]\r\nbrake_limit = 9\r\n", "guard.brake_limit", 3),
        ("guard = { drive_limit = 0.7, brake_limit = 9 }\n", "guard.brake_limit", 1),
        ("[ guard ] # x\n'brake_limit' = 9\n", "guard.brake_limit", 2),
        ("[session]\nspill = '''\n[guard]\nbrake_limit = 9\n'''\n[guard]\nbrake_limit = 8\n", "guard.brake_limit", 7),
        ("[controller.gains]\nMk = 1\nMq = -1\n", "controller.gains.Mq", 3),
        ("[board]\npwm_pins = [\n  2,\n  99,\n]\n", "board.pwm_pins.1", 2),
        ("[experiment]\nidle_s = 1\n[gurad]\nbrake_limit = 1\n", "gurad", 3),
        ("[guard]\nx = 1\n[guard.deep]\ny = 1\n", "guard.deep", 3),
    ],
)
def test_a_mistake_in_a_file_names_the_file_and_the_line_beside_the_key(written, text, key, line):
    file = written(text)
    with pytest.raises(ConfigError, match=rf"(?m)^  {key} \({file}, line {line}\): "):
        load_config(file, checks=[control_check()])


def test_mistake_names_the_profile_unless_file_or_command_line_set_the_key(tmp_path, written):
    profile = tmp_path / "lab.toml"
    profile.write_text("[board]\nlogic_version = 1\n[guard]\nbrake_limit = 7\n")
    named = f'profile = "{profile}"\n'
    for text, setting, place in (
        (named, "guard.drive_limit=0.5", f"{profile}, line 4"),
        (f"{named}[guard]\nbrake_limit = 8\n", "guard.drive_limit=0.5", f"{written('')}, line 3"),
        (f"{named}[guard]\nbrake_limit = 8\n", "guard.brake_limit=9", ""),
    ):
        with pytest.raises(ConfigError) as caught:
            load_config(written(text), [setting])
        assert [mistake.place for mistake in caught.value.mistakes] == [place]


def test_a_value_of_too_many_lines_has_its_message_but_no_line(written):
    file = written("[guard]\nbrake_limit = [" + "\n1," * 5000 + "]\n")
    assert mistakes(file=file)["guard.brake_limit"].endswith("must be a number above 0 and at most 1")
