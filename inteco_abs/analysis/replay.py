"""Repeats the decisions on logged inputs and compares every output, bit for bit or within tolerances."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from html import escape
from typing import Any, Final

import numpy as np

from inteco_abs.analysis.arithmetic import recorded_arithmetic
from inteco_abs.analysis.compiling import compiled_loops
from inteco_abs.analysis.gains import changed_gains, gain_changes, steps
from inteco_abs.analysis.tolerance import DISCRETE, OUTPUTS, Array, Shift, Shifts, Tolerance, bits
from inteco_abs.control import REFERENCE, Controller, Pipeline, build_pipeline, control_check, gains_in_force
from inteco_abs.errors import SessionError, describe_error
from inteco_abs.format import TICK, Role
from inteco_abs.sessions import (
    BLOCK_TICKS,
    RECOVERED,
    Session,
    describe_other_arithmetic,
    joined_rows,
    other_arithmetic,
    session_config,
)
from inteco_abs.signals import BoardFlags, Phase, Reason, Sample

_INPUTS: Final = tuple(column.name for column in TICK.columns if column.role is Role.INPUT)
_COMPARED: Final = ("time_ns", "tick", "dt_s", *OUTPUTS)
_LONGEST_S: Final = (1 << 64) * 1e-9
"""Range of a clock of 64 bits in ns."""
_BLOCK: Final = 4096
"""Ticks that a processor's cache holds."""
_COMPARED_TICKS: Final = 8192
"""Ticks of a block that is compared field by field."""
_NO_FLAGS: Final = BoardFlags.NONE  # two enums looked up by value would take a tenth of a tick
_NO_REQUEST: Final = Reason.NONE


@dataclass(frozen=True, slots=True)
class FirstDifference:
    """The first value that a replay did not reproduce."""

    tick: int
    field: str
    logged: str
    replayed: str
    logged_hex: str
    replayed_hex: str


@dataclass(frozen=True, slots=True, repr=False)
class Replay:
    """Result of a replay; differences within the tolerances do not count as such."""

    ticks: int
    braking_ticks: int
    differing: int
    first: FirstDifference | None
    by_field: dict[str, int]
    agreeing_ticks: int = 0
    """Number of ticks before the first difference."""
    agreeing_s: float = 0.0
    """Time from the first to the last of these ticks."""
    tolerated: dict[str, int] = field(default_factory=dict)
    """Number of ticks that differ within the tolerance, by field."""
    shifts: tuple[Shift, ...] = ()
    """Changes of phases, flags and reasons that come early, late, or not at all."""
    arithmetic: dict[str, dict[str, str]] = field(default_factory=dict)
    """Where ticks differ, how this computer's arithmetic does: `recorded` and `here`, as `other_arithmetic`."""
    left_out: int = 0
    """Number of ticks after a gap, which cannot be replayed."""
    gains: dict[str, dict[str, str | None]] = field(default_factory=dict)
    """Gains that are others than in the run, by name: `recorded`, `configured`, and `where` it is recorded."""
    error: str = ""
    """What the controller or estimator raised, if ticks differ."""

    @property
    def agrees(self) -> bool:
        """Whether every tick and gain does."""
        return not (self.differing or self.gains)

    def lines(self, name: str) -> Iterator[str]:
        """The result in words; `name` is the session's."""
        for gain, change in self.gains.items():
            was, now = (change[when] or "not there" for when in ("recorded", "configured"))
            yield f"{name}: the gain {gain} was {was} in the run ({change['where']}) and is {now} now"
        within = f", {max(self.tolerated.values())} within their tolerance" if self.tolerated else ""
        if self.first is None:
            yield f"{name}: {self.ticks} ticks ({self.braking_ticks} braking) replayed, none differ{within}"
        else:
            first = self.first
            yield f"{name}: {self.differing} of {self.ticks} ticks differ, first at tick {first.tick}: {first.field}"
            yield f"  logged   {first.logged}  {first.logged_hex}"
            yield f"  replayed {first.replayed}  {first.replayed_hex}"
            yield f"  before it {self.agreeing_ticks} ticks agree, {self.agreeing_s:.4f} s"
            yield from (f"  {field}: {count} ticks" for field, count in self.by_field.items())
        yield from (f"  {_shift_in_words(shift)}" for shift in self.shifts)
        if self.arithmetic:
            yield f"  {describe_other_arithmetic(self.arithmetic)}"

    def __repr__(self) -> str:
        return f"<Replay: {self.ticks} ticks, {self.differing} differing>"

    def _repr_html_(self) -> str:
        more = [f"failed: {self.error}"] if self.error else []
        more += [f"{self.left_out} ticks after a gap cannot be replayed"] if self.left_out else []
        return f"<pre>{escape(chr(10).join([*self.lines('replay'), *more]))}</pre>"


def _shift_in_words(shift: Shift) -> str:
    change = f"{shift.field} becomes {shift.value}"
    if shift.late_ticks is None:
        where = ("in the log", shift.logged_tick) if shift.replayed_tick is None else ("replayed", shift.replayed_tick)
        return f"{change} only {where[0]}, at tick {where[1]}"
    ticks = abs(shift.late_ticks)
    count = f"{ticks} tick{'s' if ticks > 1 else ''}"
    return f"{change} {count} {'late' if shift.late_ticks > 0 else 'early'}, at tick {shift.replayed_tick}"


def before_the_gap(session: Session) -> Session:
    """A recovered session up to its first gap, as later decisions depend on the missing ticks.

    Any other session is returned unchanged: there, a gap is a difference. Raises SessionError if it begins with a gap.
    """
    if session.metadata.get("session", {}).get("outcome") != RECOVERED:
        return session
    whole = 0
    for ticks, _ in session.blocks():
        numbers = ticks["tick"]
        odd = np.flatnonzero(numbers != whole + np.arange(len(numbers)))
        if len(odd):
            whole += int(odd[0])
            break
        whole += len(ticks)
    else:
        return session
    if not whole:
        raise SessionError(f"{session.path}: ticks 0..{numbers[0] - 1} are missing, so nothing can be replayed")
    return session.first(whole)


def replay_recorded(
    recorded: Session,
    controllers: Mapping[str, type[Controller]],
    tolerances: Mapping[str, Tolerance] | None = None,
) -> Replay:
    """Replay a session with the configuration that it keeps, up to its first gap.

    Raises SessionError if it cannot be replayed, ConfigError if its controller is not among `controllers`.
    """
    require_known(recorded)
    session = before_the_gap(recorded)
    config = session_config(session, (control_check(controllers),))
    gains = changed_gains(session, {REFERENCE: config.controller.reference_slip, **gains_in_force(config, controllers)})
    with recorded_arithmetic(session):
        pipeline = build_pipeline(config, controllers)
        found = replay_session(session, pipeline, tolerances)
    error = describe_error(pipeline.error) if found.differing and pipeline.error is not None else ""
    return replace(found, left_out=recorded.tick_count - session.tick_count, gains=gains, error=error)


def replay_session(
    session: Session,
    pipeline: Pipeline,
    tolerances: Mapping[str, Tolerance] | None = None,
    compiled: bool | None = None,
) -> Replay:
    """Run a new `pipeline` on the session's inputs and compare; fields without a tolerance must agree exactly.

    Inputs that follow from others are compared as well. Raises SessionError if there are no ticks.

    A compiled loop replays many ticks, or any if `compiled` is true, and none if it is false; where one of them
    differs, or machine code cannot replay it, Python replays all and has the last word.
    """
    require_inputs(session)
    agrees = _agrees_compiled(session, pipeline, compiled)
    if agrees is not None:
        return agrees
    found = _Comparison(tolerances or {})
    changes = gain_changes(session)
    with recorded_arithmetic(session):
        for logged, _ in checked_blocks(session, _COMPARED_TICKS):
            found.add(logged, TICK.array_of(steps(pipeline, samples_of(logged), changes)))
    return found.result(session)


def _agrees_compiled(session: Session, pipeline: Pipeline, compiled: bool | None) -> Replay | None:
    """The result, if a compiled loop replays all of the session and every bit of it agrees."""
    loops = compiled_loops(session, pipeline.estimator, pipeline.machine.controller, compiled)
    if loops is None:
        return None
    replay = loops.module.CompiledReplay(pipeline, loops.may_compile, gain_changes(session))
    count = braking = 0
    before = TICK.array(b"")
    for logged, _ in checked_blocks(session):
        again = replay.decide(logged)
        if again is None or not (_same_outputs(logged, again) and _inputs_follow(before, logged)):
            return None
        count += len(logged)
        braking += int((logged["phase"] == Phase.BRAKING).sum())
        before = logged[-1:]
    return Replay(count, braking, 0, None, {}, count, session.duration_s)


class _Comparison:
    """Decisions compared with the log, block by block.

    Each tick is judged once the log goes on as far as a tolerance reaches, and is kept as long as one reaches back.
    """

    def __init__(self, tolerances: Mapping[str, Tolerance]) -> None:
        self._tolerances = tolerances
        self._reach_ns = round(max((max(each.lead_s, each.lag_s) for each in tolerances.values()), default=0.0) * 1e9)
        self._logged = self._again = TICK.array(b"")
        self._judged = 0
        """Number of kept ticks that have been judged."""
        self._count = self._braking = self._differing = 0
        self._by_field: dict[str, int] = {}
        self._tolerated: dict[str, int] = {}
        self._shifts = {name: Shifts(name) for name in DISCRETE}
        self._first: FirstDifference | None = None
        self._first_ns = self._agreeing_ns = 0
        self._agreeing = 0

    def add(self, logged: Array, again: Array) -> None:
        """Add the decisions `again` on the next block of the log."""
        self._logged, self._again = joined_rows(self._logged, logged), joined_rows(self._again, again)
        times_ns = self._logged["time_ns"].astype(np.int64)
        # what a tick's own time should be depends on the tick after it
        self._judge(min(int(np.searchsorted(times_ns, times_ns[-1] - self._reach_ns)), len(times_ns) - 1))
        kept = int(np.searchsorted(times_ns, times_ns[self._judged] - self._reach_ns))
        kept = max(0, min(kept, self._judged - 1))
        self._logged, self._again = self._logged[kept:], self._again[kept:]
        self._judged -= kept

    def _judge(self, end: int) -> None:
        logged, again, first = self._logged, self._again, self._judged
        if end <= first:
            return
        _imply_inputs(logged, again)
        wrong = np.zeros(end - first, np.bool_)
        field = ""
        for name in _COMPARED:
            then, now = logged[name][first:end], again[name][first:end]
            if name in self._shifts:
                self._shifts[name].add(logged["tick"][first:end], then, now)
            differs = bits(then) != bits(now)
            if not differs.any():
                continue
            if name in self._tolerances:
                near = self._tolerances[name].accepts(logged[name], again[name], logged["time_ns"])[first:end]
                _count(self._tolerated, name, differs & near)
                differs &= ~near
            _count(self._by_field, name, differs)
            if self._first is None and differs.any() and (not field or differs.argmax() < wrong.argmax()):
                field = name
            wrong |= differs
        if field:
            row = first + int(wrong.argmax())
            self._first = _difference(int(again["tick"][row]), field, logged[field][row], again[field][row])
        if not self._count:
            self._first_ns = int(logged["time_ns"][first])
        if field or self._first is None:
            agreeing = int(wrong.argmax()) if field else end - first
            self._agreeing += agreeing
            self._agreeing_ns = int(logged["time_ns"][first + agreeing - 1]) if self._agreeing else self._first_ns
        self._count += end - first
        self._braking += int((logged["phase"][first:end] == Phase.BRAKING).sum())
        self._differing += int(wrong.sum())
        self._judged = end

    def result(self, session: Session) -> Replay:
        """The result, once all was added."""
        self._judge(len(self._logged))
        return Replay(
            self._count,
            self._braking,
            self._differing,
            self._first,
            {name: self._by_field[name] for name in _COMPARED if name in self._by_field},
            self._agreeing,
            (self._agreeing_ns - self._first_ns) * 1e-9,
            self._tolerated,
            tuple(shift for each in self._shifts.values() for shift in each.found()),
            other_arithmetic(session.metadata.get("software", {})) if self._first else {},
        )


def _count(counts: dict[str, int], name: str, where: Array) -> None:
    if where.any():
        counts[name] = counts.get(name, 0) + int(where.sum())


def _same_outputs(logged: Array, again: Array) -> bool:
    blocks = (slice(first, first + _BLOCK) for first in range(0, len(logged), _BLOCK))
    if all(np.array_equal(logged[block].view(np.uint8), again[block].view(np.uint8)) for block in blocks):
        return True  # much faster than column by column
    return all(np.array_equal(bits(logged[name]), bits(again[name])) for name in OUTPUTS)


def _inputs_follow(before: Array, logged: Array) -> bool:
    """Whether ticks are consecutive, from the tick `before` on, and dt_s is the time since the previous one."""
    numbers, times_ns = (np.concatenate([before[name], logged[name]]).astype(np.int64) for name in ("tick", "time_ns"))
    since_s = np.diff(times_ns) / 1e9
    dt_s = logged["dt_s"][len(logged) - len(since_s) :]
    return bool((np.diff(numbers) == 1).all() and (bits(dt_s) == bits(since_s)).all())


def decisions(session: Session, pipeline: Pipeline) -> Array:
    """Decisions of a new `pipeline` on the session's inputs: rows as in `session.ticks`, with zero timing.

    Raises SessionError as `require_inputs`.
    """
    with recorded_arithmetic(session):
        return TICK.array_of(steps(pipeline, samples(session), gain_changes(session)))


def samples(session: Session) -> Iterator[tuple[Sample, Reason]]:
    """The session's inputs: samples, and reasons of requested stops. Raises SessionError as `require_inputs`."""
    require_inputs(session)
    for ticks, _ in checked_blocks(session):
        yield from samples_of(ticks)


def require_known(session: Session) -> None:
    """Raise SessionError if this version does not know all of the session, on which decisions may depend."""
    if session.unsupported:
        raise SessionError(f"{session.path}: cannot be replayed: {session.unsupported}; replay it with that")


def require_inputs(session: Session) -> None:
    """Raise SessionError if the session has no ticks, is only a part of one, or is not fully supported."""
    if not session.tick_count:
        raise SessionError(f"{session.path}: has no ticks")
    if session.window_s is not None:
        raise SessionError(
            f"{session.path}: from {session.window_s[0]:g} s on: decisions depend on all ticks before them; "
            "replay the whole session"
        )
    require_known(session)


def checked_blocks(session: Session, ticks_each: int = BLOCK_TICKS) -> Iterator[tuple[Array, Array]]:
    """The session's ticks and true states in blocks. Raises SessionError for an impossible dt_s."""
    for ticks, states in session.blocks(ticks_each):
        impossible = np.flatnonzero(~(np.abs(ticks["dt_s"]) < _LONGEST_S))
        if len(impossible):
            tick, dt_s = (ticks[name][impossible[0]] for name in ("tick", "dt_s"))
            raise SessionError(f"{session.path}: tick {tick}: dt_s is {dt_s} s: must be less than {_LONGEST_S:.0f} s")
        yield ticks, states


def samples_of(ticks: Array) -> Iterator[tuple[Sample, Reason]]:
    """The inputs of logged ticks: samples, and reasons of requested stops."""
    for time_ns, tick, dt_s, wheel, road, flags, request in TICK.values(ticks.view(np.uint8).data, _INPUTS):
        sample = Sample(tick, time_ns, dt_s, wheel, road, BoardFlags(flags) if flags else _NO_FLAGS)
        yield sample, Reason(request) if request else _NO_REQUEST


def _imply_inputs(logged: Array, again: Array) -> None:
    """Compute the inputs in `again` that follow from others, for the comparison.

    Ticks are consecutive, and dt_s is the time since the previous tick; if it is wrong before and after a tick, that
    tick's time is wrong.
    """
    numbers, times_ns = logged["tick"].astype(np.int64), logged["time_ns"].astype(np.int64)
    again["tick"][1:] = numbers[:-1] + 1
    follows = np.diff(numbers) == 1
    again["dt_s"][1:][follows] = (np.diff(times_ns) / 1e9)[follows]
    wrong = bits(again["dt_s"]) != bits(logged["dt_s"])
    moved = np.flatnonzero(wrong[1:-1] & wrong[2:]) + 1
    again["time_ns"][moved] = times_ns[moved - 1] + np.rint(logged["dt_s"][moved] * 1e9).astype(np.int64)


def _difference(tick: int, name: str, *values: Any) -> FirstDifference:
    logged, replayed = (value.item() for value in values)
    hexes = [value.hex() if isinstance(value, float) else hex(value) for value in (logged, replayed)]
    return FirstDifference(tick, name, repr(logged), repr(replayed), *hexes)
