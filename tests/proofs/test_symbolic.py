"""The symbolic execution itself: it computes what Python computes, and what it assumes of floats is true of them."""

import math
import random
import struct

import pytest
import z3
from symbolic import FLOAT, NEAREST, Abstract, Exact, Execution, Record, Row, facts, known, lift, number, refuted

from inteco_abs.config import load_config
from inteco_abs.control import Guard, guard
from inteco_abs.signals import BoardFlags, Reason, Sample

pytestmark = pytest.mark.untraced

CONFIG = load_config(settings=["loop.rate_hz=100"])
PERIOD_S = 0.01
COUNTS_PER_RAD = 2048 / (2.0 * math.pi)
GOOD = 60
"""Ticks before anything is wrong."""


def numbers(value):
    if isinstance(value, Record):
        return {name: numbers(each) for name, each in value.values.items()}
    if isinstance(value, Row):
        return [number(value.array[i]) for i in range(value.size.as_long())]
    return number(lift(value))


def bits(value):
    """So that NaN equals NaN, and 0.0 is not -0.0."""
    if isinstance(value, dict):
        return {name: bits(each) for name, each in value.items()}
    if isinstance(value, list):
        return list(map(bits, value))
    if isinstance(value, float):
        return "NaN" if math.isnan(value) else struct.pack("<d", value)
    return int(value)


def ticks(seed):
    """Samples and requests: a run-up with a few bad exchanges, then also encoders and requests that are wrong."""
    draw = random.Random(seed)
    time_ns, angle_rad, lost = 0, 0.0, 0
    for tick in range(2 * GOOD):
        wrong = tick >= GOOD
        dt_s = PERIOD_S * draw.choice([1.0] * 12 + [0.7, 1.4, 2.0])
        time_ns += round(dt_s * 1e9)
        angle_rad += 30.0 * time_ns * 1e-9 * dt_s
        lost += draw.choice([0, 0, 0, 9, 5000]) if wrong else 0
        road = round(angle_rad * COUNTS_PER_RAD)
        flags = draw.choice([BoardFlags.NONE] * 18 + [BoardFlags.STALE, BoardFlags.SLOW])
        drive = draw.choice([0.9, 0.9, 1.2, -0.0, 0.0]) if wrong else 0.9
        brake = draw.choice([0.0, 0.5, -1.0, math.nan]) if wrong else -0.0
        yield Sample(tick, time_ns, dt_s, road - lost, road, flags), drive, brake


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_symbolic_execution_of_the_guard_leaves_the_bits_that_python_leaves(seed):
    real, k = Guard(CONFIG), known(guard.guard_constants(CONFIG))
    for i, (sample, drive, brake) in enumerate(ticks(seed)):
        again = known(real) if i % 5 == seed else None  # the others only bring the guard into new states
        guard.admit(real.k, real, sample, drive, brake)
        if again is not None:
            Execution(Exact()).call(guard.admit, k, again, known(sample), lift(drive), lift(brake))
            assert bits(numbers(again)) == bits(numbers(known(real)))
        if i == GOOD - 1:
            assert real.reason == Reason.NONE
            assert real.run_up.looks > 2
    assert real.reason != Reason.NONE


A, B = z3.FPs("a b", FLOAT)
OPERATIONS = {"add": z3.fpAdd, "sub": z3.fpSub, "mul": z3.fpMul, "div": z3.fpDiv}


@pytest.mark.parametrize(
    ("name", "a"),
    [
        ("add", A),
        ("sub", A),
        ("mul", A),
        ("mul", lift(0.5)),
        pytest.param("mul", lift(1e-9), marks=pytest.mark.long),
        pytest.param("div", A, marks=pytest.mark.long),
    ],
    ids=str,
)
def test_what_is_assumed_of_arithmetic_is_proven_of_doubles(name, a):
    claims = facts(name, a, B, OPERATIONS[name](NEAREST, a, B))
    assert refuted(z3.And(claims)) is None


@pytest.mark.parametrize("name", OPERATIONS)
def test_without_assumptions_it_would_not_hold(name):
    with_any_result = facts(name, A, B, z3.FP("result", FLOAT))
    assert refuted(z3.And(with_any_result)) is not None


@pytest.mark.parametrize("n", [0, 1, 2**53 + 1, 2**63, 2**70])
def test_what_is_assumed_of_conversions_is_true(n):
    for sign in (1, -1):
        arithmetic = Abstract()
        as_float, as_int = arithmetic.to_float(lift(sign * n)), arithmetic.to_int(lift(float(sign * n) / 3.0))
        truth = [as_float == lift(float(sign * n)), as_int == int(float(sign * n) / 3.0)]
        assert refuted(z3.And([fact for found in arithmetic.facts for fact in found()]), *truth) is None


def test_integers_and_floats_are_compared_exactly():
    exact = Exact()
    for x in (2.0**53, 2.0**53 + 2.0, math.inf, -math.inf, math.nan, -0.5):
        for n in (2**53, 2**53 + 1, 0, -1):
            assert z3.is_true(exact.at_most(lift(n), lift(x), strictly=False)) == (n <= x)
            assert z3.is_true(exact.at_most(lift(n), lift(x), strictly=True)) == (n < x)
