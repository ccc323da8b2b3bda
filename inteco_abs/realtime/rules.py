"""Who does what once a process of a run has died or stands still, decided from one look at the others.

Guardian and supervisor act on these, and `tests/faults/protocol.py` searches every state that they lead to.
"""

from __future__ import annotations

from enum import Flag, auto
from typing import Final

POLL_NS: Final = 5_000_000
"""Of everybody who has to be quick."""
POLL_S: Final = POLL_NS * 1e-9
GUARDIAN_WINDOW_NS: Final = 150_000_000
"""After which the supervisor takes a silent guardian for lost."""
LOOPS_WINDOW_NS: Final = 200_000_000
"""After which the loop does, in case that the supervisor is gone, too."""
SUPERVISOR_WINDOW_NS: Final = 200_000_000
"""After which the guardian takes a silent supervisor for lost."""


class Action(Flag):
    """What has to be done now."""

    NONE = 0
    STOP = auto()
    """Tell the loop to end the run in SAFE."""
    KILL_LOOP = auto()
    KILL_GUARDIAN = auto()
    RESCUE = auto()
    """Take the board and write SAFE: only ever after the end of everybody else who might write to it."""


def guardian_does(*, held: bool, loop_ended: bool, loop_silent: bool) -> Action:
    """Of a guardian that watches. `held`: the loop has the board, and nobody has taken it since."""
    if loop_ended:
        return Action.RESCUE if held else Action.NONE
    return Action.KILL_LOOP if loop_silent else Action.NONE


def supervisor_does(
    *, held: bool, loop_ended: bool, loop_silent: bool, guardian_ended: bool, guardian_silent: bool
) -> Action:
    """Of the supervisor, which takes the guardian's place only once that is lost."""
    if not (guardian_ended or guardian_silent) or (loop_ended and not held):
        return Action.NONE
    if not held or not (loop_ended or loop_silent):
        return Action.STOP
    if loop_ended and guardian_ended:
        return Action.RESCUE
    return Action.STOP | Action.KILL_LOOP | Action.KILL_GUARDIAN  # a guardian that wakes up must not be a second host


class Silence:
    """How long a count has not moved, by the time in which this process was awake to see it.

    A computer that stalls makes everybody silent; what passed while this process did not run counts as two polls
    at most, so that a healthy process gets its window again.
    """

    def __init__(self, window_ns: int, poll_ns: int = POLL_NS) -> None:
        self._window_ns = window_ns
        self._most_ns = 2 * poll_ns
        self._count = 0
        self._silent_ns = 0

    def lasts(self, count: int, passed_ns: int) -> bool:
        """Whether `count` has not changed for longer than the window; `passed_ns` since the call before."""
        if count != self._count:
            self._count, self._silent_ns = count, 0
        else:
            self._silent_ns += min(passed_ns, self._most_ns)
        return self._silent_ns > self._window_ns

    def forget(self) -> None:
        """Begin anew."""
        self._silent_ns = 0
