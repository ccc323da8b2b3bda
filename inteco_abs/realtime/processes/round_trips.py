"""Measures how long exchanges with the board take, in a process with the loop's tuning."""

from __future__ import annotations

import time
from typing import Final

from inteco_abs.boards import open_board
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Mailbox, RunMemory
from inteco_abs.realtime.ownership import run_role
from inteco_abs.realtime.round_trips import choose_engine, round_trips
from inteco_abs.realtime.tuning import apply, loop_tuning

COUNT: Final = 4000


def main(path: str) -> int:
    """Exchange SAFE with the board of the job in the memory at `path`; post the times, us, and the engines' facts."""
    return run_role(path, _measure)


def _measure(memory: RunMemory, job: Job) -> None:
    with open_board(job.address, job.config, time.monotonic_ns) as board:
        board.require_writable()
        apply(loop_tuning())
        engines = choose_engine(board)
        times_us = round_trips(board, COUNT)
    memory.post(Mailbox.RESULT, {"times_us": [round(each, 1) for each in times_us], "engines": engines})
