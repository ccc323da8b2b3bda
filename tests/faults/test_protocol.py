import pytest

from tests.faults.protocol import BOUND, Rules, explore

pytestmark = pytest.mark.untraced

SECOND_LINE = {"loop_waits_for_the_guardian", "supervisor_watches"}
"""Somebody else sees to it, too, if only later."""


@pytest.mark.parametrize("kills", range(5))
def test_whoever_is_killed_and_whenever_the_output_goes_off(kills, record_property):
    states, count, problem = explore(Rules(), kills, BOUND)
    record_property("told", f"processes of a run, {kills} killed: {states} states, {count} steps")
    assert problem == ""


def test_the_bound_is_no_larger_than_it_must_be():
    assert "stayed on" in explore(Rules(), 2, BOUND - 1)[2]


@pytest.mark.parametrize("rule", sorted(set(Rules._fields) - SECOND_LINE))
def test_without_this_rule_something_goes_wrong(rule):
    assert explore(Rules(**{rule: False}), 3, BOUND)[2]


@pytest.mark.parametrize("rule", sorted(SECOND_LINE))
def test_a_second_line_is_needed_only_once_the_first_is_gone(rule):
    assert explore(Rules(**{rule: False}), 3, BOUND)[2] == ""
