"""A fault with its time and duration, as text and as a value."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from inteco_abs.errors import ConfigError, ConfigIssue, near_match
from inteco_abs.mock_board.family import mock_family
from inteco_abs.mock_board.faults.kinds import KINDS, FaultKind, FaultValue

_FORM: Final = re.compile(r"(?P<kind>[^=@/]+)(?:=(?P<value>[^@/]*))?@(?P<when>[^/]+)(?:/(?P<lasts>.+))?")
_SPAN: Final = re.compile(
    r"(?:#(?P<exchanges>[0-9]{1,9}))|(?:(?P<number>[0-9]{1,9}(?:\.[0-9]{1,9})?)(?P<unit>us|ms|s))"
)
_NS: Final = {"us": 1e3, "ms": 1e6, "s": 1e9}
_LONGEST_NS: Final = 100_000 * 10**9
"""Written in milliseconds for the mock board's process, this still matches the pattern above."""
_EXAMPLE: Final = "as in lose@brake+20ms, road-stuck@3.5s, late=2@drive+#100/#5"


class FaultEvent(Enum):
    """Event that a fault's time counts from."""

    START = "start"
    """The board is opened."""
    DRIVE = "drive"
    """The drive is energized for the first time."""
    COAST = "coast"
    """The drive is switched off for the first time."""
    BRAKE = "brake"
    """The brake is energized for the first time."""


class Span(NamedTuple):
    """A time or a number of exchanges."""

    ns: int = 0
    exchanges: int = 0


_AT_ONCE: Final = Span()


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault that begins `after` an event and `lasts` for a span; None: to the end of the run.

    `value` is in the unit of its kind; NaN for kinds without a value.
    """

    name: str
    event: FaultEvent = FaultEvent.START
    after: Span = _AT_ONCE
    lasts: Span | None = None
    value: float = math.nan

    @property
    def kind(self) -> FaultKind:
        """The kind of fault."""
        return KINDS[self.name]

    @property
    def word(self) -> str:
        """The value as a word; empty for a numeric value."""
        words = self.kind.value.words if self.kind.value else ()
        return words[int(self.value)] if words else ""

    def __str__(self) -> str:
        default = self.kind.value.default if self.kind.value else None
        plain = math.isnan(self.value) or self.value == default
        value = "" if plain else f"={self.word or format(self.value, '.15g')}"
        lasts = "" if self.lasts is None else f"/{_text(self.lasts)}"
        return f"{self.name}{value}@{self.event.value}+{_text(self.after)}{lasts}"


def parse_faults(texts: Iterable[str]) -> tuple[Fault, ...]:
    """Parse faults; raises ConfigError with every mistake."""
    faults, mistakes = [], []
    for text in texts:
        try:
            faults.append(parse_fault(text))
        except ValueError as error:
            mistakes.append(ConfigIssue("--inject", f"{text[:80]!r}: {error}"))
    if mistakes:
        raise ConfigError(mistakes)
    return tuple(faults)


def require_possible(faults: Iterable[Fault], board: str, impossible: Mapping[str, str] | None = None) -> None:
    """Raise ConfigError for faults that a board of this `board.kind` cannot have.

    `impossible` gives the reason for each further impossible kind.
    """
    mock = mock_family(board)
    why: dict[str, str] = {}
    if mock.identity_offset is None:
        why["identity"] = "no answer of such a board identifies it"
    if not mock.has_alarms:
        why["alarm"] = "no alarm flags are known of such a board, only of a PCI board: --set profile=sim_pci"
    why |= impossible or {}
    mistakes = [ConfigIssue("--inject", f"{fault.name}: {why[fault.name]}") for fault in faults if fault.name in why]
    if mistakes:
        raise ConfigError(mistakes)


def parse_fault(text: str) -> Fault:
    """Parse `KIND[=VALUE]@[EVENT+]WHEN[/HOW LONG]`; times as 20ms, 1.5s or #40 exchanges. Raises ValueError."""
    form = _FORM.fullmatch(text)
    if form is None:
        raise ValueError(
            f"must be KIND[=VALUE]@[EVENT+]WHEN[/HOW LONG], {_EXAMPLE}; `inteco-abs faults` describes each kind"
        )
    name = form["kind"]
    if name not in KINDS:
        raise ValueError(f"no fault {name!r}{near_match(name, KINDS)}")
    kind = KINDS[name]
    event, after = _moment(form["when"])
    lasts = _span(form["lasts"]) if form["lasts"] else None if kind.lasting else Span(exchanges=1)
    if lasts == _AT_ONCE:
        raise ValueError(f"/{form['lasts']}: a fault of zero duration never acts; leave it out, or give a duration")
    return Fault(name, event, after, lasts, _value_of(kind, name, form["value"]))


def _moment(text: str) -> tuple[FaultEvent, Span]:
    word, plus, rest = text.partition("+")
    events = ", ".join(each.value for each in FaultEvent)
    if plus or word in {event.value for event in FaultEvent}:
        try:
            event = FaultEvent(word)
        except ValueError:
            raise ValueError(f"{word!r} is not an event; the events are: {events}") from None
        return event, _span(rest) if plus else Span()
    try:
        return FaultEvent.START, _span(text)
    except ValueError as error:
        raise ValueError(f"{error}; the events are: {events}") from None


def _span(text: str) -> Span:
    form = _SPAN.fullmatch(text)
    if form is None:
        raise ValueError(f"{text!r} is not a time: write 500us, 20ms, 1.5s, or #40 for forty exchanges")
    if form["exchanges"]:
        return Span(exchanges=int(form["exchanges"]))
    ns = round(float(form["number"]) * _NS[form["unit"]])
    if ns > _LONGEST_NS:
        raise ValueError(f"{text!r} is longer than any run: at most {_LONGEST_NS * 1e-9:g}s")
    return Span(ns=ns)


def _value_of(kind: FaultKind, name: str, text: str | None) -> float:
    wanted = kind.value
    if wanted is None:
        if text is not None:
            raise ValueError(f"{name} takes no value; leave ={text} out")
        return math.nan
    if text is None:
        if wanted.default is None:
            raise ValueError(f"{name} needs a value, as in {name}={_example(wanted)}: {wanted.allowed}")
        return wanted.default
    if wanted.words:
        if text not in wanted.words:
            raise ValueError(f"{text!r}: {name} takes one of {', '.join(wanted.words)}")
        return float(wanted.words.index(text))
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not wanted.low <= number <= wanted.high or (wanted.whole and number % 1.0):
        raise ValueError(f"{text!r}: {name} takes {wanted.allowed}")
    return number


def _example(value: FaultValue) -> str:
    return "0.5" if value.high <= 1.0 else f"{min(20.0, value.high):g}"


def _text(span: Span) -> str:
    if span.exchanges or not span.ns:
        return f"#{span.exchanges}"
    ms, ns = divmod(span.ns, 10**6)
    return f"{ms}.{ns:06}".rstrip("0").rstrip(".") + "ms"
