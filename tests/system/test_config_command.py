"""The verbs `inteco-abs config` and `inteco-abs completion`."""

import json
import os
import shutil
import subprocess
import tomllib
from dataclasses import asdict

import pytest

from inteco_abs.cli.command import cli
from inteco_abs.config import load_config
from inteco_abs.config.explain import all_keys
from inteco_abs.control import CONTROLLERS
from inteco_abs.errors import ConfigError


@pytest.fixture
def said(capsys):
    """Runs a verb in this process and gives what it printed."""

    def run(*arguments):
        cli.main(list(arguments), standalone_mode=False)
        return capsys.readouterr().out

    return run


@pytest.fixture
def begun(said, tmp_path):
    path = tmp_path / "rig.toml"
    said("config", "init", str(path))
    return path


def test_a_begun_file_changes_nothing(begun):
    assert load_config(begun) == load_config()


def test_every_default_in_a_begun_file_is_the_default(begun):
    lines = begun.read_text().splitlines()
    settings = "\n".join(line.removeprefix("# ") for line in lines if " = " in line or line.startswith("["))
    below, model = tomllib.loads(settings), load_config().as_table()
    assert below["loop"]["rate_hz"] == 2000.0
    profile = {"missed_in_a_row", "bucket_limit", "silence_s", "brake_limit"}  # the simulated board's are lenient
    for section, values in below.items():
        if isinstance(values, dict):
            assert {k: v for k, v in values.items() if k not in profile} == {
                k: model[section][k] for k in values if k not in profile
            }


def test_a_file_is_begun_once(begun, said):
    text = begun.read_text()
    with pytest.raises(ConfigError, match="exists already"):
        said("config", "init", str(begun))
    assert begun.read_text() == text


def test_a_shown_configuration_is_the_one_that_runs(said, tmp_path):
    (tmp_path / "rig.toml").write_text("[guard]\nbrake_limit = 0.5\n")
    arguments = ["--config", str(tmp_path / "rig.toml"), "--set", "loop.rate_hz=1000.0"]
    for more in ([], ["--origin"]):
        (tmp_path / "shown.toml").write_text(said("config", "show", *arguments, *more))
        assert load_config(tmp_path / "shown.toml") == load_config(tmp_path / "rig.toml", ["loop.rate_hz=1000.0"])


def test_origins_are_the_nearest_that_set_a_value(said, tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text("[guard]\nbrake_limit = 0.5\ndrive_limit = 0.9\n")
    lines = said("config", "show", "--origin", "--config", str(file), "--set", "guard.drive_limit=0.8").splitlines()
    assert f"brake_limit = 0.5  # {file}" in lines
    assert "drive_limit = 0.8  # command line" in lines
    assert "missed_in_a_row = 200  # profile sim_usb2" in lines
    assert "rate_hz = 2000.0" in lines


def test_what_is_shown_is_checked_first(said):
    with pytest.raises(ConfigError, match=r"guard\.brake_limit: 7: must be a number above 0 and at most 1"):
        said("config", "show", "--set", "guard.brake_limit=7")
    with pytest.raises(ConfigError, match="Mx: unknown gain"):
        said("config", "show", "--set", "controller.gains.Mx=7")


def test_a_key_is_explained_with_range_default_and_profile(said):
    text = said("config", "explain", "guard.brake_limit")
    for part in ("Largest brake duty", "above 0 and at most 1", "default 0.7", "profile sim_usb2: 1.0"):
        assert part in text


def test_a_gain_is_explained_for_every_controller_that_has_it(said):
    text = said("config", "explain", "controller.gains.Mq")
    for name, controller in CONTROLLERS.items():
        assert (f"of {name}:" in text) is any(gain.name == "Mq" for gain in controller.gains)


def test_a_list_of_gains_names_the_controller_of_each(said):
    lines = said("config", "explain", "controller.gains").splitlines()
    assert [line.rpartition(", of ")[2] for line in lines if line.startswith("controller.gains.Mk ")] == [
        name for name, controller in CONTROLLERS.items() if any(gain.name == "Mk" for gain in controller.gains)
    ]
    assert len(set(lines)) == len(lines)


@pytest.mark.parametrize("section", ["guard", "[guard]", "board"])
def test_a_section_lists_its_keys(said, section):
    name = section.strip("[]")
    lines = said("config", "explain", section).splitlines()
    assert [line.split(":")[0].split(" =")[0] for line in lines] == [
        key.path for key in all_keys(CONTROLLERS) if key.path.startswith(f"{name}.")
    ]


@pytest.mark.parametrize(
    ("asked", "hint"),
    [
        ("brake_limit", "did you mean guard.brake_limit?"),
        ("gard", "did you mean guard?"),
        ("", "KEY: is not a key of rig.toml; known: board, controller, "),
        (
            "nonsense",
            "is not a key of rig.toml; known: board, controller, description, encoders, estimator, experiment, ",
        ),
    ],
)
def test_an_unknown_key_is_reported_with_the_nearest(said, asked, hint):
    with pytest.raises(ConfigError) as caught:
        said("config", "explain", asked)
    assert hint in str(caught.value)


def test_every_key_has_a_meaning_and_a_kind():
    without = [key.path for key in all_keys(CONTROLLERS) if not (key.meaning and key.kind)]
    assert without == []


def test_the_schema_has_every_section(said):
    schema = json.loads(said("config", "schema"))
    assert set(schema["properties"]) == set(asdict(load_config()))
    assert schema["$defs"]["GuardConfig"]["properties"]["brake_limit"]["maximum"] == 1.0


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("run --controller pred", ["predictive-reaching"]),
        ("run --estimator edge", ["edge-time"]),
        ("run --set guard.brake", ["guard.brake_limit"]),
        pytest.param("run --rig har", ["hard:0"], marks=pytest.mark.long),
        pytest.param("run --inject brake-w", ["brake-weak="], marks=pytest.mark.long),
        pytest.param("config explain loop.", ["loop.rate_hz", "loop.pace", "loop.ring_s"], marks=pytest.mark.long),
        ("val", ["validate"]),
    ],
)
def test_bash_completes(command_path, words, offered):
    if shutil.which("bash") is None:
        pytest.fail("bash is needed: install it")
    typed = ["inteco-abs", *words.split()]
    script = f"""
        eval "$(inteco-abs completion bash)"
        COMP_WORDS=({" ".join(typed)}); COMP_CWORD={len(typed) - 1}
        _inteco_abs_completion inteco-abs
        printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    path = f"{command_path.parent}{os.pathsep}{os.environ['PATH']}"
    shell = subprocess.run(
        ["bash", "-c", script], env={**os.environ, "PATH": path}, capture_output=True, text=True, timeout=60, check=True
    )
    assert shell.stdout.split() == offered


def test_what_is_shown_as_json_is_the_configuration_with_its_origins(said, tmp_path):
    (tmp_path / "rig.toml").write_text("[guard]\nbrake_limit = 0.6\n")
    arguments = ("--config", str(tmp_path / "rig.toml"), "--set", "loop.rate_hz=1000.0")
    report = json.loads(said("config", "show", *arguments, "--json"))
    shown = tomllib.loads(said("config", "show", *arguments))
    assert {**report["config"], "board": None} == {**shown, "board": None}
    assert report["config"]["board"]["verified_on"] == str(shown["board"]["verified_on"])
    assert report["origins"]["guard.brake_limit"] == str(tmp_path / "rig.toml")
    assert report["origins"]["loop.rate_hz"] == "command line"


@pytest.mark.long
def test_every_key_is_explained_as_json_with_the_profiles_evidence(said):
    keys = [(key.path.partition(".")[0], key.path, key.meaning) for key in all_keys(CONTROLLERS)]
    for each in {section for section, _, _ in keys}:
        found = json.loads(said("config", "explain", each, "--json"))["keys"]
        explained = {(one["path"], one["meaning"]) for one in found}
        assert {(path, meaning) for section, path, meaning in keys if section == each} <= explained
    (limit,) = json.loads(said("config", "explain", "guard.missed_in_a_row", "--json"))["keys"]
    assert (limit["default"], limit["profile"]) == (4, load_config().guard.missed_in_a_row)
