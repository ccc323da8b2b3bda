"""Step 7: the operator signs off the wiring and the guard's limits by name."""

from __future__ import annotations

from typing import Final

from inteco_abs.boards import unconfirmed
from inteco_abs.commissioning.operator import agree, ask_for
from inteco_abs.commissioning.step import Facts, StepContext, today
from inteco_abs.errors import ReadOnlyError, Stopped

_LONGEST: Final = 100


def sign(context: StepContext) -> Facts:
    """Show what is not confirmed, ask who verified the rest, and sign it off together with the guard's limits."""
    board, guard = context.draft.config.board, context.draft.config.guard
    if board.read_only:
        raise ReadOnlyError(f"there is nothing to sign: the profile's outputs must never be used: {board.read_only}")
    open_points = unconfirmed(board)
    for one in open_points:
        key = one.partition(" ")[0]
        source = board.evidence[key].source if key in board.evidence else "no source"
        context.operator.say(f"  not confirmed: {one}: {source}")
    if not open_points:
        context.operator.say("  all of the wiring is confirmed")
    limits = guard.as_table()
    context.operator.say(
        f"  signed off with it: guard {', '.join(f'{key} {value:g}' for key, value in limits.items())}"
    )
    signer = ask_for(context.operator, "Who verified this wiring on the rig? Name:", _name, "a name")
    if not agree(context.operator, f"Sign for logic 0x{context.logic_version:04X} as {signer!r}?"):
        raise Stopped("not signed: the draft stays as it is")
    sign_off = {
        "board.verified_by": signer,
        "board.verified_on": today(),
        "board.verified_logic": context.logic_version,
        **{f"guard.{key}": value for key, value in limits.items()},  # a later default would otherwise count as signed
    }
    context.draft.write(sign_off)
    context.operator.say(f"  signed: inteco-abs run --board {context.rig.address} --set profile={context.draft.file}")
    return {"signed_by": signer, "unconfirmed": open_points}


def _name(text: str) -> str | None:
    return text if text and len(text) <= _LONGEST and text.isprintable() and any(map(str.isalpha, text)) else None
