"""Board addresses, such as `sim:` or `usb2:123`: their form, and the profile for each."""

from __future__ import annotations

from typing import Final

from inteco_abs.boards.family import FAMILIES, family_of, known_families
from inteco_abs.config import DEFAULT_PROFILE, MOCK_NAMES, RigConfig, beyond_ceilings
from inteco_abs.errors import ConfigError, ConfigIssue

SIMULATED: Final = "sim"
"""Scheme of the mock of the profile's board, with the simulated rig inside."""


def schemes() -> dict[str, str]:
    """Return the schemes before the colon, with their meanings."""
    known = {name: family.address_meaning for name, family in known_families().items()}
    return {SIMULATED: "the mock of the profile's board with the simulated rig inside", **known}


def check_address(uri: str) -> None:
    """Raise ConfigError unless `uri` is a board address."""
    name, colon, rest = uri.partition(":")
    if not colon or (name != SIMULATED and name not in FAMILIES):
        known = schemes()
        listed = "; ".join(f"{one}: is {what}" for one, what in known.items())
        paths = [one for one in FAMILIES if uri.startswith("/dev/") and family_of(one).address.fullmatch(uri)]
        meant = f"{paths[0]}:{uri}" if paths else f"{uri}:"
        hint = f"; did you mean {meant}?" if paths or uri in known else ""
        raise ConfigError(
            [ConfigIssue("--board", f"{uri!r} is not a board address of this version{hint or ';'} {listed}")]
        )
    if name == SIMULATED and rest:
        raise ConfigError([ConfigIssue("--board", f"{uri!r}: nothing may follow sim:")])
    if name != SIMULATED and (family := family_of(name)).address.fullmatch(rest) is None:
        raise ConfigError([ConfigIssue("--board", f"{uri!r}: {family.address_hint}")])


def check_kind(uri: str, config: RigConfig) -> None:
    """Raise ConfigError unless the profile is for the family that `uri` names, and for a real board."""
    family, name = family_of(config.board.kind), uri.partition(":")[0]
    if name == SIMULATED:
        return
    if name != family.name:
        problem = f"{family.name!r}, while the address {uri} is for boards of kind {name!r}; name another profile"
        raise ConfigError([ConfigIssue("board.kind", problem)])
    only_mock_names = family.reports_name and set(config.board.application_names) <= set(MOCK_NAMES)
    if config.board.simulated and not only_mock_names:
        problem = f"the profile was made for the mock, and {uri} is a real board: --set profile=NAME chooses another, "
        problem += "and inteco-abs commission makes one for it"
        raise ConfigError([ConfigIssue("board.simulated", problem)])


def check_limits(uri: str, config: RigConfig) -> None:
    """Raise ConfigError if `uri` names a real board and a limit of the guard exceeds its ceiling."""
    mistakes = [] if simulated(uri) or config.board.simulated else list(beyond_ceilings(config))
    if mistakes:
        raise ConfigError(mistakes)


def default_profile(uri: str) -> str:
    """Return the name of the shipped profile to begin with for a board at `uri`."""
    return DEFAULT_PROFILE if simulated(uri) else family_of(uri.partition(":")[0]).profile


def simulated(uri: str) -> bool:
    """Return whether the board at `uri` is the mock."""
    return uri.startswith(f"{SIMULATED}:")
