"""Continues a recorded run in simulation from a logged tick, with a plant that reacts.

Up to that tick the mock board gets the logged commands at the logged times, which fills the brake's dead time; then the
plant is set to the logged state. A run of the mock board in virtual time continues bit for bit; any other as well as
its log and the plant's parameters allow.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final, Self

import numpy as np

from inteco_abs.analysis.gains import changes_for, make_due
from inteco_abs.analysis.open_loop import since_braking_s
from inteco_abs.analysis.replay import recorded_arithmetic, samples
from inteco_abs.analysis.tolerance import Array
from inteco_abs.boards import Board, InProcessLink, board_behind
from inteco_abs.config import RigConfig, SimulationConfig, load_config
from inteco_abs.control import Controller, Gain, Pipeline, keeps_gain, make_controller, make_estimator, set_gain
from inteco_abs.errors import SessionError, describe_error
from inteco_abs.format import INTERNALS, TICK, TRUTH
from inteco_abs.mock_board import Device, Truth, front_end_of
from inteco_abs.sessions import Session, result_card
from inteco_abs.signals import BrakeDemand, Command, Estimate, Phase, Sample, Tick

_SIMULATED_PROFILE: Final = "sim_usb2"
_DEMAND: Final = ("brake_request", "torque_demand_nm", "switching", *INTERNALS)
_DISTANCES: Final = ("road_speed_rad_s", "slip", "brake")
_RUNNING: Final = (Phase.SPIN_UP, Phase.BRAKING)


@dataclass(frozen=True, slots=True)
class Continuation:
    """A session up to a tick, and its simulated continuation."""

    row: int
    """Row of the last logged tick."""
    state_from: str
    """Source of the plant's state: `truth` or `estimates`."""
    rig: str
    """The drawn rig, or the name of the published parameters."""
    ticks: Array
    truth: Array
    """True states of the continuation alone."""
    card: dict[str, Any]
    """Result card of the whole stop; by the estimates if the log has no truth."""


def continued(
    session: Session,
    own: RigConfig,
    other: RigConfig,
    controllers: Mapping[str, type[Controller]],
    at_s: float = 0.0,
) -> Continuation:
    """`session`, run with `own`, as if the estimator and controller of `other` had decided from `at_s`.

    The session's changes of gains go on, as far as they hold for that controller.
    `at_s` is since braking began. Each command takes effect at the next tick, as on a board. Raises SessionError if
    the run was over by then, or the errors of the mock board.
    """
    row = _row_at(session, at_s)
    simulation = own if _was_simulated(session) else _in_simulation(own)
    log = _Log(session.ticks[list(_DEMAND)], row)
    ticks: list[Tick] = []
    with recorded_arithmetic(session):
        controller = make_controller(other, controllers)
        pipeline = Pipeline(own, make_estimator(other), _Successor(log, controller))
        changes = changes_for(session, other, controller, controllers)
        rig = _Rig(session, simulation)
        with rig.board:
            for sample, request in samples(session):
                simulated = rig.exchange(sample.time_ns, pipeline.command)
                log.row = len(ticks)
                make_due(changes, sample.tick, pipeline.change)
                ticks.append(pipeline.step(sample, request))
                if len(ticks) > row:
                    break
            state_from = rig.put_into_state(row)
            rig.truths.clear()
            wheel, road = sample.wheel_count - simulated.wheel_count, sample.road_count - simulated.road_count
            while not pipeline.finished:
                before = ticks[-1]
                following = rig.exchange(before.time_ns + own.period_ns, pipeline.command)
                sample = following._replace(
                    tick=before.tick + 1,
                    wheel_count=following.wheel_count + wheel,
                    road_count=following.road_count + road,
                )
                make_due(changes, sample.tick, pipeline.change)
                ticks.append(pipeline.step(sample))
    if pipeline.error is not None:
        raise SessionError(f"{session.path}: in simulation, it raised {describe_error(pipeline.error)}")
    rows, truth = TICK.array_of(ticks), TRUTH.array_of(rig.truths)
    logged = session.truth[session.truth["time_ns"] <= rows["time_ns"][row]]
    known = TRUTH.array(logged.tobytes() + truth.tobytes())  # np.concatenate would change the layout
    card = result_card(other, rows, known if len(session.truth) else truth[:0])
    return Continuation(
        row, state_from, simulation.simulation.rig or simulation.simulation.parameters, rows, truth, card
    )


def distance(session: Session, closed: Continuation) -> dict[str, float | None]:
    """RMS difference between continuation and log over the ticks in which both brake; None if there are none."""
    ticks = closed.ticks[closed.row + 1 : len(session.ticks)]
    logged = session.ticks[closed.row + 1 : len(closed.ticks)]
    braking = (ticks["phase"] == Phase.BRAKING) & (logged["phase"] == Phase.BRAKING)
    apart = {name: ticks[name][braking] - logged[name][braking] for name in _DISTANCES}
    return {name: float(np.sqrt(np.mean(each * each))) if len(each) else None for name, each in apart.items()}


def _row_at(session: Session, at_s: float) -> int:
    """Row of the first tick at or after `at_s`; raises SessionError if the run was over by then."""
    since_s = since_braking_s(session)
    row = int(np.searchsorted(since_s, at_s - 1e-9))
    if row == len(since_s) or session.ticks["phase"][row] not in _RUNNING:
        raise SessionError(
            f"{session.path}: {at_s:g} s after braking began the run neither spins up nor brakes; "
            f"choose a time in {since_s[0]:.3f}..{since_s[session.ticks['phase'] == Phase.BRAKING][-1]:.3f} s"
        )
    return row


def _was_simulated(session: Session) -> bool:
    return session.metadata.get("rig", {}).get("simulated") == "true"


def _in_simulation(config: RigConfig) -> RigConfig:
    """A real rig's configuration with the mock board and the published rig instead."""
    return replace(config, board=load_config(profile=_SIMULATED_PROFILE).board, simulation=SimulationConfig())


@dataclass(slots=True)
class _Log:
    """The logged demands, used up to `from_row`."""

    demands: Array
    from_row: int
    row: int = -1
    """The current row."""


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
        if self._log.row >= self._log.from_row:
            return own
        brake, torque_nm, switching, *internals = self._log.demands[self._log.row].item()
        return BrakeDemand(brake, torque_nm, switching, tuple(internals))

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return a copy for the next stop of a session, which shares the log."""
        return type(self)(self._log, deepcopy(self._controller, memo))


class _Rig:
    """The mock board of a session, with a clock that is set to the logged times."""

    def __init__(self, session: Session, config: RigConfig) -> None:
        self._session = session
        self._now_ns = int(session.ticks["time_ns"][0]) - config.period_ns
        seed = int(session.metadata.get("software", {}).get("seed", "0"))
        self.truths: list[Truth] = []
        self._device = Device(config, self._time_ns, seed, self.truths.append)
        self.board: Board = board_behind(InProcessLink(front_end_of(self._device)), config, self._time_ns)

    def exchange(self, time_ns: int, command: Command) -> Sample:
        """Exchange at that time."""
        self._now_ns = time_ns
        return self.board.exchange(command)

    def put_into_state(self, row: int) -> str:
        """Set the plant to the true state of a logged tick, or to its estimated speeds; return which of the two."""
        plant, truth, logged = self._device.plant, self._session.truth, self._session.ticks[row]
        newest = int(np.searchsorted(truth["time_ns"], logged["time_ns"], side="right")) - 1
        source = truth[newest] if newest >= 0 else logged
        plant.wheel_speed = source["wheel_speed_rad_s"].item()
        plant.road_speed = source["road_speed_rad_s"].item()
        if newest < 0:
            return "estimates"
        plant.brake_torque = source["brake_torque_nm"].item()
        return "truth"

    def _time_ns(self) -> int:
        return self._now_ns
