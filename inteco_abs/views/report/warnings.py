"""Warnings that a reader needs before trusting the curves."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from inteco_abs.sessions import Session, card_of, link_errors
from inteco_abs.signals import EXPLANATIONS, BoardFlags, Phase, Reason
from inteco_abs.views.comparison import held_rows, since_s, start_ns

_WELL: Final = "completed"
_WARNING: Final = 3
_MOST_EVENTS: Final = 10


def warnings_of(session: Session) -> list[str]:
    """Warnings, most important first; empty for a good stop."""
    first = *_injected(session), *_end(session), *_guard(session)
    return [*first, *_losses(session), *_machine(session), *_source(session), *_log(session)]


def _injected(session: Session) -> Iterator[str]:
    faults = session.metadata.get("injected", {})
    if faults:
        acted = ", ".join(f"{fault} (acted {times} times)" for fault, times in faults.items())
        yield f"Faults injected into the mock board: {acted}."


def outcome_of(session: Session) -> str:
    """Outcome in one or two words."""
    recorded = session.metadata.get("session", {}).get("outcome", "")
    return recorded or ("not known" if session.incomplete else "not recorded")


def _end(session: Session) -> Iterator[str]:
    if session.incomplete:
        yield f"The file is incomplete: {session.incomplete}. {len(session.ticks)} ticks could be read."
    outcome = outcome_of(session)
    if outcome != _WELL:
        why = _explanation(session)
        yield f"Outcome: {outcome}{f': {why}' if why else ''}."
    lost = session.metadata.get("recovery", {}).get("lost", "")
    if lost not in _explanation(session):
        yield f"Recovered, with losses: {lost}."
    if not len(session.ticks):
        yield "The session holds no ticks: there is nothing to draw."
    elif not len(held_rows(session.ticks)):
        yield "The run ended before braking: times count from its first tick."


def _explanation(session: Session) -> str:
    """Explanation of the outcome from the result card, or the recorded reason."""
    card = card_of(session) or {}
    return str(card.get("explanation") or session.metadata.get("session", {}).get("reason", ""))


def _guard(session: Session) -> Iterator[str]:
    rows = np.flatnonzero(session.ticks["reason"])
    if not len(rows):
        return
    tick = session.ticks[rows[0]]
    reason = Reason(tick["reason"])
    at_s = since_s(session.ticks[rows[:1]], start_ns(session))[0]
    why = EXPLANATIONS[reason]
    words = reason.name if why in _explanation(session) else f"{reason.name}, {why}"
    phase = _last_phase(session, int(rows[0]))
    yield f"The outputs were taken away at tick {tick['tick']} ({at_s:.4f} s), in the phase {phase}: {words}."


def _last_phase(session: Session, row: int) -> str:
    before = session.ticks["phase"][:row]
    sound = before[before != Phase.FAULT]
    return Phase(sound[-1]).name.lower().replace("_", "-") if len(sound) else "idle"


def _losses(session: Session) -> Iterator[str]:
    ticks = session.ticks
    overruns = int(ticks["skipped"].sum())
    if overruns:
        held = held_rows(ticks)
        while_held = int(ticks["skipped"][held].sum())
        yield f"{overruns} periods were overrun, {while_held} of them while the brake was in charge."
    failed = link_errors(ticks)
    if failed:
        yield f"{failed} exchanges with the board failed; the counts before stand in for theirs."
    slow = int(((ticks["board_flags"] & BoardFlags.SLOW) != 0).sum())
    if slow:
        yield f"{slow} exchanges with the board took longer than a period."
    lost = (card_of(session) or {}).get("lost_ticks")
    if lost:
        yield f"{lost} ticks were decided and are not in the file."


def _machine(session: Session) -> Iterator[str]:
    red = [
        f"{name} ({finding.partition(': ')[2]})"
        for name, finding in session.metadata.get("doctor", {}).items()
        if finding.startswith("red")
    ]
    if red:
        yield f"The doctor found the computer unfit: {', '.join(red)}."


def _source(session: Session) -> Iterator[str]:
    software = session.metadata.get("software", {})
    if software.get("git_dirty") == "true":
        commit = software.get("git_commit", "")[:12]
        yield f"Dirty tree: the program had changes that commit {commit} does not hold."


def _log(session: Session) -> Iterator[str]:
    known = [EXPLANATIONS[Reason(reason)] for reason in np.unique(session.ticks["reason"])]
    texts = [event.text for event in session.log if event.level >= _WARNING]
    texts = [text for text in texts if not any(why in text for why in known)]
    yield from (f"Log: {text}." for text in texts[:_MOST_EVENTS])
    if len(texts) > _MOST_EVENTS:
        yield f"Log: {len(texts) - _MOST_EVENTS} more."
