"""Whether the decisions of a run with a controller that does not ship replay, checked when it has ended."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any, Final

from inteco_abs.config import RigConfig
from inteco_abs.control import CONTROLLERS, build_pipeline
from inteco_abs.errors import AbsError
from inteco_abs.experiment.plan import Plan
from inteco_abs.experiment.user_code import time_limit
from inteco_abs.plugins import late_files
from inteco_abs.sessions import RunResult, Session, read_session
from inteco_abs.signals import Reason

CHECKED_TICKS: Final = 20_000
"""From the start of the run: at 2 kHz, ten seconds, which have the first stop."""


def replay_problem(config: RigConfig, plan: Plan, result: RunResult) -> str:
    """Why a replay of the recorded run will not decide the same; empty if it does.

    The first CHECKED_TICKS are replayed, within 60 s. Controllers that ship are not checked, nor is a run that ended
    by the controller's error.
    """
    if config.controller.name in CONTROLLERS or result.reason is Reason.CONTROLLER_ERROR:
        return ""
    late = late_files()
    try:
        with redirect_stdout(io.StringIO()), _without_copies(), time_limit():  # it has printed already
            problem = _difference(config, plan, read_session(Path(result.card["session"])).first(CHECKED_TICKS))
    except AbsError as error:
        problem = f"the replay of its decisions cannot be checked: {error}"
    if late:
        problem += f"{'; ' if problem else ''}the controller opened {', '.join(late)} while it ran, not when it was "
        problem += "loaded or made, so the session does not keep that"
    return problem


@contextmanager
def _without_copies() -> Iterator[None]:
    """End the copies of this process that the controller forks, which would print the card, too, and its children.

    Processes that the caller has begun before stay.
    """
    process, before = os.getpid(), _children()
    try:
        yield
    finally:
        if os.getpid() != process:
            os._exit(1)
        for child in _children():
            if child not in before:
                child.kill()


def _children() -> list[Any]:
    """Living processes of `multiprocessing`, which a program without any need not import."""
    multiprocessing = sys.modules.get("multiprocessing.process")
    return multiprocessing.active_children() if multiprocessing else []


def _difference(config: RigConfig, plan: Plan, session: Session) -> str:
    if not session.tick_count:
        return ""
    from inteco_abs.analysis import recorded_arithmetic, replay_session  # noqa: PLC0415  50 ms, not before the run

    with recorded_arithmetic(session):
        replay = replay_session(session, build_pipeline(config, plan.controllers))
    if replay.first is None:
        return ""
    return (
        f"the decisions do not replay: {replay.differing} of {replay.ticks} ticks differ, first at tick "
        f"{replay.first.tick}: {replay.first.field}; the controller uses a clock, random numbers, or something "
        "outside of itself that changes"
    )
