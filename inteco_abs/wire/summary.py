"""Summary of a capture in numbers."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from statistics import median
from typing import NamedTuple

from inteco_abs.boards import BoardProtocol, MessageRole, protocol_of
from inteco_abs.wire.capture import Capture, RecordKind


class MessageTiming(NamedTuple):
    """Number and timing of messages of one role."""

    messages: int
    rate_hz: float | None
    """Rate from the first to the last; None with fewer than two, or all at once."""
    median_interval_s: float | None
    longest_interval_s: float | None


class CaptureSummary(NamedTuple):
    """Summary of a whole capture."""

    board: str
    recorded_by: str
    clock: str
    duration_s: float
    traffic: dict[str, MessageTiming]
    errors: dict[str, int]
    """Number of errors by text."""
    control_transfers: int
    warnings: tuple[str, ...]
    logic_version: int | None
    """Version in the first answer that has it."""
    application_name: str
    caution: str
    """Warning if the tables are for another logic; else empty."""


def summarize(capture: Capture) -> CaptureSummary:
    """Summarize a capture: counts, rates, errors, and its board. Raises ConfigError for a board without tables."""
    protocol = protocol_of(capture.board)
    times_s: dict[str, list[float]] = {}
    for record in capture.records:
        if record.kind is RecordKind.OUT:
            times_s.setdefault(protocol.role_out(record.data), []).append(record.t_s)
        elif record.kind is RecordKind.IN:
            role = protocol.role_in(record.data)
            times_s.setdefault("other answer" if role is MessageRole.OTHER else role, []).append(record.t_s)
    version, name = identity_seen(capture, protocol)
    at_s = [record.t_s for record in capture.records]
    return CaptureSummary(
        capture.board,
        capture.recorded_by,
        capture.clock,
        max(at_s) - min(at_s) if at_s else 0.0,
        {role: _timing(found) for role, found in times_s.items()},
        dict(Counter(record.text for record in capture.records if record.kind is RecordKind.ERROR)),
        sum(record.kind is RecordKind.CONTROL for record in capture.records),
        tuple(record.text for record in capture.records if record.kind is RecordKind.WARNING),
        version,
        name,
        caution(capture),
    )


def caution(capture: Capture) -> str:
    """Return why field names may be wrong; empty if the logic is that of the tables, or unknown."""
    protocol = protocol_of(capture.board)
    version, _ = identity_seen(capture, protocol)
    if None in {version, protocol.logic_version} or version == protocol.logic_version:
        return ""
    return (
        f"the board has logic 0x{version:04X}, the names are those of logic 0x{protocol.logic_version:04X} "
        "and may be wrong"
    )


def identity_seen(capture: Capture, protocol: BoardProtocol) -> tuple[int | None, str]:
    """The board's logic version and application's name by its first READ answer; None and nothing without one."""
    for record in capture.records:
        found = protocol.identity_in(record.data) if record.kind is RecordKind.IN else None
        if found is not None:
            return int(found["logic_version"]), str(found["application_name"])
    return None, ""


def _timing(times_s: list[float]) -> MessageTiming:
    steps = [after - before for before, after in pairwise(times_s)]
    total = sum(steps)
    rate = len(steps) / total if total > 0 else None
    return MessageTiming(len(times_s), rate, median(steps) if steps else None, max(steps) if steps else None)
