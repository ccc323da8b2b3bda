"""Sign-off of a profile: a person's name, the day and the logic, under the wiring and the guard's limits.

No key is involved: it records responsibility. Whatever it covers and is changed later takes it away.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from inteco_abs.config.model import WIRING, BoardConfig, EncodersConfig, GuardConfig, Table, defaults, section_of

SIGN_OFF: Final = ("verified_by", "verified_on", "verified_logic")
"""The keys of [board] that make it."""
COVERED: Final = (
    *WIRING,
    "timer_hz",
    "kind",
    "logic_version",
    "application_names",
    "read_only",
    "simulated",
    "verified_on",
    "verified_logic",
    "evidence",
)
"""What it covers, besides the guard's limits: keys of [board], and `encoders.counts_per_turn`."""


def signs_off(table: Table) -> bool:
    """Whether a table states who has verified the wiring, so that it answers for what it changes."""
    return bool(section_of(table, "board").get("verified_by"))


def unsigned(table: Table) -> Table:
    """The same table without its sign-off."""
    board = {key: value for key, value in section_of(table, "board").items() if key not in SIGN_OFF}
    return {**table, "board": board}


def wiring_of(table: Table) -> Table:
    """What a configuration says of `WIRING` and of the logic that it is for, and nothing else."""
    stated = _stated(table)
    return {key: stated[key] for key in (*WIRING, "logic_version", "application_names") if key in stated}


def changed_wiring(signed: Table, changed: Table, keys: Collection[str] = COVERED) -> list[str]:
    """Those of `keys` in which two tables differ; what a table does not state is the default."""
    usual = defaults(BoardConfig) | defaults(EncodersConfig)
    before, after = (usual | _stated(table) for table in (signed, changed))
    return [key for key in keys if after.get(key) != before.get(key)]


def laxer_limits(signed: Table, table: Table) -> list[str]:
    """Limits of the guard of which `table` allows more than `signed` does, in words.

    More of any limit is laxer; what a table does not state is the default.
    """
    usual = defaults(GuardConfig)
    limits, asked = (usual | section_of(each, "guard") for each in (signed, table))
    return [
        f"guard.{key} at most {limits[key]:g}, and {asked[key]:g} is asked for"
        for key in usual
        if isinstance(limits[key], int | float) and isinstance(asked[key], int | float) and asked[key] > limits[key]
    ]


def void_by_wiring(signed: Table, changed: Table) -> str:
    """Why the sign-off in `signed` does not hold for the wiring in `changed`; empty if it does, or if there is none.

    A simulated rig may be rewired at will.
    """
    board = section_of(signed, "board")
    new = changed_wiring(signed, changed, ("simulated",) if board.get("simulated") is True else COVERED)
    if not signs_off(signed) or not new:
        return ""
    return f"{board['verified_by']} signed the profile with another {', '.join(new)}; sign what you have changed"


def void_by_limits(signed: Table, changed: Table) -> str:
    """Why it does not hold for the limits in `changed`; empty if it does. A simulated rig has no limits to sign."""
    board = section_of(signed, "board")
    beyond = [] if board.get("simulated") is True else laxer_limits(signed, changed)
    if not signs_off(signed) or not beyond:
        return ""
    return f"{board['verified_by']} signed the profile with {'; '.join(beyond)}. Lower it, or sign it anew"


def _stated(table: Table) -> Table:
    """What a table says of board and wiring; nothing where it is not even a section."""
    encoders = section_of(table, "encoders")
    return section_of(table, "board") | {key: encoders[key] for key in ("counts_per_turn",) if key in encoders}
