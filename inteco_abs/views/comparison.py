"""Comparison of sessions: what differs, their colours, and the origin of their time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from inteco_abs.analysis import recorded_gains, settings_of, times_of_changes_ns
from inteco_abs.errors import ConfigError, ConfigIssue
from inteco_abs.sessions import Array, PhaseSpan, Session
from inteco_abs.signals import Phase

PALETTE: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Okabe and Ito without black and yellow: distinct for every kind of colour vision, on white and on black."""
MOST: Final = len(PALETTE)
"""Most sessions in one figure or page: one a colour."""
_MOST_SETTINGS: Final = 3
_COMPARED_BEFORE: Final = ("controller.", "estimator.", "profile")


def require_distinct(sessions: Sequence[Session]) -> None:
    """Raise ConfigError for too many sessions, or one named twice."""
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
    """Start of braking, or of a session that never brakes, ns by the ticks' clock. The session has ticks."""
    spans = session.rows.phases
    return next((span for span in spans if span.phase is Phase.BRAKING), spans[0]).first_ns


def since_s(rows: Array, start: int) -> Array:
    """Time of each row since `start`, s."""
    seconds: Array = (rows["time_ns"].astype(np.int64) - start) * 1e-9
    return seconds


def changes_s(session: Session) -> tuple[float, ...]:
    """Times at which gains changed, since `start_ns`, s. The session has ticks."""
    start = start_ns(session)
    return tuple((time_ns - start) * 1e-9 for time_ns in times_of_changes_ns(session))


def held_spans(session: Session) -> list[PhaseSpan]:
    """The phases braking and stopped, while the brake is held."""
    return [span for span in session.rows.phases if span.phase in {Phase.BRAKING, Phase.STOPPED}]


def labels(sessions: Sequence[Session]) -> list[str]:
    """Labels for a legend: what differs between sessions; for one session, controller and estimator."""
    if len(sessions) == 1:
        law = sessions[0].metadata.get("controller", {})
        return [f"{law.get('name', 'unknown controller')} on {law.get('estimator', 'unknown estimator')}"]
    words: list[list[str]] = [[] for _ in sessions]
    for differences in (_controllers, _gains, _rigs, _settings):
        if len({tuple(each) for each in words}) == len(sessions):
            break
        for each, more in zip(words, differences(sessions), strict=True):
            each.extend(more)
    found = [", ".join(each) for each in words]
    if len(set(found)) == len(found) and all(found):
        return found
    names = [session.path.stem for session in sessions]
    if len(set(names)) < len(names):
        names = [str(session.path) for session in sessions]
    return [f"{name}: {text}" if text else name for name, text in zip(names, found, strict=True)]


def _controllers(sessions: Sequence[Session]) -> list[list[str]]:
    laws = [session.metadata.get("controller", {}) for session in sessions]
    facts = [
        {
            "name": law.get("name", ""),
            "estimator": law.get("estimator", ""),
            "reference": law.get("reference") or law.get("reference_slip", ""),
        }
        for law in laws
    ]
    return _differing(facts, lambda key, value: f"reference {value}" if key == "reference" else value)


def _gains(sessions: Sequence[Session]) -> list[list[str]]:
    """Gains that differ between sessions of the same controller."""
    found: list[list[str]] = []
    gains = list(map(recorded_gains, sessions))
    names = [session.metadata.get("controller", {}).get("name", "") for session in sessions]
    for own, name in zip(gains, names, strict=True):
        peers = [other for other, its_name in zip(gains, names, strict=True) if its_name == name]
        found.append([f"{key} {_short(value)}" for key, value in own.items() if {p.get(key) for p in peers} != {value}])
    return found


def _rigs(sessions: Sequence[Session]) -> list[list[str]]:
    facts = []
    for session in sessions:
        rig, software = session.metadata.get("rig", {}), session.metadata.get("software", {})
        kind = {"true": "simulated", "false": "real rig"}.get(rig.get("simulated", ""), "")
        time = {"true": "virtual time", "false": "real time"}.get(rig.get("virtual_time", ""), "")
        drawn = rig.get("drawn", "published rig" if kind == "simulated" else "")
        facts.append({"kind": kind, "time": time, "drawn": drawn, "seed": software.get("seed", "")})
    return _differing(facts, lambda key, value: f"{key} {value}" if key == "seed" else value)


def _settings(sessions: Sequence[Session]) -> list[list[str]]:
    facts = [
        {key: str(value) for key, value in settings_of(session).items() if not key.startswith(_COMPARED_BEFORE)}
        for session in sessions
    ]
    return [each[:_MOST_SETTINGS] for each in _differing(facts, lambda key, value: f"{key} {_short(value)}")]


def _differing(facts: Sequence[dict[str, str]], text: Callable[[str, str], str]) -> list[list[str]]:
    keys = dict.fromkeys(key for each in facts for key in each)
    differing = [key for key in keys if len({each.get(key) for each in facts}) > 1]
    return [[text(key, each[key]) for key in differing if each.get(key)] for each in facts]


def _short(value: str) -> str:
    try:
        return f"{float(value):g}"
    except ValueError:
        return value
