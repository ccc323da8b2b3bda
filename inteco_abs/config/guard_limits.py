"""Ceilings of the guard's limits on a real board, which no sign-off raises."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final, NamedTuple

from inteco_abs.config.load import profiles, read_profile
from inteco_abs.config.model import BoardConfig, GuardConfig, RigConfig, Table, defaults
from inteco_abs.config.sign_off import laxer_limits
from inteco_abs.errors import ConfigIssue


class _Ceiling(NamedTuple):
    """Ceiling of one limit of the guard on a real board."""

    seconds: float | None
    """Ceiling as a time, converted to exchanges by the loop's rate; None: `least` is the ceiling."""
    least: float
    """Limit that is allowed at any rate."""
    because: str

    def at(self, rate_hz: float) -> float:
        return max(self.least, 0.0 if self.seconds is None else float(int(self.seconds * rate_hz)))


_REAL_CEILINGS: Final = {
    "missed_in_a_row": _Ceiling(
        0.025, 4, "25 ms, half the shortest silence: a loop without answers ends its run before the guardian has to"
    ),
    "bucket_limit": _Ceiling(0.15, 30, "0.15 s of a link that loses every other exchange"),
    "silence_s": _Ceiling(None, 0.1, "five periods of the slowest loop; until then a hung loop keeps the motors on"),
    "run_up_factor": _Ceiling(None, 2.0, "a larger one would not detect counts per turn that are wrong by half"),
}
"""All other limits are bounded by their ranges in `GuardConfig`."""


def beyond_ceilings(config: RigConfig) -> Iterator[ConfigIssue]:
    """Limits above the ceilings of a real board; simulated boards and recorded sessions may have them."""
    limits, rate_hz = config.guard, config.loop.rate_hz
    for key, ceiling in _REAL_CEILINGS.items():
        value, most = getattr(limits, key), ceiling.at(rate_hz)
        if value is None or not value <= most:  # also NaN
            allowed = f"at most {most:g}" + (f" at {rate_hz:g} Hz" if ceiling.seconds is not None else "")
            yield ConfigIssue(f"guard.{key}", f"{value}: on a real board {allowed} ({ceiling.because}); lower it")
    if not config.board.verified_by and not config.board.read_only:
        for beyond in laxer_limits(_shipped_limits(config.board.kind), config.as_table()):
            key, _, rest = beyond.partition(" ")
            yield ConfigIssue(key, f"{rest}: more needs a signed profile; sign one with inteco-abs commission")


def _shipped_limits(kind: str) -> Table:
    """Largest value of each limit in the shipped profiles of real boards of this kind."""
    most: Table = {}
    usual = defaults(BoardConfig)["kind"]
    for table in map(read_profile, profiles()):
        board = table["board"]
        if board.get("kind", usual) == kind and not board.get("simulated"):
            limits = table.get("guard", {})
            most |= {key: max(value, most.get(key, value)) for key, value in limits.items()}
    return {"guard": most}


def bounded_in_time(guard: GuardConfig, rate_hz: float) -> GuardConfig:
    """`guard` for another rate: limits in exchanges are lowered to the ceilings of a real board at that rate."""
    in_exchanges = [key for key, ceiling in _REAL_CEILINGS.items() if ceiling.seconds is not None]
    return replace(
        guard, **{key: min(getattr(guard, key), int(_REAL_CEILINGS[key].at(rate_hz))) for key in in_exchanges}
    )
