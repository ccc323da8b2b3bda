"""The 2 kHz loop: its clocks, its memory; beside it, the processes of a real-time run."""

from inteco_abs.realtime.clock import Beat, Clock, PacedClock, VirtualClock
from inteco_abs.realtime.histogram import Histogram
from inteco_abs.realtime.loop import Loop, Stop, StopWord
from inteco_abs.realtime.ring import RingReader, TickRing, ring_bytes

__all__ = [
    "Beat",
    "Clock",
    "Histogram",
    "Loop",
    "PacedClock",
    "RingReader",
    "Stop",
    "StopWord",
    "TickRing",
    "VirtualClock",
    "ring_bytes",
]
