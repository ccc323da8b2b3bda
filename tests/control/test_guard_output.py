import math
import struct
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.config import load_config
from inteco_abs.control import Guard
from inteco_abs.signals import BoardFlags, Command, Estimate, Reason, Sample

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

DRIVE_LIMIT, BRAKE_LIMIT = 0.8, 0.7
CONFIG = load_config(settings=[f"guard.drive_limit={DRIVE_LIMIT}", f"guard.brake_limit={BRAKE_LIMIT}"])
SEEN = Estimate(0.0, 0.0, 0.0, valid=True)
AT_REST = [Sample(tick, tick * 500_000, 0.0005, 0, 0) for tick in range(3)]

any_float = st.floats(allow_nan=True, allow_infinity=True)
reasons = st.sampled_from([reason for reason in Reason if reason is not Reason.NONE])
samples = st.builds(
    Sample,
    st.integers(0, 2**40),
    st.integers(0, 2**60),
    st.floats(0.0, 1.0),
    st.integers(-(2**40), 2**40),
    st.integers(-(2**40), 2**40),
    st.sampled_from([BoardFlags.NONE, BoardFlags.STALE]),
)
requests = st.tuples(any_float, any_float) | st.just((0.1, 0.0)) | st.just((math.nan, "1"))

NOT_A_DUTY = [
    math.nan,
    -math.nan,
    struct.unpack("<d", struct.pack("<Q", 0x7FF0000000000001))[0],  # signalling NaN
    math.inf,
    -math.inf,
    True,
    False,
    None,
    "0.5",
    b"0.5",
    0.5 + 0.0j,
    Decimal("0.5"),
    Fraction(1, 2),
    [0.5],
    (0.5,),
    {},
    object(),
    np.float64(0.5),
    np.float32(0.5),
    np.bool_(1),
    np.array(0.5),
    np.array([]),
    np.array([0.5, 0.5]),
]


@pytest.fixture
def guard():
    return Guard(CONFIG)


def test_before_the_first_decision_nothing_is_admitted(guard):
    assert (guard.drive, guard.brake) == (0.0, 0.0)


@given(any_float, any_float)
def test_any_pair_of_floats_is_admitted_inside_the_limits_or_not_at_all(drive, brake):
    guard = Guard(CONFIG)
    for sample in AT_REST:
        admitted = guard.admit(Command(drive, brake), sample, SEEN)
        assert 0.0 <= admitted.drive <= DRIVE_LIMIT
        assert 0.0 <= admitted.brake <= BRAKE_LIMIT
        if not (math.isfinite(drive) and math.isfinite(brake)):
            assert (admitted, guard.reason) == (Command.SAFE, Reason.BAD_OUTPUT)
        else:
            assert guard.reason is Reason.NONE


@given(st.floats(-1e308, 1e308), st.floats(-1e308, 1e308))
def test_a_finite_request_is_moved_to_the_nearest_admissible_one(drive, brake):
    admitted = Guard(CONFIG).admit(Command(drive, brake), AT_REST[0], SEEN)
    assert admitted.drive == sorted([0.0, drive, DRIVE_LIMIT])[1]
    assert admitted.brake == sorted([0.0, brake, BRAKE_LIMIT])[1]


@given(st.floats(0.0, DRIVE_LIMIT), st.floats(0.0, BRAKE_LIMIT))
def test_a_request_within_the_limits_is_admitted_unchanged(drive, brake):
    assert Guard(CONFIG).admit(Command(drive, brake), AT_REST[0], SEEN) == Command(drive, brake)


@pytest.mark.parametrize("limit", [DRIVE_LIMIT, BRAKE_LIMIT, 0.0])
def test_the_limits_hold_to_the_last_bit(guard, limit):
    for requested in (math.nextafter(limit, -1.0), limit, math.nextafter(limit, 2.0)):
        admitted = guard.admit(Command(requested, requested), AT_REST[0], SEEN)
        assert admitted == Command(min(max(requested, 0.0), DRIVE_LIMIT), min(max(requested, 0.0), BRAKE_LIMIT))


@pytest.mark.parametrize(
    "value", NOT_A_DUTY, ids=lambda value: f"{type(value).__name__} {value!r}".partition(" at 0x")[0][:40]
)
@pytest.mark.parametrize("output", ["drive", "brake"])
@pytest.mark.parametrize("at", [0, 2])
def test_what_is_not_a_finite_float_is_never_sent_and_ends_the_run(guard, value, output, at):
    for sample in AT_REST[:at]:
        guard.admit(Command(0.5, 0.0), sample, SEEN)
    requested = Command(value, 0.5) if output == "drive" else Command(0.5, value)
    assert guard.admit(requested, AT_REST[at], SEEN) == Command.SAFE
    assert guard.reason is Reason.BAD_OUTPUT
    assert guard.admit(Command(0.5, 0.0), AT_REST[2], SEEN) == Command.SAFE


def test_the_admitted_command_is_a_plain_command(guard):
    for requested in (Command(0.1, 0.2), Command(5.0, 5.0), Command(math.nan, 0.0)):
        admitted = guard.admit(requested, AT_REST[0], SEEN)
        assert type(admitted) is Command
        assert [type(value) for value in admitted] == [float, float]


@given(reasons, st.lists(st.tuples(requests, samples, reasons | st.none()), max_size=20))
def test_the_latch_never_opens_and_the_first_reason_stays(first, later):
    guard = Guard(CONFIG)
    guard.admit(Command(0.5, 0.0), AT_REST[0], SEEN)
    guard.trip(first)
    for requested, sample, reason in later:
        if reason is not None:
            guard.trip(reason)
        assert guard.admit(Command(*requested), sample, SEEN) == Command.SAFE
        assert guard.reason is first


def test_no_reason_does_not_trip(guard):
    guard.trip(Reason.NONE)
    assert guard.admit(Command(0.5, 0.0), AT_REST[0], SEEN) == Command(0.5, 0.0)
    guard.trip(Reason.OPERATOR_STOP)
    guard.trip(Reason.NONE)
    assert guard.reason is Reason.OPERATOR_STOP


def test_a_bad_sample_is_the_reason_when_sample_and_output_are_both_bad(guard):
    guard.admit(Command.SAFE, AT_REST[0], SEEN)
    guard.admit(Command(math.nan, 0.0), AT_REST[1]._replace(road_count=10**6), SEEN)
    assert guard.reason is Reason.COUNT_JUMP


@pytest.mark.parametrize(
    "estimate", [Estimate(math.nan, math.nan, math.nan, valid=True), Estimate(0, 0, 0, valid=False)]
)
def test_the_guard_does_not_trust_the_estimator(guard, estimate):
    for sample in AT_REST:
        assert guard.admit(Command(0.5, 0.0), sample, estimate) == Command(0.5, 0.0)
