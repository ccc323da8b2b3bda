"""exp, log, power, sine and cosine with the same bits on every processor, C library, operating system and Python.

They consist of + - * / on binary64 numbers, which IEEE 754 rounds alike everywhere, of exact scaling (frexp, ldexp
within the normal range) and of tables made by integer arithmetic. A C library's last bits depend on its version and on
the processor. Errors are below 0.6 ulp for `exp`, `log` and `power` (0.8 ulp where the result is subnormal) and below
0.8 ulp for `sin` and `sin_cos`. None raises for any float: what is undefined is NaN, what is too large is infinite.

Call them through the module, as `elementary.exp(x)`: `arithmetic` exchanges them for a C library's while a session
replays that was recorded with these.

Methods: `exp` and `log` by tables and the first terms of their series (Tang, ACM Trans. Math. Softw. 15 (1989) 144 and
16 (1990) 378); for `power` a logarithm of two floats, and their products (Dekker, Numer. Math. 18 (1971) 224); for sine
and cosine an argument reduced by quarter turns in four parts (Cody and Waite, Software Manual for the Elementary
Functions, 1980), then minimax polynomials of our own by Remez' exchange.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

_FIXED: Final = 160
"""Fraction bits of the integers that stand for the tables' numbers."""


def _parts(value: int, bits: int) -> tuple[float, float]:
    """`value` as a float with `bits` fraction bits and the rest."""
    upper = value >> _FIXED - bits
    return upper / (1 << bits), (value - (upper << _FIXED - bits)) / (1 << _FIXED)


def _powers_of_two() -> list[int]:
    """2^(j/128) for j in 0..127."""
    root = 2 << _FIXED
    for _ in range(7):
        root = math.isqrt(root << _FIXED)
    powers = [1 << _FIXED]
    while len(powers) < 128:
        powers.append(powers[-1] * root >> _FIXED)
    return powers


def _logarithm(over: int, under: int) -> int:
    """Logarithm of over/under in 1/2..2, by the series of the area tangent."""
    a, b = over - under, over + under
    power, total, n = (a << _FIXED + 1) // b, 0, 1
    while abs(power) > 1:
        total += power // n
        power, n = power * a * a // (b * b), n + 2
    return total


_LOG_BITS: Final = 42
"""Fraction bits of a logarithm's upper part: so few that its multiples and their sums are exact."""
_LN2, _LN2_REST = _parts(_logarithm(2, 1), _LOG_BITS)

_STEP, _STEP_REST = _parts(_logarithm(2, 1) >> 7, _LOG_BITS)
"""Logarithm of 2^(1/128)."""
_PER_STEP: Final = 1.0 / _STEP
_POWERS, _POWERS_REST = zip(*(_parts(power, 52) for power in _powers_of_two()), strict=True)
_NEAREST: Final = 1.5 * 2.0**52
"""Added to a smaller number and taken away again, it leaves the nearest integer."""


def exp(x: float) -> float:
    """e^x: 0 below -745.14, infinite above 709.78."""
    return _exp(x, 0.0)


def _exp(x: float, more: float) -> float:
    """e^(x + more), with `more` small against 1."""
    if not -746.0 < x < 710.0:
        return 0.0 if x <= -746.0 else x + math.inf
    n = (x * _PER_STEP + _NEAREST) - _NEAREST
    r = (x - n * _STEP) - (n * _STEP_REST - more)
    steps = int(n)
    j, scale = steps & 127, steps >> 7
    p = r + r * r * (0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0))))
    y = _POWERS[j] + (_POWERS_REST[j] + _POWERS[j] * p)
    # ldexp itself raises where the result is infinite, and not every C library rounds it well where it is subnormal
    return math.ldexp(y, scale - 1) * 2.0 if scale > 0 else math.ldexp(y, scale + 64) * 2.0**-64


_LOWEST: Final = 91
_LOGS, _LOGS_REST = zip(*(_parts(_logarithm(j, 128), _LOG_BITS) for j in range(_LOWEST, 182)), strict=True)
"""Logarithms of j/128, the numbers near 0.7071..1.4142."""
_HALVES: Final = 2.0**27 + 1.0
"""Splits a float into two of 26 bits each, whose products are exact (Veltkamp)."""


def _log(x: float) -> tuple[float, float]:
    """Logarithm of a finite x > 0 as a sum, to 2^-68 of its value."""
    m, k = math.frexp(x)
    if m < 0.7071:
        m, k = m + m, k - 1
    j = int(m * 128.0 + 0.5)
    near = j / 128.0
    j -= _LOWEST
    f, g = m - near, m + near  # log(m/near) = 2*artanh(f/g)
    s = f / g
    s1 = _HALVES * s
    s1 -= s1 - s
    g1 = _HALVES * g
    g1 -= g1 - g
    s2 = ((f - s1 * g1) - s1 * ((near - g1) + m)) / g
    z = s * s
    upper, twice = k * _LN2 + _LOGS[j], 2.0 * s1
    total = upper + twice
    series = s * z * (2.0 / 3.0 + z * (2.0 / 5.0 + z * (2.0 / 7.0)))
    return total, ((upper - total) + twice) + ((k * _LN2_REST + _LOGS_REST[j]) + (2.0 * s2 + series))


def log(x: float) -> float:
    """Natural logarithm: NaN below 0, -infinity at 0."""
    if 0.0 < x < math.inf:
        upper, rest = _log(x)
        return upper + rest
    return -math.inf if x == 0.0 else x if x > 0.0 else math.nan


def power(x: float, y: float) -> float:
    """x^y for x >= 0; NaN for other x, unless y is 0."""
    if not (0.0 < x < math.inf and -_STEEP < y < _STEEP):
        return _limit_of_power(x, y)
    upper, rest = _log(x)
    u1 = _HALVES * upper
    u1 -= u1 - upper
    y1 = _HALVES * y
    y1 -= y1 - y
    return _exp(y1 * u1, (y - y1) * u1 + y * ((upper - u1) + rest))


_STEEP: Final = 2.0**70
"""Exponent from which on the power of every number but 1 is 0 or infinite."""


def _limit_of_power(x: float, y: float) -> float:
    if x == 1.0 or y == 0.0:
        return 1.0
    if not (x >= 0.0 and (y < 0.0 or y > 0.0)):
        return math.nan
    return math.inf if (x > 1.0) == (y > 0.0) else 0.0


def raised(x: float, n: int) -> float:
    """x^n for n >= 1, as a product."""
    product = x
    for _ in range(n - 1):
        product *= x
    return product


_PI: Final = 0x3_243F6A88_85A308D3_13198A2E_03707344_A4093822
"""Pi with `_FIXED` fraction bits."""
_TURN1, _ = _parts(_PI >> 1, 31)
_TURN2, _ = _parts((_PI >> 1) % (1 << _FIXED - 31), 63)
_TURN3, _ = _parts((_PI >> 1) % (1 << _FIXED - 63), 95)
_TURN4: Final = ((_PI >> 1) % (1 << _FIXED - 95)) / (1 << _FIXED)
"""A quarter turn is their sum. Multiples of the first three by less than 2^21 are exact, those of the fourth do not
matter."""
_PER_TURN: Final = 2.0 / math.pi
_FAR: Final = 2.0**21
_FARTHEST: Final = 2.0**42


def _reduced(x: float, nearest: float) -> tuple[float, float, float]:
    """Number of quarter turns, as `nearest` rounds it, and two numbers whose difference is what they leave of x."""
    n = (x * _PER_TURN + nearest) - nearest
    a = x - n * _TURN1
    b = n * _TURN2
    c = a - b
    d = ((c - a) + b) + n * _TURN3
    y = c - d
    return n, y, ((y - c) + d) + n * _TURN4


def _turned(x: float) -> tuple[int, float, float]:
    """Number of quarter turns in 0..3, and two numbers whose difference is what they leave of x."""
    if -_FAR < x < _FAR:
        n, y, less = _reduced(x, _NEAREST)
    elif -_FARTHEST < x < _FARTHEST:
        _, far, rest = _reduced(x, _NEAREST * _FAR)  # whole turns
        n, near, less = _reduced(far, _NEAREST)
        less += rest
        y = near - less
        less += y - near
    else:
        return 0, math.nan, math.nan
    return int(n) & 3, y, less


def _sine(y: float, less: float) -> float:
    """Of y - less in -pi/4..pi/4."""
    z = y * y
    high = 2.5050757592377245e-08 - z * 1.5896764199265626e-10
    p = 0.16666666666666632 - z * (
        0.008333333333322403 - z * (0.00019841269829798974 - z * (2.755731368871211e-06 - z * high))
    )
    return y - (less * (1.0 - 0.5 * z) + y * z * p)


def _cosine(y: float, less: float) -> float:
    """Of y - less in -pi/4..pi/4."""
    z = y * y
    high = 2.0875722878299704e-09 - z * 1.1359626512488409e-11
    p = 0.0416666666666666 - z * (
        0.001388888888887411 - z * (2.4801587289473036e-05 - z * (2.7557314349554566e-07 - z * high))
    )
    half = 0.5 * z
    most = 1.0 - half
    return most + (((1.0 - most) - half) + (z * z * p + y * less))


def sin_cos(x: float) -> tuple[float, float]:
    """Sine and cosine of x in rad; NaN from 4.4e12 rad on.

    Beyond 2e6 rad the reduced argument is off by up to 4e-26 rad, which the last digits of results below 1e-9 show.
    """
    quarter, y, less = _turned(x)
    sine, cosine = _sine(y, less), _cosine(y, less)
    if quarter & 1:
        sine, cosine = cosine, -sine
    return (-sine, -cosine) if quarter & 2 else (sine, cosine)


def sin(x: float) -> float:
    """Sine of x in rad, as by `sin_cos`."""
    quarter, y, less = _turned(x)
    sine = _cosine(y, less) if quarter & 1 else _sine(y, less)
    return -sine if quarter & 2 else sine


PORTABLE: Final = "portable"
"""Name of this module's own arithmetic."""
LIBM: Final = "libm"
"""Name of the C library's, which sessions before format 5 were recorded with."""
ARITHMETICS: Final[dict[str, dict[str, Callable[..., Any]]]] = {
    PORTABLE: {function.__name__: function for function in (exp, log, power, raised, sin, sin_cos)},
    LIBM: {
        "exp": math.exp,
        "log": math.log,
        "power": operator.pow,
        "raised": operator.pow,
        "sin": math.sin,
        "sin_cos": lambda x: (math.sin(x), math.cos(x)),
    },
}
"""The functions of each arithmetic by their names here."""


@contextmanager
def arithmetic(name: str) -> Iterator[None]:
    """Compute with the functions of `name` in ARITHMETICS: in all threads, so one replay at a time.

    Compiled functions are always portable. Raises KeyError for an unknown name.
    """
    module = globals()
    before = {function: module[function] for function in ARITHMETICS[PORTABLE]}
    module.update(ARITHMETICS[name])
    try:
        yield
    finally:
        module.update(before)
