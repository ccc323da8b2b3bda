"""Preflight: what a run would meet, found by reading only, and its planned phases."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from firmware_protocol import signed32
from inteco_abs.boards import STILL_ON, Board, Identity, PlannedWord, Remark, family_of
from inteco_abs.commissioning.exchange_rate import MORE_THAN_A_READ
from inteco_abs.commissioning.reading import read_patiently
from inteco_abs.commissioning.rig_access import RigAccess
from inteco_abs.config import RigConfig
from inteco_abs.control import REST_COUNTS
from inteco_abs.errors import AbsError, BoardError
from inteco_abs.realtime import Quantiles, quantiles
from inteco_abs.signals import EXPLANATIONS, Phase, Reason

_BEAT_NS: Final = 1_000_000
"""Shortest time between two readings."""


class PlannedPhase(NamedTuple):
    """A phase of a stop that is still to come."""

    phase: str
    seconds: float
    fixed: bool
    """Whether it lasts exactly so long; otherwise at most."""
    does: str


@dataclass
class Preflight:
    """What was read from a board, and what speaks against a run."""

    identity: Identity | None = None
    """None if no board could be read."""
    moved: tuple[int, int] | None = None
    """Largest deviation of wheel and road counts from the first reading; None if they were not watched."""
    first_write: list[PlannedWord] = field(default_factory=list)
    """Words of the board that a run would change before its first tick, and unknown ones that it would keep."""
    read_us: Quantiles | None = None
    """Time of readings of both counters; None in virtual time."""
    refused: list[AbsError] = field(default_factory=list)
    cautions: list[str] = field(default_factory=list)


def run_preflight(rig: RigAccess, config: RigConfig, *, rest: bool = True) -> Preflight:
    """Read the board; write nothing to it.

    Checks its identity, whether outputs are allowed, and with `rest`, for as long as a run watches them, whether the
    wheels stand still and readings fit into a period. `refused` has what fails, also a board that cannot be read.
    """
    found = Preflight()
    try:
        with rig.open(config).reading() as board:
            found.identity = board.identity
            _judge(board, config, found)
            if rest and board.identity is not None and board.identity.logic_version == config.board.logic_version:
                _watch(rig, board, config, found)
    except AbsError as error:
        found.refused.append(error)
    if caution := family_of(config.board.kind).reading_caution:
        found.cautions.append(caution)
    return found


def planned_phases(config: RigConfig) -> Iterator[PlannedPhase]:
    """The phases of one stop in order."""
    plan, guard = config.experiment, config.guard
    drive, brake = min(plan.drive_duty, guard.drive_limit), guard.brake_limit
    controller = config.controller
    yield PlannedPhase(Phase.IDLE.name, plan.idle_s, fixed=True, does="outputs off, both wheels must stand still")
    yield PlannedPhase(Phase.ARMED.name, plan.idle_s, fixed=True, does="the same")
    spin_up = f"drive {drive:g} until the road wheel turns at {plan.start_speed_rad_s:g} rad/s"
    yield PlannedPhase(Phase.SPIN_UP.name, plan.spin_up_timeout_s, fixed=False, does=spin_up)
    law = f"{controller.name} on {config.estimator.name}, reference slip {controller.reference_text}"
    braking = f"{law}, brake at most {brake:g}, until the road wheel is below {plan.stop_speed_rad_s:g} rad/s"
    yield PlannedPhase(Phase.BRAKING.name, plan.braking_timeout_s, fixed=False, does=braking)
    yield PlannedPhase(Phase.STOPPED.name, plan.hold_s, fixed=True, does="the brake is held, then both outputs are off")


def _judge(board: Board, config: RigConfig, found: Preflight) -> None:
    """Add what keeps a run from driving the board."""
    try:
        board.require_writable()
    except BoardError as error:
        found.refused.append(error)
        return  # its message also reports outputs that were left on
    wiring = config.board
    found.first_write = board.first_write()
    running = [name for one in found.first_write if one.remark is Remark.RUNS for name in one.names]
    if running:
        found.cautions.append(
            f"PWM channels are on that the profile does not use, and a run leaves them on: {', '.join(running)}"
        )
    names = [f"pwm{channel}_width" for channel in (wiring.drive_pwm, wiring.brake_pwm)]
    if any(read_patiently(board, names).values()):
        found.cautions.append(
            f"the board's PWM outputs are not zero, an earlier program has left them so. {STILL_ON}; a run would "
            "switch them off first"
        )


def _watch(rig: RigAccess, board: Board, config: RigConfig, found: Preflight) -> None:
    """Watch both counters for as long as the phases IDLE and ARMED last together."""
    wiring = config.board
    names = wheel, road = f"encoder{wiring.wheel_encoder}_count", f"encoder{wiring.road_encoder}_count"
    first = read_patiently(board, names)
    period_ns = max(config.period_ns, _BEAT_NS)
    beats = rig.beats(period_ns)
    moved, times_us = [0, 0], list[float]()
    for _ in range(max(1, round(2.0 * config.experiment.idle_s * 1e9 / period_ns))):
        next(beats)
        start_ns = rig.now_ns()
        counts = read_patiently(board, names)
        times_us.append((rig.now_ns() - start_ns) * 1e-3)
        for number, name in enumerate((wheel, road)):
            moved[number] = max(moved[number], signed32(counts[name] - first[name]), key=abs)
    found.moved = moved[0], moved[1]
    if max(map(abs, moved)) > REST_COUNTS:
        shown = f"upper wheel {moved[0]:+d} counts, lower wheel {moved[1]:+d}"
        found.refused.append(BoardError(f"{EXPLANATIONS[Reason.WHEELS_MOVING]} ({shown})"))
    spread = quantiles(times_us)
    if spread.max:
        found.read_us = spread
        _judge_rate(spread, config, found)


def _judge_rate(spread: Quantiles, config: RigConfig, found: Preflight) -> None:
    """Refuse a period that is shorter than readings; warn if an exchange, which takes writing, may not fit."""
    period_us = config.period_ns * 1e-3
    if spread.p50 > period_us:
        found.refused.append(
            BoardError(
                f"half of the readings take longer than {spread.p50:.0f} us, and the period is {period_us:g} us: set "
                "loop.rate_hz to less; inteco-abs doctor --board measures it"
            )
        )
    elif MORE_THAN_A_READ * spread.max > period_us:
        found.cautions.append(
            f"the slowest reading took {spread.max:.0f} us, a whole exchange takes about {MORE_THAN_A_READ:g} times "
            f"as long: a run, which measures a thousand, may find that the period of {period_us:g} us is too short"
        )
