"""The files that a user's code loads from its folder: modules that it imports, and what it opens to read.

Python reports each file that it opens to an audit hook; a C library that opens a file by itself is not seen.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import source_from_cache
from pathlib import Path
from types import FrameType
from typing import Any, Final

from inteco_abs.source_files import MOST_BYTES, SourceFiles, unpacked

_WRITES: Final = os.O_WRONLY | os.O_RDWR
_INSTALLED: Final = tuple(
    os.path.realpath(place) + os.sep for place in (sys.prefix, sys.base_prefix, Path(__file__).parent.parent)
)
_BYTECODE: Final = ".pyc"


class FilesBeside:
    """What the code of one file loads from the folder that it is in."""

    def __init__(self, file: str, folder: str, source: bytes) -> None:
        self._file = file
        self._folder = os.path.realpath(folder)
        self.source = source
        self._files: dict[str, bytes] = {}
        self._sealed = False
        self._modules: set[str] = set()
        self._added = False
        self.late: dict[str, None] = {}
        """Paths below the folder of files that it opened after `seal`."""

    def packed(self) -> bytes:
        """The source with all files so far."""
        return SourceFiles(self.source, self._files).packed(Path(self._file).name)

    def seal(self) -> bytes:
        """As `packed`; files that are opened from now on come too late."""
        self._sealed = True
        return self.packed()

    @contextmanager
    def importable(self) -> Iterator[None]:
        """Import modules of the folder before others of their names, and leave no bytecode there."""
        writes, before, path = sys.dont_write_bytecode, set(sys.modules), list(sys.path)
        sys.dont_write_bytecode = True
        sys.path.insert(0, self._folder)
        importlib.invalidate_caches()
        try:
            yield
        finally:
            sys.dont_write_bytecode = writes
            with suppress(ValueError):
                sys.path.remove(self._folder)
            if self._folder not in path:
                sys.path.append(self._folder)  # for what is imported later
                self._added = True
            self._modules = {name for name in set(sys.modules) - before if self._has(sys.modules[name])}

    def forget(self) -> None:
        """Let the next code import its own modules, also those of the same names."""
        for name in self._modules:
            sys.modules.pop(name, None)
        if self._added and self._folder in sys.path:
            sys.path.remove(self._folder)

    def look(self, path: str, frame: FrameType | None) -> None:
        """Keep the file that is about to be opened. Raises ValueError if it is too large."""
        if path.endswith(_BYTECODE):
            with suppress(ValueError):  # not of a source beside it
                path = source_from_cache(path)
        name = self._below(path)
        if not name or name in self._files or not os.path.isfile(path) or not self._opens(frame):  # noqa: PTH113  in every open of the process
            return
        if self._sealed:
            self.late[name] = None
            return
        size = sum(map(len, self._files.values())) + os.path.getsize(path)  # noqa: PTH202  as above
        if size > MOST_BYTES:
            problem = f"files beside {self._file} make {size / 1e6:.1f} MB with it: must be at most"
            raise ValueError(f"{name}: the {problem} {MOST_BYTES / 1e6:g} MB, as the session keeps them")
        self._files[name] = Path(path).read_bytes()

    def _has(self, module: Any) -> bool:
        file = getattr(module, "__file__", None)
        return isinstance(file, str) and bool(self._below(file))

    def _opens(self, frame: FrameType | None) -> bool:
        """Whether one of these calls is of this code."""
        while frame is not None:
            file = frame.f_code.co_filename
            if file == self._file or (os.path.isabs(file) and self._below(file)):  # noqa: PTH117  as above
                return True
            frame = frame.f_back
        return False

    def _below(self, path: str) -> str:
        """Path below the folder, with "/"; empty for one elsewhere or of an installed package."""
        folder, name = os.path.split(path)
        place = os.path.join(os.path.realpath(folder), name)  # noqa: PTH118  as above
        if not place.startswith(self._folder + os.sep) or place.startswith(_INSTALLED):
            return ""
        return place[len(self._folder) + 1 :].replace(os.sep, "/")


_loaded: dict[str, FilesBeside] = {}
"""What was loaded, by the controller's name."""
_looking = False


def watch(name: str, beside: FilesBeside) -> None:
    """Keep what this code opens from now on, in the place of what has had the name."""
    if not _loaded:
        sys.addaudithook(_hook)
    for other in _loaded.values():
        other.forget()
    _loaded[name] = beside


def with_files(name: str, source: bytes) -> bytes:
    """The source of the controller `name` with all files that it has loaded; what it opens later is not kept."""
    beside = _loaded.get(name)
    return beside.seal() if beside is not None and beside.source == unpacked(source).source else source


def late_files() -> list[str]:
    """Files beside the controllers that they opened after `with_files`."""
    return [file for beside in _loaded.values() for file in beside.late]


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    global _looking  # noqa: PLW0603  an audit hook cannot be removed, and must not look at its own files
    if event != "open" or _looking or not isinstance(arguments[0], str | bytes | os.PathLike) or arguments[2] & _WRITES:
        return
    _looking = True
    try:
        for beside in _loaded.values():
            beside.look(os.fsdecode(arguments[0]), sys._getframe(1))  # noqa: SLF001  inspect has it only with None for other Pythons
    finally:
        _looking = False
