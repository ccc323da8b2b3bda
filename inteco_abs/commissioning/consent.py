"""The operator's consent to the first write, after seeing word by word what it changes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from inteco_abs.boards import STILL_ON, PlannedWord, Remark
from inteco_abs.commissioning.operator import agree
from inteco_abs.commissioning.step import StepContext
from inteco_abs.config import RigConfig
from inteco_abs.errors import CommissioningError, Stopped

_NAME: Final = "first_write"


def agree_on_first_write(context: StepContext, config: RigConfig) -> dict[str, list[dict[str, Any]]]:
    """Show what entering the board with `config` would change, and ask unless an earlier step had the same consent.

    The board is only read. Returns what was shown, for the step's result. Raises CommissioningError if a PWM runs that
    the wiring does not use, Stopped if the operator refuses.
    """
    with context.rig.open(config).reading() as board:
        board.require_writable()
        planned = board.first_write()
    _require_others_off(planned)
    # in the types that JSON reads back, to compare with earlier results
    shown = [{**one._asdict(), "names": list(one.names)} for one in planned if one.remark is not Remark.NUMBER]
    agreed = [one for facts in context.draft.results.values() for one in facts.get(_NAME, [])]
    changes = [one for one in planned if one.now != one.planned]
    kept = [one for one in planned if one.remark in {Remark.UNKNOWN, Remark.CUT}]
    context.operator.say(_table(changes, kept))
    new = any(one not in agreed for one in shown)
    if new and not agree(context.operator, "Write this to the board?"):
        raise Stopped("not agreed: nothing was written to the board")
    return {_NAME: shown}


def _require_others_off(planned: Sequence[PlannedWord]) -> None:
    """Raise CommissioningError if an unused channel is on: before the sign-off, it may be a motor's."""
    running = [name for one in planned if one.remark is Remark.RUNS for name in one.names]
    if running:
        keys = ", ".join(f"{name} = 0" for name in running)
        raise CommissioningError(
            f"PWM channels that the profile does not use are on: {', '.join(running)}. {STILL_ON}, then switch the "
            f"board off and on; or set them in [board.constants], as in {keys}"
        )


def _table(changes: Sequence[PlannedWord], kept: Sequence[PlannedWord]) -> str:
    lines: list[object] = [f"{len(changes)} words of the board change with the first write (now -> then):", *changes]
    if kept:
        lines += [f"{len(kept)} unknown words are written back as they were read:", *kept]
    return "\n".join(f"  {line}" for line in lines)
