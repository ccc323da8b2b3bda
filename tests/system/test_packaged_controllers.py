"""Controllers and estimators of installed packages, named by entry points: listed, run, replayed, or refused."""

import json
import os
import re
import subprocess
import sys

import pytest
from live import QUICK

from inteco_abs.config import load_config
from inteco_abs.control import CONTROLLERS, control_check
from inteco_abs.errors import ConfigError
from inteco_abs.plugins import Controllers, installed_controllers
from inteco_abs.sessions import read_session

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

LAW = '''
from pathlib import Path
from inteco_abs.control import Gain
from inteco_abs.signals import BrakeDemand

print("imported")
Path(__file__).with_suffix(".imported").touch()


class Threshold:
    """Brake on below the reference."""

    gains = (Gain("duty", 0.7, 0.0, 1.0, "1", "duty while the slip is low"),)
    internals = ()

    def __init__(self, setup, duty):
        self.reference, self.duty = setup.reference_slip, duty

    def update(self, estimate, dt_s):
        return BrakeDemand(self.duty if estimate.slip < self.reference else 0.0)
'''
SETS = [word for setting in QUICK for word in ("--set", setting)]


class Site:
    """A folder on the path with installed packages, as pip leaves them."""

    def __init__(self, folder):
        self.folder = folder
        self.environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])}

    def install(
        self,
        name="abs-threshold",
        version="1.2",
        entries=("threshold = threshold_law:Threshold",),
        group="controllers",
        **modules,
    ):
        info = self.folder / f"{name.replace('-', '_')}-{version}.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        (info / "entry_points.txt").write_text("\n".join([f"[inteco_abs.{group}]", *entries, ""]))
        for module, source in (modules or {"threshold_law": LAW}).items():
            (self.folder / f"{module}.py").write_text(source)
        return info

    @property
    def imported(self):
        return [mark.stem for mark in self.folder.glob("*.imported")]


@pytest.fixture
def site(tmp_path):
    folder = tmp_path / "site"
    folder.mkdir()
    return Site(folder)


@pytest.fixture
def here(site, monkeypatch):
    """The same folder on the path of this very process; what it imports is forgotten afterwards."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(site.folder)
    yield site
    for name in set(sys.modules) - before:
        del sys.modules[name]


def problem_of(name) -> str:
    known = installed_controllers()
    with pytest.raises(ConfigError) as caught:
        known.load(known.packaged[name])
    return caught.value.mistakes[0].problem


def test_it_is_listed_with_its_package_and_gains(main_here, here):
    here.install()
    text = main_here("controllers", check=0).stdout
    assert re.search(r"^threshold +Brake on below the reference \[abs-threshold 1\.2\]$", text, re.MULTILINE)
    assert "duty = 0.7  0..1: duty while the slip is low" in text


@pytest.fixture(scope="module")
def recorded(command_path, tmp_path_factory):
    """Session of a run with that controller, and what the run printed."""
    folder = tmp_path_factory.mktemp("recorded")
    site = Site(folder)
    site.install()
    arguments = ["--controller", "threshold", "--set", "controller.gains.duty=0.8", *SETS, "--out", "stop.mcap"]
    run = subprocess.run(
        [command_path, "run", "--virtual", "--json", *arguments],
        cwd=folder, env=site.environment, capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    return folder / "stop.mcap", run.stdout


def test_it_runs_by_its_name_and_is_kept_with_package_gains_and_source(recorded):
    path, printed = recorded
    assert json.loads(printed)["controller"] == "threshold"
    session = read_session(path)
    assert session.metadata["controller"]["package"] == "abs-threshold 1.2"
    assert session.metadata["controller"]["gain.duty"] == "0.8"
    assert session.attachments["controller.py"] == LAW.encode()


def test_a_replay_finds_it_by_the_name_in_the_session(main_here, here, recorded):
    here.install()
    again = main_here("replay", recorded[0], "--json", check=0)
    assert json.loads(again.stdout)["differing"] == 0
    assert again.stderr == "imported\n"


def test_a_replay_without_the_package_is_refused_with_its_name(main_here, recorded):
    without = main_here("replay", recorded[0], check=2)
    assert "'threshold' of the package 'abs-threshold 1.2', which is not installed" in without.stderr


def test_a_replay_reports_a_changed_package_or_source(main_here, here, recorded):
    here.install(version="1.3", threshold_law=LAW + "\n# changed\n")
    again = main_here("replay", recorded[0], check=0)
    assert "was run with abs-threshold 1.2; this is abs-threshold 1.3" in again.stderr
    assert "the controller's source differs from the session's" in again.stderr


@pytest.mark.long
def test_a_replay_with_a_broken_package_says_why(inteco_abs, site, recorded):
    site.install(threshold_law="import no_such_module\n")
    again = inteco_abs("replay", recorded[0], check=2, environment=site.environment)
    assert "No module named 'no_such_module'" in again.stderr


@pytest.mark.long
@pytest.mark.xdist_group("real time")
def test_it_runs_in_real_time(command_path, site, untraced, tmp_path):
    site.install()
    run = subprocess.run(
        [command_path, "run", "--controller", "threshold", *SETS, "--out", "stop.mcap", "--json"],
        cwd=tmp_path,
        env=untraced | {"PYTHONPATH": site.environment["PYTHONPATH"]},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert json.loads(run.stdout)["outcome"] == "completed", run.stderr
    session = read_session(tmp_path / "stop.mcap")
    assert session.metadata["controller"]["package"] == "abs-threshold 1.2"
    assert session.attachments["controller.py"] == LAW.encode()


def test_a_configuration_may_name_it(main_here, here, tmp_path):
    here.install()
    (tmp_path / "rig.toml").write_text('[controller]\nname = "threshold"\ngains = { duty = 1.5 }\n')
    run = main_here("run", "--virtual", "--config", "rig.toml", check=2)
    assert "controller.gains.duty (rig.toml, line 3): 1.5: must be a number in 0..1" in run.stderr


@pytest.mark.parametrize("arguments", [["run", "--help"], ["profiles"]])
def test_nothing_is_imported_by_verbs_that_need_none(main_here, here, arguments):
    here.install()
    main_here(*arguments, check=0)
    assert here.imported == []


def test_nothing_is_imported_but_what_was_requested(here):
    here.install()
    here.install("abs-other", "0.1", ["other = other_law:Threshold"], other_law=LAW)
    controllers = Controllers()
    assert {"relay", "threshold", "other"} <= set(controllers)
    assert len(controllers) >= len(CONTROLLERS) + 2
    assert "no-such" not in controllers
    with pytest.raises(ConfigError, match="no controller 'treshold'; did you mean threshold"):
        load_config(settings=["controller.name=treshold"], checks=[control_check(controllers)])
    assert controllers["relay"] is CONTROLLERS["relay"]
    assert here.imported == []
    assert controllers["threshold"].__name__ == "Threshold"
    assert here.imported == ["threshold_law"]


def test_a_shipped_name_stays_the_shipped_controllers(main_here, here):
    here.install("abs-relay", "0.1", ["relay = relay_law:Threshold"], relay_law=LAW)
    text = main_here("controllers", check=0).stdout
    assert re.search(r"^relay +Brake on while the slip is below the reference", text, re.MULTILINE)
    assert "broken: relay of the package abs-relay 0.1: a controller of this name ships" in text
    assert here.imported == []


def test_a_name_that_two_packages_offer_is_refused_with_both(here):
    here.install()
    here.install("abs-second", "0.1", ["threshold = second_law:Threshold"], second_law=LAW)
    problem = problem_of("threshold")
    assert "abs-threshold 1.2" in problem
    assert "abs-second 0.1" in problem
    assert here.imported == []


def test_a_package_found_twice_is_not_a_collision(here, tmp_path, monkeypatch):
    later = Site(tmp_path / "later")
    later.install(version="1.1")
    monkeypatch.syspath_prepend(later.folder)
    monkeypatch.syspath_prepend(here.folder)
    here.install()
    offer = installed_controllers().packaged["threshold"]
    assert (offer.package, offer.problem) == ("abs-threshold 1.2", "")


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("raise SystemExit('leaving')", "SystemExit: leaving"),
        ("raise ValueError", "ValueError"),
        ("class Other: pass", "AttributeError"),
        ("def Threshold(): pass", "is not a class"),
        ("class Threshold: pass", "has no method update"),
        (LAW.replace("    gains =", "    others ="), "gains must be a tuple of inteco_abs.control.Gain"),
        (LAW.replace("internals = ()", "internals = ('a',) * 5"), "internals must be a tuple of at most 4"),
        (LAW.replace("internals =", "estimator = 3\n    internals ="), "estimator must be the name of the estimator"),
        (LAW.replace('"duty", 0.7', '"duty", 1.7'), "'duty': the default 1.7 must be in its range 0..1"),
        (LAW.replace('"duty", 0.7', '"duty", "0.7"'), "'duty': low, default and high are (0.0, '0.7', 1.0)"),
        (LAW.replace("0.0, 1.0,", "0.0, float('inf'),"), "must be finite numbers"),
        (LAW.replace('Gain("duty"', 'Gain("lambda"'), "'lambda': must be a valid name of a constructor's argument"),
        (LAW.replace('"1", "duty', '1, "duty'), "'duty': unit and meaning must be text"),
    ],
)
def test_a_broken_controller_is_refused_with_its_reason(here, source, words):
    here.install(threshold_law=source + "\n")
    problem = problem_of("threshold")
    assert problem.startswith("threshold of the package abs-threshold 1.2: ")
    assert words in problem


def test_a_broken_package_is_listed_as_broken_and_others_still_work(main_here, here):
    here.install()
    here.install("abs-broken", "0.1", ["broken = broken_law:Law", "worse = 7"], broken_law="import no_such_module\n")
    found = json.loads(main_here("controllers", "--json", check=0).stdout)
    assert found["controllers"]["threshold"]["package"] == "abs-threshold 1.2"
    assert found["controllers"]["threshold"]["gains"][0]["name"] == "duty"
    assert found["controllers"]["relay"]["package"] == ""
    assert {each["name"]: each["package"] for each in found["broken"]} == {
        "broken": "abs-broken 0.1",
        "worse": "abs-broken 0.1",
    }
    assert "no_such_module" in found["broken"][0]["problem"]
    run = main_here("run", "--virtual", "--controller", "broken", check=2)
    assert "controller.name: broken of the package abs-broken 0.1: ModuleNotFoundError" in run.stderr


@pytest.mark.parametrize("data", [b"[inteco_abs.controllers]\nno equals sign\n", b"\xff\xfe[inteco_abs.controllers]"])
def test_a_package_whose_list_cannot_be_read_is_passed_over(here, data):
    here.install()
    (here.install("abs-odd", "0.1") / "entry_points.txt").write_bytes(data)
    assert installed_controllers().packaged["threshold"].package == "abs-threshold 1.2"


def test_the_source_is_that_of_the_module_that_defines_the_class(here):
    here.install(
        entries=["threshold = front_law:Threshold"], front_law="from threshold_law import *\n", threshold_law=LAW
    )
    controllers = Controllers()
    assert controllers.origin("threshold") == (LAW.encode(), "abs-threshold 1.2")
    (here.folder / "threshold_law.py").unlink()
    assert controllers.origin("threshold") == (b"", "abs-threshold 1.2")
    assert controllers.origin("relay") == (b"", "")


ESTIMATORS = """
from inteco_abs.control import ESTIMATORS, EstimatorSpec


class Broken:
    def update(self, sample, command):
        raise RuntimeError("no speed today")


SAME = EstimatorSpec("Mean speed under another name", (), ESTIMATORS["moving-window"].make, object)
BROKEN = EstimatorSpec("Fails at its first sample", (), lambda config, parameters: Broken(), Broken)
"""


@pytest.fixture
def estimators(site):
    """Environment with a package of three estimators, one of which is none."""
    entries = ("same = my_estimators:SAME", "broken = my_estimators:BROKEN", "none = my_estimators:Broken")
    site.install("my-estimators", entries=entries, group="estimators", my_estimators=ESTIMATORS)
    return site.environment


def test_a_packages_estimator_is_listed_and_its_run_replays_only_with_it(main_here, inteco_abs, estimators):
    listed = json.loads(inteco_abs("estimators", "--json", check=0, environment=estimators).stdout)
    assert listed["estimators"]["same"]["summary"] == "Mean speed under another name"
    assert [one["name"] for one in listed["broken"]] == ["none"]
    run = ("run", "--virtual", "--json", *SETS, "--out")
    own = inteco_abs(*run, "same.mcap", "--set", "estimator.name=same", check=0, environment=estimators)
    slips = [json.loads(one.stdout)["slip_rms_true"] for one in (main_here(*run, "window.mcap", check=0), own)]
    assert slips[0] == slips[1]
    inteco_abs("replay", "same.mcap", check=0, environment=estimators)
    assert "no estimator 'same'" in inteco_abs("replay", "same.mcap", check=1).stderr


def test_a_plugin_estimator_of_a_wrong_type_is_refused_at_start(inteco_abs, estimators):
    run = inteco_abs("run", "--virtual", "--set", "estimator.name=none", check=2, environment=estimators)
    assert "none of the package my-estimators 1.2: my_estimators:Broken is not an inteco_abs.control.E" in run.stderr
