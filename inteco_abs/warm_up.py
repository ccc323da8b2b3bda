"""When compiled loops pay: machine code takes a tenth of a second to load, or some seconds to make."""

from __future__ import annotations

import math
import os
from importlib import import_module
from typing import Any, Final, NamedTuple

from inteco_abs.errors import AbsError

WORTH_LOADING: Final = 20_000
"""Ticks that a replay takes as long for in Python as it takes to load machine code: 0.12 s."""
WORTH_COMPILING: Final = 1_000_000
"""Ticks that a replay takes as long for in Python as to compile a loop: 4 s, and with the observer 10 s."""

asked_for: dict[object, float] = {}
"""Ticks that this program has asked for so far, by what they need."""


class CompiledLoops(NamedTuple):
    """A module of compiled loops, and whether they may be compiled where they are not on disk."""

    module: Any
    may_compile: bool


def paying_loops(module: str, key: object, ticks: float) -> CompiledLoops | None:
    """The `module` if it pays for so many ticks, of which each takes as long as one of a replay, and those before.

    Those before had the same `key`. None without numba, too, and where the environment has numba's own switch,
    NUMBA_DISABLE_JIT=1: it saves the 45 MB of LLVM.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in {"", "0"}:
        return None
    if ticks < math.inf:
        ticks = asked_for[key] = asked_for.get(key, 0.0) + ticks
    if ticks < WORTH_LOADING:
        return None
    try:
        return CompiledLoops(import_module(module), ticks >= WORTH_COMPILING)
    except AbsError:
        asked_for[key] = -math.inf  # without numba it will not be there later either
        return None
