"""Captures of the messages between host and board: record, import, compare, play back."""

from inteco_abs.wire.capture import (
    Capture,
    Record,
    RecordKind,
    check_target,
    open_capture,
    read_capture,
    write_capture,
)
from inteco_abs.wire.changed_words import changed_words, compare_sends
from inteco_abs.wire.pcap import import_pcap
from inteco_abs.wire.recording import Recording, check_recordable, record_wire
from inteco_abs.wire.replay import profile_for, replay_wire
from inteco_abs.wire.summary import caution, summarize

__all__ = [
    "Capture",
    "Record",
    "RecordKind",
    "Recording",
    "caution",
    "changed_words",
    "check_recordable",
    "check_target",
    "compare_sends",
    "import_pcap",
    "open_capture",
    "profile_for",
    "read_capture",
    "record_wire",
    "replay_wire",
    "summarize",
    "write_capture",
]
