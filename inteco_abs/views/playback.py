"""Where the playback of a session stands: position, speed, pause; and the keys that change them."""

from __future__ import annotations

import re
from typing import Final

SLOWEST: Final = 1 / 64
FASTEST: Final = 1024.0
"""Bounds of the speed, times real time."""
KEYS: Final = "space pauses, arrows seek, comma and dot step, [ ] speed, q ends"
_LEAP_S: Final = 1.0
_STEP_S: Final = 0.01
_KEY: Final = re.compile(rb"\x1b\[[0-9;]*[A-Za-z~]|\x1bO[A-Za-z]|.", re.DOTALL)
_LEFT, _RIGHT, _HOME, _END = (frozenset({b"\x1b[" + key, b"\x1bO" + key}) for key in (b"D", b"C", b"H", b"F"))


class Playback:
    """Position in a session of `length_s` seconds, from `from_s` at `speed` times real time."""

    def __init__(self, length_s: float, *, from_s: float = 0.0, speed: float = 1.0) -> None:
        self.length_s = length_s
        self.position_s = from_s
        """Seconds since the first tick."""
        self.speed = speed
        self.paused = False
        self.left = False
        """Whether the user has ended it."""
        self.jumped = False
        """Whether the position has changed otherwise than by playing, since this was reset."""

    @property
    def at_end(self) -> bool:
        """Whether all was played."""
        return self.position_s >= self.length_s

    def advance(self, elapsed_s: float, most_s: float) -> None:
        """Go on as `elapsed_s` seconds of real time have passed, but by at most `most_s` seconds of the session."""
        if not self.paused:
            self.position_s = min(self.position_s + min(elapsed_s * self.speed, most_s), self.length_s)

    def seek(self, position_s: float) -> None:
        """Go to a position, or to the nearest one that there is."""
        before_s, self.position_s = self.position_s, min(max(position_s, 0.0), self.length_s)
        self.jumped |= self.position_s != before_s

    def control(self, *, pause: bool, speed: float, seek_s: float | None) -> None:
        """Do what a viewer's controls say; a speed that is none is ignored."""
        self.paused = pause
        if speed > 0.0:
            self.speed = min(max(speed, SLOWEST), FASTEST)
        if seek_s is not None:
            self.seek(seek_s)

    def press(self, keys: bytes) -> None:
        """Do what the keys say; others are ignored."""
        for key in _KEY.findall(keys):
            if key == b" ":
                self._pause()
            elif key in _LEFT | _RIGHT:
                self.seek(self.position_s + (_LEAP_S if key in _RIGHT else -_LEAP_S))
            elif key == b".":
                self.paused = True
                self.seek(self.position_s + _STEP_S)
            elif key == b",":
                self.paused = True
                self.seek(self.position_s - _STEP_S)
            elif key in _HOME or key == b"0":
                self.seek(0.0)
            elif key in _END:
                self.seek(self.length_s)
            elif key in b"[]":
                self.speed = min(max(self.speed * (2.0 if key == b"]" else 0.5), SLOWEST), FASTEST)
            elif key in b"qQ":
                self.left = True

    def _pause(self) -> None:
        """Pause or go on; at the end, from the beginning."""
        if self.at_end:
            self.seek(0.0)
            self.paused = False
        else:
            self.paused = not self.paused

    def __str__(self) -> str:
        """Speed and what is unusual, for people."""
        ended = ", ended" if self.at_end else ", paused" if self.paused else ""
        return f"of {self.length_s:.1f} s, {self.speed:g}x{ended}"
