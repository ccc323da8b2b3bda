"""A good exchange of frames as functions of constants and state, which can be compiled: the driver's side.

Frames are lists of bytes, and the tables of the protocol say where in them a value is.
"""

from __future__ import annotations

from dataclasses import dataclass

from firmware_protocol import signed32
from firmware_protocol.fields import Layout, get_bits, put_bits
from inteco_abs.signals import pwm_steps


@dataclass(frozen=True, slots=True)
class ExchangeConstants:
    """Where the values of a tick are: in the host's frame, and in the board's answer."""

    full: int
    """Width of duty 1."""
    numbers: int
    """Frames are numbered modulo this."""
    wheel_sign: int
    road_sign: int
    drive: Layout
    brake: Layout
    number: Layout
    drive_echo: Layout
    brake_echo: Layout
    number_echo: Layout
    wheel: Layout
    road: Layout


@dataclass(slots=True)
class ExchangeState:
    """The host's newest frame, and what it knows of the board's counts."""

    frame: list[int]
    number: int
    wheel_raw: int
    road_raw: int
    wheel_count: int
    """Unwrapped, as is `road_count`."""
    road_count: int
    tick: int
    """Number of the next tick."""
    newest_ns: int
    """Time of the newest sample."""


def put_command(k: ExchangeConstants, s: ExchangeState, drive: float, brake: float) -> None:
    """Put duties in 0..1 and the next number into the host's frame."""
    s.number = (s.number + 1) % k.numbers
    put_bits(s.frame, k.drive, pwm_steps(drive, k.full))
    put_bits(s.frame, k.brake, pwm_steps(brake, k.full))
    put_bits(s.frame, k.number, s.number)


def take_answer(k: ExchangeConstants, s: ExchangeState, answer: list[int]) -> bool:
    """Take the counts of the board's answer; False if it does not echo the newest frame."""
    if (
        get_bits(answer, k.number_echo) % k.numbers != s.number
        or get_bits(answer, k.drive_echo) != get_bits(s.frame, k.drive)
        or get_bits(answer, k.brake_echo) != get_bits(s.frame, k.brake)
    ):
        return False
    wheel = k.wheel_sign * signed32(get_bits(answer, k.wheel))
    road = k.road_sign * signed32(get_bits(answer, k.road))
    s.wheel_count += signed32(wheel - s.wheel_raw)
    s.road_count += signed32(road - s.road_raw)
    s.wheel_raw, s.road_raw = wheel, road
    return True
