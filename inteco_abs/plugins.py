"""A controller of the user's own, from a file that the user names."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Final

from inteco_abs.control import Controller, Gain
from inteco_abs.errors import ConfigError, Mistake, near_match

_MOST_INTERNALS: Final = 4


def load_controller(name: str, source: bytes | None = None) -> tuple[type[Controller], bytes]:
    """Class and source of `file.py:Class`. Runs the file; raises ConfigError if that gives no controller.

    `source` stands in for what is in the file: another process has read it already.
    """
    file, _, class_name = name.rpartition(":")
    path = Path(file)
    try:
        source = path.read_bytes() if source is None else source
    except OSError as error:
        raise _mistake(f"{file}: cannot be read: {error.strerror}") from error
    module = ModuleType(f"inteco_abs_user_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses and pickles look their module up there
    try:
        # the very bytes that the session keeps, and no cached older version of them
        exec(compile(source, str(path), "exec"), vars(module))  # noqa: S102  the user named this file to be run
    except (Exception, SystemExit) as error:  # the user's own code, which may raise anything
        raise _mistake(f"{file}: {type(error).__name__}: {error}") from error
    kind = getattr(module, class_name, None)
    if not isinstance(kind, type):
        classes = [key for key, value in vars(module).items() if isinstance(value, type)]
        raise _mistake(f"{file} has no class {class_name!r}{near_match(class_name, classes)}")
    if not callable(getattr(kind, "update", None)):
        raise _mistake(f"{class_name} has no method update(estimate, dt_s)")
    gains = getattr(kind, "gains", None)
    if not isinstance(gains, tuple) or not all(isinstance(gain, Gain) for gain in gains):
        raise _mistake(f"{class_name}.gains must be a tuple of inteco_abs.control.Gain; () if it has none")
    internals = getattr(kind, "internals", None)
    if not isinstance(internals, tuple) or len(internals) > _MOST_INTERNALS:
        raise _mistake(f"{class_name}.internals must be a tuple of at most {_MOST_INTERNALS} names; () if it logs none")
    return kind, source


def _mistake(problem: str) -> ConfigError:
    return ConfigError([Mistake("--controller", problem)])
