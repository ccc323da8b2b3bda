"""Declares, checks, encodes and decodes the fields of frames.

A frame is a fixed number of words: 16 bits, little-endian, or single bytes. A `FrameField` declares once its meaning
and, per direction, which bits of which words carry it. A `FrameTable` has all fields of one direction and checks itself
when it is built. Only these declarations contain offsets and shifts.
They are in `rtdac_usb2`, `rtdac_usb` and `open_board`; the registers of the PCI board are in `rtdac_pci`.
"""

from __future__ import annotations

import difflib
import struct
from collections.abc import Iterable, Iterator, Mapping, MutableSequence, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, NamedTuple, Protocol, Self

WORD_BITS: Final = 16
BYTE_BITS: Final = 8
_COUNTER_RANGE: Final = 1 << 32
_HALF_RANGE: Final = 1 << 31

Value = int | str
"""A decoded field: an integer, or text for names and dates."""

Buffer = bytes | bytearray | memoryview


def signed32(value: int) -> int:
    """Return the low 32 bits of `value` as a signed number: a counter's reading, or how far a counter has moved."""
    return (value + _HALF_RANGE) % _COUNTER_RANGE - _HALF_RANGE


class ProtocolError(ValueError):
    """A frame or a value breaks the protocol; the text names the field, the value and the allowed range."""


class TableError(ValueError):
    """A declaration contradicts itself; raised when the table is built, at import."""


class Status(Enum):
    """How well a field is known."""

    CONFIRMED = "confirmed"  # read in the named source
    INFERRED = "inferred"  # deduced from confirmed facts
    UNKNOWN = "unknown"  # no source


class ValueKind(Enum):
    """Interpretation of a field's bits."""

    UNSIGNED = "unsigned"
    SIGNED = "two's complement"
    TEXT = "ASCII"  # most significant byte first, padded with NUL
    HEX = "hex digits"  # the number's hexadecimal digits are the text


_WIDTH_UNITS: Final = {ValueKind.TEXT: 8, ValueKind.HEX: 4}
"""Bits per character of the text kinds."""


class Bits(NamedTuple):
    """`width` bits from bit `low` of word `word`, which carry the value's bits from `shift` on."""

    word: int
    low: int
    width: int
    shift: int = 0

    @property
    def mask(self) -> int:
        return (1 << self.width) - 1


Layout = tuple[Bits, ...]
"""Parts of a value without a gap, low part first."""


def _width(layout: Layout) -> int:
    """Return the number of bits of the whole value."""
    highest = layout[-1]
    return highest.shift + highest.width


def bits(word: int, low: int, width: int) -> Layout:
    """Return the layout of a value in one word."""
    return (Bits(word, low, width),)


def words(word: int, *widths: int) -> Layout:
    """Return a layout over consecutive words, low part first: `words(20, 15, 11)` is 15 + 11 bits from word 20."""
    layout, shift = [], 0
    for index, width in enumerate(widths):
        layout.append(Bits(word + index, 0, width, shift))
        shift += width
    return tuple(layout)


@dataclass(frozen=True, slots=True)
class FrameField:
    """One quantity on the wire.

    `read` is its layout in a READ frame of the board, `send` its layout in a SEND frame of the host; None if the frame
    does not carry it. `source` is listed in the module that declares the table.
    """

    name: str
    meaning: str
    unit: str
    source: str
    read: Layout | None = None
    send: Layout | None = None
    kind: ValueKind = ValueKind.UNSIGNED
    status: Status = Status.CONFIRMED

    def range(self, layout: Layout) -> tuple[int, int]:
        """Return the smallest and the largest integer that fits `layout`."""
        width = _width(layout)
        if self.kind is ValueKind.SIGNED:
            return -(1 << (width - 1)), (1 << (width - 1)) - 1
        return 0, (1 << width) - 1

    def to_bits(self, value: Value, layout: Layout) -> int:
        """Return the unsigned integer that carries `value`; raises ProtocolError with name, value and range."""
        if self.kind is ValueKind.UNSIGNED and type(value) is int and not value >> _width(layout):
            return value  # most values by far
        if self.kind is ValueKind.TEXT:
            return self._text_to_bits(value, layout)
        if self.kind is ValueKind.HEX:
            return self._hex_to_bits(value, layout)
        low, high = self.range(layout)
        if type(value) is not int or not low <= value <= high:
            raise ProtocolError(f"{self.name} = {value!r}: must be an integer in {low}..{high}")
        return value & ((1 << _width(layout)) - 1)

    def from_bits(self, raw: int, layout: Layout) -> Value:
        """Return the value that the unsigned integer `raw` carries."""
        if self.kind is ValueKind.UNSIGNED:
            return raw
        width = _width(layout)
        if self.kind is ValueKind.SIGNED:
            return raw - (1 << width) if raw >> (width - 1) else raw
        if self.kind is ValueKind.TEXT:
            return raw.to_bytes(width // 8, "big").rstrip(b"\0").decode("latin-1")
        return f"{raw:0{width // 4}X}"

    def _text_to_bits(self, value: Value, layout: Layout) -> int:
        length = _width(layout) // 8
        try:
            text = value.encode("latin-1") if isinstance(value, str) else None
        except UnicodeEncodeError:
            text = None
        if text is None or len(text) > length or text.endswith(b"\0"):
            raise ProtocolError(f"{self.name} = {value!r}: must be text of at most {length} single-byte characters")
        return int.from_bytes(text.ljust(length, b"\0"), "big")

    def _hex_to_bits(self, value: Value, layout: Layout) -> int:
        digits = _width(layout) // 4
        # int() also accepts signs, underscores and other scripts' digits
        if not isinstance(value, str) or len(value) != digits or not set(value) <= set("0123456789ABCDEF"):
            raise ProtocolError(f"{self.name} = {value!r}: must be {digits} hex digits, such as {'20110606'[:digits]}")
        return int(value, 16)


class Codec(Protocol):
    """Writes and reads one value at an offset of a frame, as `struct.Struct` does."""

    def pack_into(self, buffer: bytearray | memoryview, offset: int, /, *values: int) -> None: ...

    def unpack_from(self, buffer: Buffer, /, offset: int) -> tuple[int, ...]: ...


class CutCodec:
    """A value split over consecutive bytes, low part first, `widths` bits each.

    Rejects a value that does not fit: its overflow could set the bit that marks a command.
    """

    def __init__(self, widths: Iterable[int]) -> None:
        parts, shift = [], 0
        for index, width in enumerate(widths):
            parts.append((index, shift, (1 << width) - 1))
            shift += width
        self._parts = tuple(parts)
        self._bits = shift

    def pack_into(self, buffer: bytearray | memoryview, offset: int, /, *values: int) -> None:
        (value,) = values
        if value >> self._bits:  # negative ones too
            raise ProtocolError(f"value {value} at byte {offset}: must be in 0..{(1 << self._bits) - 1}")
        for index, shift, mask in self._parts:
            buffer[offset + index] = value >> shift & mask

    def unpack_from(self, buffer: Buffer, /, offset: int) -> tuple[int, ...]:
        value = 0
        for index, shift, mask in self._parts:
            value |= (buffer[offset + index] & mask) << shift
        return (value,)


class Place(NamedTuple):
    """Byte offset of a field in its frame, and its codec there."""

    offset: int
    codec: Codec


_STRUCT_CODES: Final[Mapping[int, Mapping[tuple[int, ...], tuple[str, str]]]] = {
    WORD_BITS: {(16, 16): ("I", "i")},
    BYTE_BITS: {(8, 8): ("H", "h"), (8, 8, 8, 8): ("I", "i")},
}
"""The struct module's codes for unsigned and two's complement, by word size and widths of the full words."""


class FrameTable:
    """All fields of one frame in one direction.

    `size` is the frame's length in bytes, `word_bits` the size of its words (16 or 8), `payload_bits` the bits per
    word that data may use, `command` the fixed first word (None: the first word is data). Layouts count words from
    the frame's word `data_from`. `fixed` are fields with one allowed value. Raises TableError for an overlap, a
    duplicate name, or a bit outside the frame.
    """

    def __init__(
        self,
        title: str,
        fields: Iterable[tuple[FrameField, Layout]],
        *,
        size: int,
        word_bits: int = WORD_BITS,
        payload_bits: int | None = None,
        command: int | None = None,
        data_from: int = 0,
        fixed: Mapping[str, int] | None = None,
    ) -> None:
        if word_bits not in _STRUCT_CODES:
            raise TableError(f"{title}: words of {word_bits} bits, must be one of {sorted(_STRUCT_CODES)}")
        self._word_bytes = word_bits // BYTE_BITS
        if size <= 0 or size % self._word_bytes:
            raise TableError(f"{title}: {size} bytes are not whole words")
        self.title = title
        self.size = size
        self.command = command
        self.word_bits = word_bits
        self.payload_bits = word_bits if payload_bits is None else payload_bits
        self.data_from = data_from
        self.fields: dict[str, tuple[FrameField, Layout]] = {}
        self._count = size // self._word_bytes
        self._noun = "byte" if word_bits == BYTE_BITS else "word"
        self._words = struct.Struct(f"<{self._count}{'B' if word_bits == BYTE_BITS else 'H'}")
        self._places: dict[str, Place] = {}  # filled on demand
        self._framed: dict[str, tuple[FrameField, Layout]] = {}  # layouts that count from the frame's first word
        owner: dict[tuple[int, int], str] = {}
        if command is not None:
            owner.update({(-data_from, bit): f"the command {self._noun}" for bit in range(word_bits)})
        for field, layout in fields:
            if field.name in self.fields or not field.name.isidentifier():
                raise TableError(f"{title}: {field.name!r} is declared twice or is not a name")
            self.fields[field.name] = (field, layout)
            self._claim(field.name, layout, owner)
            width, unit = sum(part.width for part in layout), _WIDTH_UNITS.get(field.kind, 1)
            if not width or width % unit:
                raise TableError(f"{title}: {field.name} has {width} bits, must be a multiple of {unit}")
            self._framed[field.name] = (field, tuple(part._replace(word=part.word + data_from) for part in layout))
        self.fixed = dict(fixed or {})
        if not self.fixed.keys() <= self.fields.keys():
            raise TableError(f"{title}: fixed fields {sorted(self.fixed)} are not all declared")
        self._fixed = tuple((*self._framed[name], value) for name, value in self.fixed.items())
        self.named_bits = self._named_bits()

    @classmethod
    def of(cls, fields: Iterable[FrameField], title: str, *, command: int | None = None, **form: Any) -> Self:
        """Build the table of the host's frame if there is a `command`, else of the board's."""
        layouts = ((field, field.read if command is None else field.send) for field in fields)
        parts = [(field, layout) for field, layout in layouts if layout is not None]
        return cls(title, parts, command=command, **form)

    def _named_bits(self) -> tuple[int, ...]:
        """Return the bits of the command and the fields, by word of the frame."""
        masks = [0] * self._count
        if self.command is not None:
            masks[0] = (1 << self.word_bits) - 1
        for _, layout in self._framed.values():
            for part in layout:
                masks[part.word] |= part.mask << part.low
        return tuple(masks)

    def _claim(self, name: str, layout: Layout, owner: dict[tuple[int, int], str]) -> None:
        shift = 0
        for part in layout:
            inside = 0 <= part.word < self._count - self.data_from and part.low >= 0 and part.width > 0
            if not inside or part.low + part.width > self.payload_bits:
                raise TableError(f"{self.title}: {name} leaves the frame at {part}")
            if part.shift != shift:
                raise TableError(f"{self.title}: {name} has a gap or overlap in its own bits at {part}")
            shift += part.width
            for bit in range(part.low, part.low + part.width):
                if (part.word, bit) in owner:
                    first = owner[part.word, bit]
                    raise TableError(f"{self.title}: {name} and {first} share {self._noun} {part.word} bit {bit}")
                owner[part.word, bit] = name

    def encode(self, values: Mapping[str, Value]) -> bytes:
        """Return the frame with `values`; other fields are zero, or their one allowed value.

        Raises ProtocolError for an unknown name or a value that does not fit.
        """
        frame = [0] * self._count
        if self.command is not None:
            frame[0] = self.command
        for name, value in {**self.fixed, **values}.items() if self.fixed else values.items():
            field, layout = self._find(name)
            raw = field.to_bits(value, layout)
            for word, low, width, shift in layout:
                frame[word] |= (raw >> shift & (1 << width) - 1) << low
        self._check_fixed(frame)
        return self._words.pack(*frame)

    def decode(self, frame: Buffer) -> dict[str, Value]:
        """Return all fields of `frame`; raises ProtocolError for a wrong length, command word or fixed field."""
        return self.decode_some(frame, self.fields)

    def decode_some(self, frame: Buffer, names: Iterable[str]) -> dict[str, Value]:
        """Return the named fields of `frame`; checks the whole frame as `decode` does."""
        words = self.check(frame)
        values: dict[str, Value] = {}
        for name in names:
            field, layout = self._find(name)
            values[name] = field.from_bits(get_bits(words, layout), layout)
        return values

    def check(self, frame: Buffer) -> tuple[int, ...]:
        """Return the words of a well-formed frame; raises ProtocolError for another."""
        if len(frame) != self.size:
            raise ProtocolError(f"{self.title}: {len(frame)} bytes, must be {self.size}")
        words: tuple[int, ...] = self._words.unpack(frame)
        if self.command is not None:
            self._check_marks(words, self.command)
        self._check_fixed(words)
        return words

    def _check_marks(self, words: Sequence[int], command: int) -> None:
        noun, digits = self._noun, self.word_bits // 4
        if words[0] != command:
            raise ProtocolError(f"{self.title}: command {noun} 0x{words[0]:0{digits}X}, must be 0x{command:0{digits}X}")
        for index in range(1, len(words)):
            if words[index] >> self.payload_bits:
                raise ProtocolError(
                    f"{self.title}: {noun} {index - self.data_from} = 0x{words[index]:0{digits}X}, data {noun}s must "
                    f"be below 0x{1 << self.payload_bits:0{digits}X} (the top bit marks a command)"
                )

    def _check_fixed(self, words: Sequence[int]) -> None:
        for field, layout, value in self._fixed:
            found = get_bits(words, layout)
            if found != value:
                raise ProtocolError(f"{self.title}: {field.name} = 0x{found:04X}, must be 0x{value:04X}")

    def words(self, frame: Buffer) -> list[int]:
        """Return the words of a frame of the right size, unchecked."""
        return list(self._words.unpack(frame))

    def pack(self, words: Sequence[int]) -> bytes:
        """Return the frame with these words, unchecked."""
        return self._words.pack(*words)

    def place(self, name: str) -> Place:
        """Return offset and codec to pack and unpack one field in place, for the loop.

        The field must share no word, and be part of one word from bit 0, or full words of 16 or 32 bits together, or,
        in frames of bytes, consecutive bytes from bit 0; others raise TableError. Unnamed bits above the field's width
        in its word are not masked.
        """
        found = self._places.get(name)
        if found is None:
            found = self._places[name] = self._place(name)
        return found

    def bytes_of(self, name: str) -> Layout:
        """Return the layout of a field over the frame's bytes, for `get_bits` and `put_bits`."""
        _, layout = self._find(name)
        return tuple(
            Bits(word * self._word_bytes + byte, first - 8 * byte, end - first, shift + first - low)
            for word, low, width, shift in layout
            for byte in range(self._word_bytes)
            if (first := max(low, 8 * byte)) < (end := min(low + width, 8 * byte + 8))
        )

    def _place(self, name: str) -> Place:
        field, layout = self._find(name)
        own = {part.word for part in layout}
        shared = any(own & {part.word for part in other} for f, other in self._framed.values() if f is not field)
        scattered = any(part.low or part.word != layout[0].word + i for i, part in enumerate(layout))
        codec = None if shared or scattered else self._codec(field, tuple(part.width for part in layout))
        if codec is None:
            raise TableError(f"{self.title}: {name} has no {self._noun}s of its own and needs decode()")
        return Place(layout[0].word * self._word_bytes, codec)

    def _codec(self, field: FrameField, widths: tuple[int, ...]) -> Codec | None:
        """Return the codec for consecutive words that only this field uses; None if there is none."""
        codes = _STRUCT_CODES[self.word_bits].get(widths)
        if codes is not None and field.kind in {ValueKind.UNSIGNED, ValueKind.SIGNED}:
            return struct.Struct(f"<{codes[field.kind is ValueKind.SIGNED]}")
        if field.kind is not ValueKind.UNSIGNED:
            return None
        if len(widths) == 1:
            return struct.Struct("<B" if self.word_bits == BYTE_BITS else "<H")
        return CutCodec(widths) if self.word_bits == BYTE_BITS else None

    def _find(self, name: str) -> tuple[FrameField, Layout]:
        found = self._framed.get(name)
        if found is None:
            raise ProtocolError(f"{self.title} has no field {name!r}{hint(name, self.fields)}")
        return found


class Logic(NamedTuple):
    """The frames of one logic of the FPGA."""

    name: str
    fields: tuple[FrameField, ...]
    read: FrameTable
    send: FrameTable
    header: FrameTable
    """Fields that READ frames of all logics share."""
    header_bytes: int
    """Length of the part of a READ frame that is constant on a given board."""
    request: bytes
    """Message that asks for a READ frame."""

    @property
    def pwm_channels(self) -> int:
        """Number of PWM channels."""
        return sum(field.name.endswith("_width") for field in self.fields)

    @property
    def encoder_channels(self) -> int:
        """Number of encoder channels."""
        return sum(field.name.endswith("_count") for field in self.fields)


def first_word(table: FrameTable, name: str) -> Layout:
    """Return the layout over bytes of the part of a field that is in its first word."""
    return tuple(part for part in table.bytes_of(name) if part.shift < table.fields[name][1][0].width)


def get_bits(words: Sequence[int], layout: Layout) -> int:
    """Return the unsigned integer that `layout` has in these words; also compiled, over rows of arrays."""
    raw = 0
    for i in range(len(layout)):
        part = layout[i]
        raw |= (words[part[0]] >> part[1] & (1 << part[2]) - 1) << part[3]
    return raw


def put_bits(words: MutableSequence[int], layout: Layout, raw: int) -> None:
    """Put an integer where `layout` has it in these words, and leave all other bits; compiled as `get_bits`."""
    for i in range(len(layout)):
        part = layout[i]
        word, low, mask = part[0], part[1], (1 << part[2]) - 1
        words[word] = words[word] & ~(mask << low) | (raw >> part[3] & mask) << low


def sent_back(
    read: FrameTable,
    send: FrameTable,
    frame: Buffer,
    values: Mapping[str, Value] | None = None,
    data: Mapping[int, int] | None = None,
) -> bytes:
    """Return the SEND frame that changes only `values` and the whole `data` words of a board that reads `frame`.

    Fields of both tables get their layout in SEND. Fields of READ alone, such as counters, are measured, and sent as
    zero. Bits in neither table are sent as they were read, at the same place, without the top bit, which marks a
    command: every published map has a setting in the same word in both directions.

    Raises ProtocolError for a damaged frame, and for a value that does not fit into SEND.
    """
    found = read.decode(frame)
    kept = {name: found[name] for name in send.fields if name in found}
    words = send.words(send.encode({**kept, **(values or {})}))
    for word, raw in _unnamed(read, send, frame):
        words[word] |= raw & (1 << send.payload_bits) - 1
    for word, value in (data or {}).items():
        words[word + send.data_from] = value
    return send.pack(words)


def unnamed(read: FrameTable, send: FrameTable, frame: Buffer) -> dict[int, int]:
    """Return the nonzero bits of `frame` that neither table names, by data word."""
    return {word - send.data_from: raw for word, raw in _unnamed(read, send, frame) if raw}


def _unnamed(read: FrameTable, send: FrameTable, frame: Buffer) -> Iterator[tuple[int, int]]:
    """Yield those bits by word of the SEND frame, which may be shorter than the READ frame."""
    shift = send.data_from - read.data_from
    words, full = read.words(frame), (1 << read.word_bits) - 1
    for word, (raw, known) in enumerate(zip(words, read.named_bits, strict=True)):
        if word + shift < len(send.named_bits):
            yield word + shift, raw & full & ~known & ~send.named_bits[word + shift]


def hint(name: str, known: Iterable[str]) -> str:
    """Return the end of a message about the unknown `name`: the most similar known name, or nothing."""
    near = difflib.get_close_matches(str(name), known, n=1)
    return f"; did you mean {near[0]}?" if near else ""
