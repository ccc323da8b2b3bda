"""A run continued in simulation: the plant takes over from a logged tick, and from there on it reacts.

The mock board gets the logged commands at the logged times up to that tick, so that what is on its way to the brake
is right; then the plant is put into the logged state. A run of the mock board in virtual time is continued to the
last bit; of any other, the state is as good as what was logged of it, and the plant as good as its parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final, Self

import numpy as np

from inteco_abs.analysis.open_loop import since_braking_s
from inteco_abs.analysis.replay import samples
from inteco_abs.analysis.tolerance import Array
from inteco_abs.boards import Board, InProcessLink, board_behind
from inteco_abs.config import RigConfig, SimulationConfig, load_config
from inteco_abs.control import Controller, Gain, Pipeline, make_controller, make_estimator
from inteco_abs.errors import SessionError, describe_error
from inteco_abs.format import TICK, TRUTH
from inteco_abs.mock_board import Device, Truth, front_end_of
from inteco_abs.sessions import Session, result_card
from inteco_abs.signals import BrakeDemand, Command, Estimate, Phase, Sample, Tick

_SIMULATED_PROFILE: Final = "sim_usb2"
_DEMAND: Final = ("brake_request", "torque_demand_nm", "switching", "c0", "c1", "c2", "c3")
_DISTANCES: Final = ("road_speed_rad_s", "slip", "brake")
_RUNNING: Final = (Phase.SPIN_UP, Phase.BRAKING)


@dataclass(frozen=True, slots=True)
class Continuation:
    """A session up to a tick, and what the simulation made of it from there on."""

    row: int
    """Of the last logged tick; the plant has it from there."""
    state_from: str
    """`truth` or `estimates`: where the plant's state came from."""
    rig: str
    """The drawn rig, or the name of the published parameters."""
    ticks: Array
    truth: Array
    """True states of the continuation alone."""
    card: dict[str, Any]
    """Of the whole stop, as in the session's own; where the log knows no truth, by the estimates."""


def continued(
    session: Session,
    own: RigConfig,
    other: RigConfig,
    controllers: Mapping[str, type[Controller]],
    at_s: float = 0.0,
) -> Continuation:
    """`session`, run with `own`, as if the estimator and controller of `other` had decided from `at_s` on.

    `at_s` is since braking began; the board's delay is the same: a command is put out at the next tick. Raises
    SessionError if the run was over by then, BoardError as the mock board does.
    """
    row = _row_at(session, at_s)
    simulation = own if _was_simulated(session) else _in_simulation(own)
    log = _Log(session.ticks[list(_DEMAND)], row)
    pipeline = Pipeline(own, make_estimator(other), _Successor(log, make_controller(other, controllers)))
    rig = _Rig(session, simulation)
    ticks: list[Tick] = []
    with rig.board:
        for sample, request in samples(session):
            simulated = rig.exchange(sample.time_ns, pipeline.command)
            log.row = len(ticks)
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
    """RMS of what the continuation leaves the log by, over the ticks in which both brake; None if there are none."""
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
    """A real rig's configuration, with the mock board and the published rig in its place."""
    return replace(config, board=load_config(profile=_SIMULATED_PROFILE).board, simulation=SimulationConfig())


@dataclass(slots=True)
class _Log:
    """What was asked for at each tick, until the successor decides."""

    demands: Array
    from_row: int
    row: int = -1
    """The tick that is being decided."""


class _Successor:
    """Controller that asks for what the log says, with another one beside it that takes over."""

    gains: ClassVar[tuple[Gain, ...]] = ()
    internals: ClassVar[tuple[str, ...]] = ()

    def __init__(self, log: _Log, controller: Controller) -> None:
        self._log = log
        self._controller = controller

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """The log's demand, or from the agreed tick on the other's."""
        own = self._controller.update(estimate, dt_s)
        if self._log.row >= self._log.from_row:
            return own
        brake, torque_nm, switching, *internals = self._log.demands[self._log.row].item()
        return BrakeDemand(brake, torque_nm, switching, tuple(internals))

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """For the next stop of a session: there is one log."""
        return type(self)(self._log, deepcopy(self._controller, memo))


class _Rig:
    """The mock board of a session, which gets its commands at given times."""

    def __init__(self, session: Session, config: RigConfig) -> None:
        self._session = session
        self._now_ns = int(session.ticks["time_ns"][0]) - config.period_ns
        seed = int(session.metadata.get("software", {}).get("seed", "0"))
        self.truths: list[Truth] = []
        self._device = Device(config, self._time_ns, seed, self.truths.append)
        self.board: Board = board_behind(InProcessLink(front_end_of(self._device)), config, self._time_ns)

    def exchange(self, time_ns: int, command: Command) -> Sample:
        """Write and read at that time."""
        self._now_ns = time_ns
        return self.board.exchange(command)

    def put_into_state(self, row: int) -> str:
        """Of a logged tick: the true one where it is known, else the estimated speeds, with the brake as it is."""
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
