"""Gains and reference as recorded in a session, in three places, compared with those of a replay."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from inteco_abs.format import PARAMETERS_TOPIC
from inteco_abs.sessions import Session

REFERENCE: Final = "reference_slip"
_GAIN: Final = "gain."
_HEX: Final = ".hex"


def recorded_gains(session: Session) -> dict[str, str]:
    """Gains of a session's run by name, as decimal text."""
    facts = session.metadata.get("controller", {})
    return {
        key.removeprefix(_GAIN): value
        for key, value in facts.items()
        if key.startswith(_GAIN) and not key.endswith(_HEX)
    }


def changed_gains(session: Session, configured: Mapping[str, float]) -> dict[str, dict[str, str | None]]:
    """Gains, and the reference, whose recorded values differ from the `configured` ones.

    By name: the value `recorded`, `where`, and the value `configured`, exactly; None if it is missing. A gain that the
    session does not have at all is left out: the controller got it later.
    """
    facts = session.metadata.get("controller", {})
    metadata = {key: value for key, value in facts.items() if key.startswith(_GAIN) or key == REFERENCE}
    message = {
        name: value.hex() for part in session.parameters if part.tick == 0 for name, value in part.values.items()
    }
    places = []
    if metadata:
        places.append(("metadata controller", metadata, dict(_in_metadata(configured))))
    if any(part.values for part in session.parameters):
        places.append((PARAMETERS_TOPIC, message, {name: value.hex() for name, value in configured.items()}))
    recorded = {_name(key) for _, found, _ in places for key in found}
    changed: dict[str, dict[str, str | None]] = {}
    for place, found, expected in places:
        for key in expected | found:
            if _name(key) in recorded and found.get(key) != expected.get(key):
                change = {"recorded": found.get(key), "configured": expected.get(key), "where": f"{place}: {key}"}
                changed.setdefault(_name(key), change)
    return changed


def _in_metadata(configured: Mapping[str, float]) -> Iterator[tuple[str, str]]:
    for name, value in configured.items():
        if name == REFERENCE:
            yield name, repr(value)
        else:
            yield f"{_GAIN}{name}{_HEX}", value.hex()
            yield f"{_GAIN}{name}", repr(value)


def _name(key: str) -> str:
    return key.removeprefix(_GAIN).removesuffix(_HEX)
