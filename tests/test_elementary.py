"""exp, log, power, sine and cosine against MPFR, and their bits."""

import ast
import math
import random
from pathlib import Path

import gmpy2
import pytest

from inteco_abs import elementary
from inteco_abs.sessions.fingerprint import PORTABLE_SHA256, arithmetic_facts

BITS = 160
EXP_MOST, POWER_MOST, SIN_MOST = 0.52, 0.52, 0.8
"""Errors in ulp; beyond 0.5 what the methods leave."""
SUBNORMAL_MOST = 0.8
"""Rounded twice."""
SMALLEST = 2.0**-1022


def spread(low, high):
    """A number between two positive ones, evenly on a logarithmic scale."""
    return lambda pick: math.exp(pick.uniform(math.log(low), math.log(high)))


def signed(of):
    return lambda pick: math.copysign(of(pick), pick.random() - 0.5)


def evenly(low, high):
    return lambda pick: pick.uniform(low, high)


def around_one(nearest, farthest):
    return lambda pick: 1.0 + signed(spread(nearest, farthest))(pick)


def multiple_of_a_quarter_turn(pick):
    with gmpy2.context(precision=BITS):
        return float(pick.randrange(1, 1_335_000) * gmpy2.const_pi() / 2)


def with_any_exponent_of(base):
    """Base and exponent, whose power is anywhere in the range of floats."""

    def pair(pick):
        x = base(pick)
        return x, 0.0 if x == 1.0 else max(-1e300, min(1e300, pick.uniform(-744.0, 709.0) / math.log(x)))

    return pair


def sine(x):
    return elementary.sin_cos(x)[0]


def cosine(x):
    return elementary.sin_cos(x)[1]


ANGLES = {
    "first": signed(spread(1e-300, 0.8)),
    "near": evenly(-10.0, 10.0),
    "turned": evenly(-(2.0**21), 2.0**21),
    "quarters": signed(multiple_of_a_quarter_turn),
    "far": signed(spread(2.0**21, 2.0**42)),
}
CASES = [
    pytest.param(function, truth, most, picks, id=f"{function.__name__}-{name}")
    for function, truth, most, ranges in (
        (
            elementary.exp,
            gmpy2.exp,
            EXP_MOST,
            {"all": evenly(-745.1, 709.7), "small": signed(spread(1e-20, 1.0))},
        ),
        (
            elementary.log,
            gmpy2.log,
            EXP_MOST,
            {
                "all": spread(5e-324, 1.7e308),
                "middle": evenly(0.5, 2.0),
                "one": around_one(1e-16, 0.1),
            },
        ),
        (
            elementary.power,
            pow,
            POWER_MOST,
            {
                "slip": lambda pick: (pick.random(), pick.uniform(0.0, 5.0)),
                "all": with_any_exponent_of(spread(1e-307, 1e307)),
                "one": with_any_exponent_of(around_one(1e-15, 0.1)),
            },
        ),
        (elementary.sin, gmpy2.sin, SIN_MOST, ANGLES),
        (sine, gmpy2.sin, SIN_MOST, ANGLES),
        (cosine, gmpy2.cos, SIN_MOST, ANGLES),
    )
    for name, picks in ranges.items()
]


def error_ulp(found, truth):
    """Distance to the true value, in units of the last place of the nearest float."""
    return float(abs(gmpy2.mpfr(found) - truth) / math.ulp(float(truth)))


def largest_error_ulp(function, truth, picks, number, seed):
    """Largest error in ulp of all whose result is normal, and of all others."""
    pick = random.Random(seed)
    normal = subnormal = 0.0
    with gmpy2.context(precision=BITS):
        for _ in range(number):
            chosen = picks(pick)
            arguments = chosen if isinstance(chosen, tuple) else (chosen,)
            exact = truth(*map(gmpy2.mpfr, arguments))
            error = error_ulp(function(*arguments), exact)
            if abs(exact) < SMALLEST:
                subnormal = max(subnormal, error)
            else:
                normal = max(normal, error)
    return normal, subnormal


@pytest.mark.parametrize(("function", "truth", "most", "picks"), CASES)
def test_errors_are_below_the_stated_share_of_the_last_place(function, truth, most, picks):
    normal, subnormal = largest_error_ulp(function, truth, picks, 300, seed=1)
    assert normal < most
    assert subnormal < SUBNORMAL_MOST


@pytest.mark.long
@pytest.mark.untraced
@pytest.mark.parametrize(("function", "truth", "most", "picks"), CASES)
def test_errors_are_below_the_stated_share_of_the_last_place_at_millions_of_points(function, truth, most, picks):
    normal, subnormal = largest_error_ulp(function, truth, picks, 150_000, seed=2)
    assert normal < most
    assert subnormal < SUBNORMAL_MOST


# results nearest to a float or to the middle between two: Lefevre and Muller, Worst cases for correct rounding of the
# elementary functions in double precision, 2001
HARDEST = [
    (elementary.exp, gmpy2.exp, 7.5417527749959590e-10),
    (elementary.log, gmpy2.log, float.fromhex("0x1.62A88613629B6p+678")),
    (sine, gmpy2.sin, float.fromhex("0x1.E0000000001C2p-20")),
    (cosine, gmpy2.cos, float.fromhex("0x1.8000000000009p-23")),
]


@pytest.mark.parametrize(("function", "truth", "argument"), HARDEST)
def test_the_hardest_arguments_are_within_the_errors_too(function, truth, argument):
    with gmpy2.context(precision=BITS):
        exact = truth(gmpy2.mpfr(argument))
        halves = 2 * (exact - float(exact)) / math.ulp(float(exact))
        assert abs(halves - gmpy2.rint(halves)) < 2.0**-50  # they are hard
        assert error_ulp(function(argument), exact) < SIN_MOST


def test_every_power_of_a_half_and_every_small_square_is_exact():
    assert all(elementary.power(2.0, float(n)) == math.ldexp(1.0, n) for n in range(-1074, 1024))
    assert all(elementary.power(float(n), 2.0) == float(n * n) for n in range(1, 1000))
    assert all(elementary.power(float(n * n), 0.5) == float(n) for n in range(1, 1000))
    assert [elementary.exp(0.0), elementary.log(1.0), *elementary.sin_cos(0.0)] == [1.0, 0.0, 0.0, 1.0]


INF, NAN = math.inf, math.nan
EDGES = [
    *((elementary.exp, (x,), y) for x, y in ((-0.0, 1.0), (INF, INF), (-INF, 0.0), (710.0, INF), (-746.0, 0.0))),
    *((elementary.exp, (x,), y) for x, y in ((709.782712893384, 1.7976931348622732e308), (709.7827128933841, INF))),
    *((elementary.exp, (x,), y) for x, y in ((-745.1332191019411, 5e-324), (-745.1332191019412, 0.0), (NAN, NAN))),
    *((elementary.log, (x,), y) for x, y in ((0.0, -INF), (-0.0, -INF), (INF, INF), (-1.0, NAN), (NAN, NAN))),
    *((elementary.sin, (x,), y) for x, y in ((-0.0, -0.0), (5e-324, 5e-324), (-5e-324, -5e-324))),
    *((function, (x,), NAN) for function in (elementary.sin, sine, cosine) for x in (INF, -INF, NAN, 2.0**42)),
    *((sine, (x,), y) for x, y in ((0.0, 0.0), (-0.0, -0.0), (5e-324, 5e-324))),
    *((elementary.power, (x, 0.0), 1.0) for x in (0.0, 1.0, -1.0, INF, NAN)),
    *((elementary.power, (1.0, y), 1.0) for y in (5.0, INF, -INF, NAN)),
    *((elementary.power, (0.0, y), z) for y, z in ((2.0, 0.0), (INF, 0.0), (-2.0, INF), (-INF, INF), (NAN, NAN))),
    *((elementary.power, (INF, y), z) for y, z in ((2.0, INF), (INF, INF), (-2.0, 0.0), (-INF, 0.0), (NAN, NAN))),
    *((elementary.power, (2.0, y), z) for y, z in ((INF, INF), (-INF, 0.0), (1e308, INF), (-1e308, 0.0), (NAN, NAN))),
    *((elementary.power, (0.5, y), z) for y, z in ((INF, 0.0), (-INF, INF), (1e308, 0.0))),
    *((elementary.power, (x, 2.0), NAN) for x in (-1.0, -INF, NAN)),
]


def test_limits_and_what_is_undefined():
    for function, arguments, result in EDGES:
        found = function(*arguments).hex()
        assert found == result.hex(), (function, arguments)  # which distinguishes -0.0 from 0.0


def test_a_whole_power_is_a_product():
    assert [elementary.raised(1.1, n) for n in (1, 2, 3, 4)] == [1.1, 1.1 * 1.1, 1.1 * 1.1 * 1.1, 1.1 * 1.1 * 1.1 * 1.1]


def test_their_bits_are_those_of_every_other_machine():
    """An arithmetic never changes: sessions name it, and must replay. Another one gets another name."""
    assert arithmetic_facts()[PORTABLE_SHA256].startswith("a269dd98d9ec90c520eb2a4b8f4829a8")


ENGINE = [path for part in ("control", "rig") for path in (Path(elementary.__file__).parent / part).rglob("*.py")]
EXACT = {"ceil", "copysign", "floor", "inf", "isfinite", "isnan", "nan", "pi", "radians", "sqrt"}
"""What IEEE 754 or its meaning makes the same everywhere."""


def of_the_machine(tree):
    """Lines with a function of the C library, or with a power of what is not a literal."""
    for node in ast.walk(tree):
        match node:
            case ast.BinOp(op=ast.Pow(), left=left) if not isinstance(left, ast.Constant):
                yield node.lineno
            case ast.Attribute(value=ast.Name(id="math" | "cmath"), attr=name) if name not in EXACT:
                yield node.lineno
            case ast.ImportFrom(module="math" | "cmath"):
                yield node.lineno


@pytest.mark.parametrize("source", ["math.exp(x)", "x**2", "(x + y) ** k.p", "from math import exp"])
def test_functions_of_the_c_library_are_found(source):
    assert list(of_the_machine(ast.parse(source))) == [1]


def test_decisions_and_physics_call_no_function_of_the_c_library():
    found = {str(path): list(of_the_machine(ast.parse(path.read_text(encoding="utf-8")))) for path in ENGINE}
    assert {path: lines for path, lines in found.items() if lines} == {}
