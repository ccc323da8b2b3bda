"""Steps 1 and 2: which boards are there, and what the board says of itself."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from inteco_abs.boards import Identity, family_of
from inteco_abs.commissioning.operator import agree
from inteco_abs.commissioning.reading import open_for_reading, outputs_left_on
from inteco_abs.commissioning.step import Facts, StepContext
from inteco_abs.config import load_config, profiles
from inteco_abs.errors import ConfigError, ProbeError

_BYTES_A_LINE: Final = 16
_CANDIDATE: Final = "_abs_candidate"


def list_boards(visit: StepContext) -> Facts:
    """Devices that may be the board, as the kernel lists them."""
    found = visit.bench.devices(visit.draft.config)
    if not found:
        raise ProbeError(f"no device for {visit.bench.address}: plug the board in, switch it on, try another cable")
    for one in found:
        visit.person.tell(f"  {one.address}  {one.description}")
    return {"devices": [{**one._asdict(), "told": dict(one.told)} for one in found]}


def read_header(visit: StepContext) -> Facts:
    """One reading: who the board is; the draft is made for it from here on."""
    bridge = visit.bench.bridge(visit.draft.config)
    with open_for_reading(visit) as board:
        identity, (values, raw) = board.identify(), board.survey()
        left_on = outputs_left_on(board)
    visit.person.tell("\n".join([f"  {identity}", *(f"  {name}: {text}" for name, text in bridge.items())]))
    visit.person.tell(hex_dump(raw))
    if left_on:
        visit.person.tell("  THE PWM OUTPUTS ARE NOT ZERO: press the emergency switch, switch the board off and on")
    suggested = fitting_profile(visit.draft.config.board.kind, identity)
    if suggested != visit.draft.profile:
        _suggest(visit, suggested)
    _write(visit, identity)
    counts = {name: value for name, value in values.items() if name.endswith("_channels")}
    return {**identity.facts(), "bridge": bridge, "channels": counts, "suggested_profile": suggested, "raw": raw.hex()}


def fitting_profile(kind: str, identity: Identity) -> str:
    """Name of the shipped profile that was made for this logic, else of the one for unknown logics."""
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
    """Lines of bytes with their offsets; lines like the one before are left out."""
    shown, before = [], b""
    for at in range(0, len(raw), _BYTES_A_LINE):
        line = raw[at : at + _BYTES_A_LINE]
        if line != before:
            shown.append(f"  {at:04x}  {line.hex(' ')}")
        before = line
    return "\n".join(shown)


def _suggest(visit: StepContext, suggested: str) -> None:
    """A profile that fits better is taken only if the person says so: it may be their own that does not ship."""
    visit.person.tell(f"  the matching shipped profile is {suggested}; the draft began from {visit.draft.profile}")
    if not visit.quiet and agree(visit.person, f"Begin a new draft from {suggested}?"):
        visit.draft.begin_from(suggested)


def _write(visit: StepContext, identity: Identity) -> None:
    board = visit.draft.config.board
    found: dict[str, object] = {"board.logic_version": identity.logic_version}
    changed = replace(board, logic_version=identity.logic_version)
    try:
        # a logic whose frames are not known must not get into the draft
        with open_for_reading(visit, replace(visit.draft.config, board=changed)):
            pass
    except ConfigError as error:
        raise ProbeError(f"logic 0x{identity.logic_version:04X} cannot be driven by this version: {error}") from error
    if family_of(board.kind).says_name:
        found["board.application_names"] = [identity.application_name]
    visit.draft.write(found)
