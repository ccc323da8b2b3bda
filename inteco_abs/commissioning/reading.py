"""Reading of a board that must not be written to yet."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

from inteco_abs.boards import STILL_ON, Board, family_of
from inteco_abs.commissioning.step import StepContext
from inteco_abs.config import RigConfig
from inteco_abs.errors import CommissioningError, LinkError

_MOST_FAILURES: Final = 4
_ONLY_READ: Final = "this step of the commissioning only reads"


@contextmanager
def open_for_reading(context: StepContext, config: RigConfig | None = None) -> Iterator[Board]:
    """Open the board for reading only, regardless of draft and sign-off."""
    config = config or context.draft.config
    reading = replace(config, board=replace(config.board, read_only=_ONLY_READ))
    with context.rig.open(reading) as board:
        yield board


def outputs_left_on(board: Board) -> bool:
    """Whether an earlier program left a PWM output on; the board is open for reading."""
    return board.identity is not None and STILL_ON in board.identity.read_only_because


def require_outputs_off(board: Board) -> None:
    """Raise CommissioningError if an earlier program left an output on."""
    if outputs_left_on(board):
        raise CommissioningError(
            f"the board's PWM outputs are not zero, an earlier program has left them so. {STILL_ON}, "
            "then switch the board off and on"
        )


def require_same_board(board: Board, config: RigConfig) -> None:
    """Raise CommissioningError if the open board is not the one whose header is in the draft."""
    identity, wiring = board.identity, config.board
    if (
        identity is None
        or identity.logic_version != wiring.logic_version
        or (family_of(wiring.kind).reports_name and identity.application_name not in wiring.application_names)
    ):
        raise CommissioningError(f"this board ({identity}) is not the one that the draft was begun with: --redo header")


def read_patiently(board: Board, names: Collection[str]) -> dict[str, int]:
    """The named numbers. Raises LinkError after four failed readings in a row."""
    failures = 0
    while True:
        try:
            values = board.survey(names).values
        except LinkError:
            failures += 1
            if failures >= _MOST_FAILURES:
                raise
        else:
            return {name: int(values[name]) for name in names}
