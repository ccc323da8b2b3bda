"""Warnings that a reader needs before trusting the curves."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from inteco_abs.sessions import Session, card_of, link_errors
from inteco_abs.signals import EXPLANATIONS, BoardFlags, Phase, Reason
from inteco_abs.views.comparison import held_spans, start_ns

_WELL: Final = "completed"
_WARNING: Final = 3
_MOST_EVENTS: Final = 10


def warnings_of(session: Session) -> list[str]:
    """Warnings, most important first; empty for a good stop."""
    counts = _Counts(session)
    first = *_injected(session), *_end(session), *_guard(session, counts)
    return [*first, *_losses(session, counts), *_machine(session), *_source(session), *_log(session, counts)]


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
        yield f"The file is incomplete: {session.incomplete}. {session.tick_count} ticks could be read."
    outcome = outcome_of(session)
    if outcome != _WELL:
        why = _explanation(session)
        yield f"Outcome: {outcome}{f': {why}' if why else ''}."
    lost = session.metadata.get("recovery", {}).get("lost", "")
    if lost not in _explanation(session):
        yield f"Recovered, with losses: {lost}."
    if not session.tick_count:
        yield "The session holds no ticks: there is nothing to draw."
    elif not held_spans(session):
        yield "The run ended before braking: times count from its first tick."


def _explanation(session: Session) -> str:
    """Explanation of the outcome from the result card, or the recorded reason."""
    card = card_of(session) or {}
    return str(card.get("explanation") or session.metadata.get("session", {}).get("reason", ""))


class _Counts:
    """What the ticks have to say, in one pass."""

    def __init__(self, session: Session) -> None:
        self.first_reason: tuple[int, int, Reason] | None = None
        """Index, number and reason of the first tick without outputs."""
        self.reasons: set[Reason] = set()
        self.overruns = self.overruns_held = self.failed = self.slow = 0
        ticks_before = 0
        for ticks, _ in session.blocks():
            self.reasons |= {Reason(each) for each in np.unique(ticks["reason"])}
            if self.first_reason is None and ticks["reason"].any():
                row = int(np.flatnonzero(ticks["reason"])[0])
                self.first_reason = ticks_before + row, int(ticks["tick"][row]), Reason(ticks["reason"][row])
                self.first_reason_ns = int(ticks["time_ns"][row])
            held = (ticks["phase"] == Phase.BRAKING) | (ticks["phase"] == Phase.STOPPED)
            self.overruns += int(ticks["skipped"].sum())
            self.overruns_held += int(ticks["skipped"][held].sum())
            self.failed += link_errors(ticks)
            self.slow += int(((ticks["board_flags"] & BoardFlags.SLOW) != 0).sum())
            ticks_before += len(ticks)


def _guard(session: Session, counts: _Counts) -> Iterator[str]:
    if counts.first_reason is None:
        return
    row, tick, reason = counts.first_reason
    at_s = (counts.first_reason_ns - start_ns(session)) * 1e-9
    why = EXPLANATIONS[reason]
    words = reason.name if why in _explanation(session) else f"{reason.name}, {why}"
    phase = _last_phase(session, row)
    yield f"The outputs were taken away at tick {tick} ({at_s:.4f} s), in the phase {phase}: {words}."


def _last_phase(session: Session, row: int) -> str:
    sound = [span.phase for span in session.rows.phases if span.first < row and span.phase is not Phase.FAULT]
    return sound[-1].name.lower().replace("_", "-") if sound else "idle"


def _losses(session: Session, counts: _Counts) -> Iterator[str]:
    if counts.overruns:
        yield f"{counts.overruns} periods were overrun, {counts.overruns_held} of them while the brake was in charge."
    if counts.failed:
        yield f"{counts.failed} exchanges with the board failed; the counts before stand in for theirs."
    if counts.slow:
        yield f"{counts.slow} exchanges with the board took longer than a period."
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


def _log(session: Session, counts: _Counts) -> Iterator[str]:
    known = [EXPLANATIONS[reason] for reason in counts.reasons]
    texts = [event.text for event in session.log if event.level >= _WARNING]
    texts = [text for text in texts if not any(why in text for why in known)]
    yield from (f"Log: {text}." for text in texts[:_MOST_EVENTS])
    if len(texts) > _MOST_EVENTS:
        yield f"Log: {len(texts) - _MOST_EVENTS} more."
