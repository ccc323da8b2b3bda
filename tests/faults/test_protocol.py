import pytest

from tests.faults.protocol import BOUND, POLL_NS, Rules, Seen, explore, unexplained

pytestmark = pytest.mark.untraced

SECOND_LINE = {"loop_waits_for_the_guardian", "supervisor_stops"}
"""Another process does it, too, only later."""


@pytest.mark.parametrize("strikes", [0, 1, *(pytest.param(each, marks=pytest.mark.long) for each in (2, 3))])
def test_outputs_go_off_for_any_processes_killed_or_frozen_at_any_time(strikes, record_property):
    states, count, problem = explore(Rules(), strikes, BOUND)
    record_property("figures", f"processes of a run, {strikes} killed or frozen: {states} states, {count} steps")
    assert problem == ""


@pytest.mark.long
def test_bound_is_the_promised_quarter_of_a_second_and_no_larger():
    assert BOUND * POLL_NS == 250_000_000
    assert "stayed on" in explore(Rules(), 2, BOUND - 1)[2]


@pytest.mark.long
@pytest.mark.parametrize("rule", sorted(set(Rules._fields) - SECOND_LINE))
def test_without_this_rule_something_goes_wrong(rule):
    assert explore(Rules(**{rule: False}), 2, BOUND)[2]


@pytest.mark.long
@pytest.mark.parametrize("rule", sorted(SECOND_LINE))
def test_a_second_line_is_needed_only_once_the_first_is_gone(rule):
    assert explore(Rules(**{rule: False}), 2, BOUND)[2] == ""


DRIVES = Seen("runs", "runs", "runs", "runs", holds=True, stop=False, output=True)
KILLED = DRIVES._replace(loop="gone")
FROZEN = DRIVES._replace(loop="stopped")
SAFE = {"output": False, "holds": False}


@pytest.mark.parametrize(
    "trace",
    [
        (DRIVES, KILLED, KILLED._replace(**SAFE)),
        (DRIVES, FROZEN, KILLED._replace(**SAFE)),
        (DRIVES, DRIVES._replace(supervisor="gone"), DRIVES._replace(supervisor="gone", stop=True)),
    ],
)
def test_what_a_struck_run_looks_like_is_explained_by_the_model(trace):
    assert unexplained(trace, 1, {}) is None


@pytest.mark.parametrize(
    "trace",
    [
        (DRIVES, FROZEN, FROZEN._replace(**SAFE)),  # taken from a process that may still write
        (DRIVES, DRIVES._replace(holds=False)),  # given up with an output on
        (DRIVES, DRIVES._replace(loop="gone", guardian="gone")),  # two ends for one strike
        (DRIVES, KILLED, KILLED._replace(**SAFE), KILLED),  # on once more after the rescue
        (DRIVES, DRIVES._replace(guardian="stopped"), KILLED._replace(guardian="stopped")),  # no process's deed
    ],
)
def test_what_the_rules_do_not_allow_is_not_explained_by_the_model(trace):
    assert unexplained(trace, 1, {}) == trace[-1]
