"""Machine code of functions of constants and state, and records of both, which such code reads and writes.

`compiled` makes machine code of a function and of all Python functions that it calls, wherever they are written: the
source is that which Python runs.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import re
from collections import namedtuple
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import Field, astuple, fields, is_dataclass
from functools import cache, partial
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Final, NamedTuple, TypeVar, cast

import numpy as np

from inteco_abs import elementary
from inteco_abs.errors import AbsError

try:
    from numba import njit, typeof
    from numba.core.caching import IndexDataCacheFile
except ImportError as error:
    raise AbsError("many rigs at once need numba: pip install 'inteco-abs[lab]'") from error

_PACKAGE: Final = Path(elementary.__file__).parent
_PICKLE: Final = b"\x80"
"""Its first byte, which no other byte of a version is."""
_DIGEST_BYTES: Final = hashlib.sha256().digest_size
_PLACE: Final = re.compile(r'File "([^"]+)", line (\d+)')
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


def is_compiled(function: Function) -> bool:
    """Whether there is machine code of `function` in this process or on disk, which is loaded in under a second."""
    native: Any = compiled(function)
    folder = native.stats.cache_path
    return bool(native.signatures) or (
        folder is not None and any(Path(folder).glob(f"*.{native.py_func.__qualname__}-*.nbi"))
    )


def is_own(function: Function) -> bool:
    """Whether all source of `function` is this package's: tests ensure that its machine code has the bits of Python."""
    return all(Path(file).is_relative_to(_PACKAGE) for file in _files(_bound(function)))


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
    native: Any = njit(cache=on_disk, nogil=True, error_model="numpy")(copy)
    if on_disk and native is not copy:  # as it is where NUMBA_DISABLE_JIT is set
        native._cache._cache_file.__class__ = _CheckedFiles  # noqa: SLF001  numba offers no other place for a check
    return native


class _CheckedFiles(IndexDataCacheFile):
    """Numba's files of machine code with a digest each: a damaged one counts as missing, and is made once more.

    Numba would load it, and the process might crash. Each is named by what it is the code of: numba numbers them, and
    two processes that compile at once may give one number to the code of two kinds of record.
    """

    def save(self, key: object, data: object) -> None:
        name = f"{Path(self._index_name).stem}.{hashlib.sha256(self._dump(key)).hexdigest()[:16]}.nbc"
        self._save_data(name, data)
        self._save_index(self._load_index() | {key: name})

    def _dump(self, content: object) -> bytes:
        data: bytes = super()._dump(content)
        return data + hashlib.sha256(data).digest()  # behind its end, where pickle does not read

    def _load_data(self, name: str) -> Any:
        if not _is_whole(Path(self._data_path(name)).read_bytes()):
            raise FileNotFoundError(name)
        return super()._load_data(name)

    def _load_index(self) -> Any:
        with suppress(Exception):  # a damaged index may have any bytes
            content = Path(self._index_path).read_bytes()
            if _is_whole(content[content.index(_PICKLE, 1) :]):  # behind the version, which numba writes first
                return super()._load_index()
        return {}


def _is_whole(data: bytes) -> bool:
    return hashlib.sha256(data[:-_DIGEST_BYTES]).digest() == data[-_DIGEST_BYTES:]


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


_LEAST_RING: Final = 128
"""Entries of a ring's array: with few lengths there are few types, each of which takes seconds to compile."""


def record(part: Any) -> Any:
    """The fields of a dataclass's instance as a record: numbers, flags, lists of numbers or of rows, and dataclasses.

    A list of numbers has an array with room for a power of two, at least _LEAST_RING.
    """
    return records(part)[0]


def records(*parts: Any) -> Any:
    """An array of such records, of instances of one dataclass whose lists are equally long."""
    return np.array([_values(part) for part in parts], _kind(parts[0])).view(np.recarray)


def restore(found: Any, part: Any) -> None:
    """Put what a record holds back into the dataclass's instance that it was made of, or one like it."""
    for field in fields(part):
        value, numbers = getattr(part, field.name), found[field.name]
        if is_dataclass(value):
            restore(numbers, value)
        elif isinstance(value, list):
            value[:] = numbers.tolist()[: len(value)]
        else:
            setattr(part, field.name, type(value)(numbers.item()))


def _kind(value: Any) -> np.dtype[Any]:
    if is_dataclass(value):
        return np.dtype([(field.name, _kind(getattr(value, field.name))) for field in row_fields(value)], align=True)
    if isinstance(value, list | tuple):
        return np.dtype((_kind(np.ravel(value)[0].item()), np.shape(_values(value))))
    return np.dtype(np.bool_ if isinstance(value, bool) else np.int64 if isinstance(value, int) else np.float64)


def _values(value: Any) -> Any:
    if is_dataclass(value):
        return tuple(_values(getattr(value, field.name)) for field in row_fields(value))
    if isinstance(value, list) and not isinstance(value[0], list):
        room = max(_LEAST_RING, 1 << (len(value) - 1).bit_length())
        return value + [value[0] * 0] * (room - len(value))
    return value


def row_fields(kind: Any) -> tuple[Field[Any], ...]:
    """Backwards: numba takes a record that begins as another one for that one, and warns; a subclass's would.

    So would those of two classes that end with the same fields: what many have comes first.
    """
    return fields(kind)[::-1]
