"""The process of one submission: answers the grader, line by line in JSON, and has neither rig nor score.

Whatever the submission changes here, imports or prints, the physics and the judgement are in another process, which
takes nothing but these lines, as numbers.
"""

from __future__ import annotations

import ast
import json
import os
import sys
from collections.abc import Mapping
from types import ModuleType, SimpleNamespace
from typing import Any, Final, TextIO

import numpy as np

from inteco_abs.control import Setup
from inteco_abs.course.confinement import confine
from inteco_abs.errors import AbsError, describe_error, on_one_line, place_in
from inteco_abs.plugins import require_controller
from inteco_abs.rig import RigParameters
from inteco_abs.signals import BoardFlags, Command, Estimate, Prediction, Sample

_PACKAGE: Final = "inteco_abs"


class _RefusalError(Exception):
    """What the submission is not."""


def main() -> None:
    """Answer until the grader closes the pipe."""
    requests, replies = os.fdopen(os.dup(0), encoding="utf-8"), os.fdopen(os.dup(1), "w", encoding="utf-8")
    with open(os.devnull, "rb") as nothing:  # noqa: PTH123  a submission must not read or write there
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    student = _Student()
    for line in requests:
        kind, *given = json.loads(line)
        try:
            answer = getattr(student, kind)(*given)
        except BaseException as error:  # noqa: BLE001  the top of a process, with a student's code in it
            _reply(replies, {"error": student.described(error)})
        else:
            _reply(replies, answer)
    os._exit(0)  # at once: Python would wait for a submission's threads


def _reply(replies: TextIO, answer: object) -> None:
    replies.write(json.dumps(answer) + "\n")
    replies.flush()


class _Student:
    """What the grader asks for, by the name of the request."""

    def __init__(self) -> None:
        self._file = ""
        self._module = ModuleType("submission")
        self._made: Any = None
        self._parameters = RigParameters.named("mask")

    def described(self, error: BaseException) -> str:
        """An error as its author wants to read it."""
        if isinstance(error, _RefusalError):
            return str(error)
        if isinstance(error, AbsError):
            return on_one_line(error)
        if isinstance(error, SyntaxError):
            return f"SyntaxError: {error.msg}{place_in(error, self._file)}"
        place = place_in(error, self._file)
        return f"{type(error).__name__}: {error}{place}" if place else describe_error(error)

    def confine(self, cpu_s: int) -> list[str]:
        """Confine the process; what holds."""
        return confine(cpu_s)

    def load(self, file: str, source: str, name: str, may_import: list[str]) -> None:
        """Run the file, whose class or function `name` is asked from now on."""
        self._file = file
        for line, what in _imports(ast.parse(source, file)):
            if not any(what == each or what.startswith(f"{each}.") for each in may_import):
                allowed = ", ".join(may_import) or "nothing"
                raise _RefusalError(f"line {line} imports {what}: this exercise may import from inteco_abs: {allowed}")
        self._module.__file__ = file
        sys.modules[self._module.__name__] = self._module
        exec(compile(source, file, "exec"), vars(self._module))  # noqa: S102  in here it can do no harm
        if not callable(getattr(self._module, name, None)):
            raise _RefusalError(f"it has no {name}, which this exercise asks for")
        self._kind: Any = getattr(self._module, name)

    def controller(self, reference_slip: float, hold_below_rad_s: float) -> None:
        """Begin with a new object of a controller's class, with its gains' defaults."""
        kind: Any = require_controller("the class", self._kind, self._kind.__name__)
        setup = Setup(reference_slip, self._parameters, hold_below_rad_s)
        self._made = kind(setup, **{gain.name: float(gain.default) for gain in kind.gains})

    def observer(self, counts_per_turn: int, period_s: float) -> None:
        """Begin with a new object of an estimator's or a monitor's class."""
        self._made = self._kind(counts_per_turn, self._parameters, period_s)

    def demand(self, dt_s: float, *seen: Any) -> float:
        """Duty for an estimate: speeds, slip, validity, prediction or None."""
        wheel, road, slip, valid, outlook = seen
        predicted = None if outlook is None else Prediction(*outlook)
        demanded = self._made.update(Estimate(wheel, road, slip, valid, predicted), dt_s)
        return _number(getattr(demanded, "brake", demanded), "the brake duty of update(estimate, dt_s)")

    def estimate(self, *seen: Any) -> list[float]:
        """Speeds and slip for a sample."""
        estimated = self._update(*seen)
        try:
            wheel, road, slip = estimated[:3]
        except (TypeError, ValueError):
            raise _RefusalError("update(sample, command) must return an Estimate") from None
        names = "wheel_speed_rad_s", "road_speed_rad_s", "slip"
        return [_number(value, name) for value, name in zip((wheel, road, slip), names, strict=True)]

    def watch(self, *seen: Any) -> str:
        """What a monitor says of a sample."""
        said = self._update(*seen)
        if said is not None and not isinstance(said, str):
            raise _RefusalError(f"update(sample, command) returned {said!r}: must be the name of a fault, or ''")
        return said or ""

    def _update(self, tick: int, time_ns: int, dt_s: float, wheel: int, road: int, drive: float, brake: float) -> Any:
        sample = Sample(tick, time_ns, dt_s, wheel, road, BoardFlags.NONE)
        return self._made.update(sample, Command(drive, brake))

    def identify(self, counts_per_turn: int, sessions: list[Mapping[str, Any]]) -> dict[str, list[float]]:
        """Value and ends of the interval of each parameter, from sessions of arrays."""
        given = [_session(each) for each in sessions]
        found = self._kind(given, counts_per_turn, self._parameters)
        if not isinstance(found, Mapping):
            raise _RefusalError("identify must return a dict of parameters")
        return {str(name): _interval(str(name), each) for name, each in found.items()}


def _session(recorded: Mapping[str, Any]) -> SimpleNamespace:
    arrays = {name: np.array(values) for name, values in recorded.items() if name != "name"}
    return SimpleNamespace(name=recorded["name"], **arrays)


def _interval(name: str, given: Any) -> list[float]:
    try:
        value, low, high = given
    except (TypeError, ValueError):
        raise _RefusalError(f"{name}: {given!r}: must be (value, low, high)") from None
    return [_number(each, name) for each in (value, low, high)]


def _number(value: Any, what: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise _RefusalError(f"{what} is {value!r}: must be a number") from None
    if not np.isfinite(number):
        raise _RefusalError(f"{what} is {number!r}: must be a finite number")
    return number


def _imports(tree: ast.Module) -> list[tuple[int, str]]:
    """Line and full name of what is imported from this package."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(node.lineno, each.name) for each in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found += [(node.lineno, f"{node.module}.{each.name}") for each in node.names]
    return [(line, name) for line, name in found if name.split(".")[0] == _PACKAGE]


if __name__ == "__main__":
    main()
