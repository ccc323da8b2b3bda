"""Speed from the times of an encoder's edges."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.control.estimators.registry import EstimatorSpec, on_both_wheels, parameter


class EdgeTime:
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
    """

    __slots__ = ("_count", "_edges", "_line_ns", "_window_ns")

    def __init__(self, counts_per_turn: int, window_s: float) -> None:
        self._line_ns = 2.0 * math.pi / counts_per_turn * 1e9
        self._window_ns = window_s * 1e9
        self._edges: deque[tuple[int, int]] = deque()  # instant and line of each, at most one a sample
        self._count: int | None = None

    def update(self, time_ns: int, count: int, edge_ns: int | None = None) -> float:
        """Speed in rad/s at `time_ns`; 0 until two edges were seen.

        `edge_ns` is the instant of the newest edge, on the clock of `time_ns`; None: this sample's, if `count` is new.
        """
        before, self._count = self._count, count
        if before is not None and count != before:
            line = count if count > before else count + 1
            self._see(time_ns if edge_ns is None else edge_ns, line)
        edges = self._edges
        if len(edges) < 2:
            return 0.0
        (first_ns, first), (last_ns, last) = edges[0], edges[-1]
        speed = (last - first) * self._line_ns / (last_ns - first_ns)
        quiet_ns = time_ns - last_ns
        most = self._line_ns / quiet_ns if quiet_ns > 0 else math.inf
        return max(-most, min(most, speed))

    def _see(self, edge_ns: int, line: int) -> None:
        edges = self._edges
        if edges and edge_ns <= edges[-1][0]:  # the clock stood still or went back
            edges.clear()
        edges.append((edge_ns, line))
        while len(edges) > 2 and edge_ns - edges[1][0] >= self._window_ns:
            edges.popleft()


def _edge_time(config: RigConfig) -> EdgeTime:
    return EdgeTime(config.encoders.counts_per_turn, config.estimator.window_s)


SPEC: Final = EstimatorSpec(
    "Angle between edges over the time between them, known to a sample as no board stamps edges",
    (parameter("window_s", "s", "least time between the two edges; the speed lags by half of it"),),
    on_both_wheels(_edge_time),
    EdgeTime,
)
