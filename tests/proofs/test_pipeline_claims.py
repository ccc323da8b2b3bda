"""The classes around the proven functions lose none of their claims: an SMT solver over the classes' own source.

Estimator and controller may return anything, and raise at any instant. docs/safety.md has what is assumed.
"""

from copy import deepcopy
from functools import cache

import pytest
import z3
from symbolic import FLOAT, Abstract, Execution, Outside, Record, changed, copied, finite, refuted, unknown
from test_guard_claims import clamped, in_range, is_safe, limits_hold
from test_phase_claims import CLAIMS as OF_PHASES

from inteco_abs.control import gain_changes, guard, phase_machine, pipeline
from inteco_abs.signals import BrakeDemand, Command, Estimate, Phase, Reason, Sample, Timing

pytestmark = pytest.mark.untraced

NONE = int(Reason.NONE)
OUTSIDE = {phase_machine.demand_of: BrakeDemand, deepcopy: int, gain_changes.set_gain: int}


def any_guard(name):
    found = unknown(guard.Guard, name)
    found.values["k"] = unknown(guard.GuardConstants, f"{name}.k")
    return found


def any_machine():
    found = unknown(phase_machine.PhaseMachine, "machine")
    found.values |= {
        "k": unknown(phase_machine.MachineConstants, "machine.k"),
        "controller": z3.Int("controller"),
        "controller_as_made": z3.Int("controller_as_made"),
        "last_demand": unknown(BrakeDemand, "last_demand"),
    }
    return found


def any_pipeline():
    return Record(
        pipeline.Pipeline,
        {
            "error": z3.Int("error"),
            "command": unknown(Command, "command"),
            "estimator": Record(object, {"update": Outside(Estimate)}),
            "machine": any_machine(),
            "guard": any_guard("guard"),
            "_constant_slip": z3.FP("constant_slip", FLOAT),
            "_reference": Outside(float),
            "_estimate": unknown(Estimate, "estimate"),
        },
    )


class Run:
    """One call of a method; that of `Pipeline.decide` looks like one of the function `advance_and_admit`."""

    def __init__(self, method, change, of, *arguments):
        self.of, self.before_of = of, copied(of)
        self.execution = Execution(Abstract(), change, OUTSIDE)
        self.returned = self.execution.call(method, of, *arguments)
        self.defined = self.execution.definitions[-len(self.returned or ()) :]
        """What the parts of the returned tuple are."""
        self.raised = z3.Or(self.execution.raised)
        if of.kind is pipeline.Pipeline:
            self.before, self.after, self.k = self.before_of.machine, of.machine, of.machine.k
            self.guard_before, self.guard = self.before_of.guard, of.guard
            self.limits = in_range(of.guard.k)

    def escaping(self):
        """What leaves the method by an exception."""
        return [condition for _, what, condition in self.execution.hazards if "escapes" in what or "may raise" in what]


@cache
def decided(change=()):
    sample, stop_request = unknown(Sample, "sample"), unknown(int, "stop_request")
    run = Run(pipeline.Pipeline.decide, change, any_pipeline(), sample, stop_request)
    run.stop_request = stop_request
    run.good = z3.And(sample.board_flags == 0, run.before_of.error == 0)
    return run


def is_off(command):
    return z3.And(*(z3.fpIsZero(duty) for duty in command))


def as_admitted(command, state):
    return z3.And(z3.fpEQ(command[0], state.drive), z3.fpEQ(command[1], state.brake))


# claims: of any pipeline, sample and request, and of anything that estimator and controller return or raise


def the_command_is_what_the_guard_admits(change=()):
    run = decided(change)
    return as_admitted(run.of.command, run.guard), run.limits


def what_the_guard_keeps_is_within_its_limits(change=()):
    run = decided(change)
    return z3.And(limits_hold(run.guard.k, run.guard)), run.limits


def every_reason_to_stop_is_safe_in_the_same_tick(change=()):
    run = decided(change)
    asked = z3.Or(run.raised, *(it != NONE for it in (run.stop_request, run.guard_before.reason, run.guard.reason)))
    return z3.Implies(asked, z3.And(is_off(run.of.command), run.after.phase == int(Phase.FAULT))), []


def the_first_reason_stays(change=()):
    run = decided(change)
    return z3.Implies(run.guard_before.reason != NONE, run.guard.reason == run.guard_before.reason), []


def what_raised_is_kept_and_asked_no_more(change=()):
    run = decided(change)
    calls = [given for name, given, *_ in run.execution.calls if name == "PhaseMachine.advance"]
    asked_no_more = z3.Implies(run.before_of.error != 0, z3.Not(z3.Or(calls)))
    return z3.And(z3.Implies(run.raised, run.of.error != 0), asked_no_more), []


def a_failure_between_two_ticks_is_safe_in_the_next(change=()):
    """As `a_failed_change_of_gain` leaves it."""
    run = decided(change)
    failed = z3.And(run.before_of.error != 0, run.before.reason != NONE)
    return z3.Implies(failed, is_off(run.of.command)), []


def no_exception_leaves_the_decision(change=()):
    run = decided(change)
    return z3.Not(z3.Or(run.escaping())), []


def the_tick_records_the_command(change=()):
    arguments = unknown(Sample, "sample"), unknown(int, "stop_request"), unknown(Timing, "timing")
    run = Run(pipeline.Pipeline.step, change, any_pipeline(), *arguments)
    tick = run.returned
    recorded = z3.And(tick.drive == run.of.command.drive, tick.brake == run.of.command.brake)
    whole = z3.And(as_admitted(run.of.command, run.guard), tick.reason == run.guard.reason)
    return z3.And(recorded, whole), [*run.limits, *run.defined]


def a_failed_change_of_gain_admits_nothing_new(change=()):
    run = Run(pipeline.Pipeline.change, change, any_pipeline(), unknown(str, "name"), unknown(float, "value"))
    kept = [run.of.command == run.before_of.command, is_same(run.guard, run.guard_before)]
    failed = z3.And(run.of.error != 0, run.after.reason != NONE)
    return z3.And(*kept, z3.Implies(run.raised, failed), z3.Not(z3.Or(run.escaping()))), []


def a_resumed_pipeline_has_the_command_of_the_state(change=()):
    state = unknown(pipeline.DecisionState, "state")
    run = Run(pipeline.Pipeline.resume, change, any_pipeline(), state)
    command = z3.And(run.of.command.drive == state.drive, run.of.command.brake == state.brake)
    return z3.And(command, is_same(run.guard, run.guard_before)), []


def is_same(one, other):
    names = ("reason", "drive", "brake", "bucket", "in_a_row", "begun")
    return z3.And(*(getattr(one, name) == getattr(other, name) for name in names))


@cache
def admitted(change=()):
    request, sample, estimate = unknown(Command, "request"), unknown(Sample, "sample"), unknown(Estimate, "estimate")
    run = Run(guard.Guard.admit, change, any_guard("s"), request, sample, estimate)
    run.request = request
    run.are_floats = z3.And(
        *(run.execution.is_type.get((str(duty), float), z3.Bool(f"{duty} is float")) for duty in request)
    )
    return run


def the_guard_returns_what_it_keeps(change=()):
    run = admitted(change)
    same = z3.And(run.returned.drive == run.of.drive, run.returned.brake == run.of.brake)
    return z3.And(same, *limits_hold(run.of.k, run.of)), [*in_range(run.of.k), *run.defined]


def a_request_that_is_not_of_floats_trips(change=()):
    run = admitted(change)
    tripped = z3.And(run.of.reason != NONE, is_safe(run.of))
    return z3.Implies(z3.Not(run.are_floats), tripped), in_range(run.of.k)


def a_request_of_floats_passes_unchanged_or_clamped(change=()):
    run = admitted(change)
    wanted = clamped(run.request.drive, run.of.k.drive_limit), clamped(run.request.brake, run.of.k.brake_limit)
    passes = z3.And(run.are_floats, *map(finite, run.request), run.of.reason == NONE)
    return z3.Implies(passes, as_admitted(wanted, run.of)), in_range(run.of.k)


def a_trip_from_outside_latches(change=()):
    reason = unknown(int, "reason")
    run = Run(guard.Guard.trip, change, any_guard("s"), reason)
    before = run.before_of.reason
    return run.of.reason == z3.If(before == NONE, reason, before), []


CLAIMS = [
    (
        the_command_is_what_the_guard_admits,
        pipeline,
        "Command(guard.drive, guard.brake)",
        "Command(guard.drive, machine.brake_request)",
    ),
    (the_command_is_what_the_guard_admits, pipeline, "or guard.brake != brake", "and guard.brake != brake"),
    (
        what_the_guard_keeps_is_within_its_limits,
        pipeline,
        "        drive, brake = command\n",
        "        guard.brake = machine.brake_request\n        drive, brake = command\n",
    ),
    (
        every_reason_to_stop_is_safe_in_the_same_tick,
        pipeline,
        "sample, stop_request)\n        d",
        "sample, _NONE)\n        d",
    ),
    (every_reason_to_stop_is_safe_in_the_same_tick, pipeline, "                machine.fail()\n        a", "        a"),
    (
        every_reason_to_stop_is_safe_in_the_same_tick,
        phase_machine,
        "reason = Reason.CONTROLLER_ERROR",
        "reason = _NONE",
    ),
    (
        the_first_reason_stays,
        pipeline,
        "        if not sample.board_flags and",
        "        guard.reason = _NONE\n        if not sample.board_flags and",
    ),
    (
        what_raised_is_kept_and_asked_no_more,
        pipeline,
        "self.error = error\n                self._estimate = _NO_ESTIMATE\n                m",
        "self._estimate = _NO_ESTIMATE\n                m",
    ),
    (
        what_raised_is_kept_and_asked_no_more,
        pipeline,
        "if not sample.board_flags and self.error is None",
        "if not sample.board_flags",
    ),
    (
        a_failure_between_two_ticks_is_safe_in_the_next,
        pipeline,
        "if not sample.board_flags and self.error is None",
        "if not sample.board_flags",
    ),
    (
        no_exception_leaves_the_decision,
        pipeline,
        "(Exception, SystemExit) as error:  # noqa: BLE001  a u",
        "Exception as error:  # a u",
    ),
    (
        no_exception_leaves_the_decision,
        pipeline,
        "        drive, brake = command\n",
        "        self.estimator.update(sample, command)\n        drive, brake = command\n",
    ),
    (
        the_tick_records_the_command,
        pipeline,
        "            *self.command,\n",
        "            machine.drive_request,\n            machine.brake_request,\n",
    ),
    (a_failed_change_of_gain_admits_nothing_new, pipeline, "            self.machine.fail()\n", ""),
    (
        a_failed_change_of_gain_admits_nothing_new,
        pipeline,
        "SystemExit) as error:  # noqa: BLE001  as",
        "KeyError) as error:  #",
    ),
    (
        a_resumed_pipeline_has_the_command_of_the_state,
        pipeline,
        "Command(s.drive, s.brake)",
        "Command(s.drive, s.demanded)",
    ),
    (the_guard_returns_what_it_keeps, guard, "Command(self.drive, self.brake)", "Command(self.drive, brake)"),
    (a_request_that_is_not_of_floats_trips, guard, "is float and type(brake) is float", "is float"),
    (
        a_request_of_floats_passes_unchanged_or_clamped,
        guard,
        "sample, drive if numbers else math.nan, brake",
        "sample, brake if numbers else math.nan, brake",
    ),
    (a_trip_from_outside_latches, guard, "        trip(self, reason)", "        self.reason = reason"),
]
IN_THE_CLASS = "        if phase is _STOPPED and self.phase"
OF_THE_FUNCTIONS = [
    ("the_drive_is_requested_only_in_spin_up", "        self.drive_request = self.k.drive_duty\n"),
    ("the_brake_is_requested_only_while_braking_and_holding", "        self.brake_request = self.last_demand.brake\n"),
    ("phases_follow_their_order", "        self.phase = _BRAKING\n"),
]
"""Claims that a line in the class breaks, though the functions keep them."""


@pytest.mark.parametrize("claim", dict.fromkeys(claim for claim, *_ in CLAIMS), ids=lambda claim: claim.__name__)
def test_the_classes_keep_the_claim(claim):
    holds, assumed = claim()
    assert refuted(holds, *assumed) is None


@pytest.mark.long
@pytest.mark.parametrize(("claim", "module", "old", "new"), CLAIMS, ids=lambda each: getattr(each, "__name__", ""))
def test_a_changed_class_breaks_the_claim(claim, module, old, new):
    holds, assumed = claim(tuple(changed(module, old, new).items()))
    assert refuted(holds, *assumed) is not None


@pytest.mark.parametrize("claim", dict.fromkeys(claim for claim, *_ in OF_PHASES), ids=lambda claim: claim.__name__)
def test_the_classes_keep_what_is_proven_of_the_functions(claim):
    holds, assumed = claim(decided())
    assert refuted(holds, *assumed) is None


@pytest.mark.long
@pytest.mark.parametrize(("name", "line"), OF_THE_FUNCTIONS)
def test_a_changed_class_breaks_what_is_proven_of_the_functions(name, line):
    (claim,) = {claim for claim, *_ in OF_PHASES if claim.__name__ == name}
    holds, assumed = claim(decided(tuple(changed(phase_machine, IN_THE_CLASS, line + IN_THE_CLASS).items())))
    assert refuted(holds, *assumed) is not None
