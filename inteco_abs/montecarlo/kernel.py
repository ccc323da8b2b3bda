"""The plant's functions compiled, in loops over many rigs whose constants, states and commands are rows of arrays.

`compiled` makes machine code of a function and of all Python functions that it calls, wherever they are written: the
source is that of `Plant`.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import re
from collections import namedtuple
from collections.abc import Callable, Sequence
from dataclasses import astuple, fields, is_dataclass
from functools import cache, partial
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Final, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from inteco_abs import elementary
from inteco_abs.errors import AbsError
from inteco_abs.rig.encoder import count
from inteco_abs.rig.model import wheel_slip
from inteco_abs.rig.plant import move_on
from inteco_abs.rig.rng import normal_pair

try:
    from numba import njit, typeof
except ImportError as error:
    raise AbsError("many rigs at once need numba: pip install 'inteco-abs[lab]'") from error

_PLACE: Final = re.compile(r'File "([^"]+)", line (\d+)')
Floats = NDArray[np.float64]
Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """`function` as machine code, beside which other threads run; the keywords of a partial must be functions as well.

    The code is kept on disk under the content of every file that it comes from: numba itself looks at one alone.
    """
    found: Function = _compiled(_bound(function))
    return found


def compile_problem(function: Function, arguments: Sequence[Any]) -> str:
    """What cannot be compiled for such arguments, with its line as far as numba names it; empty if all can."""
    native: Any = compiled(function)
    try:
        native.compile(tuple(map(typeof, arguments)))
    except Exception as error:  # noqa: BLE001  from a user's function numba raises anything, a KeyError for an attribute
        text = str(error)
        said = (line.strip() for line in text.splitlines())
        problem = next((line for line in said if line and not line.startswith(("Failed in", "During", "File"))), text)
        places = [place for place in _PLACE.findall(text) if not place[0].endswith("closed_loop.py")]
        return f"{type(error).__name__}: {problem}" + "".join(f" ({file}, line {line})" for file, line in places[:1])
    return ""


class _Bound(NamedTuple):
    """A function, and those that it gets as keywords."""

    function: FunctionType
    keywords: tuple[tuple[str, _Bound], ...]


def _bound(function: Any) -> _Bound:
    if isinstance(function, partial):
        keywords = tuple((name, _bound(part)) for name, part in function.keywords.items())
        return _Bound(cast(FunctionType, function.func), keywords)
    return _Bound(function, ())


@cache
def _compiled(bound: _Bound) -> Any:
    function = _without_parameters(*bound)
    own = {name: _native(function.__globals__[name]) for name in _globals(function)}
    own |= {name: _compiled(part) for name, part in bound.keywords}
    copy = FunctionType(function.__code__, {**function.__globals__, **own}, function.__name__, function.__defaults__)
    files = [Path(file) for file in sorted(_files(bound))]
    on_disk = all(file.is_file() for file in files)  # a user's source may come without its file
    content = b"".join(file.read_bytes() for file in files) if on_disk else b""
    copy.__qualname__ = f"{_name(bound)}_{hashlib.sha256(content).hexdigest()[:16]}"
    return njit(cache=on_disk, nogil=True, error_model="numpy")(copy)


def _without_parameters(function: FunctionType, keywords: Sequence[tuple[str, _Bound]]) -> FunctionType:
    """Make these parameters global names: numba keeps no code on disk that passes functions on."""
    if not keywords:
        return function
    source = ast.parse(inspect.getsource(function))
    ast.increment_lineno(source, function.__code__.co_firstlineno - 1)
    arguments = cast(ast.FunctionDef, source.body[0]).args
    names = [name for name, _ in keywords]
    arguments.args = [argument for argument in arguments.args if argument.arg not in names]
    made: dict[str, Any] = {**function.__globals__}
    flags = annotations.compiler_flag
    exec(compile(source, function.__code__.co_filename, "exec", flags), made)  # noqa: S102  our own source
    found: FunctionType = made[function.__name__]
    return found


def _name(bound: _Bound) -> str:
    return "_".join([bound.function.__qualname__, *(_name(part) for _, part in bound.keywords)])


def _globals(function: FunctionType) -> list[str]:
    return [name for name in function.__code__.co_names if name in function.__globals__]


def _native(value: Any) -> Any:
    if isinstance(value, FunctionType):
        return compiled(value)
    if value is elementary:
        module = ModuleType(elementary.__name__)
        portable = elementary.ARITHMETICS[elementary.PORTABLE]
        vars(module).update({name: compiled(function) for name, function in portable.items()})
        return module
    if is_dataclass(value) and not isinstance(value, type):
        return namedtuple(type(value).__name__, [field.name for field in fields(value)])(*astuple(value))  # noqa: PYI024  its fields are another's
    return value


def _files(bound: _Bound) -> set[str]:
    function, keywords = bound
    used = [function.__globals__[name] for name in _globals(function)]
    parts = [*(_bound(value) for value in used if isinstance(value, FunctionType)), *(part for _, part in keywords)]
    own = {elementary.__file__} if any(value is elementary for value in used) else set[str]()
    return own.union({function.__code__.co_filename}, *map(_files, parts))


@compiled
def first_outside(duties: Floats) -> int:
    """Place of the first duty that is not in 0..1, or -1."""
    for i in range(duties.size):
        if not 0.0 <= duties[i] <= 1.0:
            return i
    return -1


@compiled
def advance(
    rigs: Any,
    states: Any,
    due_s: Floats,
    torques: Floats,
    drives: Floats,
    brakes: Floats,
    tick: int,
    duration_s: float,
) -> int:
    """Move all rigs on; the largest number of commands on their way to a brake.

    `drives` and `brakes` hold the duties of the newest ticks, a row each, those of `tick` in row `tick` modulo
    the number of rows.
    """
    most = 0
    for i in range(rigs.size):
        k, s = rigs[i], states[i]
        row = (tick - k.command_delay_ticks) % drives.shape[0]
        move_on(k, s, due_s[i], torques[i], drives[row, i], brakes[row, i], duration_s)
        most = max(most, s.sent - s.arrived)
    return most


@compiled
def slips(rigs: Any, states: Any, found: Floats) -> None:
    """Write every rig's slip to `found`."""
    for i in range(rigs.size):
        found[i] = wheel_slip(states[i].wheel_speed, states[i].road_speed, rigs[i])


@compiled
def read_encoders(rigs: Any, states: Any, reading: Any, wheel: NDArray[np.int64], road: NDArray[np.int64]) -> None:
    """Write every rig's counts to `wheel` and `road`, with the noise of that number of reading, 1 at first."""
    for i in range(rigs.size):
        k, s = rigs[i], states[i]
        noise1 = noise2 = 0.0
        if k.wheel_encoder.jitter_counts > 0.0 or k.road_encoder.jitter_counts > 0.0:
            noise1, noise2 = normal_pair(k.noise_seed, reading)
        wheel[i] = count(k.wheel_encoder, s.wheel_angle, noise1)
        road[i] = count(k.road_encoder, s.road_angle, noise2)
