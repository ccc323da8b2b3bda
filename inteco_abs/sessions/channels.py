"""The channels of a session, the same in its file and in a live view: schemas, units, and messages that are no rows."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from inteco_abs.control import FallBack, GainChange
from inteco_abs.format import (
    INTERNALS,
    LOG_NAME,
    LOG_TOPIC,
    PARAMETERS_NAME,
    PARAMETERS_TOPIC,
    RESULT,
    RESULT_NAME,
    RESULT_TOPIC,
    TICK,
    Message,
    chunk,
    double,
    integer,
    log_descriptor,
    parameters_descriptor,
    result_descriptor,
    tag,
)
from inteco_abs.quantities import Quantity
from inteco_abs.signals import EXPLANATIONS, Phase, Reason

INFO: Final = 2
"""Level of foxglove.Log."""
WARNING: Final = 3
ERROR: Final = 4
_STATE: Final = ("phase", "reason")
_UNDECLARED: Final = "controller internal"
"""What the meaning of an internal begins with that its controller has not declared."""
_REFERENCE: Final = Quantity("reference_slip", "1", "slip to hold")


class Channel(NamedTuple):
    """A stream of messages of one protobuf schema."""

    topic: str
    schema_name: str
    descriptor: bytes
    """FileDescriptorSet of the schema."""
    facts: Mapping[str, str]
    """Metadata, such as units in JSON."""


def row_channel(message: Message, internals: Iterable[Quantity] | None = None) -> Channel:
    """The channel of `message`, with unit and meaning of each column, and the names of the controller's internals."""
    columns = {column.name: Quantity(column.name, column.unit, column.meaning) for column in message.columns}
    own = {}
    if internals is not None:
        named = dict(zip(INTERNALS, internals, strict=False))
        columns |= named
        own["internals"] = json.dumps([each.name for each in named.values()])
    return Channel(message.topic, message.name, message.descriptor(), _described(columns) | own)


def event_channel() -> Channel:
    """The channel of the log."""
    return Channel(LOG_TOPIC, LOG_NAME, log_descriptor(), {})


def parameter_channel(gains: Iterable[Quantity] = ()) -> Channel:
    """The channel of the parameters in force, with unit and meaning of each."""
    facts = _described({each.name: each for each in (_REFERENCE, *gains)})
    return Channel(PARAMETERS_TOPIC, PARAMETERS_NAME, parameters_descriptor(), facts)


def result_channel() -> Channel:
    """The channel of the result card, with the unit of each metric."""
    units = {entry.name: Quantity(entry.name, entry.unit) for entry in RESULT}
    return Channel(RESULT_TOPIC, RESULT_NAME, result_descriptor(), _described(units))


def _described(columns: Mapping[str, Quantity]) -> dict[str, str]:
    """Metadata of a channel: units and meanings in JSON, of the columns that have them."""
    units = {name: each.unit for name, each in columns.items() if each.unit}
    meanings = {name: each.meaning for name, each in columns.items() if each.meaning}
    return {name: json.dumps(texts) for name, texts in (("units", units), ("describe", meanings)) if texts}


def internals_of(channels: Mapping[str, Mapping[str, str]]) -> tuple[Quantity, ...]:
    """The controller's internals in c0, c1 and so on, as the channels' metadata name and describe them.

    Sessions before units of internals have names only. What cannot be read is left out.
    """
    facts = channels.get(TICK.topic, {})
    units, meanings = (_texts(facts, key) for key in ("units", "describe"))
    found = []
    for column, name in zip(INTERNALS, _texts(facts, "internals").values(), strict=False):
        declared = not meanings.get(column, "").startswith(_UNDECLARED)
        found.append(Quantity(name, units.get(column, ""), meanings.get(column, "")) if declared else Quantity(name))
    return tuple(found)


def gains_of(channels: Mapping[str, Mapping[str, str]]) -> tuple[Quantity, ...]:
    """The reference and the gains with unit and meaning, as the metadata of their channel describe them."""
    facts = channels.get(PARAMETERS_TOPIC, {})
    units, meanings = (_texts(facts, key) for key in ("units", "describe"))
    return tuple(Quantity(name, units.get(name, ""), meanings.get(name, "")) for name in units | meanings)


def _texts(facts: Mapping[str, str], key: str) -> dict[str, str]:
    """The texts in the JSON of a fact, by name, or by place in a list; none if it is damaged."""
    try:
        found = json.loads(facts.get(key, "{}"))
    except (ValueError, RecursionError):
        return {}
    pairs = found.items() if isinstance(found, dict) else enumerate(found) if isinstance(found, list) else ()
    return {str(name): text for name, text in pairs if isinstance(text, str)}


def pack_event(stamp_ns: int, level: int, text: str) -> bytes:
    """An entry of the log, at UNIX time `stamp_ns`."""
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    stamp = integer(1, seconds) + integer(2, nanoseconds)
    return chunk(1, stamp) + integer(2, level) + chunk(3, text) + chunk(4, "inteco-abs")


def pack_parameters(values: Mapping[str, float], tick: int = 0) -> bytes:
    """Parameters in force from `tick` on."""
    entries = b"".join(chunk(1, chunk(1, name) + double(2, value)) for name, value in values.items())
    return entries + tag(2, 5) + struct.pack("<I", tick)


def pack_change(stamp_ns: int, change: GainChange) -> bytes:
    """The entry of the log for a change of a gain, at UNIX time `stamp_ns`."""
    return pack_event(stamp_ns, INFO, describe_change(change))


def describe_change(change: GainChange) -> str:
    """What the log says of a change of a gain."""
    return f"{change.name} = {change.value:.6g} from tick {change.tick}"


class StateEvents:
    """Finds the changes of phase, reason and gains in force among ticks, and what the log says of them.

    A law whose slip swings to both sides of the `band` falls back; with 0 there is none.
    """

    def __init__(self, band: float = 0.0) -> None:
        self._before = (int(Phase.UNKNOWN), int(Reason.NONE))
        self._band = band
        self._fall_back = FallBack(band)

    def among(self, rows: npt.NDArray[np.void]) -> Iterator[tuple[int, list[tuple[int, str]]]]:
        """Yield index, and level and text of each entry, for every change in `rows`, which follow those before."""
        changes = [np.diff(rows[name], prepend=old) != 0 for name, old in zip(_STATE, self._before, strict=True)]
        steps = dict(self._steps(rows) if self._band > 0.0 else ())
        for index in sorted({*np.flatnonzero(np.logical_or(*changes)).tolist(), *steps}):
            entries = self._entries(*(int(rows[name][index]) for name in _STATE))
            yield index, [*entries, *([steps[index]] if index in steps else [])]

    def _steps(self, rows: npt.NDArray[np.void]) -> Iterator[tuple[int, tuple[int, str]]]:
        """Index and entry of each change of the gains of a law that falls back; each stop begins with all of them."""
        columns = (rows[name].tolist() for name in ("phase", "switching", "slip_reference", "dt_s"))
        braked = self._before[0] == Phase.BRAKING
        for index, (phase, error, reference, dt_s) in enumerate(zip(*columns, strict=True)):
            if phase == Phase.BRAKING:
                if not braked:
                    self._fall_back = FallBack(self._band)
                before, steps = self._fall_back.steps, self._fall_back.follow(error, reference, dt_s)
                if steps > before:
                    yield index, (WARNING, f"the slip swings: the law falls back to 1/{1 << steps} of its gains")
                elif steps < before:
                    yield index, (INFO, f"the slip is calm: the law takes a step back up, to {_share_of(steps)} gains")
            braked = phase == Phase.BRAKING

    def _entries(self, phase: int, reason: int) -> list[tuple[int, str]]:
        before, self._before = self._before, (phase, reason)
        entries = [(INFO, f"phase {Phase(phase).name}")] if phase != before[0] else []
        if reason != before[1]:
            entries.append((ERROR, f"{Reason(reason).name}: {EXPLANATIONS[Reason(reason)]}"))
        return entries


def _share_of(steps: int) -> str:
    return f"1/{1 << steps} of its" if steps else "its full"
