"""Loops of machine code that are kept on disk as object files, and run without numba.

numba makes them, and takes 0.7 s and 90 MB to load. LLVM, which it is built on, loads an object file alone.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np

from inteco_abs.bound_function import bound, is_own
from inteco_abs.errors import AbsError

try:
    _NUMBA: Final = version("numba")
    from llvmlite import binding
except ImportError as error:
    raise AbsError("machine code needs numba: pip install 'inteco-abs[lab]'") from error

_DIGEST_BYTES: Final = hashlib.sha256().digest_size
_FROM_C: Final = {"numba_frexp": "frexp", "numba_ldexp": "ldexp"}
"""Functions of the C library that numba has under names of its own."""
_UNUSED: Final = ("NRT_MemInfo_call_dtor", "numba_runtime_build_excinfo_struct", "numba_unpickle")
"""Functions of numba's runtime for arrays of its own and for texts of exceptions: no loop makes one, none is read."""


class KeptLoop:
    """A loop in machine code, for arguments of one kind: numbers, records, arrays of records, and tuples of those.

    It returns whether it has done its work. `may_make` says whether it is made where it is not on disk.
    """

    def __init__(self, function: Callable[..., bool], *, may_make: bool) -> None:
        self._function = function
        self._may_make = may_make
        self._code: Callable[..., int] | None = None

    def run(self, *arguments: Any) -> bool:
        """Run it; False if it is missing, cannot be made, raises, or leaves the rest to Python."""
        if self._code is None:
            self._code = self._loaded(arguments)
            if self._code is None:
                return False
        done = ctypes.c_bool()
        leaves = list(_leaves(arguments))
        return self._code(ctypes.byref(done), ctypes.byref(ctypes.c_void_p()), *_passed(leaves)) == 0 and done.value

    def _loaded(self, arguments: tuple[Any, ...]) -> Callable[..., int] | None:
        file = _folder() / f"{bound(self._function).name[:100]}.{_digest(self._function, arguments)}.o"
        if (code := _LOADED.get(file)) is None:
            kept = _read(file)
            if kept is None and self._may_make:
                kept = _make(self._function, arguments, file)
            if kept is None:
                return None
            code = _LOADED[file] = _load(*kept, arguments)
        return code


_LOADED: Final[dict[Path, Callable[..., int]]] = {}
_ENGINES: Final[list[Any]] = []
"""What keeps the code in memory."""


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, tuple):
        for part in value:
            yield from _leaves(part)
    else:
        yield value


def _passed(leaves: list[Any]) -> Iterator[Any]:
    for leaf in leaves:
        if isinstance(leaf, int | float):
            yield leaf
        else:
            yield np.frombuffer(leaf, np.uint8).ctypes.data
            if leaf.shape:
                yield len(leaf)


def _parameters(leaves: list[Any]) -> Iterator[Any]:
    for leaf in leaves:
        if isinstance(leaf, int | float):
            yield ctypes.c_double if isinstance(leaf, float) else ctypes.c_int64
        else:
            yield ctypes.c_void_p
            if leaf.shape:
                yield ctypes.c_int64


def _digest(function: Callable[..., bool], arguments: tuple[Any, ...]) -> str:
    """Of all that the code depends on: source, kinds of arguments, processor and what makes the code."""
    kinds = [
        repr(leaf.dtype) + str(leaf.ndim) if hasattr(leaf, "dtype") else type(leaf).__name__
        for leaf in _leaves(arguments)
    ]
    processor = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    parts = (bound(function).content(), *kinds, *processor, _NUMBA, sys.platform)
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def _folder() -> Path:
    """Numba's own folder, that of compiled Python beside this file, or one of the user."""
    if named := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(named)
    beside = Path(__file__).parent
    if os.access(beside, os.W_OK):
        return beside / "__pycache__"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "inteco-abs")


def _read(file: Path) -> tuple[str, bytes] | None:
    with suppress(OSError):
        data = file.read_bytes()
        content, digest = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
        if hashlib.sha256(content).digest() == digest:  # the process might crash by damaged code
            name, _, code = content.partition(b"\n")
            return name.decode(), code
    return None


def _make(function: Callable[..., bool], arguments: tuple[Any, ...], file: Path) -> tuple[str, bytes] | None:
    """Make it in a process of its own, as numba takes 360 MB, unless it or the function is only here."""
    if "numba" in sys.modules or not is_own(function):
        return make(function, arguments, file)
    command = [sys.executable, "-P", "-m", __name__, str(file)]
    given = pickle.dumps((function, arguments))
    # a Ctrl-C ends it, too, and Python goes on
    subprocess.run(command, input=given, stderr=subprocess.DEVNULL, check=False)  # noqa: S603  our own module
    return _read(file)


def make(function: Callable[..., bool], arguments: tuple[Any, ...], file: Path) -> tuple[str, bytes] | None:
    """Compile it and keep it in `file`, if that can be written. None if it cannot be compiled."""
    from inteco_abs.machine_code import object_code  # noqa: PLC0415  loads numba

    made = object_code(function, arguments)
    if made is None:
        return None
    name, code = made
    content = name.encode() + b"\n" + code
    new = file.with_suffix(f".{os.getpid()}")
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        new.write_bytes(content + hashlib.sha256(content).digest())
        new.replace(file)
    return made


def _load(name: str, code: bytes, arguments: tuple[Any, ...]) -> Callable[..., int]:
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    library = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    for own, other in (*_FROM_C.items(), *((unused, "abort") for unused in _UNUSED)):
        if binding.address_of_symbol(own) is None:  # numba's own, if it is here
            binding.add_symbol(own, ctypes.cast(library[other], ctypes.c_void_p).value)
    engine = binding.create_mcjit_compiler(
        binding.parse_assembly(""), binding.Target.from_default_triple().create_target_machine()
    )
    engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _ENGINES.append(engine)
    parameters = ctypes.c_void_p, ctypes.c_void_p, *_parameters(list(_leaves(arguments)))
    return ctypes.CFUNCTYPE(ctypes.c_int32, *parameters)(engine.get_function_address(name))


if __name__ == "__main__":
    wanted, samples = pickle.load(sys.stdin.buffer)  # noqa: S301  from `_make` in the process that waits
    make(wanted, samples, Path(sys.argv[1]))
