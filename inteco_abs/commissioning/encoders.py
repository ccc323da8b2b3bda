"""Step 4: turning the wheels by hand gives each encoder's channel, sign and counts per turn."""

from __future__ import annotations

from typing import Final, NamedTuple

from inteco_abs.boards import Board
from inteco_abs.commissioning.hand_turning import USUAL_COUNTS, HandTurn, Unclear, counts_per_turn, watch
from inteco_abs.commissioning.operator import agree, ask_for, wait_for
from inteco_abs.commissioning.reading import open_for_reading, require_outputs_off, require_same_board
from inteco_abs.commissioning.rig_access import TURNS, Wheel
from inteco_abs.commissioning.step import Facts, StepContext, today
from inteco_abs.errors import CommissioningError

_TRIALS: Final = 3
_NAMES: Final[dict[Wheel, str]] = {"wheel": "upper", "road": "lower"}
_LEAST, _MOST = 256, 1_000_000
"""Counts per turn that a configuration may have."""
KEYS: Final = ("road_encoder", "wheel_encoder", "road_sign", "wheel_sign", "counts_per_turn")


class _Encoder(NamedTuple):
    channel: int
    sign: int
    per_turn: int
    turned: HandTurn


def turn_wheels(context: StepContext) -> Facts:
    """Have both wheels turned by hand; write channels, signs and counts per turn into the draft.

    Raises CommissioningError if a wheel stays unclear, or if the wheels differ in counts per turn.
    """
    context.operator.say(
        "  Power interface off. Lift the balance lever, so that the wheels do not touch. Forwards is as the drive\n"
        "  turns them: where they touch, both rims move the same way, so seen from one side they turn in opposite "
        "directions."
    )
    with open_for_reading(context) as board:
        require_same_board(board, context.draft.config)
        require_outputs_off(board)
        images = [board.survey().raw.hex()]
        wheel = _turn(context, board, "wheel", None)
        images.append(board.survey().raw.hex())
        road = _turn(context, board, "road", wheel)
        images.append(board.survey().raw.hex())
    if wheel.per_turn != road.per_turn:
        raise CommissioningError(
            f"{wheel.per_turn} counts per turn on the upper wheel, {road.per_turn} on the lower: a configuration has "
            "one number for both; if the encoders are the same, you miscounted the turns"
        )
    _write(context, wheel, road)
    found = {name: one._asdict() | {"turned": one.turned.counts} for name, one in (("wheel", wheel), ("road", road))}
    return {**found, "images": images}


def _turn(context: StepContext, board: Board, which: Wheel, other: _Encoder | None) -> _Encoder:
    """One wheel, repeated while the result is unclear."""
    trouble = ""
    for _ in range(_TRIALS):
        wait_for(
            context.operator, f"Ready to turn the {_NAMES[which]} wheel, and no other, {TURNS} full turns forwards?"
        )
        context.operator.say("  turn it now; counting ends after three seconds at rest")
        context.rig.turned(which)
        try:
            return _understood(context, watch(context.rig, board, context.operator), other)
        except Unclear as unclear:
            trouble = str(unclear)
            context.operator.say(f"  {trouble}")
    raise CommissioningError(f"{_NAMES[which]} wheel: not clear in {_TRIALS} trials; the last time {trouble}")


def _understood(context: StepContext, turned: HandTurn, other: _Encoder | None) -> _Encoder:
    if other is not None and turned.channel == other.channel:
        raise Unclear(f"channel {turned.channel} is the upper wheel's: turn the lower wheel")
    context.operator.say(f"  channel {turned.channel}: {turned.counts:+d} counts")
    sign = 1 if turned.counts > 0 else -1
    question = "It counted down. Did you turn the wheel forwards, the way the drive turns it?"
    if sign < 0 and not agree(context.operator, question):
        raise Unclear("you turned it backwards")
    return _Encoder(turned.channel, sign, _per_turn(context, turned), turned)


def _per_turn(context: StepContext, turned: HandTurn) -> int:
    """Counts per turn; asks the operator if they are neither usual nor those of the profile."""
    configured = context.draft.config.encoders.counts_per_turn
    found = counts_per_turn(turned.counts)
    if found == configured:
        return found
    result = (
        f"{found} counts per turn, and the profile says {configured}"
        if found
        else "an unusual number of counts per turn"
    )
    context.operator.say(f"  {TURNS} turns would give {result}")
    turns = ask_for(context.operator, "How many full turns did you make?", _positive, "a number of turns, such as 10")
    found = counts_per_turn(turned.counts, turns)
    if found is not None:
        return found
    measured = round(abs(turned.counts) / turns)
    usual = " nor ".join(map(str, USUAL_COUNTS))
    if not _LEAST <= measured <= _MOST:
        raise Unclear(f"{measured} counts per turn are neither {usual} nor within {_LEAST}..{_MOST}: count again")
    if agree(context.operator, f"That makes {measured} counts per turn, neither {usual}. Keep it?"):
        return measured
    raise Unclear("the turns were not certain: count them again")


def _positive(text: str) -> float | None:
    try:
        turns = float(text)
    except ValueError:
        return None
    return turns if 0.0 < turns < 1e6 else None


def _write(context: StepContext, wheel: _Encoder, road: _Encoder) -> None:
    context.draft.write(
        {
            "board.wheel_encoder": wheel.channel,
            "board.wheel_sign": wheel.sign,
            "board.road_encoder": road.channel,
            "board.road_sign": road.sign,
            "encoders.counts_per_turn": wheel.per_turn,
        }
    )
    context.draft.confirm(KEYS, f"turned by hand on {today()}")
    context.operator.say(
        f"  upper wheel: encoder {wheel.channel}, sign {wheel.sign:+d}; lower wheel: encoder {road.channel}, "
        f"sign {road.sign:+d}; {wheel.per_turn} counts per turn"
    )
