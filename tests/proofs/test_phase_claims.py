"""The order of the phases, and when motors may be on, proven by an SMT solver over the phase machine's source."""

from functools import cache

import pytest
import z3
from symbolic import ZERO, Abstract, Execution, changed, copied, lift, refuted, unknown

from inteco_abs.control import advance_and_admit, guard, phase_machine, pipeline
from inteco_abs.control.phase_machine import MachineConstants, MachineState
from inteco_abs.signals import Phase, Reason, Sample

pytestmark = pytest.mark.untraced

NONE = int(Reason.NONE)
NEXT = {
    Phase.IDLE: {Phase.IDLE, Phase.ARMED},
    Phase.ARMED: {Phase.ARMED, Phase.SPIN_UP},
    Phase.SPIN_UP: {Phase.SPIN_UP, Phase.BRAKING},
    Phase.BRAKING: {Phase.BRAKING, Phase.STOPPED},
    Phase.STOPPED: {Phase.STOPPED, Phase.DONE, Phase.IDLE},
    Phase.DONE: {Phase.DONE},
    Phase.FAULT: {Phase.FAULT},
}


class Run:
    """One tick of phase machine and guard, on any state, demand, sample and request to stop."""

    def __init__(self, change):
        k, machine, sample = unknown(MachineConstants, "k"), unknown(MachineState, "machine"), unknown(Sample, "sample")
        limits, state = unknown(guard.GuardConstants, "limits"), unknown(guard.GuardState, "guard")
        self.k, self.before, self.guard_before = k, copied(machine), copied(state)
        self.good = sample.board_flags == 0
        demand, stop_request = unknown(float, "demand"), unknown(int, "stop_request")
        Execution(Abstract(), change).call(
            advance_and_admit, (k, limits), (machine, state), sample, demand, stop_request
        )
        self.after, self.guard = machine, state
        self.limits = [z3.And(limit > ZERO, limit <= lift(1.0)) for limit in (limits.drive_limit, limits.brake_limit)]


@cache
def stepped(change=()):
    return Run(change)


def is_in(phase, *phases):
    return z3.Or(*(phase == int(each) for each in phases))


def asks_nothing(s):
    return z3.And(z3.fpIsZero(s.drive_request), z3.fpIsZero(s.brake_request))


def invariant(machine, state):
    """What holds between two ticks: after the end nothing is requested, or the guard has tripped."""
    over = z3.Implies(machine.phase == int(Phase.DONE), asks_nothing(machine))
    failed = z3.Implies(machine.phase == int(Phase.FAULT), state.reason != NONE)
    return z3.And(over, failed)


def phases_follow_their_order(run):
    steps = (z3.Implies(run.before.phase == int(one), is_in(run.after.phase, *NEXT[one], Phase.FAULT)) for one in NEXT)
    return z3.And(*steps), [is_in(run.before.phase, *NEXT)]


def a_fault_has_a_reason(run):
    faulty = run.after.phase == int(Phase.FAULT)
    return z3.Implies(run.before.phase != int(Phase.FAULT), faulty == (run.guard.reason != NONE)), []


def a_sample_with_flags_keeps_phase_and_requests(run):
    kept = [
        run.after.drive_request == run.before.drive_request,
        run.after.brake_request == run.before.brake_request,
        z3.Or(run.guard.reason != NONE, run.after.phase == run.before.phase),
    ]
    return z3.Or(run.good, z3.And(kept)), []


def the_drive_is_requested_only_in_spin_up(run):
    claim = z3.Implies(run.before.phase != int(Phase.SPIN_UP), z3.fpIsZero(run.after.drive_request))
    return claim, [run.good]


def the_brake_is_requested_only_while_braking_and_holding(run):
    allowed = is_in(run.before.phase, Phase.BRAKING, Phase.STOPPED)
    return z3.Implies(z3.Not(allowed), z3.fpIsZero(run.after.brake_request)), [run.good]


def drive_and_brake_are_never_requested_together(run):
    both = (run.after.drive_request, run.after.brake_request)
    return z3.Or(*map(z3.fpIsZero, both)), [run.good]


def a_tick_without_either_separates_drive_and_brake(run):
    begins = z3.And(run.before.phase == int(Phase.SPIN_UP), run.after.phase == int(Phase.BRAKING))
    return z3.Implies(begins, asks_nothing(run.after)), []


def after_the_end_only_safe_is_admitted(run):
    over = is_in(run.after.phase, Phase.DONE, Phase.FAULT)
    safe = z3.And(z3.fpIsZero(run.guard.drive), z3.fpIsZero(run.guard.brake))
    return z3.Implies(over, safe), [invariant(run.before, run.guard_before), *run.limits]


def the_end_stays(run):
    ended = is_in(run.before.phase, Phase.DONE, Phase.FAULT)
    stays = z3.And(is_in(run.after.phase, Phase.DONE, Phase.FAULT), invariant(run.after, run.guard))
    return z3.Implies(ended, stays), [invariant(run.before, run.guard_before)]


def the_invariant_is_preserved(run):
    return invariant(run.after, run.guard), [invariant(run.before, run.guard_before)]


CLAIMS = [
    (
        phases_follow_their_order,
        phase_machine,
        "s.phase, s.since_ns = _STOPPED, time_ns",
        "s.phase, s.since_ns = Phase.DONE, time_ns",
    ),
    (phases_follow_their_order, phase_machine, "_ARMED if s.phase == _IDLE else _SPIN_UP", "_SPIN_UP"),
    (
        the_drive_is_requested_only_in_spin_up,
        phase_machine,
        "s.drive_request = s.brake_request = 0.0",
        "s.brake_request = 0.0",
    ),
    (
        the_brake_is_requested_only_while_braking_and_holding,
        phase_machine,
        "= k.drive_duty, 0.0",
        "= k.drive_duty, brake",
    ),
    (drive_and_brake_are_never_requested_together, phase_machine, "= 0.0, brake, True", "= k.drive_duty, brake, True"),
    (
        a_tick_without_either_separates_drive_and_brake,
        phase_machine,
        "_BRAKING, time_ns, 0.0",
        "_BRAKING, time_ns, k.drive_duty",
    ),
    (
        after_the_end_only_safe_is_admitted,
        phase_machine,
        "        return\n    s.phase, s.since_ns = Phase.DONE",
        "    s.phase, s.since_ns = Phase.DONE",
    ),
    (the_end_stays, phase_machine, "elif phase in (_IDLE, _ARMED):", "elif phase in (_IDLE, Phase.DONE):"),
    (the_invariant_is_preserved, phase_machine, "s.drive_request = s.brake_request = 0.0", "s.brake_request = 0.0"),
    (a_fault_has_a_reason, pipeline, "machine.phase = Phase.FAULT", "machine.phase = Phase.DONE"),
    (a_sample_with_flags_keeps_phase_and_requests, pipeline, "if not sample.board_flags:", "if not stop_request:"),
]


@pytest.mark.parametrize("claim", dict.fromkeys(claim for claim, *_ in CLAIMS), ids=lambda claim: claim.__name__)
def test_the_phase_machine_keeps_its_claim(claim):
    holds, assumed = claim(stepped())
    assert refuted(holds, *assumed) is None


@pytest.mark.parametrize(("claim", "module", "old", "new"), CLAIMS, ids=lambda each: getattr(each, "__name__", ""))
def test_a_changed_phase_machine_breaks_the_claim(claim, module, old, new):
    holds, assumed = claim(stepped(tuple(changed(module, old, new).items())))
    assert refuted(holds, *assumed) is not None
