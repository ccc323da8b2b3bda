"""A whole stop in virtual time on a faulty mock board, judged by the board's own record."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache

from inteco_abs.boards import InProcessLink, board_behind
from inteco_abs.config import RigConfig, load_config
from inteco_abs.control import build_pipeline
from inteco_abs.errors import AbsError, UnsafeError
from inteco_abs.mock_board import (
    Fault,
    FaultyDevice,
    FaultyFrontEnd,
    Schedule,
    Truth,
    front_end_of,
    parse_faults,
    require_possible,
)
from inteco_abs.realtime.clock import VirtualClock
from inteco_abs.realtime.loop import Loop, StopFlag
from inteco_abs.signals import Phase, Reason, Tick

AS_ON_A_REAL_BOARD = ("guard.missed_in_a_row=4", "guard.bucket_limit=30")
"""The mock's own profile tolerates pauses of shared computers."""
SHORTEST = (
    "loop.rate_hz=250", "experiment.start_speed_rad_s=10", "experiment.idle_s=0.01", "experiment.hold_s=0.01",
    "controller.name=relay", "experiment.spin_up_timeout_s=1", "experiment.braking_timeout_s=1",
)  # fmt: skip
"""A stop of a hundred ticks, with all phases."""


@cache
def configured(*settings: str, profile: str = "sim_usb2") -> RigConfig:
    return load_config(settings=[*AS_ON_A_REAL_BOARD, *settings], profile=profile)


@dataclass
class Ride:
    """What became of a stop."""

    period_ns: int
    ticks: list[Tick] = field(default_factory=list)
    truths: list[Truth] = field(default_factory=list)
    reason: Reason = Reason.NONE
    refused: AbsError | None = None
    """What kept the board from being opened, or SAFE from being confirmed."""
    duties: tuple[float, float] = (0.0, 0.0)
    """At the device's terminals, after everything."""
    times: dict[str, int] = field(default_factory=dict)
    first_ns: dict[str, int] = field(default_factory=dict)
    exchanges: int = 0
    """With the board, from its opening until it was let go of."""

    @property
    def unsafe(self) -> bool:
        """Whether the user was warned that motor power may still be on."""
        return isinstance(self.refused, UnsafeError)

    @property
    def over_ns(self) -> int:
        """Time from which both outputs stay off, by the device's own record."""
        last = 0
        for truth, following in zip(self.truths, self.truths[1:], strict=False):
            if truth.drive or truth.brake:
                last = following.time_ns
        return last

    @property
    def reaction_ticks(self) -> float:
        """Periods from the first act of a fault until both outputs stayed off; 0 if they were off before."""
        return max(0, self.over_ns - min(self.first_ns.values())) / self.period_ns

    @property
    def phases(self) -> set[Phase]:
        return {tick.phase for tick in self.ticks}


class Rows:
    """A ring that keeps ticks as they are."""

    def __init__(self) -> None:
        self.ticks: list[Tick] = []

    def append(self, tick: Tick) -> None:
        self.ticks.append(tick)


def ride(
    config: RigConfig, faults: Sequence[str | Fault] = (), seed: int = 0, most_ticks: int = 40_000, stop_at: int = -1
) -> Ride:
    """One stop with `faults`; `stop_at`: tick at which the operator asks for the end."""
    clock = VirtualClock(config.period_ns)
    parsed = [fault if isinstance(fault, Fault) else parse_faults([fault])[0] for fault in faults]
    require_possible(parsed, config.board.kind)
    schedule = Schedule(parsed, clock.now_ns, seed)
    result = Ride(config.period_ns)
    device = FaultyDevice(config, clock.now_ns, seed, result.truths.append, schedule=schedule)
    front_end = FaultyFrontEnd(
        front_end_of,
        device,
        lambda seconds: clock.pass_ns(round(seconds * 1e9)),
        lambda seconds: clock.oversleep_ns(round(seconds * 1e9)),
    )
    board = board_behind(InProcessLink(front_end), config, clock.now_ns)
    pipeline, rows, stop = build_pipeline(config), Rows(), StopFlag()
    try:
        with board:
            loop = Loop(board, pipeline, clock, rows, stop, paced_by_board=config.loop.pace == "board")
            if stop_at >= 0 and not loop.run(stop_at):
                stop.request()
            loop.run(most_ticks)
            assert pipeline.finished, f"still {pipeline.phase.name} after {most_ticks} ticks"
    except AbsError as error:
        result.refused = error
    if device.due_ns >= 0:  # a board that lets go by itself gets its time
        clock.pass_ns(config.board.watchdog_ms * 1_000_000 + config.period_ns)
    device.catch_up()
    result.ticks, result.reason, result.duties = rows.ticks, pipeline.reason, device.duties
    result.truths.append(device.truth())
    result.times, result.first_ns = schedule.times, schedule.first_ns
    result.exchanges = schedule.exchange
    return result
