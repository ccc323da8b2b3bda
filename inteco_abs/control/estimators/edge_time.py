"""Speed from the times of an encoder's edges."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Final

from inteco_abs.config import RigConfig
from inteco_abs.control.estimators.registry import EstimatorSpec, on_both_wheels, parameter
from inteco_abs.control.functions import Function

_ROOM: Final = 8
"""Edges for which there is room beyond those of a window: its two ends, and samples that come early."""


@dataclass(frozen=True, slots=True)
class EdgeConstants:
    """Constants of a window over the edges of an encoder."""

    line_ns: float
    """Angle between two lines in rad, times 1e9: speeds come from times in ns."""
    window_ns: float
    length: int
    """Edges that the rings hold."""


@dataclass(slots=True)
class EdgeState:
    """The newest edges, at most one a sample: rings of their instants and lines."""

    edges_ns: list[int]
    lines: list[int]
    first: int = 0
    """Place of the oldest edge."""
    edges: int = 0
    count: int = 0
    """Count of the previous sample."""
    started: bool = False


def edge_time(k: EdgeConstants, s: EdgeState, time_ns: int, count: int, edge_ns: int) -> float:
    """Speed in rad/s at `time_ns`; 0 until two edges were seen. A new count has its newest edge at `edge_ns`."""
    if s.started and count != s.count:
        _see(k, s, edge_ns, count if count > s.count else count + 1)
    s.started, s.count = True, count
    if s.edges < 2:
        return 0.0
    first, last = s.first, (s.first + s.edges - 1) % k.length
    last_ns = s.edges_ns[last]
    speed = (s.lines[last] - s.lines[first]) * k.line_ns / (last_ns - s.edges_ns[first])
    quiet_ns = time_ns - last_ns
    most = k.line_ns / quiet_ns if quiet_ns > 0 else math.inf
    return max(-most, min(most, speed))


def _see(k: EdgeConstants, s: EdgeState, edge_ns: int, line: int) -> None:
    if s.edges > 0 and edge_ns <= s.edges_ns[(s.first + s.edges - 1) % k.length]:
        s.edges = 0  # the clock stood still or went back
    if s.edges == k.length:
        _forget(k, s)
    place = (s.first + s.edges) % k.length
    s.edges_ns[place], s.lines[place] = edge_ns, line
    s.edges += 1
    while s.edges > 2 and edge_ns - s.edges_ns[(s.first + 1) % k.length] >= k.window_ns:
        _forget(k, s)


def _forget(k: EdgeConstants, s: EdgeState) -> None:
    s.first = (s.first + 1) % k.length
    s.edges -= 1


def edge_speed(k: EdgeConstants, s: EdgeState, time_ns: int, count: int) -> float:
    """`edge_time` without stamps: an edge has the time of the first sample that shows its count."""
    return edge_time(k, s, time_ns, count, time_ns)


class EdgeTime(EdgeState):
    """v = angle between two edges / time between them: the newest, and the newest that is `window_s` older.

    No new edge for a time t: |v| <= (2 pi/N)/t. The edge of a count is the line that was passed last, so a wheel that
    oscillates about a line has speed 0. Lag: half the time between the two edges, plus the age of the newest.

    With stamps of a board (`edge_ns`), the noise is that of the stamp, v*25 ns/window with a 40 MHz clock, and a window
    of 0 is best: it takes the newest edges of two samples (docs/facts/rig.md#speed-estimators).
    None of the supported boards stamps edges: the PCI logic counts them in a window, and the input of the USB2's
    chronometers is unknown (docs/facts/boards.md#generic-usb2-logic). Without stamps, an edge has the time of the first
    sample that shows its count, and is up to a period older: the noise is q/sqrt(6) with q = min(2 pi/N,
    v*period)/window. This equals the moving window while every period has a count, and is better only below that, at
    6 rad/s with 2048 counts and 2 kHz.

    Samples come at most at `rate_hz`: where they come faster, the window gets shorter.
    """

    __slots__ = ("k",)

    function: ClassVar[Function] = staticmethod(edge_speed)

    def __init__(self, counts_per_turn: int, window_s: float, rate_hz: float = 10_000.0) -> None:
        length = int(window_s * rate_hz) + _ROOM
        super().__init__([0] * length, [0] * length)
        self.k = EdgeConstants(2.0 * math.pi / counts_per_turn * 1e9, window_s * 1e9, length)

    def update(self, time_ns: int, count: int, edge_ns: int | None = None) -> float:
        """Speed in rad/s at `time_ns`; 0 until two edges were seen.

        `edge_ns` is the instant of the newest edge, on the clock of `time_ns`; None: this sample's, if `count` is new.
        """
        return edge_time(self.k, self, time_ns, count, time_ns if edge_ns is None else edge_ns)


def _edge_time(config: RigConfig) -> EdgeTime:
    return EdgeTime(config.encoders.counts_per_turn, config.estimator.window_s, config.loop.rate_hz)


SPEC: Final = EstimatorSpec(
    "Angle between edges over the time between them, known to a sample as no board stamps edges",
    (parameter("window_s", "s", "least time between the two edges; the speed lags by half of it"),),
    on_both_wheels(_edge_time),
    EdgeTime,
)
