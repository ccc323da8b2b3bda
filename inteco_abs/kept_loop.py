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
from typing import Any, Final, cast

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
"""Functions of numba's runtime for arrays of its own and for texts of exceptions: a loop that makes one needs others,
and no text is read."""
_C_LIBRARY: Final = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)


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
        run = self.prepared(*arguments)
        return run is not None and run()

    def prepared(self, *arguments: Any) -> Callable[[], bool] | None:
        """`run` with these arguments, again and again at 1 us each; None if it is missing or cannot be made."""
        if self._code is None:
            self._code = self._loaded(arguments)
            if self._code is None:
                return None
        code, done = self._code, ctypes.c_bool()
        passed = (ctypes.byref(done), ctypes.byref(ctypes.c_void_p()), *_passed(arguments))

        def run(_kept: tuple[Any, ...] = arguments) -> bool:  # `passed` has no more than addresses
            return code(*passed) == 0 and done.value

        return run

    def _loaded(self, arguments: tuple[Any, ...]) -> Callable[..., int] | None:
        file = _file(self._function, arguments)
        if file not in _LOADED:
            kept = _read(file) or (_made(self._function, arguments) if self._may_make else b"")
            if kept or self._may_make:
                _LOADED[file] = _load(kept) if kept else None
        return _LOADED.get(file)


_LOADED: Final[dict[Path, Callable[..., int] | None]] = {}
"""None if it cannot be made."""


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, tuple):
        for part in value:
            yield from _leaves(part)
    else:
        yield value


def _passed(arguments: tuple[Any, ...]) -> Iterator[Any]:
    for leaf in _leaves(arguments):
        if isinstance(leaf, float):
            yield ctypes.c_double(leaf)
        elif isinstance(leaf, int):
            yield ctypes.c_int64(leaf)
        else:
            yield ctypes.c_void_p(np.frombuffer(leaf, np.uint8).ctypes.data)
            if leaf.shape:
                yield ctypes.c_int64(len(leaf))


def _file(function: Callable[..., bool], arguments: tuple[Any, ...]) -> Path:
    """Named by all that the code depends on: functions, kinds of arguments, processor and what makes the code."""
    kinds = [
        repr(leaf.dtype) + str(leaf.ndim) if hasattr(leaf, "dtype") else type(leaf).__name__
        for leaf in _leaves(arguments)
    ]
    processor = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    parts = (bound(function).content(), *kinds, *processor, _NUMBA, sys.platform)
    digest = hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
    return _folder() / f"{bound(function).name[:100]}.{digest}.o"


def _folder() -> Path:
    """Numba's own folder, that of compiled Python beside this file, or one of the user."""
    if named := os.environ.get("NUMBA_CACHE_DIR"):
        return Path(named)
    beside = Path(__file__).parent / "__pycache__"
    if os.access(beside, os.W_OK):
        return beside
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "inteco-abs")


def _read(file: Path) -> bytes:
    """Symbol, new line and object file; empty if it is missing or damaged."""
    with suppress(OSError):
        return _whole(file.read_bytes())
    return b""


def _whole(data: bytes) -> bytes:
    content, digest = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
    return content if hashlib.sha256(content).digest() == digest else b""  # the process might crash by damaged code


def _made(function: Callable[..., bool], arguments: tuple[Any, ...]) -> bytes:
    """As by `_read`, made in a process of its own, as numba takes 360 MB, unless it is loaded or the loop a user's."""
    if "numba" in sys.modules or not is_own(function):
        return _whole(make(function, arguments))
    command = [sys.executable, "-P", "-m", __name__]
    given = pickle.dumps((function, arguments))
    with suppress(OSError):
        # a Ctrl-C ends it, too, and Python goes on
        done = subprocess.run(command, input=given, capture_output=True, check=False)  # noqa: S603  our own module
        return _whole(done.stdout)
    return b""


def make(function: Callable[..., bool], arguments: tuple[Any, ...]) -> bytes:
    """Compile it, and keep it if there is a place. Content of its file, or nothing if it cannot be compiled."""
    from inteco_abs.machine_code import object_code  # noqa: PLC0415  loads numba

    made = object_code(function, arguments)
    if made is None or not all(map(_is_here, made[2])):
        return b""
    content = made[0].encode() + b"\n" + made[1]
    content += hashlib.sha256(content).digest()
    file = _file(function, arguments)
    new = file.with_suffix(f".{os.getpid()}")
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            new.write_bytes(content)
            new.replace(file)
        finally:
            new.unlink(missing_ok=True)
    return content


def _is_here(symbol: str) -> bool:
    """Whether it can be loaded without numba: LLVM would end the process."""
    return symbol.startswith("llvm.") or symbol in {*_FROM_C, *_UNUSED} or hasattr(_C_LIBRARY, symbol)


def _load(kept: bytes) -> Callable[..., int]:
    name, _, code = kept.partition(b"\n")
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    for own, other in (*_FROM_C.items(), *((unused, "abort") for unused in _UNUSED)):
        if binding.address_of_symbol(own) is None:  # numba's own, if it is here
            binding.add_symbol(own, ctypes.cast(_C_LIBRARY[other], ctypes.c_void_p).value)
    engine = binding.create_mcjit_compiler(
        binding.parse_assembly(""), binding.Target.from_default_triple().create_target_machine()
    )
    engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    loaded: Any = ctypes.CFUNCTYPE(ctypes.c_int32)(engine.get_function_address(name.decode()))
    loaded.engine = engine  # keeps the code in memory
    return cast("Callable[..., int]", loaded)


if __name__ == "__main__":
    wanted, samples = pickle.load(sys.stdin.buffer)  # noqa: S301  from `_made` in the process that waits
    sys.stdout.buffer.write(make(wanted, samples))
