"""Runs the decision path again on logged inputs and compares every output bit for bit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from inteco_abs.config import Check, RigConfig, parse_config
from inteco_abs.control import Pipeline
from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.records.schema import TICK, Role, pack_tick
from inteco_abs.sessions.reader import Session
from inteco_abs.signals import BoardFlags, Phase, Reason, Sample, Tick, Timing

CONFIG_NAME: Final = "config.toml"
_TIMING_FIELDS: Final = len(Timing._fields)
_STOP: Final = Tick._fields.index("stop_request")


@dataclass(frozen=True, slots=True)
class Difference:
    """The first output that a replay did not reproduce."""

    tick: int
    field: str
    logged: str
    replayed: str
    logged_hex: str
    replayed_hex: str


@dataclass(frozen=True, slots=True)
class Replay:
    """Outcome of a replay: how many ticks, how many of them differ, where first, and which fields how often."""

    ticks: int
    braking_ticks: int
    differing: int
    first: Difference | None
    by_field: dict[str, int]


def session_config(session: Session, checks: tuple[Check, ...]) -> RigConfig:
    """The effective configuration that the session was run with; raises SessionError if it is not usable."""
    stored = session.attachments.get(CONFIG_NAME)
    if stored is None:
        raise SessionError(f"{session.path}: holds no {CONFIG_NAME}, so there is nothing to replay it with")
    try:
        return parse_config(stored.decode("utf-8"), checks)
    except (ConfigError, UnicodeDecodeError) as error:
        raise SessionError(f"{session.path}: its {CONFIG_NAME} cannot be used here: {error}") from error


def replay(session: Session, pipeline: Pipeline) -> Replay:
    """Drive a fresh `pipeline` with the session's inputs and compare. Raises SessionError if there are no ticks."""
    count = len(session.ticks)
    if not count:
        raise SessionError(f"{session.path}: holds no ticks")
    again = bytearray(count * TICK.size)
    for index, row in enumerate(session.ticks.tolist()):
        pack_tick(again, index * TICK.size, _decide(pipeline, row))
    braking = int((session.ticks["phase"] == Phase.BRAKING).sum())
    if again == session.payload:
        return Replay(count, braking, 0, None, {})
    return _compare(session, bytes(again), braking)


def _decide(pipeline: Pipeline, row: tuple[Any, ...]) -> Tick:
    time_ns, tick, dt_s, wheel, road, flags = row[:_STOP]
    sample = Sample(tick, time_ns, dt_s, wheel, road, BoardFlags(flags))
    return pipeline.step(sample, Reason(row[_STOP]), Timing(*row[-_TIMING_FIELDS:]))


def _compare(session: Session, again: bytes, braking: int) -> Replay:
    logged, replayed = session.ticks, TICK.array(again)
    differs = {
        column.name: _bits(logged[column.name]) != _bits(replayed[column.name])
        for column in TICK.columns
        if column.role is Role.OUTPUT
    }
    any_differs = np.logical_or.reduce(list(differs.values()))
    first = None
    if any_differs.any():
        row = int(np.argmax(any_differs))
        name = next(name for name, where in differs.items() if where[row])
        first = _difference(int(logged["tick"][row]), name, logged[name][row].item(), replayed[name][row].item())
    by_field = {name: int(where.sum()) for name, where in differs.items() if where.any()}
    return Replay(len(logged), braking, int(any_differs.sum()), first, by_field)


def _bits(values: Any) -> Any:
    """Values as unsigned integers of the same width: NaN equals itself, and -0.0 differs from 0.0."""
    return np.ascontiguousarray(values).view(f"u{values.dtype.itemsize}")


def _difference(tick: int, name: str, logged: Any, replayed: Any) -> Difference:
    hexes = [value.hex() if isinstance(value, float) else hex(value) for value in (logged, replayed)]
    return Difference(tick, name, repr(logged), repr(replayed), *hexes)
