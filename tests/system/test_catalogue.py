import json
import tomllib

import pytest

from inteco_abs.config import EstimatorConfig, load_config, profiles
from inteco_abs.control import CONTROLLERS, ESTIMATORS
from inteco_abs.errors import ConfigError


@pytest.fixture
def inteco_abs(main_here):
    return main_here


def test_every_controller_is_listed_with_a_line_and_its_gains(inteco_abs):
    text = inteco_abs("controllers", check=0).stdout
    found = json.loads(inteco_abs("controllers", "--json", check=0).stdout)["controllers"]
    assert found.keys() == CONTROLLERS.keys()
    for name, one in found.items():
        assert f"\n{name} " in f"\n{text}"
        assert f"\n{name:19} {one['summary']}" in f"\n{text}"
        assert [gain["name"] for gain in one["gains"]] == [gain.name for gain in CONTROLLERS[name].gains]


def test_every_profile_is_listed_with_what_stands_between_it_and_outputs(inteco_abs):
    text = inteco_abs("profiles", check=0).stdout
    found = json.loads(inteco_abs("profiles", "--json", check=0).stdout)["profiles"]
    assert list(found) == profiles()
    assert found["usb2_generic_0103"]["unconfirmed"]
    assert found["usb2_tras"]["read_only"] in text
    assert found["sim_usb2"]["verified_by"]


def test_a_profile_is_printed_whole_for_a_lab_to_begin_with(inteco_abs, tmp_path):
    text = inteco_abs("profiles", "usb2_generic_0103", check=0).stdout
    assert tomllib.loads(text)["board"]["logic_version"] == 0x0103
    assert text.startswith("#")
    (tmp_path / "lab.toml").write_text(text, encoding="utf-8")
    run = inteco_abs("run", "--virtual", "--set", "profile=lab.toml", check=1)
    assert "reading only" in run.stderr


def test_a_profile_that_does_not_exist_is_named_with_the_nearest(inteco_abs):
    run = inteco_abs("profiles", "usb2_generic_103", check=2)
    assert "did you mean usb2_generic_0103" in run.stderr


def test_every_estimator_is_listed_with_its_parameters_as_the_configuration_has_them(inteco_abs):
    text = inteco_abs("estimators", check=0).stdout
    found = json.loads(inteco_abs("estimators", "--json", check=0).stdout)["estimators"]
    assert found.keys() == ESTIMATORS.keys()
    for name, one in found.items():
        assert f"\n{name} " in f"\n{text}"
        assert one["summary"] in text
        for parameter in one["parameters"]:
            assert parameter["default"] == getattr(EstimatorConfig(), parameter["name"])
            assert f"{parameter['name']} = {parameter['default']:g}" in text
            for outside in (parameter["low"] - 1e-3, parameter["high"] * 1.001):
                with pytest.raises(ConfigError):
                    load_config(settings=[f"estimator.{parameter['name']}={outside}"])


def test_every_estimator_is_named_in_the_help_of_run(inteco_abs):
    text = inteco_abs("run", "--help", check=0).stdout
    for name in ESTIMATORS:
        assert name in " ".join(text.split())


@pytest.mark.parametrize("group", [(), ("config",), ("golden",), ("wire",)])
def test_help_says_of_every_verb_its_whole_sentence(inteco_abs, monkeypatch, group):
    monkeypatch.setenv("COLUMNS", "80")
    text = inteco_abs(*group, "--help", check=0).stdout
    assert "Commands:" in text
    assert "..." not in text.partition("Commands:")[2]
    assert max(map(len, text.splitlines())) <= 80


def test_a_verb_of_a_group_that_is_none_is_told_with_the_nearest(inteco_abs):
    assert "no command 'tst'; did you mean test?" in inteco_abs("golden", "tst", check=2).stderr
