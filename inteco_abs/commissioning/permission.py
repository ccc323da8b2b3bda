"""The only way to outputs before the sign-off: the operator types a phrase at the rig."""

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
"""The vendor's limit, which protects its brake supply."""
SPEED_LIMIT_RAD_S: Final = 60.0
"""A quarter of the rig's limit."""


def outputs_permitted(context: StepContext, request: str, phrase: str) -> RigConfig:
    """Configuration that allows outputs, after the operator typed `phrase`.

    It is signed in memory only, for the logic that the header step read, with the guard's limits of this procedure.
    Raises ReadOnlyError for a profile whose outputs must never be used, AnswerError for any other phrase.
    """
    config = context.draft.config
    board, guard, plan = config.board, config.guard, config.experiment
    if board.read_only:
        raise ReadOnlyError(f"the profile's outputs must never be used: {board.read_only}")
    require_phrase(context.operator, request, phrase)
    sign_off: dict[str, Any] = {"verified_by": _BY, "verified_on": today(), "verified_logic": context.logic_version}
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
