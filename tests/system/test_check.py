"""The check repeats a few failed tests alone and reports it; what fails alone, or fails in many places, fails."""

import re
import runpy
from concurrent.futures import Future
from pathlib import Path

import pytest

pytestmark = pytest.mark.untraced  # a check inside of the check

CHECKS = Path(__file__).parent.parent.parent / "tools" / "checks.py"
FLAKY = """
import pytest
from pathlib import Path

@pytest.mark.xdist_group("real time")
@pytest.mark.parametrize("case", {cases!r})
def test_flaky(case):
    tried = Path("tried-" + case.replace("/", "-"))
    assert tried.exists() or tried.touch()

def test_steady():
    pass
"""
UNTRACED = """
import sys

def test_untraced():
    assert "coverage" not in sys.modules
"""
HOPELESS = """
def test_hopeless():
    raise ArithmeticError
"""


@pytest.fixture
def checked(tmp_path, monkeypatch, capfd):
    """Runs the check's tests over files in an empty folder: its exit code, what it printed, and the table's rows."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # they take most of the time
    monkeypatch.setenv("PYTEST_PLUGINS", "xdist.plugin")
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = long\n")

    def run(*, long=False, **files):
        for name, text in files.items():
            (tmp_path / f"test_{name}.py").write_text(text)
        others = Future()
        others.set_result(None)
        check = runpy.run_path(str(CHECKS))["Check"](long=long)
        check.workers = 1
        check.tests("tests", "not long", others=others)
        code = check.report()
        printed = capfd.readouterr().out
        return code, printed, dict(re.findall(r"^(tests.*?) {2,}(passed|FAILED) ", printed, re.MULTILINE))

    return run


def test_a_test_that_fails_beside_others_and_passes_alone_is_named_at_the_end(checked):
    code, printed, parts = checked(flaky=FLAKY.format(cases=["a::b", "c@d/e"]))
    assert (code, parts) == (0, {"tests": "passed", "tests, failed ones alone": "passed"})
    end = printed.partition("passed alone, but failed together with other tests:")[2]
    assert end.split() == [
        "test_flaky.py::test_flaky[a::b]",
        "test_flaky.py::test_flaky[c@d/e]",
        *["all", "checks", "passed"],
    ]


def test_a_long_check_measures_coverage_but_not_of_those_that_it_repeats(checked, tmp_path):
    (tmp_path / ".coveragerc").write_text("[run]\npatch = subprocess\nparallel = true\n")
    code, _, parts = checked(untraced=UNTRACED, long=True)
    assert (code, parts) == (0, {"tests": "passed", "tests, failed ones alone": "passed"})
    assert list(tmp_path.glob(".coverage.*"))


def test_a_test_that_fails_alone_as_well_fails_the_check(checked):
    code, printed, parts = checked(flaky=FLAKY.format(cases=["one"]), hopeless=HOPELESS)
    assert (code, parts) == (1, {"tests": "FAILED", "tests, failed ones alone": "FAILED"})
    assert printed.endswith("FAILED: tests, tests, failed ones alone\n")


def test_more_than_a_handful_of_failures_is_final(checked):
    code, printed, parts = checked(flaky=FLAKY.format(cases=list("abcdef")))
    assert (code, parts) == (1, {"tests": "FAILED"})
    assert "6 failed, 1 passed" in printed


def test_a_test_that_cannot_be_read_is_final(checked):
    assert checked(broken="import nowhere_to_be_found", flaky=FLAKY.format(cases=["one"]))[0] == 1
