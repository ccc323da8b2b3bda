"""The loop with its clocks and its memory, and the processes of a real-time run."""

from inteco_abs.realtime.clock import Beat, Clock, PacedClock, VirtualClock
from inteco_abs.realtime.gain_changes import ChangeTable, GainChanges, Tuner
from inteco_abs.realtime.histogram import Histogram
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.loop import Loop, StopFlag, StopSource, detail_of
from inteco_abs.realtime.memory import (
    FOLDER,
    Field,
    Mailbox,
    RunMemory,
    alive,
    is_ring,
    left_rings,
    require_room,
    run_bytes,
)
from inteco_abs.realtime.ring import RingReader, TickRing, ring_bytes
from inteco_abs.realtime.round_trips import RATE_MARGIN, Quantiles, quantiles
from inteco_abs.realtime.screen import (
    POINTS_PER_S,
    Lines,
    NoScreen,
    Point,
    SafeScreen,
    Screen,
    Snapshot,
    SnapshotSource,
    StartCheck,
    snapshot_of,
)
from inteco_abs.realtime.signal_handlers import handle_signals
from inteco_abs.realtime.tuning import (
    BOARD_PRIORITY,
    GUARDIAN_PRIORITY,
    LOOP_PRIORITY,
    Core,
    Setting,
    apply,
    cores_of,
    guardian_tuning,
    kernel_list,
    loop_cpus,
    loop_tuning,
    parse_cpus,
)
from inteco_abs.realtime.watchdog import prove_watchdog
from inteco_abs.realtime.window import Window

__all__ = [
    "BOARD_PRIORITY",
    "FOLDER",
    "GUARDIAN_PRIORITY",
    "LOOP_PRIORITY",
    "POINTS_PER_S",
    "RATE_MARGIN",
    "Beat",
    "ChangeTable",
    "Clock",
    "Core",
    "Field",
    "GainChanges",
    "Histogram",
    "Job",
    "Lines",
    "Loop",
    "Mailbox",
    "NoScreen",
    "PacedClock",
    "Point",
    "Quantiles",
    "RingReader",
    "RunMemory",
    "SafeScreen",
    "Screen",
    "Setting",
    "Snapshot",
    "SnapshotSource",
    "StartCheck",
    "StopFlag",
    "StopSource",
    "TickRing",
    "Tuner",
    "VirtualClock",
    "Window",
    "alive",
    "apply",
    "cores_of",
    "detail_of",
    "guardian_tuning",
    "handle_signals",
    "is_ring",
    "kernel_list",
    "left_rings",
    "loop_cpus",
    "loop_tuning",
    "parse_cpus",
    "prove_watchdog",
    "quantiles",
    "require_room",
    "ring_bytes",
    "run_bytes",
    "snapshot_of",
]
