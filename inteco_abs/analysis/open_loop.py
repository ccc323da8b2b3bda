"""Demands of another controller or estimator, or of other gains, for the counts that a session has logged.

Open loop: the logged counts do not react. After the demands diverge from the log, they are hypothetical.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, cast

import numpy as np
import tomli_w

from inteco_abs.analysis.arithmetic import recorded_arithmetic
from inteco_abs.analysis.compiling import compiled_loops
from inteco_abs.analysis.gains import changes_for, make_due
from inteco_abs.analysis.replay import require_known
from inteco_abs.config import RigConfig, apply_setting, parse_config
from inteco_abs.control import (
    Controller,
    control_check,
    demand_of,
    make_controller,
    make_estimator,
    preferred_estimator,
    set_gain,
)
from inteco_abs.errors import ConfigError, ConfigIssue, SessionError, describe_error
from inteco_abs.quantities import finite
from inteco_abs.sessions import Array, Session, session_config
from inteco_abs.signals import BrakeDemand, Command, Phase, Sample

DUTY_THRESHOLD: Final = 0.01
TORQUE_THRESHOLD_NM: Final = 0.1
COMPARED: Final = ("slip", "torque_demand_nm", "brake_request")
_PHASES: Final = (Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED)
_OPEN: Final = ("controller", "estimator", "model")
"""Sections that may be changed: they decide the demands, not the recorded events."""
_DTYPE: Final = np.dtype([(name, "<f8") for name in COMPARED])
_LOGGED: Final = ["tick", "time_ns", "dt_s", "wheel_count", "road_count", "board_flags", "drive", "brake", "phase"]
_NO_DEMAND: Final = BrakeDemand(0.0)


class Demand(NamedTuple):
    """Estimate and demand of one tick, named as columns of the log."""

    slip: float
    torque_demand_nm: float
    brake_request: float


@dataclass(frozen=True, slots=True)
class Divergence:
    """How one field diverges from the log."""

    field: str
    threshold: float | None
    """None for a field that is only reported."""
    tick: int | None
    """First one beyond the threshold, or None."""
    time_s: float | None
    """Time of that tick since braking began."""
    largest: float | None
    rms: dict[str, float | None]
    """RMS differences by the log's phase; None where one of both is not a number."""


@dataclass(frozen=True, slots=True)
class WhatIf:
    """One alternative on the logged counts."""

    divergences: tuple[Divergence, ...]
    requests: Array | None
    """A row for each tick, with the columns COMPARED, if they were kept; before the switch they are the log's."""

    @property
    def horizon_s(self) -> float | None:
        """Time since braking began at which it leaves the log, or None."""
        times = [each.time_s for each in self.divergences if each.time_s is not None]
        return min(times, default=None)


def alternative(session: Session, settings: Sequence[str], controllers: Mapping[str, type[Controller]]) -> RigConfig:
    """The session's configuration changed by `settings`; another controller begins with its default gains.

    Raises ConfigError with all mistakes, SessionError if the session's configuration cannot be used.
    """
    table = tomllib.loads(session_config(session, ()).to_toml())
    chosen: dict[str, Any] = {}
    mistakes = [mistake for setting in settings for mistake in apply_setting(chosen, setting)]
    mistakes += [
        ConfigIssue(key, f"cannot be changed here, only {', '.join(f'{each}.*' for each in _OPEN)}")
        for key in chosen
        if key not in _OPEN
    ]
    mistakes += [
        ConfigIssue(key, f"{value!r}: is a section; name a key in it, as in controller.gains.Mk=5")
        for key, value in chosen.items()
        if key in _OPEN and not isinstance(value, dict)
    ]
    if mistakes:
        raise ConfigError(mistakes)
    before = table["controller"]["name"]
    for setting in settings:
        apply_setting(table, setting)
    if table["controller"]["name"] != before:
        table["controller"]["gains"] = chosen["controller"].get("gains", {})
    if "estimator" not in chosen:
        table["estimator"] |= preferred_estimator(controllers)(table).get("estimator", {})
    return parse_config(tomli_w.dumps(table), (control_check(controllers),))


def braking_start(session: Session) -> tuple[int, int]:
    """Row of the first tick of braking, and its time in ns. Raises SessionError without one."""
    before = 0
    for ticks, _ in session.blocks():
        rows = np.flatnonzero(ticks["phase"] == Phase.BRAKING)
        if len(rows):
            return before + int(rows[0]), int(ticks["time_ns"][rows[0]])
        before += len(ticks)
    raise SessionError(f"{session.path}: the run ended before braking; there is nothing to compare")


def since_braking_s(session: Session) -> Array:
    """Time of each tick since braking began, s."""
    seconds: Array = (session.ticks["time_ns"].astype(np.int64) - braking_start(session)[1]) * 1e-9
    return seconds


def what_if(
    session: Session,
    config: RigConfig,
    controllers: Mapping[str, type[Controller]],
    at_s: float | None = None,
    duty: float = DUTY_THRESHOLD,
    torque_nm: float = TORQUE_THRESHOLD_NM,
    compiled: bool | None = None,
    *,
    keep: bool = True,
) -> WhatIf:
    """Demands of the estimator and controller of `config` for the logged counts, and where they leave the log.

    They are updated from the first tick, with the session's changes of gains that hold for them, and compared from
    `at_s` after braking began, or always. `duty` and `torque_nm` are the largest differences that still agree with the
    log; `compiled` as for `replay_session`. Unless they are to `keep`, the requests are compared block by block and
    forgotten. Raises SessionError without braking, if the run was over by `at_s`, or if the estimator or controller
    raises.
    """
    require_known(session)
    _, zero_ns = braking_start(session)
    over_s = (int(session.rows.edges()[1]["time_ns"][0]) - zero_ns) * 1e-9
    switch_s = -math.inf if at_s is None else at_s - 1e-9
    if over_s < switch_s:
        raise SessionError(
            f"{session.path}: {at_s:g} s after braking began the run was over; choose at most {over_s:.3f} s"
        )

    def compared(asked: Iterable[tuple[Array, Array | None]]) -> WhatIf | None:
        comparisons = [_Comparison(name, thresholds.get(name)) for name in COMPARED]
        kept = list[Array]()
        for ticks, requests in asked:
            if requests is None:
                return None
            since_s = (ticks["time_ns"].astype(np.int64) - zero_ns) * 1e-9
            ahead = since_s < switch_s
            requests[ahead] = ticks[list(COMPARED)].astype(_DTYPE)[ahead]
            for each in comparisons:
                each.add(ticks, since_s, requests)
            if keep:
                kept.append(requests)
        return WhatIf(tuple(each.divergence for each in comparisons), np.concatenate(kept) if keep else None)

    thresholds = {"torque_demand_nm": torque_nm, "brake_request": duty}
    with recorded_arithmetic(session):
        found = compared(_compiled_requests(session, config, controllers, compiled))
        return found or cast(WhatIf, compared(_requests(session, config, controllers)))


def _compiled_requests(
    session: Session, config: RigConfig, controllers: Mapping[str, type[Controller]], compiled: bool | None
) -> Iterator[tuple[Array, Array | None]]:
    """As `_requests`, by a compiled loop; None where that cannot go on."""
    estimator, controller = make_estimator(config), make_controller(config, controllers)
    changed = changes_for(session, config, controller, controllers)
    loops = None if changed else compiled_loops(session, estimator, controller, compiled)
    demands = loops and loops.module.CompiledDemands(estimator, controller, _DTYPE, loops.may_compile)
    for ticks, _ in session.blocks():
        yield ticks, demands and demands.rows(ticks)


def _requests(
    session: Session, config: RigConfig, controllers: Mapping[str, type[Controller]]
) -> Iterator[tuple[Array, Array]]:
    """Blocks of the session, each with the demands for it."""
    alternative = _Alternative(session, config, controllers)
    answer, command, before = Demand(0.0, 0.0, 0.0), Command.SAFE, Phase.UNKNOWN
    for ticks, _ in session.blocks():
        answers = list[Demand]()
        for tick, time_ns, dt_s, wheel, road, flags, drive, brake, phase in ticks[_LOGGED].tolist():
            if not flags:  # without a valid sample the run kept its previous demand
                sample = Sample(tick, time_ns, dt_s, wheel, road)
                try:
                    answer = alternative.step(sample, command, Phase(before), Phase(phase))
                except (Exception, SystemExit) as error:  # a user's controller may raise anything
                    raise SessionError(
                        f"{session.path}: asked at tick {tick}, it raised {describe_error(error)}"
                    ) from error
            answers.append(answer)
            command, before = Command(drive, brake), phase
        yield ticks, np.array(answers, _DTYPE)


class _Alternative:
    """Estimator and controller; the controller is updated where the log's was: from the tick after braking began."""

    def __init__(self, session: Session, config: RigConfig, controllers: Mapping[str, type[Controller]]) -> None:
        self._arguments = config, controllers
        self._estimator = make_estimator(config)
        self._controller = make_controller(config, controllers)
        self._changes = changes_for(session, config, self._controller, controllers)
        self._made: dict[str, float] = {}
        """Gains changed so far."""
        self._held = _NO_DEMAND

    def step(self, sample: Sample, command: Command, before: Phase, phase: Phase) -> Demand:
        """Demand of a tick that goes from one phase to the next."""
        make_due(self._changes, sample.tick, self._change)
        estimate = self._estimator.update(sample, command)
        demand = _NO_DEMAND
        if before is Phase.BRAKING:
            demand = self._held = demand_of(self._controller, estimate, sample.dt_s)
        elif before is Phase.STOPPED and phase is Phase.STOPPED:
            demand = self._held
        elif before is Phase.STOPPED:
            self._controller = make_controller(*self._arguments)  # each stop begins with a new one
            for gain in self._made.items():
                set_gain(self._controller, *gain)
        return Demand(estimate.slip, demand.torque_nm, demand.brake)

    def _change(self, name: str, value: float) -> None:
        self._made[name] = value
        set_gain(self._controller, name, value)


class _Comparison:
    """One field of requests and log, block by block."""

    def __init__(self, name: str, threshold: float | None) -> None:
        self._name, self._threshold = name, threshold
        self._first: tuple[int, float] | None = None
        self._largest = 0.0
        self._squares = dict.fromkeys(_PHASES, (0, 0.0))
        """Number of ticks, and sum of squared differences."""

    def add(self, ticks: Array, since_s: Array, requests: Array) -> None:
        requested, logged, phases = requests[self._name], ticks[self._name], ticks["phase"]
        apart = np.where(np.isnan(requested) & np.isnan(logged), 0.0, np.abs(requested - logged))
        judged = np.isin(phases, _PHASES)
        self._largest = float(np.max(apart[judged], initial=self._largest))
        beyond = np.flatnonzero(judged & ~(apart <= (math.inf if self._threshold is None else self._threshold)))
        if self._first is None and self._threshold is not None and len(beyond):
            self._first = int(ticks["tick"][beyond[0]]), float(since_s[beyond[0]])
        for phase, (number, squares) in self._squares.items():
            values = apart[phases == phase]
            self._squares[phase] = number + len(values), squares + float(np.sum(values * values))

    @property
    def divergence(self) -> Divergence:
        tick, time_s = self._first or (None, None)
        return Divergence(
            self._name,
            self._threshold,
            tick,
            time_s,
            finite(self._largest),
            {phase.name: finite(math.sqrt(total / n)) for phase, (n, total) in self._squares.items() if n},
        )
