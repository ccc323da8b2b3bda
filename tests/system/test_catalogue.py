import inspect
import json
import tomllib
from pkgutil import resolve_name

import pytest

from inteco_abs.config import EstimatorConfig, load_config, profiles
from inteco_abs.control import CONTROLLERS, ESTIMATORS, control_check, gains_in_force, preferred_estimator
from inteco_abs.errors import ConfigError
from inteco_abs.mock_board.faults import KINDS
from inteco_abs.published import PUBLISHED

CLASSES = CONTROLLERS | {name: resolve_name(place) for name, place in PUBLISHED.items()}


@pytest.fixture
def inteco_abs(main_here):
    return main_here


def test_every_controller_is_listed_with_a_line_and_its_gains(inteco_abs):
    text = inteco_abs("controllers", check=0).stdout
    found = json.loads(inteco_abs("controllers", "--json", check=0).stdout)["controllers"]
    assert list(found) == list(CLASSES)
    for name, one in found.items():
        assert f"\n{name} " in f"\n{text}"
        assert f"\n{name:19} {one['summary']}" in f"\n{text}"
        assert [gain["name"] for gain in one["gains"]] == [gain.name for gain in CLASSES[name].gains]


def test_every_profile_is_listed_with_the_reasons_it_is_read_only(inteco_abs):
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


def test_every_estimator_is_listed_with_its_configured_parameters(inteco_abs):
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


def toml_of(text):
    return tomllib.loads(text.partition("in rig.toml, with the defaults:")[2])


@pytest.mark.parametrize("name", CONTROLLERS)
def test_one_controller_is_described_with_lines_that_set_it(inteco_abs, tmp_path, name):
    text = inteco_abs("controllers", name, check=0).stdout
    assert inspect.getdoc(CONTROLLERS[name]) in text
    for gain in CONTROLLERS[name].gains:
        assert f"{gain.name} = {gain.default:g}" in text
        assert gain.meaning in text
    (tmp_path / "rig.toml").write_text(text.partition("in rig.toml, with the defaults:")[2])
    rig = load_config(tmp_path / "rig.toml", checks=[control_check()], follows=preferred_estimator())
    assert (rig.controller.name, rig.controller.gains) == (name, gains_in_force(rig))


@pytest.mark.parametrize("name", ESTIMATORS)
def test_one_estimator_is_described_with_lines_that_set_it(inteco_abs, name):
    text = inteco_abs("estimators", name, check=0).stdout
    assert ESTIMATORS[name].summary in text
    assert inspect.getdoc(ESTIMATORS[name].works) in text
    values = {each.name: each.default for each in ESTIMATORS[name].parameters}
    assert ("nothing to set" in text) is (not values)
    assert toml_of(text) == {"estimator": {"name": name, **values}}


def test_the_description_of_a_controller_has_its_requirement(inteco_abs):
    assert "works with the estimator observer only" in inteco_abs("controllers", "predictive-reaching", check=0).stdout
    report = json.loads(inteco_abs("controllers", "predictive-reaching", "--json", check=0).stdout)
    assert (report["name"], report["estimator"]) == ("predictive-reaching", "observer")


def test_a_users_file_is_described_without_running_it(inteco_abs, tmp_path):
    law = "class Law:\n    'Mine.'\n    gains = internals = ()\n    def update(self, estimate, dt_s): ...\n"
    (tmp_path / "law.py").write_text(law)
    report = json.loads(inteco_abs("controllers", "law.py:Law", "--json", check=0).stdout)
    assert (report["text"], tomllib.loads(report["toml"])) == ("Mine.", {"controller": {}})


@pytest.mark.parametrize(("verb", "name", "near"), [("controllers", "pid", "pi"), ("estimators", "kalmann", "kalman")])
def test_an_unknown_name_suggests_the_nearest(inteco_abs, verb, name, near):
    assert f"did you mean {near}?" in inteco_abs(verb, name, check=2).stderr


@pytest.mark.parametrize("group", [(), ("config",), ("golden",), ("wire",)])
def test_help_prints_the_whole_sentence_of_every_verb(inteco_abs, monkeypatch, group):
    monkeypatch.setenv("COLUMNS", "80")
    text = inteco_abs(*group, "--help", check=0).stdout
    listed = text.partition("-h, --help")[2]
    assert listed.count("\n  ") > len(group)
    assert "..." not in listed
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize(("verb", "option"), [("doctor", "--seconds"), ("mock-board", "--serial")])
def test_help_gives_a_number_without_limits_no_range(inteco_abs, verb, option):
    assert option in (text := inteco_abs(verb, "--help", check=0).stdout)
    assert "None" not in text


def test_an_unknown_verb_of_a_group_is_reported_with_the_nearest(inteco_abs):
    assert "no command 'tst'; did you mean test?" in inteco_abs("golden", "tst", check=2).stderr


def test_every_fault_is_in_the_json_with_the_range_of_its_value(inteco_abs):
    report = json.loads(inteco_abs("faults", "--json", check=0).stdout)
    assert report["faults"].keys() == KINDS.keys()
    assert (report["faults"]["late"]["value"]["low"], report["faults"]["late"]["value"]["unit"]) == (0.001, "ms")
    assert (report["faults"]["reset"]["value"]["low"], report["faults"]["reset"]["value"]["words"][0]) == (None, "zero")
    assert report["events"] == ["start", "drive", "coast", "brake"]
