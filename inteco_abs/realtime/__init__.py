"""The 2 kHz loop, its clocks and its memory."""

from inteco_abs.realtime.clock import Beat, Clock, PacedClock, VirtualClock
from inteco_abs.realtime.loop import Loop, StopWord
from inteco_abs.realtime.ring import TickRing

__all__ = ["Beat", "Clock", "Loop", "PacedClock", "StopWord", "TickRing", "VirtualClock"]
