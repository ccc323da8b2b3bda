"""How a field of a frame is declared, checked, encoded and decoded.

A frame is a fixed number of 16-bit little-endian words. A `Field` says once what it means and, per direction,
which bits of which words carry it; a `FrameTable` is all fields of one direction and checks itself when it is
built. Offsets and shifts live in these declarations and nowhere else.
"""

from __future__ import annotations

import difflib
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

WORD_BITS: Final = 16
WORD_BYTES: Final = 2

Value = int | str
"""A decoded field: an integer, or text for names and dates."""


class ProtocolError(ValueError):
    """A frame or a value breaks the protocol; the text names the field, the value and what is allowed."""


class TableError(ValueError):
    """A declaration contradicts itself; raised while the table is built, that is at import."""


class Status(Enum):
    """How well a field is known."""

    CONFIRMED = "confirmed"  # read in a source that is named
    INFERRED = "inferred"  # deduced from confirmed facts
    UNKNOWN = "unknown"  # no source


class Kind(Enum):
    """How the bits of a field are read."""

    UNSIGNED = "unsigned"
    SIGNED = "two's complement"
    TEXT = "ASCII"  # most significant byte first, padded with NUL
    HEX = "hex digits"  # the number's hexadecimal digits are the text


_WIDTH_UNITS: Final = {Kind.TEXT: 8, Kind.HEX: 4}
"""Bits per character, for the kinds that are text."""


@dataclass(frozen=True, slots=True)
class Bits:
    """`width` bits from bit `low` of word `word`; they are bits `shift` and up of the value."""

    word: int
    low: int
    width: int
    shift: int = 0

    @property
    def mask(self) -> int:
        return (1 << self.width) - 1


Layout = tuple[Bits, ...]


def bits(word: int, low: int, width: int) -> Layout:
    """Part of one word."""
    return (Bits(word, low, width),)


def words(word: int, *widths: int) -> Layout:
    """A value cut over consecutive words, low part first: `words(20, 15, 11)` is 15 + 11 bits from word 20."""
    layout, shift = [], 0
    for index, width in enumerate(widths):
        layout.append(Bits(word + index, 0, width, shift))
        shift += width
    return tuple(layout)


@dataclass(frozen=True, slots=True)
class Field:
    """One quantity on the wire.

    `read` is where the board puts it in a READ frame, `send` where the host puts it in a SEND frame; either may
    be None. `source` names the fact's origin, as listed in the module that declares the table.
    """

    name: str
    meaning: str
    unit: str
    source: str
    read: Layout | None = None
    send: Layout | None = None
    kind: Kind = Kind.UNSIGNED
    status: Status = Status.CONFIRMED

    def range(self, layout: Layout) -> tuple[int, int]:
        """Smallest and largest integer that fits `layout`."""
        width = sum(part.width for part in layout)
        if self.kind is Kind.SIGNED:
            return -(1 << (width - 1)), (1 << (width - 1)) - 1
        return 0, (1 << width) - 1

    def to_bits(self, value: Value, layout: Layout) -> int:
        """Unsigned integer that carries `value`; raises ProtocolError with name, value and range."""
        if self.kind is Kind.TEXT:
            return self._text_to_bits(value, layout)
        if self.kind is Kind.HEX:
            return self._hex_to_bits(value, layout)
        low, high = self.range(layout)
        if type(value) is not int or not low <= value <= high:
            raise ProtocolError(f"{self.name} = {value!r}: must be an integer in {low}..{high}")
        return value & ((1 << sum(part.width for part in layout)) - 1)

    def from_bits(self, raw: int, layout: Layout) -> Value:
        """Value carried by the unsigned integer `raw`."""
        width = sum(part.width for part in layout)
        if self.kind is Kind.SIGNED:
            return raw - (1 << width) if raw >> (width - 1) else raw
        if self.kind is Kind.TEXT:
            return raw.to_bytes(width // 8, "big").rstrip(b"\0").decode("latin-1")
        if self.kind is Kind.HEX:
            return f"{raw:0{width // 4}X}"
        return raw

    def _text_to_bits(self, value: Value, layout: Layout) -> int:
        length = sum(part.width for part in layout) // 8
        try:
            text = value.encode("latin-1") if isinstance(value, str) else None
        except UnicodeEncodeError:
            text = None
        if text is None or len(text) > length or text.endswith(b"\0"):
            raise ProtocolError(f"{self.name} = {value!r}: must be text of at most {length} single-byte characters")
        return int.from_bytes(text.ljust(length, b"\0"), "big")

    def _hex_to_bits(self, value: Value, layout: Layout) -> int:
        digits = sum(part.width for part in layout) // 4
        # int() would also take signs, underscores and other scripts' digits
        if not isinstance(value, str) or len(value) != digits or not set(value) <= set("0123456789ABCDEF"):
            raise ProtocolError(f"{self.name} = {value!r}: must be {digits} hex digits, such as {'20110606'[:digits]}")
        return int(value, 16)


class Place(NamedTuple):
    """Byte offset of a field in its frame, and its codec there."""

    offset: int
    codec: struct.Struct


class FrameTable:
    """All fields of one frame in one direction.

    `size` is the frame's length in bytes, `payload_bits` the bits per word that data may use, `command` the
    fixed first word (None: the first word is data). Building the table raises TableError on any overlap,
    duplicate name, or bit outside the frame.
    """

    def __init__(
        self,
        title: str,
        fields: Iterable[tuple[Field, Layout]],
        *,
        size: int,
        payload_bits: int = WORD_BITS,
        command: int | None = None,
    ) -> None:
        if size <= 0 or size % WORD_BYTES:
            raise TableError(f"{title}: {size} bytes are not whole words")
        self.title = title
        self.size = size
        self.command = command
        self.payload_bits = payload_bits
        self.fields: dict[str, tuple[Field, Layout]] = {}
        self._words = struct.Struct(f"<{size // WORD_BYTES}H")
        owner: dict[tuple[int, int], str] = {}
        if command is not None:
            owner.update({(0, bit): "the command word" for bit in range(WORD_BITS)})
        for field, layout in fields:
            if field.name in self.fields or not field.name.isidentifier():
                raise TableError(f"{title}: {field.name!r} is declared twice or is no name")
            self.fields[field.name] = (field, layout)
            self._claim(field.name, layout, owner)
            width, unit = sum(part.width for part in layout), _WIDTH_UNITS.get(field.kind, 1)
            if not width or width % unit:
                raise TableError(f"{title}: {field.name} has {width} bits, must be a multiple of {unit}")

    def _claim(self, name: str, layout: Layout, owner: dict[tuple[int, int], str]) -> None:
        shift = 0
        for part in layout:
            inside = 0 <= part.word < self.size // WORD_BYTES and part.low >= 0 and part.width > 0
            if not inside or part.low + part.width > self.payload_bits:
                raise TableError(f"{self.title}: {name} leaves the frame at {part}")
            if part.shift != shift:
                raise TableError(f"{self.title}: {name} has a gap or overlap in its own bits at {part}")
            shift += part.width
            for bit in range(part.low, part.low + part.width):
                if (part.word, bit) in owner:
                    first = owner[part.word, bit]
                    raise TableError(f"{self.title}: {name} and {first} share word {part.word} bit {bit}")
                owner[part.word, bit] = name

    def encode(self, values: Mapping[str, Value]) -> bytes:
        """Whole frame with `values`; fields not named are zero.

        Raises ProtocolError for an unknown name or a value that does not fit; no frame is made then.
        """
        frame = [0] * (self.size // WORD_BYTES)
        if self.command is not None:
            frame[0] = self.command
        for name, value in values.items():
            field, layout = self._find(name)
            raw = field.to_bits(value, layout)
            for part in layout:
                frame[part.word] |= (raw >> part.shift & part.mask) << part.low
        return self._words.pack(*frame)

    def decode(self, frame: bytes | bytearray | memoryview) -> dict[str, Value]:
        """All fields of `frame`; raises ProtocolError on a wrong length or command word."""
        return self.decode_some(frame, self.fields)

    def decode_some(self, frame: bytes | bytearray | memoryview, names: Iterable[str]) -> dict[str, Value]:
        """The named fields of `frame`; the whole frame is checked all the same."""
        words = self.check(frame)
        values: dict[str, Value] = {}
        for name in names:
            field, layout = self._find(name)
            raw = 0
            for part in layout:
                raw |= (words[part.word] >> part.low & part.mask) << part.shift
            values[name] = field.from_bits(raw, layout)
        return values

    def check(self, frame: bytes | bytearray | memoryview) -> tuple[int, ...]:
        """Words of a well-formed frame; raises ProtocolError naming what is wrong."""
        if len(frame) != self.size:
            raise ProtocolError(f"{self.title}: {len(frame)} bytes, must be {self.size}")
        words: tuple[int, ...] = self._words.unpack(frame)
        if self.command is None:
            return words
        if words[0] != self.command:
            raise ProtocolError(f"{self.title}: command word 0x{words[0]:04X}, must be 0x{self.command:04X}")
        for index in range(1, len(words)):
            if words[index] >> self.payload_bits:
                raise ProtocolError(
                    f"{self.title}: word {index} = 0x{words[index]:04X}, data words must be below "
                    f"0x{1 << self.payload_bits:04X} (the top bit marks a command)"
                )
        return words

    def place(self, name: str) -> Place:
        """Where the named field can be packed and unpacked alone and in place, for the loop.

        Only for fields that have their words for themselves: part of one word from bit 0, or 32 bits over two full
        words. Any other raises TableError. Unnamed bits above a field's width in its word are not masked.
        """
        field, layout = self._find(name)
        own = {part.word for part in layout}
        shared = any(own & {part.word for part in other} for f, other in self.fields.values() if f is not field)
        widths = tuple(part.width for part in layout)
        if shared or any(part.low or part.word != layout[0].word + i for i, part in enumerate(layout)):
            code = ""
        elif widths == (WORD_BITS, WORD_BITS):
            code = "i" if field.kind is Kind.SIGNED else "I"
        else:
            code = "H" if len(widths) == 1 and field.kind is Kind.UNSIGNED else ""
        if not code:
            raise TableError(f"{self.title}: {name} has no words of its own and needs decode()")
        return Place(layout[0].word * WORD_BYTES, struct.Struct(f"<{code}"))

    def _find(self, name: str) -> tuple[Field, Layout]:
        found = self.fields.get(name)
        if found is None:
            near = difflib.get_close_matches(str(name), self.fields, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise ProtocolError(f"{self.title} has no field {name!r}{hint}")
        return found
