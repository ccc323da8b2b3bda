"""Opens the board, holds it safe, and waits to be killed, to prove that the guardian takes over.

Protections fail by not being armed, not by not firing (docs/facts/hazards.md#findings, 9).
"""

from __future__ import annotations

import os
import time
from typing import Final

from inteco_abs.boards import open_board
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory
from inteco_abs.realtime.ownership import holding, run_role, stopped
from inteco_abs.signals import Command

_LONGEST_S: Final = 20.0
_PERIOD_S: Final = 0.001


def main(path: str) -> int:
    """Hold the board of the job in the memory at `path` until killed, for 20 s at most."""
    return run_role(path, _hold)


def _hold(memory: RunMemory, job: Job) -> None:
    with holding(memory), open_board(job.address, job.config, time.monotonic_ns) as board:
        board.require_writable()
        memory.post(Mailbox.SAFE_IMAGE, board.safe_image)
        memory.words[Field.READY] = os.getpid()
        end = time.monotonic() + _LONGEST_S
        while time.monotonic() < end and not stopped(memory):
            board.exchange(Command.SAFE)
            time.sleep(_PERIOD_S)
