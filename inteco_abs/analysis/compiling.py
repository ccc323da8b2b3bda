"""Compiled loops over the ticks of sessions, where they pay."""

from __future__ import annotations

import math

from inteco_abs import elementary
from inteco_abs.analysis.arithmetic import recorded_with
from inteco_abs.control import Controller, Estimator
from inteco_abs.sessions import Session
from inteco_abs.warm_up import CompiledLoops, paying_loops


def compiled_loops(
    session: Session, estimator: Estimator, controller: Controller, compiled: bool | None
) -> CompiledLoops | None:
    """Compiled loops, unless they are not `compiled`; None: if they pay for this session and those before.

    Those are what this program has replayed with such parts. Machine code has portable arithmetic only and needs numba.
    """
    if compiled is False or recorded_with(session) != elementary.PORTABLE:
        return None
    key, module = ("replay", type(estimator), type(controller)), "inteco_abs.analysis.compiled_replay"
    return paying_loops(module, key, math.inf if compiled else session.tick_count)
