"""Differences between two sessions: outcome, metrics, signals, settings, software and host."""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from inteco_abs.analysis.gains import recorded_gains
from inteco_abs.format import DOUBLE, TICK, TRUTH, Message, Role
from inteco_abs.sessions import CONFIG_NAME, Session, card_of
from inteco_abs.signals import Phase

_NOT_METRICS: Final = frozenset(
    {"schema_version", "session", "outcome", "reason", "explanation", "controller", "estimator", "board", "rig"}
    | {"payload_sha256"}
)
_NEVER: Final = np.uint64((1 << 64) - 1)
_INTERNALS: Final = ("c0", "c1", "c2", "c3")

Array = npt.NDArray[Any]


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
    at_s: float
    """Time of the largest difference since braking began."""
    rms_difference: float
    one_sided: int
    """Number of ticks at which only one of the two is a number."""
    ticks: int
    """Number of ticks compared."""


@dataclass(frozen=True, slots=True)
class Diff:
    """Changes by requested section, in the order of `SECTIONS`."""

    changes: dict[str, list[Change | SignalChange]]

    @property
    def equal(self) -> bool:
        """Whether nothing differs in the requested sections."""
        return not any(self.changes.values())


def diff_sessions(a: Session, b: Session, sections: tuple[str, ...] = (), rel: float = 0.0) -> Diff:
    """Differences of `a` and `b` in `sections`, by default in all.

    Metrics are equal within `rel` times the larger of the two, signals within `rel` times the peak in `a`. Signals are
    compared from the start of braking, or from the first tick if one session never braked; each tick of `a` with the
    one of `b` nearest in time. Session, date and command line are not compared.
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
    return _changes(recorded_gains(a), recorded_gains(b))


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
    if not len(a.ticks) or not len(b.ticks):
        yield from _changes({"ticks": len(a.ticks)}, {"ticks": len(b.ticks)})
        return
    starts = _starts(a.ticks, b.ticks)
    internals = [session.channels.get(TICK.topic, {}).get("internals") for session in (a, b)]
    left_out = () if internals[0] == internals[1] else _INTERNALS
    yield from _compare(TICK, _align(a.ticks, b.ticks, starts), rel, left_out)
    if len(a.truth) and len(b.truth):
        yield from _compare(TRUTH, _align(a.truth, b.truth, starts), rel)
    else:
        yield from _changes({"truth": bool(len(a.truth))}, {"truth": bool(len(b.truth))})


class _AlignedRows(NamedTuple):
    """Rows of both sessions at the same times."""

    a: Array
    b: Array
    since_s: Array


def _starts(a: Array, b: Array) -> tuple[int, int]:
    """Start of braking in each, or of each session if one never braked, ns."""
    braking = [np.flatnonzero(ticks["phase"] == Phase.BRAKING) for ticks in (a, b)]
    first = [int(where[0]) for where in braking if len(where)]
    rows = first if len(first) == len(braking) else [0, 0]
    return int(a["time_ns"][rows[0]]), int(b["time_ns"][rows[1]])


def _align(a: Array, b: Array, starts: tuple[int, int]) -> _AlignedRows:
    """Each row of `a` since its start, up to the end of the shorter one, with the nearest of `b`.

    Of several rows at one time, as when the outputs are made safe at the end, the last is used.
    """
    a, b = (rows[np.diff(rows["time_ns"], append=_NEVER) > 0] for rows in (a, b))
    times_a, times_b = (rows["time_ns"].astype(np.int64) - start for rows, start in zip((a, b), starts, strict=True))
    kept = (times_a >= 0) & (times_a <= times_b[-1])
    wanted = times_a[kept]
    after = np.minimum(np.searchsorted(times_b, wanted), len(times_b) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(wanted - times_b[before] < times_b[after] - wanted, before, after)
    return _AlignedRows(a[kept], b[nearest], wanted * 1e-9)


def _compare(
    message: Message, rows: _AlignedRows, rel: float, left_out: tuple[str, ...] = ()
) -> Iterator[SignalChange]:
    prefix = "" if message is TICK else "truth."
    for column in message.columns:
        compared = message is TRUTH or column.role is Role.OUTPUT
        if column.kind is DOUBLE and compared and column.name not in left_out:
            change = _signal(rows.a[column.name], rows.b[column.name], rows.since_s, rel)
            if change is not None:
                yield change._replace(key=prefix + column.name, unit=column.unit)


def _signal(a: Array, b: Array, since_s: Array, rel: float) -> SignalChange | None:
    known = np.isfinite(a) & np.isfinite(b)
    one_sided = int(((a != b) & ~known & ~(np.isnan(a) & np.isnan(b))).sum())
    apart = np.abs(a[known] - b[known])
    largest = int(apart.argmax()) if len(apart) else None
    most = 0.0 if largest is None else float(apart[largest])
    peak = float(np.abs(a[known]).max(initial=0.0))
    if not one_sided and most <= rel * peak:
        return None
    at_s = 0.0 if largest is None else float(since_s[known][largest])
    rms = float(np.sqrt(np.mean(apart**2))) if len(apart) else 0.0
    return SignalChange("", "", most, at_s, rms, one_sided, len(a))


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
