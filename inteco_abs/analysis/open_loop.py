"""Demands of another controller or estimator, or of other gains, for the counts that a session has logged.

Open loop: the logged counts do not react. After the demands diverge from the log, they are hypothetical.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import tomli_w

from inteco_abs.analysis.compiling import compiled_loops
from inteco_abs.analysis.gains import changes_for, make_due
from inteco_abs.analysis.replay import recorded_arithmetic, require_known
from inteco_abs.analysis.tolerance import Array
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
from inteco_abs.sessions import Session, session_config
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

    requests: Array
    """A row for each tick, with the columns COMPARED; before the switch they are the log's."""
    divergences: tuple[Divergence, ...]

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


def braking_row(session: Session) -> int:
    """Row of the first tick of braking. Raises SessionError without one."""
    rows = np.flatnonzero(session.ticks["phase"] == Phase.BRAKING)
    if not len(rows):
        raise SessionError(f"{session.path}: the run ended before braking; there is nothing to compare")
    return int(rows[0])


def since_braking_s(session: Session) -> Array:
    """Time of each tick since braking began, s."""
    times_ns = session.ticks["time_ns"].astype(np.int64)
    seconds: Array = (times_ns - times_ns[braking_row(session)]) * 1e-9
    return seconds


def what_if(
    session: Session,
    config: RigConfig,
    controllers: Mapping[str, type[Controller]],
    at_s: float | None = None,
    duty: float = DUTY_THRESHOLD,
    torque_nm: float = TORQUE_THRESHOLD_NM,
    compiled: bool | None = None,
) -> WhatIf:
    """Demands of the estimator and controller of `config` for the logged counts, and where they leave the log.

    They are updated from the first tick, with the session's changes of gains that hold for them, and compared from
    `at_s` after braking began, or always. `duty` and `torque_nm` are the largest differences that still agree with the
    log; `compiled` as for `replay_session`. Raises SessionError without braking, if the run was over by `at_s`, or if
    the estimator or controller raises.
    """
    require_known(session)
    since_s = since_braking_s(session)
    ahead = since_s < (-math.inf if at_s is None else at_s - 1e-9)
    if ahead.all():
        raise SessionError(
            f"{session.path}: {at_s:g} s after braking began the run was over; choose at most {since_s[-1]:.3f} s"
        )
    with recorded_arithmetic(session):
        requests = _compiled_requests(session, config, controllers, compiled)
        if requests is None:
            requests = np.array(list(_requests(session, config, controllers)), _DTYPE)
    logged = session.ticks[list(COMPARED)].astype(_DTYPE)
    requests[ahead] = logged[ahead]
    thresholds = {"torque_demand_nm": torque_nm, "brake_request": duty}
    found = [_divergence(session, since_s, requests, logged, name, thresholds.get(name)) for name in COMPARED]
    return WhatIf(requests, tuple(found))


def _compiled_requests(
    session: Session, config: RigConfig, controllers: Mapping[str, type[Controller]], compiled: bool | None
) -> Array | None:
    """As `_requests`, by a compiled loop, or None."""
    estimator, controller = make_estimator(config), make_controller(config, controllers)
    if changes_for(session, config, controller, controllers):
        return None
    loops = compiled_loops(session, estimator, controller, compiled)
    found: Array | None = loops and loops.module.demand_rows(
        estimator, controller, session.ticks, _DTYPE, loops.may_compile
    )
    return found


def _requests(session: Session, config: RigConfig, controllers: Mapping[str, type[Controller]]) -> Iterator[Demand]:
    alternative = _Alternative(session, config, controllers)
    answer, command, before = Demand(0.0, 0.0, 0.0), Command.SAFE, Phase.UNKNOWN
    for tick, time_ns, dt_s, wheel, road, flags, drive, brake, phase in session.ticks[_LOGGED].tolist():
        if not flags:  # without a valid sample the run kept its previous demand
            sample = Sample(tick, time_ns, dt_s, wheel, road)
            try:
                answer = alternative.step(sample, command, Phase(before), Phase(phase))
            except (Exception, SystemExit) as error:  # a user's controller may raise anything
                raise SessionError(
                    f"{session.path}: asked at tick {tick}, it raised {describe_error(error)}"
                ) from error
        yield answer
        command, before = Command(drive, brake), phase


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


def _divergence(
    session: Session, since_s: Array, requests: Array, logged: Array, name: str, threshold: float | None
) -> Divergence:
    both_missing = np.isnan(requests[name]) & np.isnan(logged[name])
    apart = np.where(both_missing, 0.0, np.abs(requests[name] - logged[name]))
    phases = session.ticks["phase"]
    judged = np.isin(phases, _PHASES)
    beyond = np.flatnonzero(judged & ~(apart <= (math.inf if threshold is None else threshold)))
    where = {phase.name: apart[phases == phase] for phase in _PHASES if (phases == phase).any()}
    return Divergence(
        name,
        threshold,
        int(session.ticks["tick"][beyond[0]]) if len(beyond) and threshold is not None else None,
        float(since_s[beyond[0]]) if len(beyond) and threshold is not None else None,
        finite(np.max(apart[judged])),
        {phase: finite(np.sqrt(np.mean(values * values))) for phase, values in where.items()},
    )
