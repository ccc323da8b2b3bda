"""Declares, checks, encodes and decodes the registers of a board on the PCI bus.

A `Register` is one quantity in a 32-bit register, or in some of its bits; a `RegisterMap` has all of one logic of
the FPGA, and checks itself when it is built. Some registers exist once per channel and are reached through an
index register: the host writes the channel there, then accesses the data register. The two accesses are not atomic:
the caller must exclude all others from the pair.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from firmware_protocol.fields import ProtocolError, Status, TableError, ValueKind, hint

REGISTER_BITS: Final = 32
REGISTER_BYTES: Final = 4


class Access(Enum):
    """How the host uses a register."""

    READ = "read"
    READ_WRITE = "read, write"


class Write(NamedTuple):
    """One 32-bit write: byte offset from the base, and value."""

    offset: int
    value: int


@dataclass(frozen=True, slots=True)
class Conversion:
    """Converts the values of the registers `inputs` to a quantity in `unit`, by `function`."""

    unit: str
    formula: str
    function: Callable[..., float]
    inputs: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Register:
    """`width` bits from bit `low` of the 32-bit register at byte `offset` from the base.

    With `channels` it is an index register, which selects one of that many channels; `index` is the index register to
    write before each access. `unit` is of the raw value, `conversion` gives SI or shop units. `source` is listed in the
    module that declares the map.
    """

    name: str
    offset: int
    meaning: str
    unit: str
    source: str
    low: int = 0
    width: int = REGISTER_BITS
    access: Access = Access.READ
    kind: ValueKind = ValueKind.UNSIGNED
    channels: int = 0
    index: Register | None = None
    conversion: Conversion | None = None
    status: Status = Status.CONFIRMED

    @property
    def mask(self) -> int:
        """Bits of the 32-bit register that belong to this one."""
        return ((1 << self.width) - 1) << self.low

    @property
    def range(self) -> tuple[int, int]:
        """Smallest and largest value."""
        if self.channels:
            return 0, self.channels - 1
        if self.kind is ValueKind.SIGNED:
            return -(1 << (self.width - 1)), (1 << (self.width - 1)) - 1
        return 0, (1 << self.width) - 1

    def decode(self, raw: int) -> int:
        """Return the value in the 32 bits `raw` read at the offset."""
        if type(raw) is not int or raw >> REGISTER_BITS:
            raise ProtocolError(f"{self.name}: read {raw!r}, must be an integer in 0..{(1 << REGISTER_BITS) - 1}")
        value = (raw & self.mask) >> self.low
        return value - (1 << self.width) if self.kind is ValueKind.SIGNED and value >> (self.width - 1) else value

    def encode(self, value: int) -> int:
        """Return the 32 bits that carry `value`, all others zero; raises ProtocolError with name, value and range."""
        low, high = self.range
        if type(value) is not int or not low <= value <= high:
            raise ProtocolError(f"{self.name} = {value!r}: must be an integer in {low}..{high}")
        return value << self.low & self.mask


class RegisterMap:
    """All registers of one logic, in a range of `size` bytes.

    Raises TableError for duplicate names, shared bits, a bit outside the range, an index or a conversion that needs an
    undeclared register, or a writable register that shares its 32 bits.
    """

    def __init__(self, title: str, registers: Iterable[Register], *, size: int) -> None:
        self.title = title
        self.size = size
        self.registers: dict[str, Register] = {}
        self._at: dict[int, tuple[Register, ...]] = {}
        for register in registers:
            if register.name in self.registers or not register.name.isidentifier():
                raise TableError(f"{title}: {register.name!r} is declared twice or is not a name")
            self._claim(register)
            self.registers[register.name] = register
            self._at[register.offset] = (*self.at(register.offset), register)
        for register in self.registers.values():
            self._check_references(register)

    def _claim(self, new: Register) -> None:
        inside = 0 <= new.offset < self.size and new.offset % REGISTER_BYTES == 0
        if not inside or new.low < 0 or new.width <= 0 or new.low + new.width > REGISTER_BITS:
            raise TableError(f"{self.title}: {new.name} leaves the registers at 0x{new.offset:02X}")
        if new.kind not in {ValueKind.UNSIGNED, ValueKind.SIGNED} or not 0 <= new.channels <= 1 << new.width:
            raise TableError(f"{self.title}: {new.name} is not a number, or cannot count its channels")
        for old in self.at(new.offset):
            if old.mask & new.mask:
                raise TableError(f"{self.title}: {new.name} and {old.name} share bits at 0x{new.offset:02X}")
            if Access.READ_WRITE in {old.access, new.access}:
                raise TableError(f"{self.title}: {new.name} and {old.name} cannot be written apart")

    def _check_references(self, register: Register) -> None:
        index = register.index
        if index is not None:
            selects = index.channels and index.index is None and index.access is Access.READ_WRITE
            if self.registers.get(index.name) is not index or not selects:
                raise TableError(
                    f"{self.title}: {register.name} is reached through {index.name}, which is not an index here"
                )
        if register.conversion is not None and not set(register.conversion.inputs) <= self.registers.keys():
            raise TableError(f"{self.title}: {register.name} is converted with undeclared registers")

    def at(self, offset: int) -> tuple[Register, ...]:
        """Return the registers at a byte offset; empty if none is known."""
        return self._at.get(offset, ())

    def find(self, name: str) -> Register:
        """Return the register of that name; raises ProtocolError with the most similar name."""
        found = self.registers.get(name)
        if found is None:
            raise ProtocolError(f"{self.title} has no register {name!r}{hint(name, self.registers)}")
        return found

    def select(self, register: Register, channel: int | None = None) -> tuple[Write, ...]:
        """Return the writes before an access: one for a register with channels, else none.

        Raises ProtocolError for a register of another logic, and for a missing, superfluous or invalid channel.
        """
        self._own(register)
        if register.index is None:
            if channel is not None:
                raise ProtocolError(f"{register.name}: channel {channel!r}, but it has no channels")
            return ()
        if type(channel) is not int or not 0 <= channel < register.index.channels:
            raise ProtocolError(
                f"{register.name}: channel {channel!r}, must be an integer in 0..{register.index.channels - 1}"
            )
        return (Write(register.index.offset, register.index.encode(channel)),)

    def write(self, register: Register, value: int, channel: int | None = None) -> tuple[Write, ...]:
        """Return the writes that set a register, in order. Raises ProtocolError, also for a read-only register."""
        selects = self.select(register, channel)
        if register.access is Access.READ:
            raise ProtocolError(f"{register.name} is read-only")
        return (*selects, Write(register.offset, register.encode(value)))

    def quantity(self, register: Register, values: Mapping[str, int]) -> float:
        """Return what a register measures, in its conversion's unit, from values by register name.

        Raises ProtocolError if the register has no conversion or a value is missing.
        """
        self._own(register)
        if register.conversion is None:
            raise ProtocolError(f"{register.name} has no conversion")
        missing = [name for name in register.conversion.inputs if name not in values]
        if missing:
            raise ProtocolError(f"{register.name} is converted with {', '.join(missing)}, which is not given")
        return register.conversion.function(*(values[name] for name in register.conversion.inputs))

    def _own(self, register: Register) -> None:
        if self.registers.get(register.name) is not register:
            here = " and ".join(own.name for own in self.at(register.offset)) or "unknown"
            raise ProtocolError(f"{self.title} has no {register.name}: 0x{register.offset:02X} is {here}")
