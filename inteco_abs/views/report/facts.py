"""The report's tables of results and settings, one column per session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from inteco_abs.analysis import listed_changes, recorded_gains, settings_of
from inteco_abs.sessions import Session, card_of
from inteco_abs.views.result_panel import FALL_BACK_ROWS, ROWS

NOTHING: Final = "–"
_LATENESS: Final = (("late, p50", "p50"), ("late, p99", "p99"), ("late, p99.9", "p999"), ("late, most", "max"))
_COUNTS: Final = (
    ("stops", "stops"), ("ticks", "ticks"), ("overruns", "overruns"), ("link errors", "link_errors"),
    ("lost ticks", "lost_ticks"),
)  # fmt: skip
_SHOWN_ELSEWHERE: Final = ("result", "controller")


class FactRow(NamedTuple):
    """One fact of all sessions."""

    name: str
    values: tuple[str, ...]
    differs: bool


class FactTable(NamedTuple):
    """A table of facts."""

    title: str
    rows: list[FactRow]


def result_rows(sessions: Sequence[Session]) -> list[FactRow]:
    """Result cards side by side; a value that was not measured is a dash."""
    cards = [card_of(session) or {} for session in sessions]
    own = FALL_BACK_ROWS if any(card.get("swing_share") is not None for card in cards) else ()
    rows = [
        _row(label, [_number(card.get(key), form, factor) for card in cards])
        for label, key, form, factor in (*ROWS, *own)
    ]
    rows += [_row(label, [_number(card.get(key), "{:.0f}") for card in cards]) for label, key in _COUNTS]
    late = [each if isinstance(each := card.get("lateness_us"), dict) else {} for card in cards]
    rows += [_row(label, [_number(each.get(key), "{:.1f} us") for each in late]) for label, key in _LATENESS]
    return rows


def fact_tables(sessions: Sequence[Session]) -> list[FactTable]:
    """Gains, configuration and every metadata record; the payload's hash is in `integrity`."""
    gains = [{**_controller(session), **recorded_gains(session), **listed_changes(session)} for session in sessions]
    settings = [{key: str(value) for key, value in settings_of(session).items()} for session in sessions]
    records = dict.fromkeys(name for session in sessions for name in session.metadata if name not in _SHOWN_ELSEWHERE)
    found = [_facts("controller and gains", gains), _facts("configuration", settings)]
    found += [_facts(name, [session.metadata.get(name, {}) for session in sessions]) for name in records]
    return [facts for facts in found if facts.rows]


def _controller(session: Session) -> dict[str, str]:
    facts = session.metadata.get("controller", {})
    return {key: value for key, value in facts.items() if not key.startswith("gain.")}


def _facts(title: str, records: Sequence[Mapping[str, str]]) -> FactTable:
    keys = dict.fromkeys(key for each in records for key in each)
    return FactTable(title, [_row(key, [each.get(key) or NOTHING for each in records]) for key in keys])


def _row(name: str, values: Sequence[str]) -> FactRow:
    return FactRow(name, tuple(values), len(set(values)) > 1)


def _number(value: Any, form: str, factor: float = 1.0) -> str:
    known = isinstance(value, int | float) and not isinstance(value, bool)
    return form.format(value * factor) if known else NOTHING
