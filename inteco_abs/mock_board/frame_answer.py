"""A good exchange of frames as functions of constants and state, which can be compiled: the mock board's side.

It is that of a frame which changes only the rig's two widths and its own number. The rig moves meanwhile, with the
duties of the frame before, by the functions of `rig`.
"""

from __future__ import annotations

from dataclasses import dataclass

from firmware_protocol import signed32
from firmware_protocol.fields import Layout, get_bits, put_bits


@dataclass(frozen=True, slots=True)
class AnswerConstants:
    """Where the values of a tick are, in the host's frame and in the answer; the rig's plugs."""

    drive_full: int
    """Width of duty 1."""
    brake_full: int
    drive_connected: bool
    """Whether the channel's pin is an output with PWM function."""
    brake_connected: bool
    wheel_sign: int
    road_sign: int
    wheel_offset: int
    """The counter's value minus the encoder's count."""
    road_offset: int
    number_top: int
    """Bits of the numbered prescaler that come from the word after the number."""
    drive: Layout
    brake: Layout
    number: Layout
    drive_echo: Layout
    brake_echo: Layout
    number_echo: Layout
    wheel: Layout
    road: Layout


@dataclass(slots=True)
class AnswerState:
    """The newest answer, the duties at the rig's terminals, and the readings of its encoders so far."""

    answer: list[int]
    drive: float
    brake: float
    time_ns: int
    readings: int


def take_command(k: AnswerConstants, s: AnswerState, frame: list[int]) -> None:
    """Apply the widths of the host's frame, and echo them and its number."""
    drive, brake = get_bits(frame, k.drive), get_bits(frame, k.brake)
    s.drive = (drive & k.drive_full) / k.drive_full if k.drive_connected else 0.0
    s.brake = (brake & k.brake_full) / k.brake_full if k.brake_connected else 0.0
    put_bits(s.answer, k.drive_echo, drive)
    put_bits(s.answer, k.brake_echo, brake)
    put_bits(s.answer, k.number_echo, get_bits(frame, k.number) | k.number_top)


def give_counts(k: AnswerConstants, s: AnswerState, wheel: int, road: int) -> None:
    """Put the counters of two encoders, which count so much, into the answer."""
    put_bits(s.answer, k.wheel, signed32(k.wheel_sign * wheel + k.wheel_offset))
    put_bits(s.answer, k.road, signed32(k.road_sign * road + k.road_offset))
