"""Gains and reference as a session has recorded them, in three places, against those that a replay is run with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from inteco_abs.format import PARAMETERS_TOPIC
from inteco_abs.sessions import Session

REFERENCE: Final = "reference_slip"
_GAIN: Final = "gain."
_HEX: Final = ".hex"


def changed_gains(session: Session, configured: Mapping[str, float]) -> dict[str, dict[str, str | None]]:
    """Gains, and the reference, that are not everywhere in the session what they are `configured` to be.

    By name: what was `recorded`, `where`, and what is `configured`, exactly; None where it is not. A gain that the
    session has recorded nowhere is none of them: the controller has it since.
    """
    told = session.metadata.get("controller", {})
    metadata = {key: value for key, value in told.items() if key.startswith(_GAIN) or key == REFERENCE}
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
