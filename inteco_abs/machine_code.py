"""Machine code of functions of constants and state, made by numba.

`compiled` makes machine code of a function and of all Python functions that it calls, wherever they are written: the
source is that which Python runs.
"""

from __future__ import annotations

import ast
import gc
import hashlib
import inspect
import re
from collections import namedtuple
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import astuple, fields, is_dataclass
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Final, TypeVar, cast

from inteco_abs import elementary
from inteco_abs.bound_function import BoundFunction, bound, global_names
from inteco_abs.errors import AbsError

try:
    from numba import from_dtype, njit, typeof, types
    from numba.core.caching import IndexDataCacheFile
    from numba.np.numpy_support import carray
except ImportError as error:
    raise AbsError("many rigs at once need numba: pip install 'inteco-abs[lab]'") from error

_PICKLE: Final = b"\x80"
"""Its first byte, which no other byte of a version is."""
_DIGEST_BYTES: Final = hashlib.sha256().digest_size
_DECLARED: Final = re.compile(r'^(?:declare [^@]*)?@"?([^"(\s]+)"?(?:\(| = external )', re.MULTILINE)
_BARE: Final[dict[str, Any]] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of numba: no code by which Python or C could call the function."""
_PLACE: Final = re.compile(r'File "([^"]+)", line (\d+)')
Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """`function` as machine code, beside which other threads run; the keywords of a partial must be functions as well.

    The code is kept on disk under the content of every function and constant: numba itself looks at one file alone.
    """
    found: Function = _compiled(bound(function))
    return found


def compile_problem(function: Function, arguments: Sequence[Any]) -> str:
    """What cannot be compiled for such arguments, with its line as far as numba names it; empty if all can."""
    collecting = gc.isenabled()
    gc.disable()  # nearly all that numba makes stays: looking for the rest takes an eighth of the time
    try:
        native: Any = compiled(function)
        native.compile(tuple(map(typeof, arguments)))
    except Exception as error:  # noqa: BLE001  from a user's function numba raises anything, a KeyError for an attribute
        text = str(error)
        said = (line.strip() for line in text.splitlines())
        problem = next((line for line in said if line and not line.startswith(("Failed in", "During", "File"))), text)
        places = [place for place in _PLACE.findall(text) if not place[0].endswith("closed_loop.py")]
        return f"{type(error).__name__}: {problem}" + "".join(f" ({file}, line {line})" for file, line in places[:1])
    finally:
        if collecting:
            gc.enable()
    return ""


def object_code(function: Callable[..., Any], arguments: Sequence[Any]) -> tuple[str, bytes, set[str]] | None:
    """Symbol, object file and symbols of others of `function` for such arguments, or None if it cannot be compiled.

    Its parameters are the leaves of the arguments: an address for a record, address and length for an array, numbers as
    they are.
    """
    if compile_problem(function, arguments):
        return None
    names: list[str] = []
    kinds: list[Any] = []
    known: dict[str, Any] = {"carray": carray, "function": compiled(function)}

    def parameter(kind: Any) -> str:
        names.append(f"p{len(names)}")
        kinds.append(kind)
        return names[-1]

    def expression(value: Any) -> str:
        if isinstance(value, tuple):
            known[type(value).__name__] = type(value)
            return f"{type(value).__name__}({', '.join(map(expression, value))})"
        if isinstance(value, int | float):
            return parameter(typeof(value))
        address = parameter(types.CPointer(from_dtype(value.dtype)))
        return f"carray({address}, {parameter(types.int64)})" if value.shape else f"carray({address}, 1)[0]"

    call = f"function({', '.join(map(expression, arguments))})"
    exec(f"def entry({', '.join(names)}):\n    return {call}", known)  # noqa: S102  of the lines above
    entry = njit(tuple(kinds), error_model="numpy", **_BARE)(known["entry"])
    made: Any = next(iter(entry.overloads.values()))
    _, _, (data, _) = made.library.serialize_using_object_code()
    return made.fndesc.llvm_func_name, data, set(_DECLARED.findall(made.library.get_llvm_str()))


@cache
def _compiled(function: BoundFunction, *, inner: bool = False) -> Any:
    """As by `compiled`; `inner` has machine code for its caller only: code for Python takes a third of the time."""
    made = _without_parameters(*function)
    own = {name: _native(made.__globals__[name]) for name in global_names(made)}
    own |= {name: _compiled(part, inner=True) for name, part in function.keywords}
    copy = FunctionType(made.__code__, {**made.__globals__, **own}, made.__name__, made.__defaults__)
    copy.__qualname__ = f"{function.name}_{function.content()}{'_inner' * inner}"  # numba finds its files by it
    kept = Path(made.__code__.co_filename).is_file()  # numba has no folder for one without a file
    native: Any = njit(cache=kept, nogil=True, error_model="numpy", **(_BARE if inner else {}))(copy)
    if kept and native is not copy:  # as it is where NUMBA_DISABLE_JIT is set
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


def _without_parameters(function: FunctionType, keywords: Sequence[tuple[str, BoundFunction]]) -> FunctionType:
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


def _native(value: Any) -> Any:
    if isinstance(value, FunctionType):
        return _compiled(bound(value), inner=True)
    if value is elementary:
        module = ModuleType(elementary.__name__)
        portable = elementary.ARITHMETICS[elementary.PORTABLE]
        vars(module).update({name: _compiled(bound(function), inner=True) for name, function in portable.items()})
        return module
    if is_dataclass(value) and not isinstance(value, type):
        return namedtuple(type(value).__name__, [field.name for field in fields(value)])(*astuple(value))  # noqa: PYI024  its fields are another's
    return value
