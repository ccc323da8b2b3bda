"""Continues a recorded run in simulation from a logged tick, with a plant that reacts.

Up to that tick the mock board gets the logged commands at the logged times, which fills the brake's dead time; then the
plant is set to the logged state. A run of the mock board in virtual time continues bit for bit; any other as well as
its log and the plant's parameters allow.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final, Self

import numpy as np

from inteco_abs.analysis.arithmetic import recorded_arithmetic
from inteco_abs.analysis.gains import changes_for, make_due
from inteco_abs.analysis.open_loop import braking_start
from inteco_abs.analysis.replay import checked_blocks, require_inputs, samples_of
from inteco_abs.boards import Board, InProcessLink, board_behind
from inteco_abs.config import RigConfig, SimulationConfig, load_config
from inteco_abs.control import Controller, Gain, Pipeline, keeps_gain, make_controller, make_estimator, set_gain
from inteco_abs.errors import SessionError, describe_error
from inteco_abs.format import INTERNALS, TICK, TRUTH
from inteco_abs.mock_board import Device, Truth, front_end_of
from inteco_abs.sessions import BLOCK_TICKS, Array, RunningCard, Session, joined_rows
from inteco_abs.signals import BrakeDemand, Command, Estimate, Phase, Reason, Sample, Tick

_SIMULATED_PROFILE: Final = "sim_usb2"
_DEMAND: Final = ("brake_request", "torque_demand_nm", "switching", *INTERNALS)
_DISTANCES: Final = ("road_speed_rad_s", "slip", "brake")
_RUNNING: Final = (Phase.SPIN_UP, Phase.BRAKING)


@dataclass(frozen=True, slots=True)
class Continuation:
    """A session up to a tick, and its simulated continuation."""

    row: int
    """Row of the last logged tick."""
    from_tick: int
    """Number of that tick."""
    state_from: str
    """Source of the plant's state: `truth` or `estimates`."""
    rig: str
    """The drawn rig, or the name of the published parameters."""
    reason: Reason
    """Why it ended."""
    card: dict[str, Any]
    """Result card of the whole stop; by the estimates if the log has no truth."""
    distance: dict[str, float | None]
    """RMS difference to the log over the ticks in which both brake, by field; None if there are none."""
    ticks: Array | None
    """All ticks, those up to `row` too, if they were kept."""
    truth: Array | None
    """True states of the continuation alone, if they were kept."""


def continued(
    session: Session,
    own: RigConfig,
    other: RigConfig,
    controllers: Mapping[str, type[Controller]],
    at_s: float = 0.0,
    *,
    keep: bool = True,
) -> Continuation:
    """`session`, run with `own`, as if the estimator and controller of `other` had decided from `at_s`.

    The session's changes of gains go on, as far as they hold for that controller.
    `at_s` is since braking began. Each command takes effect at the next tick, as on a board. Unless they are to
    `keep`, ticks and states are judged in blocks and forgotten. Raises SessionError if the run was over by then, or the
    errors of the mock board.
    """
    require_inputs(session)
    row, last, state = _place_at(session, at_s)
    simulation = own if session.metadata.get("rig", {}).get("simulated") == "true" else _in_simulation(own)
    result = _Result(session, other, row, keep=keep)
    log = _Log(row)
    with recorded_arithmetic(session):
        controller = make_controller(other, controllers)
        pipeline = Pipeline(own, make_estimator(other), _Successor(log, controller))
        changes = changes_for(session, other, controller, controllers)
        rig = _Rig(session, simulation)
        with rig.board:
            for logged, states in checked_blocks(session):
                log.demands = logged[list(_DEMAND)]
                ticks = list[Tick]()
                for sample, request in samples_of(logged[: row + 1 - log.before]):
                    log.row = len(ticks)
                    simulated = rig.exchange(sample.time_ns, pipeline.command)
                    make_due(changes, sample.tick, pipeline.change)
                    ticks.append(pipeline.step(sample, request))
                result.add_logged(ticks, states[states["time_ns"] <= last["time_ns"]])
                rig.truths.clear()
                log.before += len(logged)
                if log.before > row:
                    break
            state_from = rig.put_into_state(last, state)
            wheel, road = sample.wheel_count - simulated.wheel_count, sample.road_count - simulated.road_count
            before, ticks = ticks[-1], []
            while not pipeline.finished:
                following = rig.exchange(before.time_ns + own.period_ns, pipeline.command)
                sample = following._replace(
                    tick=before.tick + 1,
                    wheel_count=following.wheel_count + wheel,
                    road_count=following.road_count + road,
                )
                make_due(changes, sample.tick, pipeline.change)
                before = pipeline.step(sample)
                ticks.append(before)
                if len(ticks) == BLOCK_TICKS:
                    result.add(ticks, rig.truths)
                    ticks, rig.truths[:] = [], []
    if pipeline.error is not None:
        raise SessionError(f"{session.path}: in simulation, it raised {describe_error(pipeline.error)}")
    result.add(ticks, rig.truths)
    name = simulation.simulation.rig or simulation.simulation.parameters
    return result.continuation(row, int(last["tick"]), state_from, name, before.reason)


class _Result:
    """Card of a continuation, and its distance from the log, block by block."""

    def __init__(self, session: Session, config: RigConfig, row: int, *, keep: bool) -> None:
        self._card = RunningCard(config)
        self._true = session.truth_count > 0
        self._rest = _rows_from(session, row + 1)
        self._logged = TICK.array(b"")
        self._squares = dict.fromkeys(_DISTANCES, 0.0)
        self._both = 0
        """Ticks in which both brake."""
        self._kept = ([TICK.array(b"")], [TRUTH.array(b"")]) if keep else None

    def add_logged(self, ticks: list[Tick], states: Array) -> None:
        """Add ticks on logged samples, and the log's states."""
        rows = TICK.array_of(ticks)
        self._card.add(rows, states)
        if self._kept is not None:
            self._kept[0].append(rows)

    def add(self, ticks: list[Tick], truths: list[Truth]) -> None:
        """Add simulated ticks and states."""
        rows, states = TICK.array_of(ticks), TRUTH.array_of(truths)
        self._card.add(rows, states if self._true else states[:0])
        if self._kept is not None:
            self._kept[0].append(rows)
            self._kept[1].append(states)
        while len(self._logged) < len(rows) and (more := next(self._rest, None)) is not None:
            self._logged = joined_rows(self._logged, more)
        logged, self._logged = self._logged[: len(rows)], self._logged[len(rows) :]
        rows = rows[: len(logged)]
        braking = (rows["phase"] == Phase.BRAKING) & (logged["phase"] == Phase.BRAKING)
        self._both += int(braking.sum())
        for name in _DISTANCES:
            apart = rows[name][braking] - logged[name][braking]
            self._squares[name] += float(np.sum(apart * apart))

    def continuation(self, row: int, tick: int, state_from: str, rig: str, reason: Reason) -> Continuation:
        """The result, once all was added."""
        apart = {name: math.sqrt(total / self._both) if self._both else None for name, total in self._squares.items()}
        ticks, truth = (None, None) if self._kept is None else (joined_rows(*each) for each in self._kept)
        return Continuation(row, tick, state_from, rig, reason, self._card.card(), apart, ticks, truth)


def _rows_from(session: Session, row: int) -> Iterator[Array]:
    """The session's ticks from a row on, in blocks."""
    before = 0
    for ticks, _ in session.blocks():
        yield ticks[max(0, row - before) :]
        before += len(ticks)


def _place_at(session: Session, at_s: float) -> tuple[int, Any, Any]:
    """Row and tick of the first one at or after `at_s`, and the true state then, None if there is none.

    Raises SessionError if the run was over by then.
    """
    _, start_ns = braking_start(session)
    before, state, over = 0, None, False
    running_s: list[float] = []
    for ticks, states in session.blocks():
        since_s = (ticks["time_ns"].astype(np.int64) - start_ns) * 1e-9
        row = int(np.searchsorted(since_s, at_s - 1e-9))
        if row < len(ticks) and not over:
            if ticks["phase"][row] in _RUNNING:
                newest = int(np.searchsorted(states["time_ns"], ticks["time_ns"][row], side="right")) - 1
                return before + row, ticks[row], states[newest] if newest >= 0 else state
            over = True
        running_s += [] if before else [float(since_s[0])]
        running_s[1:] = since_s[ticks["phase"] == Phase.BRAKING][-1:].tolist() or running_s[1:]
        state = states[-1] if len(states) else state
        before += len(ticks)
    raise SessionError(
        f"{session.path}: {at_s:g} s after braking began the run neither spins up nor brakes; "
        f"choose a time in {running_s[0]:.3f}..{running_s[1]:.3f} s"
    )


def _in_simulation(config: RigConfig) -> RigConfig:
    """A real rig's configuration with the mock board and the published rig instead."""
    return replace(config, board=load_config(profile=_SIMULATED_PROFILE).board, simulation=SimulationConfig())


class _Log:
    """The logged demands, used up to `from_row`; block by block."""

    def __init__(self, from_row: int) -> None:
        self.from_row = from_row
        self.before = 0
        """Rows before the current block."""
        self.row = -1
        """The current row of that block."""
        self.demands: Array = np.empty(0)


class _Successor:
    """Demands what the log has, then what another controller demands, which is updated from the start."""

    gains: ClassVar[tuple[Gain, ...]] = ()
    internals: ClassVar[tuple[str, ...]] = ()

    def __init__(self, log: _Log, controller: Controller) -> None:
        self._log = log
        self._controller = controller

    def keeps_gain(self, name: str, value: float) -> bool:
        """Whether the other controller can change a gain."""
        return keeps_gain(self._controller, name, value)

    def change_gain(self, name: str, value: float) -> None:
        """Change a gain of the other controller."""
        set_gain(self._controller, name, value)

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """The log's demand, or from the row on the other controller's."""
        own = self._controller.update(estimate, dt_s)
        if self._log.before + self._log.row >= self._log.from_row:
            return own
        brake, torque_nm, switching, *internals = self._log.demands[self._log.row].item()
        return BrakeDemand(brake, torque_nm, switching, tuple(internals))

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return a copy for the next stop of a session, which shares the log."""
        return type(self)(self._log, deepcopy(self._controller, memo))


class _Rig:
    """The mock board of a session, with a clock that is set to the logged times."""

    def __init__(self, session: Session, config: RigConfig) -> None:
        self._now_ns = int(session.rows.edges()[0]["time_ns"][0]) - config.period_ns
        seed = int(session.metadata.get("software", {}).get("seed", "0"))
        self.truths: list[Truth] = []
        self._device = Device(config, self._time_ns, seed, self.truths.append)
        self.board: Board = board_behind(InProcessLink(front_end_of(self._device)), config, self._time_ns)

    def exchange(self, time_ns: int, command: Command) -> Sample:
        """Exchange at that time."""
        self._now_ns = time_ns
        return self.board.exchange(command)

    def put_into_state(self, logged: Any, state: Any) -> str:
        """Set the plant to a true state, or without one to a logged tick's estimates; return which of the two."""
        plant, source = self._device.plant, logged if state is None else state
        plant.wheel_speed = source["wheel_speed_rad_s"].item()
        plant.road_speed = source["road_speed_rad_s"].item()
        if state is None:
            return "estimates"
        plant.brake_torque = source["brake_torque_nm"].item()
        return "truth"

    def _time_ns(self) -> int:
        return self._now_ns
