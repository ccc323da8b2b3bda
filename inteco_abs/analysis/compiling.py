"""When compiled loops pay: numba and its machine code take a second to load, or some seconds to make."""

from __future__ import annotations

import math
from importlib import import_module
from typing import Any, Final, NamedTuple

from inteco_abs import elementary
from inteco_abs.control import Controller, Estimator
from inteco_abs.errors import AbsError
from inteco_abs.sessions import Session

WORTH_LOADING: Final = 100_000
"""Ticks that a replay takes as long for in Python as it takes to load numba and machine code: 0.7 s."""
WORTH_COMPILING: Final = 1_000_000
"""Ticks that a replay takes as long for in Python as to compile a loop: 4 s, and with the observer 10 s."""

_ticks: dict[object, float] = {}
"""Ticks that this program has asked for so far, by what they need."""


class CompiledLoops(NamedTuple):
    """A module of compiled loops, and whether they may be compiled where they are not on disk."""

    module: Any
    may_compile: bool


def compiled_loops(
    session: Session, estimator: Estimator, controller: Controller, compiled: bool | None
) -> CompiledLoops | None:
    """Compiled loops, unless they are not `compiled`; None: if they pay for this session and those before.

    Those are what this program has replayed with such parts. Machine code has portable arithmetic only and needs numba.
    """
    if compiled is False or recorded_with(session) != elementary.PORTABLE:
        return None
    key, module = ("replay", type(estimator), type(controller)), "inteco_abs.analysis.compiled_replay"
    return paying_loops(module, key, math.inf if compiled else len(session.ticks))


def paying_loops(module: str, key: object, ticks: float) -> CompiledLoops | None:
    """The `module` if it pays for so many ticks, of which each takes as long as one of a replay, and those before.

    Those before had the same `key`. None without numba, too.
    """
    if ticks < math.inf:
        ticks = _ticks[key] = _ticks.get(key, 0.0) + ticks
    if ticks < WORTH_LOADING:
        return None
    try:
        return CompiledLoops(import_module(module), ticks >= WORTH_COMPILING)
    except AbsError:
        return None


def recorded_with(session: Session) -> str:
    """Name of the arithmetic that the session was recorded with."""
    name: str = session.metadata.get("software", {}).get("arithmetic", elementary.PORTABLE)
    return name
