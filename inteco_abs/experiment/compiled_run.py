"""Ticks of a virtual run in one compiled loop: frames, mock board, rig and decisions, with the bits of the loop."""

from __future__ import annotations

from dataclasses import astuple, replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from inteco_abs.analysis.compiled_replay import function_of_pipeline, pipeline_records, resume_pipeline
from inteco_abs.boards import Board
from inteco_abs.boards.frame_board import FrameBoard
from inteco_abs.boards.frame_exchange import put_command, take_answer
from inteco_abs.bound_function import is_own
from inteco_abs.control import Function, Pipeline
from inteco_abs.format import TICK, TRUTH
from inteco_abs.kept_loop import KeptLoop
from inteco_abs.mock_board import Device, FrontEnd, give_counts, take_command
from inteco_abs.records import record, restore
from inteco_abs.rig.adhesion_curve import road_adhesion
from inteco_abs.rig.model import true_slip
from inteco_abs.rig.plant import move_on, read_encoders
from inteco_abs.rig_rows import STATE, rig_rows
from inteco_abs.signals import Phase

_UNDER_WAY: Final = 4096
"""Room for commands that went to the brake and do not act yet: 2 s at 2 kHz."""
_DONE, _FAULT = Phase.DONE, Phase.FAULT
_unsigned: Final[Any] = np.uint64


class RigRecords(NamedTuple):
    """Constants and state of the rig, and its commands under way."""

    k: Any
    s: Any
    due_s: Any
    torques: Any


class WireRecords(NamedTuple):
    """Constants and state of both ends of the wire."""

    host_k: Any
    host: Any
    board_k: Any
    board: Any


class CompiledRun:
    """Moves a run on whose board, front end and pipeline have exchanged a good frame; `resume` gives them their state.

    Raises ValueError where one of them is not made of the package's own functions, or more than widths change on the
    wire.
    """

    def __init__(
        self, board: Board, front_end: FrontEnd, pipeline: Pipeline, period_ns: int, may_compile: bool
    ) -> None:
        device = front_end.device
        made: Any = getattr(front_end, "answer_parts", None)
        replaced = "step" in vars(pipeline) or type(device) is not Device or made is None  # by a caller
        path, terminals = pipeline_records(pipeline), device.terminals()
        if path is None or not is_own(function_of_pipeline(pipeline)):  # a replay in Python must have its bits
            raise ValueError("estimator or controller are stepped in Python")
        if replaced or not isinstance(board, FrameBoard) or terminals is None:
            raise ValueError("this run is stepped in Python")
        host, answer = board.exchange_parts(), made()
        if host is None or answer is None:
            raise ValueError("more than widths change on the wire")
        self._board, self._pipeline = board, pipeline
        self._front_end: Any = front_end  # it has `answer_parts` and `resume`
        self._exchange, self._answer = host[1], answer[1]
        self._period_ns = period_ns
        plant = device.plant
        k = rig_rows([replace(plant.constants, noise_seed=terminals.noise_seed)])[0]
        state = np.array([astuple(plant)[::-1]], STATE).view(np.recarray)[0]
        rig = RigRecords(k, state, *(np.tile(each, _UNDER_WAY // len(each)) for each in plant.commands))
        self._state: tuple[Any, ...] = (*path, rig, WireRecords(*map(record, (*host, *answer))))
        self._loop = KeptLoop(partial(run_ticks, decide=function_of_pipeline(pipeline)), may_make=may_compile)

    def run(self, most: int) -> tuple[bytes, bytes]:
        """Ticks and true states of up to `most` ticks, packed; none where Python has to run them."""
        ticks, truths = TICK.blank(most), TRUTH.blank(most)
        state = tuple(type(each)(*map(_copied, each)) for each in self._state)
        ended = np.zeros(1, np.int64)
        if not self._loop.run(*state, self._period_ns, TICK.array(ticks), TRUTH.array(truths), ended):
            return b"", b""
        self._state = state
        return bytes(ticks[: ended[0] * TICK.size]), bytes(truths[: ended[0] * TRUTH.size])

    def resume(self) -> None:
        """Give board, front end, rig and pipeline the state in which the ticks so far have left them."""
        *path, rig, wire = self._state
        plant = self._front_end.device.plant
        for numbers, part in ((rig.s, plant), (wire.host, self._exchange), (wire.board, self._answer)):
            restore(numbers, part)
        plant.commands = rig.due_s.tolist(), rig.torques.tolist()
        resume_pipeline(self._pipeline, (path[0], path[1]))
        self._front_end.resume(self._answer)
        self._board.resume(self._exchange, bytes(self._answer.answer))


def _copied(part: Any) -> Any:
    return part if isinstance(part, float) else part.copy()


def run_ticks(
    parts: Any,
    sequence: Any,
    rig: RigRecords,
    wire: WireRecords,
    period_ns: int,
    rows: Any,
    truths: Any,
    ended: Any,
    decide: Function,
) -> bool:
    """Fill a row of ticks and one of truths for each tick, up to the run's end, and their number into `ended`.

    False where Python has to run them: as by `decide_row`, or for too many commands under way.
    """
    (host_k, host, board_k, board), (k, s, due_s, torques) = wire, rig
    machine, decided = sequence.machine, sequence.decided
    for i in range(rows.size):
        row, truth = rows[i], truths[i]
        put_command(host_k, host, decided.drive, decided.brake)
        move_on(k, s, due_s, torques, board.drive, board.brake, period_ns / 1e9)
        if s.sent - s.arrived == due_s.size:
            return False
        board.time_ns += period_ns
        take_command(board_k, board, host.frame)
        truth.time_ns = board.time_ns
        slip = true_slip(k, s)
        truth.wheel_speed_rad_s, truth.road_speed_rad_s, truth.slip = s.wheel_speed, s.road_speed, slip
        truth.brake_torque_nm, truth.drive, truth.brake = s.brake_torque, board.drive, board.brake
        truth.adhesion = s.grip * road_adhesion(k, s, slip)
        board.readings += 1
        wheel, road = read_encoders(k, s, _unsigned(board.readings))
        give_counts(board_k, board, wheel, road)
        if not take_answer(host_k, host, board.answer):
            return False
        row.time_ns, row.tick, row.dt_s = board.time_ns, host.tick, (board.time_ns - host.newest_ns) / 1e9
        row.wheel_count, row.road_count = host.wheel_count, host.road_count
        host.tick += 1
        host.newest_ns = board.time_ns
        if not decide(parts, sequence, row):
            return False
        ended[0] += 1
        if machine.phase in (_DONE, _FAULT):
            break
    return True
