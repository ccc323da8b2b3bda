"""Loads a controller from a user's file."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Final

from inteco_abs.control import Controller
from inteco_abs.entry_points import foreign_code
from inteco_abs.errors import ConfigError, near_file, near_match
from inteco_abs.plugins.beside import FilesBeside, watch
from inteco_abs.plugins.shape import require_controller
from inteco_abs.source_files import SourceFiles, unpacked

FROM_FILE: Final = ".py:"
"""Part of the name of a controller from a user's file."""
_PATH: Final = "--controller"


def load_controller(name: str, source: bytes | None = None) -> tuple[type[Controller], bytes]:
    """Class and source of `file.py:Class`. Runs the file; raises ConfigError if the class is not a controller.

    The source comes with the files beside it that it loads, as one value. If that is given, it replaces the file's
    content, and the files are restored in a temporary folder if those beside the file are others or not there.
    """
    file, _, class_name = name.rpartition(":")
    given = _read(file) if source is None else _unpacked(file, source)
    place = Path(file).parent if _has(Path(file).parent, given) else _restored(file, given)
    path = Path(file)
    module = ModuleType(f"inteco_abs_user_{path.stem}")
    module.__file__ = str(place / path.name)
    sys.modules[module.__name__] = module  # for dataclasses and pickle
    beside = FilesBeside(file, str(place), given.source)
    watch(name, beside)
    with foreign_code(_PATH, file), beside.importable():
        # exactly the bytes that the session keeps, not a cached version
        exec(compile(given.source, file, "exec"), vars(module))  # noqa: S102  the user named this file to be run
    kind = getattr(module, class_name, None)
    if not isinstance(kind, type):
        classes = [key for key, value in vars(module).items() if isinstance(value, type)]
        raise _mistake(f"{file} has no class {class_name!r}{near_match(class_name, classes)}")
    return require_controller(_PATH, kind, name), beside.packed()


def differs(own: bytes, recorded: bytes) -> bool:
    """Whether two packed sources differ, or a file that both have. Raises ConfigError for a damaged one."""
    mine, other = _unpacked("the controller", own), _unpacked("the session's controller", recorded)
    changed = any(other.files.get(name, content) != content for name, content in mine.files.items())
    return changed or mine.source != other.source


def _read(file: str) -> SourceFiles:
    path = Path(file)
    if path.exists() and not path.is_file():  # opening a pipe waits for its writer
        raise _mistake(f"{file}: not a regular file; name a file as in law.py:Class")
    try:
        return SourceFiles(path.read_bytes(), {})
    except OSError as error:
        hint = near_file(path) or "; name a file as in law.py:Class"
        raise _mistake(f"{file}: cannot be read: {error.strerror}{hint}") from error


def _unpacked(file: str, data: bytes) -> SourceFiles:
    try:
        return unpacked(data)
    except ValueError as error:
        raise _mistake(f"{file}: the files kept with it cannot be restored: {error}") from error


def _has(folder: Path, given: SourceFiles) -> bool:
    """Whether all files are in the folder as they were kept."""
    try:
        return all((folder / name).read_bytes() == content for name, content in given.files.items())
    except OSError:
        return False


def _restored(file: str, given: SourceFiles) -> Path:
    """Folder of its own for the files, until this process ends."""
    folder = Path(_temporary().name) / str(len(list(Path(_temporary().name).iterdir())))
    for name, content in {Path(file).name: given.source, **given.files}.items():
        path = folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        except OSError as error:
            raise _mistake(f"{file}: {name} that was kept with it cannot be restored: {error.strerror}") from error
    return folder


@cache
def _temporary() -> TemporaryDirectory[str]:
    return TemporaryDirectory(prefix="inteco-abs-")


def _mistake(problem: str) -> ConfigError:
    return ConfigError.of(_PATH, problem)
