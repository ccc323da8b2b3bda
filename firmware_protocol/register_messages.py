"""Register accesses between two processes on one computer, in place of a bus.

A request is a number chosen by the host and any number of accesses, in order: byte offset and value for a write, byte
offset with `READ` set and zero for a read. The answer is the request's number and the values read, in order; a request
without reads has no answer. All are 32 bits, least significant byte first. Messages keep their boundaries
(`local_socket`).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final

from firmware_protocol.fields import ProtocolError
from firmware_protocol.registers import REGISTER_BITS, REGISTER_BYTES, Write

READ: Final = 1 << 31
"""In an offset: the register is read."""
NUMBERS: Final = 1 << REGISTER_BITS
"""Requests are numbered 0..NUMBERS-1."""

RegisterAccess = Write | int
"""One access: a write, or the offset of a register that is read."""
_STEP_WORDS: Final = 2


def encode_request(number: int, steps: Sequence[RegisterAccess]) -> bytes:
    """Return a request; raises ProtocolError for a number, offset or value of more than 32 bits."""
    words = [number]
    for step in steps:
        words += (READ | step, 0) if isinstance(step, int) else step
    return _pack(words)


def decode_request(message: bytes | bytearray) -> tuple[int, list[RegisterAccess]]:
    """Return number and accesses of a request; raises ProtocolError for a malformed one."""
    words = _unpack(message)
    if len(words) % _STEP_WORDS != 1:
        raise ProtocolError(f"a request of {len(message)} bytes: must be a number and whole accesses")
    pairs = zip(words[1::_STEP_WORDS], words[2::_STEP_WORDS], strict=True)
    return words[0], [offset & ~READ if offset & READ else Write(offset, value) for offset, value in pairs]


def encode_answer(number: int, values: Sequence[int]) -> bytes:
    """Return the answer to request `number`; raises ProtocolError for a value of more than 32 bits."""
    return _pack([number, *values])


def decode_answer(message: bytes | bytearray) -> tuple[int, tuple[int, ...]]:
    """Return the request's number and the values read; raises ProtocolError for a malformed answer."""
    words = _unpack(message)
    return words[0], words[1:]


def answer_bytes(values: int) -> int:
    """Return the length of an answer with `values` values, in bytes."""
    return REGISTER_BYTES * (1 + values)


def _pack(words: Sequence[int]) -> bytes:
    try:
        return struct.pack(f"<{len(words)}I", *words)
    except struct.error as error:
        raise ProtocolError(f"{words}: must be numbers of 32 bits") from error


def _unpack(message: bytes | bytearray) -> tuple[int, ...]:
    count, rest = divmod(len(message), REGISTER_BYTES)
    if rest or not count:
        raise ProtocolError(f"a message of {len(message)} bytes: must be whole words of {REGISTER_BYTES}")
    return struct.unpack(f"<{count}I", message)
