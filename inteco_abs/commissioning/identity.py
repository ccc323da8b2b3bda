"""Steps 1 and 2: list the boards; identify this one."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from inteco_abs.boards import Identity, family_of
from inteco_abs.commissioning.operator import agree
from inteco_abs.commissioning.reading import open_for_reading, outputs_left_on
from inteco_abs.commissioning.step import Facts, StepContext
from inteco_abs.config import load_config, profiles
from inteco_abs.errors import CommissioningError, ConfigError

_BYTES_A_LINE: Final = 16
_CANDIDATE: Final = "_abs_candidate"


def list_boards(context: StepContext) -> Facts:
    """List the devices that may be the board, as the kernel knows them. Raises CommissioningError if there are none."""
    found = context.rig.devices(context.draft.config)
    if not found:
        raise CommissioningError(
            f"no device for {context.rig.address}: plug the board in, switch it on, try another cable"
        )
    for one in found:
        context.operator.say(f"  {one.address}  {one.description}")
    return {"devices": [{**one._asdict(), "told": dict(one.told)} for one in found]}


def read_header(context: StepContext) -> Facts:
    """Read the board once; write its logic version and name into the draft."""
    bridge = context.rig.bridge(context.draft.config)
    with open_for_reading(context) as board:
        identity, (values, raw) = board.identify(), board.survey()
        left_on = outputs_left_on(board)
    context.operator.say("\n".join([f"  {identity}", *(f"  {name}: {text}" for name, text in bridge.items())]))
    context.operator.say(hex_dump(raw))
    if left_on:
        context.operator.say("  THE PWM OUTPUTS ARE NOT ZERO: press the emergency switch, switch the board off and on")
    suggested = fitting_profile(context.draft.config.board.kind, identity)
    if suggested != context.draft.profile:
        begun = context.draft.profile
        context.operator.say(f"  the matching shipped profile is {suggested}; the draft began from {begun}")
        # only the operator decides, as the draft may come from the lab's own profile
        if not context.quiet and agree(context.operator, f"Begin a new draft from {suggested}?"):
            context.draft.begin_from(suggested)
    _write(context, identity)
    counts = {name: value for name, value in values.items() if name.endswith("_channels")}
    return {**identity.facts(), "bridge": bridge, "channels": counts, "suggested_profile": suggested, "raw": raw.hex()}


def fitting_profile(kind: str, identity: Identity) -> str:
    """Name of the shipped profile for this logic, or else of the one for unknown logics."""
    fallback = ""
    for name in profiles():
        board = load_config(profile=name).board
        if board.simulated or board.kind != kind or board.read_only:
            continue
        if name.endswith(_CANDIDATE):
            fallback = name
        elif board.logic_version == identity.logic_version:
            return name
        fallback = fallback or name
    return fallback or family_of(kind).profile


def hex_dump(raw: bytes) -> str:
    """16 bytes a line with their offset; repeated lines are left out."""
    shown, before = [], b""
    for at in range(0, len(raw), _BYTES_A_LINE):
        line = raw[at : at + _BYTES_A_LINE]
        if line != before:
            shown.append(f"  {at:04x}  {line.hex(' ')}")
        before = line
    return "\n".join(shown)


def _write(context: StepContext, identity: Identity) -> None:
    board = context.draft.config.board
    found: dict[str, object] = {"board.logic_version": identity.logic_version}
    changed = replace(board, logic_version=identity.logic_version)
    try:
        # raises for a logic without known frames, which must not get into the draft
        with open_for_reading(context, replace(context.draft.config, board=changed)):
            pass
    except ConfigError as error:
        raise CommissioningError(
            f"logic 0x{identity.logic_version:04X} cannot be driven by this version: {error}"
        ) from error
    if family_of(board.kind).reports_name:
        found["board.application_names"] = [identity.application_name]
    context.draft.write(found)
