"""The controllers of a call: shipped and installed ones, a user's own, and the one of a session."""

from __future__ import annotations

import ast
import inspect
import linecache
import os
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from inteco_abs.errors import ConfigError, near_match
from inteco_abs.plugins import FROM_FILE, Controllers, Origin, differs, load_controller

if TYPE_CHECKING:
    from inteco_abs.control import Controller
    from inteco_abs.sessions import Session

RECORDED: Final = "recorded"
"""Name for the code that a session keeps."""
_OPTION: Final = "--controller"


def known_controllers(name: str | type[Controller] | None) -> Controllers:
    """Known controllers, with the user's own if `name` is a class or `file.py:Class`. Raises ConfigError."""
    if name is not None and not isinstance(name, str):
        return _of_class(name)
    if name is None or FROM_FILE not in name:
        controllers = Controllers()
        if name is not None and name not in controllers:
            file = name if name.endswith(".py") else f"{name}.py"
            if name == file or os.path.isfile(file):  # noqa: PTH113  a name too long for a file is not an error here
                raise ConfigError.of(_OPTION, f"{name}: name the class too, as in {file}:Class")
        return controllers
    from inteco_abs.experiment import time_limit

    with time_limit():
        kind, source = load_controller(name)
    return Controllers({name: (kind, Origin(source))})


def name_of(controller: str | type[Controller]) -> str:
    """The name by which `known_controllers` has it."""
    return controller if isinstance(controller, str) else controller.__name__


def _of_class(kind: type[Controller]) -> Controllers:
    from inteco_abs.plugins import require_controller

    given: object = kind  # a caller's mistake
    if not isinstance(given, type):
        problem = f"{kind!r}: must be a name, file.py:Class, or a class with update, gains and internals"
        raise ConfigError.of(_OPTION, problem)
    require_controller(_OPTION, kind, kind.__name__)
    return Controllers({kind.__name__: (kind, Origin(_source_of(kind).encode()))})


def _source_of(kind: type) -> str:
    """Source of a class; empty where it is not known, as at a prompt."""
    with suppress(OSError, TypeError):
        return inspect.getsource(kind)
    # before Python 3.13 inspect does not find a class of a notebook's cell, but its methods know the cell
    for method in filter(inspect.isfunction, vars(kind).values()):
        cell = "".join(linecache.getlines(method.__code__.co_filename))
        with suppress(SyntaxError):
            for node in ast.walk(ast.parse(cell)):
                if isinstance(node, ast.ClassDef) and node.name == kind.__name__:
                    return f"{ast.get_source_segment(cell, node)}\n"
    return ""


def user_controllers(names: Sequence[str]) -> tuple[Controllers, dict[str, bytes]]:
    """All known controllers, and the sources of those from the user's files; a name may be a list with commas."""
    from inteco_abs.montecarlo import split_list

    own = {}
    for name in (one.strip() for text in names for one in split_list(text)):
        known = known_controllers(name)
        if FROM_FILE in name:
            own[name] = known[name], known.origin(name)
    return Controllers(own), {name: origin.source for name, (_, origin) in own.items()}


def controllers_of(session: Session, controller: str | type[Controller] | None) -> tuple[Controllers, list[str]]:
    """Controllers with the session's among them, or `controller` in its place; and what differs from the run's.

    Raises ConfigError if there is none.
    """
    recorded = session.metadata.get("controller", {})
    name, package = recorded.get("name", ""), recorded.get("package", "")
    if controller == RECORDED:
        return _kept_controllers(session, name), []
    controllers = known_controllers(controller)
    if controller is not None:
        given = name_of(controller)
        if given not in controllers:
            raise ConfigError.of(_OPTION, f"no controller {given!r}{near_match(given, controllers)}")
        controllers = Controllers({name: (controllers[given], controllers.origin(given))})
    elif FROM_FILE in name:
        hint = f"name that file to replay it, or {RECORDED} to run the code that the session keeps"
        raise ConfigError.of(_OPTION, f"the session was run with {name!r}; {hint}")
    elif package and name not in controllers:
        problem = f"the session was run with {name!r} of the package {package!r}, which is not installed; install it"
        raise ConfigError.of(_OPTION, problem)
    if name not in controllers:
        return controllers, []
    return controllers, _other_than(session, controllers.origin(name), package)


def _kept_controllers(session: Session, name: str) -> Controllers:
    """The session's own controller, from the code and files that it keeps. Raises ConfigError if there is none."""
    from inteco_abs.experiment import time_limit

    source = _kept_source(session)
    if FROM_FILE not in name or source is None:
        problem = f"{RECORDED}: {session.path} keeps no controller of a file; leave the option out"
        raise ConfigError.of(_OPTION, problem)
    with time_limit():
        kind, _ = load_controller(name, source)
    return Controllers({name: (kind, Origin(source))})


def _kept_source(session: Session) -> bytes | None:
    """Source of the session's controller, with the files beside it if there are."""
    from inteco_abs.sessions import CONTROLLER_FILES, CONTROLLER_SOURCE

    return session.attachments.get(CONTROLLER_FILES, session.attachments.get(CONTROLLER_SOURCE))


def _other_than(session: Session, origin: Origin, package: str) -> list[str]:
    """Why the controller is not the one that the session was run with; empty if it is."""
    found, source = [], _kept_source(session)
    if package not in {"", origin.package}:
        found.append(f"the session was run with {package}; this is {origin.package or 'another controller'}")
    if source is not None and differs(origin.source, source):
        found.append("the controller's source differs from the session's")
    return found
