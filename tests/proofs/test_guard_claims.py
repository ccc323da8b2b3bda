"""The guard's claims, proven by an SMT solver over its own source; docs/safety.md has what is assumed."""

from dataclasses import dataclass
from functools import cache

import pytest
import z3
from symbolic import ZERO, Abstract, Execution, Record, changed, copied, finite, known, lift, refuted, unknown, within

from inteco_abs.config import load_config
from inteco_abs.control import count_speed, guard, pipeline, run_up
from inteco_abs.control.guard import Guard
from inteco_abs.control.phase_machine import MachineState
from inteco_abs.signals import Phase, Reason, Sample

pytestmark = pytest.mark.untraced  # the source is read, not run

NONE = int(Reason.NONE)
OF_RUN_UP = {"plausible", "_allow", "_begin", "_gain"}


@dataclass
class Run:
    """One call on any state, sample and request."""

    k: Record
    before: Record
    after: Record
    sample: Sample
    drive: z3.FPRef
    brake: z3.FPRef
    execution: Execution

    def results(self, name):
        """Condition and result of each call of a function."""
        found = [(given, result) for called, given, result, _ in self.execution.calls if called == name]
        assert found
        return found

    def facts(self, *names):
        """What IEEE 754 says of the arithmetic in these functions: with more of it the solver takes longer."""
        ranges = [within for called, _, _, within in self.execution.calls if called in names]
        return assumed_of(self.execution, *ranges)

    def begins(self):
        """What is assumed of a tick."""
        return [*in_range(self.k), *invariant(self.k, self.before), *possible(self.sample)]


def assumed_of(execution, *ranges):
    return [fact for each in ranges for found in execution.arithmetic.facts[each] for fact in found()]


@cache
def admitted(change=()):
    k, s = unknown(guard.GuardConstants, "k"), unknown(guard.GuardState, "s")
    sample = unknown(Sample, "sample")
    drive, brake = unknown(float, "drive"), unknown(float, "brake")
    execution, before = Execution(Abstract(), change), copied(s)
    execution.call(guard.admit, k, s, sample, drive, brake)
    return Run(k, before, s, sample, drive, brake, execution)


def in_range(k):
    """The configuration's ranges."""
    ranges = [lift(0.0) < k.drive_limit, k.drive_limit <= lift(1.0), lift(0.0) < k.brake_limit]
    ranges += [k.brake_limit <= lift(1.0), lift(1e-4) <= k.period_s, k.period_s <= lift(0.02)]
    ranges += [k.most_in_a_row >= 1, k.bucket_limit >= 3, k.history >= 1, k.speeds.length >= 1]
    return [*ranges, *drives_in_range(k.run_up)]


def drives_in_range(k):
    found = [k.look_ns >= 1]
    for drive in (k.published, k.own):
        losses = (drive.back_nm_s, drive.drag_nm_s, drive.inertia)
        found += [z3.And(each >= lift(1e-9), each <= lift(1e9)) for each in losses]
        found += [drive.factor >= lift(1.0), drive.factor <= lift(10.0)]
    return found


def invariant(k, s):
    """What holds between two ticks."""
    rings = [(row, k.speeds.length) for row in (s.speeds.times_ns, s.speeds.wheel_counts, s.speeds.road_counts)]
    rings += [(row, k.history) for row in (s.road_times_ns, s.road_speeds)]
    return [
        *(row.size == length for row, length in rings),
        z3.And(s.oldest >= 0, s.oldest < k.history),
        z3.And(s.speeds.oldest >= -1, s.speeds.oldest < k.speeds.length),
        z3.And(s.in_a_row >= 0, s.bucket >= 0),
        z3.Implies(s.reason != NONE, is_safe(s)),
        *limits_hold(k, s),
    ]


def run_up_invariant(k, s):
    lags = [lag for bounds in (s.published, s.own) for lag in (bounds.slow_lag_s, bounds.fast_lag_s)]
    return [
        s.looks >= 0,
        z3.Implies(s.looks >= 1, s.next_ns == s.then_ns + k.look_ns),
        *(z3.Implies(s.looks >= 2, lag >= ZERO) for lag in lags),
    ]


def possible(sample):
    return [sample.dt_s >= ZERO, sample.dt_s <= lift(2.0**64)]


def limits_hold(k, s):
    return [s.drive >= ZERO, s.drive <= k.drive_limit, s.brake >= ZERO, s.brake <= k.brake_limit]


def is_safe(s):
    """Both outputs are 0.0 to the bit: -0.0 is another term."""
    return z3.And(s.drive == ZERO, s.brake == ZERO)


def clamped(request, limit):
    return z3.If(request < ZERO, ZERO, z3.If(request > limit, limit, request))


# claims: each of any state that the guard may be in, any sample and any request


def nothing_above_the_limits_is_admitted(run):
    return z3.And(limits_hold(run.k, run.after)), in_range(run.k)


def a_trip_latches(run):
    return z3.Implies(run.before.reason != NONE, is_safe(run.after)), []


def the_first_reason_stays(run):
    return z3.Implies(run.before.reason != NONE, run.after.reason == run.before.reason), []


def a_trip_is_safe_in_the_same_tick(run):
    return z3.Implies(run.after.reason != NONE, is_safe(run.after)), []


def a_request_that_is_not_finite_trips(run):
    numbers = z3.And(finite(run.drive), finite(run.brake))
    return z3.Implies(z3.Not(numbers), z3.And(run.after.reason != NONE, is_safe(run.after))), in_range(run.k)


def a_request_passes_unchanged_or_clamped(run):
    passed = z3.And(
        z3.fpEQ(run.after.drive, clamped(run.drive, run.k.drive_limit)),
        z3.fpEQ(run.after.brake, clamped(run.brake, run.k.brake_limit)),
    )
    return z3.Implies(run.after.reason == NONE, passed), in_range(run.k)


def every_finding_of_a_check_trips(run):
    found = [*run.results("_judge"), *run.results("_count_misses")]
    return z3.And(*(z3.Implies(z3.And(given, it != NONE), run.after.reason != NONE) for given, it in found)), []


def every_good_sample_is_judged(run):
    """By each check, unless one before has found something."""
    checks = [(name, True) for name in ("mean_speeds", "_judge_road", "_judge_wheel")] + [
        ("plausible", run.k.judges_run_up)
    ]
    judged_by = (z3.Implies(wanted, given) for name, wanted in checks for given, _ in run.results(name))
    good = run.sample.board_flags == 0
    return z3.Implies(good, z3.Or(run.after.reason != NONE, z3.And(*judged_by))), run.execution.definitions


def a_speed_above_the_limit_trips(run):
    ((given, speeds),) = run.results("mean_speeds")
    limit = run.k.over_speed
    allowed = z3.And(*(z3.And(-limit <= speed, speed <= limit) for speed in speeds))
    claim = z3.Implies(z3.And(given, run.before.filling == 0, z3.Not(allowed)), run.after.reason != NONE)
    return claim, run.execution.definitions


def enough_bad_exchanges_trip(run):
    bad = run.sample.board_flags != 0
    counted = z3.And(
        run.after.in_a_row >= run.before.in_a_row + 1,
        z3.Implies(run.after.in_a_row >= run.k.most_in_a_row, run.after.reason != NONE),
        z3.Implies(run.after.bucket >= run.k.bucket_limit, run.after.reason != NONE),
    )
    return z3.Implies(bad, counted), [*run.begins(), *run.facts("_count_misses"), *run.execution.definitions]


def the_invariant_is_preserved(run):
    return z3.And(invariant(run.k, run.after)), [*run.begins(), *run.facts("_count_misses")]


def nothing_raises(run):
    raising = [condition for function, _, condition in run.execution.hazards if function not in OF_RUN_UP]
    assert raising
    return z3.Not(z3.Or(raising)), [*run.begins(), *run.facts("_count_misses", "mean_speeds")]


CLAIMS = [
    (
        nothing_above_the_limits_is_admitted,
        guard,
        "min(max(brake, 0.0), k.brake_limit)",
        "min(max(brake, 0.0), k.drive_limit)",
    ),
    (nothing_above_the_limits_is_admitted, guard, "0.0 <= drive <= k.drive_limit", "drive <= k.drive_limit"),
    (a_trip_latches, guard, "drive = brake = 0.0", "drive = 0.0"),
    (a_trip_latches, guard, "    if s.reason != _NONE:", "    if found != _NONE:"),
    (the_first_reason_stays, guard, "    if s.reason == _NONE:", "    if s.reason != reason:"),
    (a_trip_is_safe_in_the_same_tick, guard, "drive = brake = 0.0", "drive = brake = -0.0"),
    (a_request_that_is_not_finite_trips, guard, "and math.isfinite(brake)", "and brake == brake"),
    (a_request_that_is_not_finite_trips, guard, "math.isfinite(drive) and", "math.isfinite(drive) or"),
    (a_request_passes_unchanged_or_clamped, guard, "max(drive, 0.0)", "max(drive, brake)"),
    (every_finding_of_a_check_trips, guard, "if found != _NONE:", "if found == Reason.OVER_SPEED:"),
    (every_good_sample_is_judged, guard, "found == _NONE and not flags:", "found == _NONE and flags:"),
    (
        every_good_sample_is_judged,
        guard,
        "    if k.judges_run_up and not plausible(",
        "    if s.filling and not plausible(",
    ),
    (a_speed_above_the_limit_trips, guard, "<= wheel <= limit and -limit <= road <=", "<= wheel <= limit and road <="),
    (enough_bad_exchanges_trip, guard, "s.in_a_row >= k.most_in_a_row", "s.in_a_row > k.most_in_a_row"),
    (enough_bad_exchanges_trip, guard, "max(skipped, 1 if flags else 0)", "skipped"),
    (the_invariant_is_preserved, guard, "s.oldest = i if i < k.history else 0", "s.oldest = i"),
    (the_invariant_is_preserved, guard, "max(0, s.bucket - 1)", "s.bucket - 1"),
    (nothing_raises, count_speed, "if elapsed_ns <= 0:", "if elapsed_ns < 0:"),
    (nothing_raises, count_speed, "    if i < 0:", "    if i < -1:"),
]

CONFIGURED = [
    [],
    [
        "loop.rate_hz=50",
        "estimator.window_s=0.1",
        "guard.missed_in_a_row=1",
        "guard.bucket_limit=3",
        "encoders.counts_per_turn=256",
    ],
    ["loop.rate_hz=10000", "guard.brake_limit=1", "guard.drive_limit=0.2", "guard.run_up_factor=10"],
]


@pytest.mark.parametrize("claim", dict.fromkeys(claim for claim, *_ in CLAIMS), ids=lambda claim: claim.__name__)
def test_the_guard_keeps_its_claim(claim):
    holds, assumed = claim(admitted())
    assert refuted(holds, *assumed) is None


@pytest.mark.long
@pytest.mark.parametrize(("claim", "module", "old", "new"), CLAIMS, ids=lambda each: getattr(each, "__name__", ""))
def test_a_changed_guard_breaks_the_claim(claim, module, old, new):
    holds, assumed = claim(admitted(tuple(changed(module, old, new).items())))
    assert refuted(holds, *assumed) is not None


@pytest.mark.parametrize("settings", CONFIGURED, ids=" ".join)
def test_a_new_guard_is_as_the_proofs_assume(settings):
    config = load_config(settings=settings)
    new = Guard(config)
    k, s = known(guard.guard_constants(config)), known(new)
    rings = [new.road_times_ns, new.road_speeds, new.speeds.times_ns, new.speeds.wheel_counts, new.speeds.road_counts]
    assert len(set(map(id, rings))) == len(rings)
    assumed = [*in_range(k), *invariant(k, s), *run_up_invariant(k.run_up, s.run_up)]
    assert [str(each) for each in assumed if not z3.is_true(z3.simplify(each))] == []


def judged(change=()):
    k, s = unknown(run_up.RunUpConstants, "k"), unknown(run_up.RunUpState, "s")
    drive, brake = unknown(float, "drive"), unknown(float, "brake")
    execution, before = Execution(Abstract(), change), copied(s)
    execution.call(run_up.plausible, k, s, unknown(int, "now_ns"), unknown(int, "count"), drive, brake)
    raising = [condition for function, _, condition in execution.hazards if function in OF_RUN_UP]
    assumed = [*drives_in_range(k), within(drive, 1.0), within(brake, 1.0), *run_up_invariant(k, before)]
    assumed += [*execution.definitions, *assumed_of(execution, slice(None))]
    return z3.And(z3.Not(z3.Or(raising)), *run_up_invariant(k, s)), assumed


def test_the_check_of_the_run_up_never_raises():
    holds, assumed = judged()
    assert refuted(holds, *assumed) is None


@pytest.mark.long
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("if s.looks == 1:", "if s.looks == 0:"),
        ("s.fast_lag_s = k.inertia / falling * (1.0 / k.factor)", "s.fast_lag_s = -k.inertia"),
        ("(lag_s + 0.5 * elapsed_s)", "(lag_s - 0.5 * elapsed_s)"),
    ],
)
def test_a_changed_check_of_the_run_up_may_raise(old, new):
    holds, assumed = judged(changed(run_up, old, new))
    assert refuted(holds, *assumed) is not None


def ended(change=()):
    k, s = unknown(guard.GuardConstants, "k"), unknown(guard.GuardState, "s")
    machine, stop_request = unknown(MachineState, "machine"), unknown(int, "stop_request")
    execution, before, asked = Execution(Abstract(), change), copied(s), copied(machine)
    execution.call(pipeline.admit_request, k, s, machine, unknown(Sample, "sample"), stop_request)
    asked_to_stop = z3.Or(stop_request != NONE, asked.reason != NONE, before.reason != NONE)
    tripped = z3.Implies(s.reason != NONE, z3.And(is_safe(s), machine.phase == int(Phase.FAULT)))
    return z3.And(tripped, z3.Implies(asked_to_stop, s.reason != NONE))


def test_any_reason_to_stop_ends_the_experiment_in_safe():
    assert refuted(ended()) is None


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("    if stop_request != _NONE:", "    if stop_request == Reason.OPERATOR_STOP:"),
        ("    if machine.reason != _NONE:", "    if machine.reason == _NONE:"),
        ("machine.phase = Phase.FAULT", "machine.phase = Phase.DONE"),
    ],
)
def test_a_changed_end_of_the_experiment_breaks_the_claim(old, new):
    assert refuted(ended(changed(pipeline, old, new))) is not None
