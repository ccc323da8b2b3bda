"""Comparison of sessions: what differs, their colours, and the origin of their time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from inteco_abs.analysis import settings_of
from inteco_abs.errors import ConfigError, ConfigIssue
from inteco_abs.sessions import Session
from inteco_abs.signals import Phase

PALETTE: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Okabe and Ito without black and yellow: distinct for every kind of colour vision, on white and on black."""
MOST: Final = len(PALETTE)
"""Sessions that colours can distinguish."""
_MOST_SETTINGS: Final = 3
_TOLD_ALREADY: Final = ("controller.", "estimator.", "profile")

Array = npt.NDArray[Any]


class Stretch(NamedTuple):
    """Rows `first` to before `end`, all in one phase."""

    phase: Phase
    first: int
    end: int


def require_distinct(sessions: Sequence[Session]) -> None:
    """Raise ConfigError if there are too many, or one of them twice."""
    paths = [session.path.resolve() for session in sessions]
    twice = [str(session.path) for session, path in zip(sessions, paths, strict=True) if paths.count(path) > 1]
    mistakes = [ConfigIssue("FILE", f"{name}: is named more than once") for name in twice[:1]]
    if len(sessions) > MOST:
        mistakes.append(
            ConfigIssue("FILE", f"{len(sessions)} sessions: at most {MOST} can be compared in one figure or page")
        )
    if mistakes:
        raise ConfigError(mistakes)


def start_ns(session: Session) -> int:
    """When braking began, or, where it never did, when the session began; on the ticks' clock. It has ticks."""
    rows = np.flatnonzero(session.ticks["phase"] == Phase.BRAKING)
    return int(session.ticks["time_ns"][rows[0] if len(rows) else 0])


def since_s(rows: Array, start: int) -> Array:
    """Time of each row since `start`, s."""
    seconds: Array = (rows["time_ns"].astype(np.int64) - start) * 1e-9
    return seconds


def stretches(ticks: Array) -> list[Stretch]:
    """The phases in the order in which they came."""
    phases = ticks["phase"]
    edges = [0, *(np.flatnonzero(np.diff(phases)) + 1).tolist(), len(phases)]
    return [Stretch(Phase(phases[first]), first, end) for first, end in pairwise(edges) if end]


def held_rows(ticks: Array) -> Array:
    """Rows in which the brake was in charge: while the wheels stopped and until the brake was let go."""
    return np.flatnonzero((ticks["phase"] == Phase.BRAKING) | (ticks["phase"] == Phase.STOPPED))


def labels(sessions: Sequence[Session]) -> list[str]:
    """What differs between the sessions, in words for a legend; of one session, what it was run with."""
    if len(sessions) == 1:
        told = sessions[0].metadata.get("controller", {})
        return [f"{told.get('name', 'unknown controller')} on {told.get('estimator', 'unknown estimator')}"]
    words: list[list[str]] = [[] for _ in sessions]
    for tell in (_makers, _gains, _rigs, _settings):
        if len({tuple(each) for each in words}) == len(sessions):
            break
        for each, more in zip(words, tell(sessions), strict=True):
            each.extend(more)
    found = [", ".join(each) for each in words]
    if len(set(found)) == len(found) and all(found):
        return found
    names = [session.path.stem for session in sessions]
    if len(set(names)) < len(names):
        names = [str(session.path) for session in sessions]
    return [f"{name}: {text}" if text else name for name, text in zip(names, found, strict=True)]


def _makers(sessions: Sequence[Session]) -> list[list[str]]:
    return _differing([_told(session, ("name", "estimator", "reference_slip")) for session in sessions], _fact)


def _fact(key: str, value: str) -> str:
    return f"reference {value}" if key == "reference_slip" else value


def _gains(sessions: Sequence[Session]) -> list[list[str]]:
    """Gains in which sessions of the same controller differ."""
    found: list[list[str]] = []
    gains = [gains_of(session) for session in sessions]
    names = [session.metadata.get("controller", {}).get("name", "") for session in sessions]
    for own, name in zip(gains, names, strict=True):
        peers = [other for other, its_name in zip(gains, names, strict=True) if its_name == name]
        found.append([f"{key} {_short(value)}" for key, value in own.items() if {p.get(key) for p in peers} != {value}])
    return found


def gains_of(session: Session) -> dict[str, str]:
    """Gains in force, as decimals."""
    return {
        key.removeprefix("gain."): value
        for key, value in session.metadata.get("controller", {}).items()
        if key.startswith("gain.") and not key.endswith(".hex")
    }


def _rigs(sessions: Sequence[Session]) -> list[list[str]]:
    told = []
    for session in sessions:
        rig, software = session.metadata.get("rig", {}), session.metadata.get("software", {})
        kind = {"true": "simulated", "false": "real rig"}.get(rig.get("simulated", ""), "")
        time = {"true": "virtual time", "false": "real time"}.get(rig.get("virtual_time", ""), "")
        drawn = rig.get("drawn", "published rig" if kind == "simulated" else "")
        told.append({"kind": kind, "time": time, "drawn": drawn, "seed": software.get("seed", "")})
    return _differing(told, lambda key, value: f"{key} {value}" if key == "seed" else value)


def _settings(sessions: Sequence[Session]) -> list[list[str]]:
    told = [
        {key: str(value) for key, value in settings_of(session).items() if not key.startswith(_TOLD_ALREADY)}
        for session in sessions
    ]
    return [each[:_MOST_SETTINGS] for each in _differing(told, lambda key, value: f"{key} {_short(value)}")]


def _told(session: Session, keys: Sequence[str]) -> dict[str, str]:
    facts = session.metadata.get("controller", {})
    return {key: facts.get(key, "") for key in keys}


def _differing(told: Sequence[dict[str, str]], words: Callable[[str, str], str]) -> list[list[str]]:
    keys = dict.fromkeys(key for each in told for key in each)
    apart = [key for key in keys if len({each.get(key) for each in told}) > 1]
    return [[words(key, each[key]) for key in apart if each.get(key)] for each in told]


def _short(value: str) -> str:
    try:
        return f"{float(value):g}"
    except ValueError:
        return value
