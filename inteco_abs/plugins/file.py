"""Loads a controller from a user's file."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Final

from inteco_abs.control import Controller
from inteco_abs.entry_points import foreign_code
from inteco_abs.errors import ConfigError, near_file, near_match
from inteco_abs.plugins.shape import require_controller

FROM_FILE: Final = ".py:"
"""Part of the name of a controller from a user's file."""
_PATH: Final = "--controller"


def load_controller(name: str, source: bytes | None = None) -> tuple[type[Controller], bytes]:
    """Class and source of `file.py:Class`. Runs the file; raises ConfigError if the class is not a controller.

    `source` replaces the file's content, if another process has read it already.
    """
    file, _, class_name = name.rpartition(":")
    path = Path(file)
    if source is None and path.exists() and not path.is_file():  # opening a pipe waits for its writer
        raise _mistake(f"{file}: not a regular file; name a file as in law.py:Class")
    try:
        source = path.read_bytes() if source is None else source
    except OSError as error:
        hint = near_file(path) or "; name a file as in law.py:Class"
        raise _mistake(f"{file}: cannot be read: {error.strerror}{hint}") from error
    module = ModuleType(f"inteco_abs_user_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # for dataclasses and pickle
    with foreign_code(_PATH, file):
        # exactly the bytes that the session keeps, not a cached version
        exec(compile(source, file, "exec"), vars(module))  # noqa: S102  the user named this file to be run
    kind = getattr(module, class_name, None)
    if not isinstance(kind, type):
        classes = [key for key, value in vars(module).items() if isinstance(value, type)]
        raise _mistake(f"{file} has no class {class_name!r}{near_match(class_name, classes)}")
    return require_controller(_PATH, kind, name), source


def _mistake(problem: str) -> ConfigError:
    return ConfigError.of(_PATH, problem)
