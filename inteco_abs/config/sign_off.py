"""Sign-off of a profile: a name, the day and the logic, for its wiring and the guard's limits.

It records responsibility; no cryptographic key is involved. A later change of what it covers removes it.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from inteco_abs.config.model import WIRING, BoardConfig, EncodersConfig, GuardConfig, Table, defaults, section_of

SIGN_OFF: Final = ("verified_by", "verified_on", "verified_logic")
"""Keys of [board] that make a sign-off."""
COVERED: Final = (
    *WIRING, "timer_hz", "kind", "logic_version", "application_names", "read_only", "simulated", "verified_on",
    "verified_logic", "evidence",
)  # fmt: skip
"""Keys that a sign-off covers besides the guard's limits: of [board], and `encoders.counts_per_turn`."""


def signs_off(table: Table) -> bool:
    """Whether a table has its own sign-off."""
    return bool(section_of(table, "board").get("verified_by"))


def unsigned(table: Table) -> Table:
    """Return the table without its sign-off."""
    board = {key: value for key, value in section_of(table, "board").items() if key not in SIGN_OFF}
    return {**table, "board": board}


def wiring_of(table: Table) -> Table:
    """The keys of `WIRING` and of the logic that a configuration states."""
    stated = _stated(table)
    return {key: stated[key] for key in (*WIRING, "logic_version", "application_names") if key in stated}


def changed_wiring(signed: Table, changed: Table, keys: Collection[str] = COVERED) -> list[str]:
    """Return those of `keys` in which two tables differ; a missing key has its default."""
    usual = defaults(BoardConfig) | defaults(EncodersConfig)
    before, after = (usual | _stated(table) for table in (signed, changed))
    return [key for key in keys if after.get(key) != before.get(key)]


def laxer_limits(signed: Table, table: Table) -> list[str]:
    """Limits of the guard that `table` sets higher than `signed`, as text; a missing key has its default."""
    usual = defaults(GuardConfig)
    limits, asked = (usual | section_of(each, "guard") for each in (signed, table))
    return [
        f"guard.{key} at most {limits[key]:g}, and {asked[key]:g} is requested"
        for key in usual
        if isinstance(limits[key], int | float) and isinstance(asked[key], int | float) and asked[key] > limits[key]
    ]


def void_by_wiring(signed: Table, changed: Table) -> str:
    """Why the sign-off in `signed` does not hold for the wiring in `changed`; empty if it holds or is missing.

    It holds for any wiring of a simulated rig.
    """
    board = section_of(signed, "board")
    new = changed_wiring(signed, changed, ("simulated",) if board.get("simulated") is True else COVERED)
    if not signs_off(signed) or not new:
        return ""
    return f"{board['verified_by']} signed the profile with another {', '.join(new)}; sign what you have changed"


def void_by_limits(signed: Table, changed: Table) -> str:
    """Why the sign-off in `signed` does not hold for the limits in `changed`; empty if it holds, or if simulated."""
    board = section_of(signed, "board")
    beyond = [] if board.get("simulated") is True else laxer_limits(signed, changed)
    if not signs_off(signed) or not beyond:
        return ""
    return f"{board['verified_by']} signed the profile with {'; '.join(beyond)}. Lower it, or sign the profile again"


def _stated(table: Table) -> Table:
    """Keys of board and wiring in a table; empty without such sections."""
    encoders = section_of(table, "encoders")
    return section_of(table, "board") | {key: encoders[key] for key in ("counts_per_turn",) if key in encoders}
