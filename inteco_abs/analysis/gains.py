"""Gains and reference as recorded in a session, in three places, and the changes of them while it lasted."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import starmap
from typing import Final

import numpy as np

from inteco_abs.config import RigConfig
from inteco_abs.control import REFERENCE, Controller, GainChange, Pipeline, gains_in_force, keeps_gain
from inteco_abs.format import PARAMETERS_TOPIC
from inteco_abs.sessions import Metadata, Session, changes_among, session_config
from inteco_abs.signals import Reason, Sample, Tick

_GAIN: Final = "gain."
_HEX: Final = ".hex"


def gain_changes(session: Session) -> deque[GainChange]:
    """Gains that were changed while the run lasted, in the order in which they took effect."""
    return deque(changes_among(session.parameters))


def listed_changes(session: Session) -> dict[str, str]:
    """Gains that were changed while the run lasted, for lists of facts: by name and tick, as decimal text."""
    return {f"{name} from tick {tick}": repr(value) for tick, name, value in gain_changes(session)}


def times_of_changes_ns(session: Session) -> list[int]:
    """Time of the tick of each change of a gain that the session has, ns."""
    ticks, times_ns = np.array([change.tick for change in gain_changes(session)], np.uint64), list[int]()
    if len(ticks):
        for rows, _ in session.blocks():
            numbers = rows["tick"].astype(np.uint64)
            places = np.searchsorted(numbers, ticks)
            places = places[np.append(numbers, np.iinfo(np.uint64).max)[places] == ticks]
            times_ns += rows["time_ns"][places].tolist()
    return times_ns


def make_due(changes: deque[GainChange], tick: int, change: Callable[[str, float], None]) -> None:
    """Take the changes up to `tick` away, and make each."""
    while changes and changes[0].tick <= tick:
        _, name, value = changes.popleft()
        change(name, value)


def changes_for(
    session: Session, other: RigConfig, controller: Controller, controllers: Mapping[str, type[Controller]]
) -> deque[GainChange]:
    """The session's changes that also hold for the `controller` of another configuration.

    Those of the reference, and those of gains of the same law, unless the configuration begins with another value.
    """
    own = session_config(session, ())
    then, now = ({REFERENCE: each.controller.reference_slip} for each in (own, other))
    if own.controller.name == other.controller.name:
        then |= gains_in_force(own, controllers)
        now |= gains_in_force(other, controllers)
    same = {name for name, value in now.items() if then[name] == value and keeps_gain(controller, name, value)}
    return deque(change for change in gain_changes(session) if change.name in same)


def steps(pipeline: Pipeline, inputs: Iterable[tuple[Sample, Reason]], changes: deque[GainChange]) -> Iterator[Tick]:
    """Ticks that `pipeline` decides on, each after the `changes` up to it, which are taken away."""
    return _changed_steps(pipeline, inputs, changes) if changes else starmap(pipeline.step, inputs)


def _changed_steps(
    pipeline: Pipeline, inputs: Iterable[tuple[Sample, Reason]], changes: deque[GainChange]
) -> Iterator[Tick]:
    for sample, request in inputs:
        make_due(changes, sample.tick, pipeline.change)
        yield pipeline.step(sample, request)


def recorded_gains(session: Session) -> dict[str, str]:
    """Gains of a session's run by name, as decimal text."""
    return gains_in(session.metadata)


def gains_in(metadata: Metadata) -> dict[str, str]:
    """Gains in a session's metadata by name, as decimal text."""
    facts = metadata.get("controller", {})
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
