"""The rules by which guardian and supervisor react when a process of a run dies or hangs.

`tests/faults/protocol.py` searches every state that they lead to.
"""

from __future__ import annotations

from enum import Flag, auto
from typing import Final

POLL_NS: Final = 5_000_000
"""Polling interval of guardian and supervisor."""
POLL_S: Final = POLL_NS * 1e-9
GUARDIAN_WINDOW_NS: Final = 150_000_000
"""Silence after which the supervisor considers the guardian lost."""
LOOPS_WINDOW_NS: Final = 200_000_000
"""Silence after which the loop considers it lost, in case the supervisor is gone too."""
SUPERVISOR_WINDOW_NS: Final = 200_000_000
"""Silence after which the guardian considers the supervisor lost."""


class Action(Flag):
    """What to do now."""

    NONE = 0
    STOP = auto()
    """Have the loop end the run in SAFE."""
    KILL_LOOP = auto()
    KILL_GUARDIAN = auto()
    RESCUE = auto()
    """Take the board and write SAFE; only after every other process that might write to it has ended."""


def guardian_does(*, held: bool, loop_ended: bool, loop_silent: bool) -> Action:
    """Return the guardian's action. `held`: the loop has the board, and it was not taken over since."""
    if loop_ended:
        return Action.RESCUE if held else Action.NONE
    return Action.KILL_LOOP if loop_silent else Action.NONE


def supervisor_does(
    *, held: bool, loop_ended: bool, loop_silent: bool, guardian_ended: bool, guardian_silent: bool
) -> Action:
    """Return the supervisor's action; it replaces the guardian only once that is lost."""
    if not (guardian_ended or guardian_silent) or (loop_ended and not held):
        return Action.NONE
    if not held or not (loop_ended or loop_silent):
        return Action.STOP
    if loop_ended and guardian_ended:
        return Action.RESCUE
    return Action.STOP | Action.KILL_LOOP | Action.KILL_GUARDIAN  # else a guardian that wakes up would be a second host


class Silence:
    """How long a count has stood still, as far as this process was awake to see it.

    A stalled computer makes every process silent: time in which this process did not run counts as two polls at most,
    so that a healthy process gets its whole window.
    """

    def __init__(self, window_ns: int, poll_ns: int = POLL_NS) -> None:
        self._window_ns = window_ns
        self._most_ns = 2 * poll_ns
        self._count = 0
        self._silent_ns = 0

    def lasts(self, count: int, passed_ns: int) -> bool:
        """Return whether `count` has stood still for longer than the window; `passed_ns` is since the last call."""
        if count != self._count:
            self._count, self._silent_ns = count, 0
        else:
            self._silent_ns += min(passed_ns, self._most_ns)
        return self._silent_ns > self._window_ns

    def forget(self) -> None:
        """Start the window again."""
        self._silent_ns = 0
