"""Manual control: a process that holds the board, and applies what a screen requests while a key is held.

The screen is another process. A request is valid for half a second after the key was last seen, on this process's
clock, so the outputs go off when the screen hangs or dies.
"""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from firmware_protocol import signed32
from inteco_abs.boards import Board, family_of, open_board, simulated
from inteco_abs.config import RigConfig, bounded_in_time
from inteco_abs.control import Guard, MovingAverageSpeed
from inteco_abs.errors import BoardError, LinkError
from inteco_abs.format import TICK, pack_tick
from inteco_abs.realtime.clock import PacedClock
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.loop import StopSource
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory, alive
from inteco_abs.realtime.ownership import holding, run_role
from inteco_abs.realtime.processes.loop import SharedStop
from inteco_abs.realtime.round_trips import require_rate
from inteco_abs.realtime.tuning import apply, loop_tuning
from inteco_abs.realtime.watchdog import prove_watchdog
from inteco_abs.signals import UNTIMED, BoardFlags, Command, Estimate, Phase, Reason, Sample, Tick

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

HELD_NS: Final = 500_000_000
"""Time for which a request is valid after the key was last seen."""
RATE_HZ: Final = 100.0
"""Enough for slow wheels: the guard's speed window of five periods still detects a wheel that stands or races."""
ONLY_WATCHED: Final = "this panel only watches"
_SCALE: Final = 1_000_000
"""Duties are shared as whole millionths."""
_WINDOW_S: Final = 0.1
_LOOK_S: Final = 0.002
"""Polling interval for new ticks: a fifth of a period."""
_MOST_FAILURES: Final = 100
"""Failed readings in a row, one second; nothing is energised meanwhile."""
_NO_ESTIMATE: Final = Estimate(0.0, 0.0, 0.0, valid=False)


class HeldRequest:
    """Duties that a screen requests, in shared memory."""

    def __init__(self, memory: RunMemory) -> None:
        self._words = memory.words

    def keep_on(self, request: Command, seen_ns: int) -> None:
        """Request duties; the key was seen at `seen_ns` on the monotonic clock."""
        self._words[Field.REQUESTED_DRIVE] = int(request.drive * _SCALE)
        self._words[Field.REQUESTED_BRAKE] = int(request.brake * _SCALE)
        self._words[Field.KEY_SEEN_NS] = seen_ns  # last: it makes the duties valid

    def take_away(self) -> None:
        """Request both outputs off at once."""
        self._words[Field.KEY_SEEN_NS] = -HELD_NS

    def at(self, now_ns: int) -> Command:
        """Return the request now; SAFE unless the key was seen within the last half second."""
        words = self._words
        if abs(now_ns - words[Field.KEY_SEEN_NS]) >= HELD_NS:
            return Command.SAFE
        return Command(words[Field.REQUESTED_DRIVE] / _SCALE, words[Field.REQUESTED_BRAKE] / _SCALE)


class ManualLoop(ABC):
    """Exchanges with a board, one a beat, each recorded in the ring; reads the whole board on request."""

    def __init__(self, board: Board, config: RigConfig, memory: RunMemory, stop: StopSource) -> None:
        self._board = board
        self._memory = memory
        self._stop = stop
        self._ring = memory.tick_ring(pack_tick)
        length = max(1, round(_WINDOW_S * config.loop.rate_hz))
        self._wheel = MovingAverageSpeed(config.encoders.counts_per_turn, length)
        self._road = MovingAverageSpeed(config.encoders.counts_per_turn, length)

    @abstractmethod
    def beat(self) -> bool:
        """Exchange or read once; return False once the loop has to end."""

    def _show(self, sample: Sample, request: Command, command: Command, reason: Reason, stop: Reason) -> None:
        wheel = self._wheel.update(sample.time_ns, sample.wheel_count)
        road = self._road.update(sample.time_ns, sample.road_count)
        inputs = (sample.time_ns, sample.tick, sample.dt_s, sample.wheel_count, sample.road_count, sample.board_flags)
        estimate, demand = (wheel, road, 0.0, False), (Phase.UNKNOWN, 0.0, 0.0, 0.0)
        duties = (request.drive, request.brake, command.drive, command.brake)
        internals = (0.0, 0.0, 0.0, 0.0)
        self._ring.append(Tick(*inputs, stop, *estimate, *demand, *duties, reason, *internals, *UNTIMED))

    def look(self) -> None:
        """Post a reading of the whole board if the screen has requested one."""
        words = self._memory.words
        asked = words[Field.LOOKS_ASKED]
        if asked != words[Field.LOOKS]:
            self._memory.post(Mailbox.RESULT, read_all(self._board))
            words[Field.LOOKS] = asked


class DriveLoop(ManualLoop):
    """Drives an entered board. Each command passes the guard, and is written at the next beat."""

    def __init__(self, board: Board, config: RigConfig, memory: RunMemory, stop: StopSource) -> None:
        super().__init__(board, config, memory, stop)
        self._request = HeldRequest(memory)
        self._guard = Guard(config)
        self._command = Command.SAFE
        self._made_safe = False  # after a trip
        self._always = family_of(config.board.kind).fast_readings

    def beat(self) -> bool:
        """Exchange once. When the guard trips, write SAFE and read it back; raises UnsafeError if that fails."""
        if self._always or self._command == Command.SAFE:
            self.look()
        self._board.armed = self._guard.reason is Reason.NONE
        sample = self._board.exchange(self._command)
        stop = self._stop.wanted(sample.time_ns)
        if stop is not Reason.NONE:
            self._guard.trip(stop)
        request = self._request.at(sample.time_ns)
        self._command = self._guard.admit(request, sample, _NO_ESTIMATE)
        self._show(sample, request, self._command, self._guard.reason, stop)
        if self._guard.reason is not Reason.NONE and not self._made_safe:
            self._made_safe = True
            self._board.make_safe()
        return stop is Reason.NONE


class WatchLoop(ManualLoop):
    """Reads the encoders of a board that must not be driven."""

    def __init__(self, board: Board, config: RigConfig, memory: RunMemory, stop: StopSource) -> None:
        super().__init__(board, config, memory, stop)
        wiring = config.board
        self._fields = {
            f"encoder{wiring.wheel_encoder}_count": wiring.wheel_sign,
            f"encoder{wiring.road_encoder}_count": wiring.road_sign,
        }
        self._raw: tuple[int, ...] = ()
        self._counts = (0, 0)
        self._tick = 0
        self._failures = 0

    def beat(self) -> bool:
        """Read once. Raises LinkError after a hundred failures in a row."""
        self.look()
        flags = BoardFlags.NONE
        try:
            values = self._board.survey(self._fields).values
        except LinkError:
            flags = BoardFlags.STALE
            self._failures += 1
            if self._failures >= _MOST_FAILURES:
                raise
        else:
            self._failures = 0
            self._move(tuple(int(values[name]) for name in self._fields))
        now_ns = time.monotonic_ns()
        stop = self._stop.wanted(now_ns)
        sample = Sample(self._tick, now_ns, 1.0 / RATE_HZ, *self._counts, flags)
        self._tick += 1
        self._show(sample, Command.SAFE, Command.SAFE, stop, stop)
        return stop is Reason.NONE

    def _move(self, raw: tuple[int, ...]) -> None:
        steps = (signed32(new - old) for new, old in zip(raw, self._raw or raw, strict=True))
        signed = zip(self._counts, self._fields.values(), steps, strict=True)
        wheel, road = (count + sign * step for count, sign, step in signed)
        self._raw, self._counts = raw, (wheel, road)


class ManualClient:
    """The screen's end of manual control: ticks and readings of the board, and requests."""

    def __init__(self, memory: RunMemory) -> None:
        self.request = HeldRequest(memory)
        self._memory = memory
        self._ticks = memory.tick_reader()

    @property
    def introduction(self) -> dict[str, str]:
        """`identity` of the board, and `read_only_because`: empty if its outputs may be used."""
        header: dict[str, str] = self._memory.note(Mailbox.HEADER)
        return header

    def now_ns(self) -> int:
        """Return the time on the clock of the process that holds the board, ns."""
        return time.monotonic_ns()

    def ticks(self) -> npt.NDArray[np.void]:
        """Return all ticks since the last call, oldest first."""
        return TICK.array(self._ticks.take())

    def next_ticks(self) -> npt.NDArray[np.void]:
        """Wait for at least one tick since the last call; return none only if the board is not held any more."""
        while not len(ticks := self.ticks()) and not self.over:
            time.sleep(_LOOK_S)
        return ticks

    def ask(self) -> None:
        """Request a reading of the whole board; a USB board waits until the outputs are off."""
        self._memory.words[Field.LOOKS_ASKED] += 1

    @property
    def answered(self) -> bool:
        """Whether the newest reading is the one that was requested last."""
        words = self._memory.words
        return words[Field.LOOKS] == words[Field.LOOKS_ASKED]

    @property
    def look(self) -> dict[str, Any] | None:
        """The newest reading of the whole board; None while it is being replaced."""
        reading: dict[str, Any] | None = self._memory.note(Mailbox.RESULT)
        return reading

    @property
    def over(self) -> bool:
        """Whether the board is not held any more."""
        return not alive(self._memory.words[Field.LOOP_PID])

    @property
    def reason(self) -> Reason:
        """Why the user's side or the guardian ended it; NONE if neither did."""
        words = self._memory.words
        return Reason(words[Field.STOP] or words[Field.GUARDIAN_STOP])


def slowed(config: RigConfig) -> RigConfig:
    """Return the configuration at the rate of manual control, or at its own rate if that is lower."""
    rate_hz = min(RATE_HZ, config.loop.rate_hz)
    window_s = max(config.estimator.window_s, 1.0 / rate_hz)  # no estimator runs, but both must fit
    loop = replace(config.loop, rate_hz=rate_hz)
    guard = config.guard if config.board.simulated else bounded_in_time(config.guard, rate_hz)
    return replace(config, guard=guard, loop=loop, estimator=replace(config.estimator, window_s=window_s))


def read_all(board: Board) -> dict[str, Any]:
    """Return a reading of the whole board for JSON, or the `problem` with it."""
    try:
        survey = board.survey()
        readings = board.readings()
    except BoardError as error:
        return {"problem": str(error)}
    shown = [(one.name, one.value, one.unit, one.status.value) for one in readings]
    return {"problem": "", "values": dict(survey.values), "raw": survey.raw.hex(), "readings": shown}


def main(path: str) -> int:
    """Hold the board of the job in the memory at `path` until it has to end."""
    return run_role(path, _hold)


def _hold(memory: RunMemory, job: Job) -> None:
    config = job.config
    clock = PacedClock(config.period_ns)
    with holding(memory), open_board(job.address, config, clock.now_ns) as board:
        read_only = board.identity is None or board.identity.read_only_because
        memory.post(Mailbox.HEADER, {"identity": str(board.identity), "read_only_because": read_only})
        if not read_only:
            memory.post(Mailbox.SAFE_IMAGE, board.safe_image)
            apply(loop_tuning())
            if not simulated(job.board):
                require_rate(board, config.period_ns)
            prove_watchdog(board, config.period_ns, time.sleep)
        memory.post(Mailbox.RESULT, read_all(board))
        loop = (WatchLoop if read_only else DriveLoop)(board, config, memory, SharedStop(memory))
        memory.words[Field.READY] = os.getpid()
        for _ in clock:
            if not loop.beat():
                break
    if not alive(memory.words[Field.SUPERVISOR_PID]):
        memory.remove()  # no other process will, and nothing in it is to be kept
