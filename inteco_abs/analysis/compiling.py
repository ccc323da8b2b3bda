"""When compiled loops pay: numba and its machine code take a second to load, or some seconds to make."""

from __future__ import annotations

from importlib import import_module
from typing import Any, Final, NamedTuple

from inteco_abs import elementary
from inteco_abs.control import Controller, Estimator
from inteco_abs.errors import AbsError
from inteco_abs.sessions import Session

WORTH_LOADING: Final = 100_000
"""Ticks that take as long in Python as it takes to load numba and machine code: 0.7 s."""
WORTH_COMPILING: Final = 1_000_000
"""Ticks that take as long in Python as to compile a loop: 4 s, and with the observer 10 s."""

_decided: dict[tuple[type, type], int] = {}
"""Ticks of which the program was asked for decisions, by types of estimator and controller."""


class CompiledLoops(NamedTuple):
    """The module `compiled_replay`, and whether its loops may be compiled where they are not on disk."""

    module: Any
    may_compile: bool


def compiled_loops(
    session: Session, estimator: Estimator, controller: Controller, compiled: bool | None
) -> CompiledLoops | None:
    """Compiled loops, unless they are not `compiled`; None: if they pay for this session and those before.

    Those are what this program has replayed with such parts. Machine code has portable arithmetic only and needs numba.
    """
    key = type(estimator), type(controller)
    ticks = _decided[key] = _decided.get(key, 0) + len(session.ticks)
    wanted = ticks >= WORTH_LOADING if compiled is None else compiled
    if not wanted or recorded_with(session) != elementary.PORTABLE:
        return None
    try:
        module = import_module("inteco_abs.analysis.compiled_replay")
    except AbsError:  # without numba
        return None
    return CompiledLoops(module, compiled or ticks >= WORTH_COMPILING)


def recorded_with(session: Session) -> str:
    """Name of the arithmetic that the session was recorded with."""
    name: str = session.metadata.get("software", {}).get("arithmetic", elementary.PORTABLE)
    return name
