"""Decides whether a board may be driven: its header against the profile, and the lab's sign-off."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from firmware_protocol import FrameField, Register, Status
from inteco_abs.boards.family import family_of
from inteco_abs.config import BoardConfig

_FIX: Final = (
    "inteco-abs commission makes a profile for this rig, or continues yours, and asks for your sign-off "
    "(board.verified_by, verified_on, verified_logic)"
)


def read_only_reason(
    wiring: BoardConfig, version: int, name: str | None, relied_on: Iterable[FrameField | Register]
) -> str:
    """Return why outputs must stay off; empty if they may be used.

    `version` and `name` are the board's (None: it reports no name), `relied_on` the fields or registers that the driver
    uses. Outputs that rest on anything unconfirmed need a sign-off for this logic.
    """
    if wiring.read_only:
        return wiring.read_only
    because = _open_question(wiring, version, name, relied_on)
    return f"{because}. {_FIX}" if because else ""


def unconfirmed(wiring: BoardConfig) -> list[str]:
    """Return the unconfirmed facts that outputs rest on, with their status."""
    return wiring.unconfirmed(family_of(wiring.kind).unused_wiring)


def _open_question(
    wiring: BoardConfig, version: int, name: str | None, relied_on: Iterable[FrameField | Register]
) -> str:
    if version != wiring.logic_version:
        return f"the board has logic 0x{version:04X}, the profile was made for 0x{wiring.logic_version:04X}"
    if name is not None and name not in wiring.application_names:
        known = ", ".join(map(repr, wiring.application_names)) or "none yet"
        return f"the board's logic is named {name!r}, the profile knows {known}"
    if wiring.verified_by:
        return _signed_for_another(wiring, version)
    questions = [
        *(f"board.{one}" for one in unconfirmed(wiring)),
        *(f"the frame's {one.name} ({one.status.value})" for one in relied_on if one.status is not Status.CONFIRMED),
    ]
    unsigned = "the profile's wiring was not verified on the rig (verified_by is empty); not confirmed: "
    return unsigned + ", ".join(questions) if questions else ""


def _signed_for_another(wiring: BoardConfig, version: int) -> str:
    if wiring.verified_logic == version:
        return ""
    return f"{wiring.verified_by} signed for logic 0x{wiring.verified_logic or 0:04X}, the board has 0x{version:04X}"
