"""Differences between two sessions: outcome, metrics, signals, settings, software and host."""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from html import escape
from typing import Any, Final, NamedTuple

import numpy as np

from inteco_abs.analysis.gains import listed_changes, recorded_gains
from inteco_abs.errors import ConfigError, ConfigIssue, near_match
from inteco_abs.format import DOUBLE, INTERNALS, TICK, TRUTH, Role
from inteco_abs.quantities import Quantity
from inteco_abs.sessions import CONFIG_NAME, Array, Session, card_of, internals_of, joined_rows
from inteco_abs.signals import Phase

_NOT_METRICS: Final = frozenset(
    {"schema_version", "session", "outcome", "reason", "explanation", "controller", "estimator", "board", "rig"}
    | {"payload_sha256"}
)
_BLOCK_TICKS: Final = 1 << 14


class Change(NamedTuple):
    """A value that differs between two sessions; None if a session does not have it."""

    key: str
    a: Any
    b: Any


class SignalChange(NamedTuple):
    """Difference between a signal of two sessions."""

    key: str
    unit: str
    max_difference: float
    """While both sessions are in the same phase, if the signal differs there, as the next three."""
    at_s: float
    """Time of the largest difference since braking began."""
    rms_difference: float
    ticks: int
    """Number of ticks compared."""
    one_sided: int
    """Number of ticks at which only one of the two is a number, in any phase."""
    other_phase: int
    """Number of ticks that were left out, as one of the two had stopped, or brakes later."""


@dataclass(frozen=True, slots=True, repr=False)
class Diff:
    """Changes by requested section, in the order of `SECTIONS`."""

    changes: dict[str, list[Change | SignalChange]]

    @property
    def equal(self) -> bool:
        """Whether nothing differs in the requested sections."""
        return not any(self.changes.values())

    def lines(self, a: str, b: str) -> Iterator[str]:
        """The changes in words; `a` and `b` are the sessions' names."""
        if self.equal:
            yield f"{a} and {b} do not differ in {', '.join(self.changes)}"
        for name, changes in self.changes.items():
            if changes:
                yield name
            yield from (f"  {_in_words(change)}" for change in changes)

    def __repr__(self) -> str:
        found = ", ".join(f"{len(changes)} in {name}" for name, changes in self.changes.items() if changes)
        return f"<Diff: {found or 'equal'}>"

    def _repr_html_(self) -> str:
        return f"<pre>{escape(chr(10).join(self.lines('the first', 'the second')))}</pre>"


def _in_words(change: Change | SignalChange) -> str:
    if not isinstance(change, SignalChange):
        return f"{change.key}: {_value(change.a)} -> {_value(change.b)}"
    unit = "" if change.unit == "1" else f" {change.unit}"
    line = f"{change.key}: up to {change.max_difference:.4g}{unit} at {change.at_s:.3f} s, "
    line += f"RMS {change.rms_difference:.4g}{unit} over {change.ticks} ticks"
    line += f" in the same phase, of {change.ticks + change.other_phase}" if change.other_phase else ""
    return f"{line}; {change.one_sided} ticks have a number in one session only" if change.one_sided else line


def _value(value: Any) -> str:
    return "-" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def require_sections(names: Iterable[str]) -> None:
    """Raise ConfigError for a name that is not one of `SECTIONS`."""
    unknown = [name for name in names if name not in SECTIONS]
    if mistakes := [ConfigIssue("--only", f"no section {name!r}{near_match(name, SECTIONS)}") for name in unknown]:
        raise ConfigError(mistakes)


def diff_sessions(a: Session, b: Session, sections: tuple[str, ...] = (), rel: float = 0.0) -> Diff:
    """Differences of `a` and `b` in `sections`, by default in all.

    Metrics are equal within `rel` times the larger of the two, signals within `rel` times the peak in `a`. Signals are
    compared from the start of braking, or from the first tick if one session never braked; each tick of `a` with the
    one of `b` nearest in time. Internals have the names that the controller declares. Session, date and command line
    are not compared.
    """
    return Diff(
        {name: list(compare(a, b, rel)) for name, compare in _SECTIONS.items() if name in (sections or SECTIONS)}
    )


def _changes(a: Mapping[str, Any], b: Mapping[str, Any], rel: float = 0.0) -> Iterator[Change]:
    for key in dict.fromkeys((*a, *b)):
        if not _same(a.get(key), b.get(key), rel):
            yield Change(key, a.get(key), b.get(key))


def _same(a: Any, b: Any, rel: float) -> bool:
    if isinstance(a, int | float) and isinstance(b, int | float):
        try:
            return bool(a == b or abs(a - b) <= rel * max(abs(a), abs(b)) or (math.isnan(a) and math.isnan(b)))
        except OverflowError:  # TOML's integers may have more than the 309 digits of a double
            return False
    return bool(a == b)


def _of(session: Session, record: str, keys: Iterable[str]) -> dict[str, str | None]:
    facts = session.metadata.get(record, {})
    return {key: facts.get(key) for key in keys}


def _outcome(a: Session, b: Session, _rel: float) -> Iterator[Change]:
    keys = ("outcome", "reason")
    return _changes(_of(a, "session", keys), _of(b, "session", keys))


def _result(a: Session, b: Session, rel: float) -> Iterator[Change]:
    return _changes(_metrics(a), _metrics(b), rel)


def _metrics(session: Session) -> dict[str, Any]:
    card = dict(card_of(session) or {})
    late = card.pop("lateness_us", None)
    metrics = {key: value for key, value in card.items() if key not in _NOT_METRICS}
    return metrics | ({f"lateness_us.{key}": value for key, value in late.items()} if isinstance(late, dict) else {})


def _gains(a: Session, b: Session, _rel: float) -> Iterator[Change]:
    first, second = ({**recorded_gains(each), **listed_changes(each)} for each in (a, b))
    return _changes(first, second)


def _configuration(a: Session, b: Session, _rel: float) -> Iterator[Change]:
    return _changes(settings_of(a), settings_of(b))


def settings_of(session: Session) -> dict[str, Any]:
    """Every setting of the session's run by dotted key; empty without a configuration."""
    stored = session.attachments.get(CONFIG_NAME)
    if stored is None:
        return {}
    try:
        return dict(_dotted("", tomllib.loads(stored.decode("utf-8"))))
    except (ValueError, RecursionError):  # not TOML: compare the files
        return {CONFIG_NAME: f"unreadable, sha256 {hashlib.sha256(stored).hexdigest()}"}


def _dotted(prefix: str, table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _dotted(f"{prefix}{key}.", value)
        else:
            yield prefix + key, value if isinstance(value, bool | int | float | str) else json.dumps(value, default=str)


def _facts(*names: str, without: tuple[str, ...] = ()) -> Callable[[Session, Session, float], Iterator[Change]]:
    def compare(a: Session, b: Session, _rel: float) -> Iterator[Change]:
        for name in names:
            for change in _changes(a.metadata.get(name, {}), b.metadata.get(name, {})):
                if change.key not in without:
                    yield change._replace(key=change.key if len(names) == 1 else f"{name}.{change.key}")

    return compare


def _software(a: Session, b: Session, rel: float) -> Iterator[Change]:
    yield from _facts("software", without=("argv",))(a, b, rel)
    keys = ("name", "package", "source_sha256")
    for change in _changes(_of(a, "controller", keys), _of(b, "controller", keys)):
        yield change._replace(key=f"controller.{change.key}")


def _signals(a: Session, b: Session, rel: float) -> Iterator[Change | SignalChange]:
    if not a.tick_count or not b.tick_count:
        yield from _changes({"ticks": a.tick_count}, {"ticks": b.tick_count})
        return
    starts = _starts(a, b)
    named, others = ([each for each in internals_of(session.channels) if each.name] for session in (a, b))
    same = [each.name for each in named] == [each.name for each in others]
    called = dict(zip(INTERNALS, named, strict=False))
    outputs = {
        column.name: called.get(column.name) or Quantity(column.name, column.unit)
        for column in TICK.columns
        if column.role is Role.OUTPUT and column.kind is DOUBLE and (same or column.name not in INTERNALS)
    }
    phases = _PhasesApart()
    yield from _compare(outputs, _aligned(_ticks(a), _ticks(b), starts), phases.of_ticks, rel)
    if a.truth_count and b.truth_count:
        truths = {
            column.name: Quantity(f"truth.{column.name}", column.unit)
            for column in TRUTH.columns
            if column.kind is DOUBLE
        }
        yield from _compare(truths, _aligned(_truths(a), _truths(b), starts), phases.of_truths, rel)
    else:
        yield from _changes({"truth": bool(a.truth_count)}, {"truth": bool(b.truth_count)})


def _ticks(session: Session) -> Iterator[Array]:
    return (ticks for ticks, _ in session.blocks(_BLOCK_TICKS))


def _truths(session: Session) -> Iterator[Array]:
    return (truth for _, truth in session.blocks(_BLOCK_TICKS))


def _starts(a: Session, b: Session) -> tuple[int, int]:
    """Start of braking in each, or of each session if one never braked, ns."""
    first, braking = zip(*map(_first_times_ns, (a, b)), strict=True)
    return first if None in braking else braking


def _first_times_ns(session: Session) -> tuple[int, int | None]:
    """Time of the first tick, and of the first that brakes."""
    first_ns = None
    for ticks in _ticks(session):
        first_ns = int(ticks["time_ns"][0]) if first_ns is None else first_ns
        braking = ticks["phase"] == Phase.BRAKING
        if braking.any():
            return first_ns, int(ticks["time_ns"][braking.argmax()])
    return first_ns or 0, None


class _AlignedRows(NamedTuple):
    """Rows of both sessions at the same times."""

    a: Array
    b: Array
    since_s: Array


def _aligned(a: Iterable[Array], b: Iterable[Array], starts: tuple[int, int]) -> Iterator[_AlignedRows]:
    """Each row of `a` since its start, up to the end of the shorter one, with the nearest of `b`, in blocks."""
    others = _distinct(b)
    near = next(others)
    for rows in _distinct(a):
        times_a, times_b = _since(rows, starts[0]), _since(near, starts[1])
        more: Array | None = near
        while times_b[-1] < times_a[-1] and more is not None:
            more = next(others, None)
            if more is not None:
                known = near[max(int(np.searchsorted(times_b, times_a[0])) - 1, 0) :]
                near = joined_rows(known, more)
                times_b = _since(near, starts[1])
        kept = (times_a >= 0) & (times_a <= times_b[-1])
        wanted = times_a[kept]
        after = np.minimum(np.searchsorted(times_b, wanted), len(times_b) - 1)
        before = np.maximum(after - 1, 0)
        nearest = np.where(wanted - times_b[before] < times_b[after] - wanted, before, after)
        yield _AlignedRows(rows[kept], near[nearest], wanted * 1e-9)


def _distinct(blocks: Iterable[Array]) -> Iterator[Array]:
    """Of several rows at one time, as when the outputs are made safe at the end, the last."""
    newest: Array | None = None
    for block in blocks:
        rows = block if newest is None else joined_rows(newest, block)
        if len(rows):
            yield from filter(len, [rows[:-1][np.diff(rows["time_ns"]) > 0]])
            newest = rows[-1:]
    if newest is not None:
        yield newest


def _since(rows: Array, start: int) -> Array:
    times_ns: Array = rows["time_ns"].astype(np.int64) - start
    return times_ns


class _PhasesApart:
    """When two sessions are in different phases, which only their ticks have."""

    def __init__(self) -> None:
        self._begins: list[float] = []
        self._ends: list[float] = []
        self._apart = False

    def of_ticks(self, rows: _AlignedRows) -> Array:
        """Which rows are in the same phase, kept for the truths."""
        apart = rows.a["phase"] != rows.b["phase"]
        for at in np.flatnonzero(np.diff(apart, prepend=self._apart)):
            (self._begins if apart[at] else self._ends).append(float(rows.since_s[at]))
        self._apart = bool(apart[-1]) if len(apart) else self._apart
        return np.asarray(~apart)

    def of_truths(self, rows: _AlignedRows) -> Array:
        """Which rows are in the same phase, after all ticks."""
        begun, ended = (np.searchsorted(times, rows.since_s, "right") for times in (self._begins, self._ends))
        return np.asarray(begun == ended)


def _compare(
    columns: Mapping[str, Quantity],
    aligned: Iterable[_AlignedRows],
    in_same_phase: Callable[[_AlignedRows], Array],
    rel: float,
) -> Iterator[SignalChange]:
    found = {name: (_Apart(), _Apart()) for name in columns}
    for rows in aligned:
        same = in_same_phase(rows)
        for name, (everywhere, alike) in found.items():
            everywhere.add(rows.a[name], rows.b[name], rows.since_s)
            alike.add(rows.a[name][same], rows.b[name][same], rows.since_s[same])
    for name, (everywhere, alike) in found.items():
        if everywhere.one_sided or everywhere.most > rel * everywhere.peak:
            shown = alike if alike.most > 0.0 else everywhere
            yield SignalChange(
                columns[name].name,
                columns[name].unit,
                shown.most,
                shown.at_s,
                shown.rms,
                shown.ticks,
                everywhere.one_sided,
                everywhere.ticks - shown.ticks,
            )


class _Apart:
    """How far a signal of two sessions is apart, block by block."""

    def __init__(self) -> None:
        self.one_sided = self.ticks = self._known = 0
        self.most = self.peak = self.at_s = self._squares = 0.0

    def add(self, a: Array, b: Array, since_s: Array) -> None:
        known = np.isfinite(a) & np.isfinite(b)
        self.one_sided += int(((a != b) & ~known & ~(np.isnan(a) & np.isnan(b))).sum())
        self.ticks += len(a)
        apart = np.abs(a[known] - b[known])
        if not len(apart):
            return
        largest = int(apart.argmax())
        if apart[largest] > self.most or not self._known:
            self.most, self.at_s = float(apart[largest]), float(since_s[known][largest])
        self.peak = max(self.peak, float(np.abs(a[known]).max()))
        self._squares += float(np.sum(apart**2))
        self._known += len(apart)

    @property
    def rms(self) -> float:
        return math.sqrt(self._squares / self._known) if self._known else 0.0


_SECTIONS: Final[dict[str, Callable[[Session, Session, float], Iterator[Change | SignalChange]]]] = {
    "outcome": _outcome,
    "result": _result,
    "signals": _signals,
    "gains": _gains,
    "configuration": _configuration,
    "software": _software,
    "host": _facts("host", "realtime"),
    "rig": _facts("rig"),
}
SECTIONS: Final = tuple(_SECTIONS)
"""Names of the sections, in order of the output."""
