"""The one narrow way to outputs before a profile is signed: a person at the rig types what they have made sure of."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

from inteco_abs.commissioning.operator import require_phrase
from inteco_abs.commissioning.step import StepContext, today
from inteco_abs.config import RigConfig, bounded_in_time
from inteco_abs.errors import ReadOnlyError

_BY: Final = "commission: typed confirmation by the operator"
DRIVE_LIMIT: Final = 0.2
BRAKE_LIMIT: Final = 0.7
"""The vendor's own, for its brake supply's sake."""
SPEED_LIMIT_RAD_S: Final = 60.0
"""A quarter of the rig's limit."""


def outputs_permitted(visit: StepContext, request: str, phrase: str) -> RigConfig:
    """Configuration with which the board may be entered for output, once `phrase` has been typed.

    It is signed in memory only, for the very logic that the header step has read, and its guard's limits are the
    walk's; the processes that hold the board have it from this one, and it ends with them. Raises ReadOnlyError for a
    profile whose outputs are never to be used, ProbeError for any other phrase.
    """
    config = visit.draft.config
    board, guard, plan = config.board, config.guard, config.experiment
    if board.read_only:
        raise ReadOnlyError(f"the profile's outputs must never be used: {board.read_only}")
    require_phrase(visit.person, request, phrase)
    sign_off: dict[str, Any] = {
        "verified_by": _BY,
        "verified_on": today(),
        "verified_logic": visit.logic_version,
    }
    limits: dict[str, Any] = {
        "drive_limit": DRIVE_LIMIT,
        "brake_limit": min(BRAKE_LIMIT, guard.brake_limit),
        "over_speed_rad_s": min(SPEED_LIMIT_RAD_S, guard.over_speed_rad_s),
    }
    limited = replace(guard, **limits)
    start_rad_s = min(plan.start_speed_rad_s, 0.9 * limits["over_speed_rad_s"])  # no stop is made, but both must fit
    speeds: dict[str, Any] = {
        "start_speed_rad_s": start_rad_s,
        "stop_speed_rad_s": min(plan.stop_speed_rad_s, 0.5 * start_rad_s),
    }
    return replace(
        config,
        board=replace(board, **sign_off),
        guard=limited if board.simulated else bounded_in_time(limited, config.loop.rate_hz),
        experiment=replace(plan, **speeds),
    )
