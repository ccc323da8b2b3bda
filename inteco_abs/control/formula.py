"""A slip as a formula of time and road speed: parsed once, evaluated in each tick with the same bits everywhere."""

from __future__ import annotations

import ast
import math
from dataclasses import dataclass
from typing import Any, Final

from inteco_abs import elementary

_NUMBER, _TIME, _SPEED, _NEGATIVE, _SIN, _COS, _EXP, _ADD, _SUBTRACT, _MULTIPLY, _DIVIDE, _MIN, _MAX, _STEP = range(14)
_NAMES: Final = {"t": _TIME, "speed": _SPEED}
_UNARY: Final = {"sin": _SIN, "cos": _COS, "exp": _EXP}
_SEVERAL: Final = {"min": _MIN, "max": _MAX}
_OPERATORS: Final[dict[type, int]] = {ast.Add: _ADD, ast.Sub: _SUBTRACT, ast.Mult: _MULTIPLY, ast.Div: _DIVIDE}
_MOST: Final = 128
"""Steps of a program: a shorter one computes in less than a tenth of a tick, even in Python."""
_LONGEST: Final = 500
"""Characters: Python's parser goes as deep as they nest."""
GRAMMAR: Final = (
    "numbers, t (s since braking began), speed (estimated road speed, rad/s), pi, + - * /, sin, cos, exp, min, max, "
    "step(x, x0) (1 from x0 on, else 0), and parentheses"
)


@dataclass(frozen=True, slots=True)
class Program:
    """A formula for a machine with a stack: the numbers that it pushes stand where their steps do."""

    codes: list[int]
    numbers: list[float]

    @property
    def uses_speed(self) -> bool:
        """Whether its value depends on the road speed."""
        return _SPEED in self.codes


def parse_formula(text: str) -> Program:
    """Program of a formula. Raises ValueError with what is wrong and what is allowed."""
    if len(text) > _LONGEST:
        raise ValueError(f"{len(text)} characters: at most {_LONGEST}; write it shorter, or give reference_points")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
        program = Program([], [])
        _translate(tree, program)
    except SyntaxError as error:
        raise ValueError(f"not a formula at character {error.offset or 0}; allowed are {GRAMMAR}") from None
    except (RecursionError, MemoryError):
        raise ValueError("nested too deeply; write it shorter") from None
    if len(program.codes) > _MOST:
        raise ValueError(f"{len(program.codes)} steps: at most {_MOST}; write it shorter, or give reference_points")
    return program


def _translate(node: ast.expr, program: Program) -> None:
    """Append the steps for a node, its operands first."""
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool) and abs(value) < 1e300:
            _append(program, _NUMBER, float(value))
        case ast.Name(id="pi"):
            _append(program, _NUMBER, math.pi)
        case ast.Name(id=name) if name in _NAMES:
            _append(program, _NAMES[name])
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            _translate(operand, program)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            _translate(operand, program)
            _append(program, _NEGATIVE)
        case ast.BinOp(left=left, op=operator, right=right) if type(operator) in _OPERATORS:
            _translate(left, program)
            _translate(right, program)
            _append(program, _OPERATORS[type(operator)])
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
            _call(name, arguments, program)
        case _:
            raise ValueError(f"{ast.unparse(node)!r} is not allowed; allowed are {GRAMMAR}")


def _call(name: str, arguments: list[ast.expr], program: Program) -> None:
    if name in _UNARY and len(arguments) == 1:
        _translate(arguments[0], program)
        _append(program, _UNARY[name])
    elif name == "step" and len(arguments) == 2:
        for argument in arguments:
            _translate(argument, program)
        _append(program, _STEP)
    elif name in _SEVERAL and len(arguments) >= 2:
        _translate(arguments[0], program)
        for argument in arguments[1:]:
            _translate(argument, program)
            _append(program, _SEVERAL[name])
    else:
        raise ValueError(f"{name} with {len(arguments)} arguments is not allowed; allowed are {GRAMMAR}")


def _append(program: Program, code: int, number: float = 0.0) -> None:
    program.codes.append(code)
    program.numbers.append(number)


def evaluate(codes: Any, numbers: Any, count: int, stack: Any, t: float, speed: float) -> float:
    """Value of a program of `count` steps at the time `t` in s and a road speed in rad/s.

    `stack` has room for as many numbers. What is undefined is NaN, what is too large is infinite; nothing raises.
    """
    top = -1
    for i in range(count):
        code = codes[i]
        if code <= _SPEED:
            top += 1
            stack[top] = numbers[i] if code == _NUMBER else t if code == _TIME else speed
        elif code <= _EXP:
            stack[top] = _of_one(code, stack[top])
        else:
            top -= 1
            stack[top] = _of_two(code, stack[top], stack[top + 1])
    value: float = stack[0]
    return value


def _of_one(code: int, x: float) -> float:
    if code == _NEGATIVE:
        return -x
    if code == _SIN:
        return elementary.sin(x)
    if code == _COS:
        _, cosine = elementary.sin_cos(x)
        return cosine
    return elementary.exp(x)


def _of_two(code: int, a: float, b: float) -> float:
    if code == _ADD:
        return a + b
    if code == _SUBTRACT:
        return a - b
    if code == _MULTIPLY:
        return a * b
    if code == _DIVIDE:
        return a / b if b != 0.0 else a * math.inf
    if code == _STEP:
        return 1.0 if a >= b else 0.0
    return a if (a < b) == (code == _MIN) else b
