"""The messages of a session: one table gives protobuf schema, constant byte layout and numpy dtype.

A message is flat, and every field is always written, in order, with a fixed-width type. So its bytes have a constant
layout that numpy reads and any protobuf parser understands.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum
from functools import cached_property
from importlib import import_module
from itertools import islice, starmap
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from inteco_abs.format.descriptors import ENUM, INT32, INT64, MESSAGE, TEXT, enum, field, message, proto_file
from inteco_abs.format.protobuf import chunk, fields, integer, tag
from inteco_abs.signals import BoardFlags, Phase, Reason, Tick

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

PACKAGE: Final = "inteco_abs.v1"
_FROM_ONE: Final = range(1, 1 << 29)


class MessageKind(NamedTuple):
    """Type of a field: descriptor.proto type number, wire type, struct code, numpy type, and its enum if any."""

    type_number: int
    wire_type: int
    code: str
    dtype: str
    members: type[IntEnum] | None = None


DOUBLE: Final = MessageKind(1, 1, "d", "<f8")
FLOAT: Final = MessageKind(2, 5, "f", "<f4")
FIXED64: Final = MessageKind(6, 1, "Q", "<u8")
FIXED32: Final = MessageKind(7, 5, "I", "<u4")
SFIXED64: Final = MessageKind(16, 1, "q", "<i8")
BOOL: Final = MessageKind(8, 0, "?", "?")
PHASE: Final = MessageKind(14, 0, "B", "u1", Phase)
REASON: Final = MessageKind(14, 0, "B", "u1", Reason)


class Role(Enum):
    """What replay does with a field."""

    INPUT = "input"  # fed to the pipeline
    OUTPUT = "output"  # recomputed and compared bit for bit
    TIMING = "timing"  # copied: only a clock could make it


@dataclass(frozen=True, slots=True)
class Column:
    """One field of a message."""

    name: str
    kind: MessageKind
    unit: str
    """As in UCUM; `1` has no dimension, empty is only declared by the run's controller."""
    meaning: str
    role: Role = Role.OUTPUT


class Message:
    """A flat message with a constant layout. Fields are numbered from 1 in the order of `columns`, or as `numbers`."""

    def __init__(self, name: str, topic: str, columns: Sequence[Column], numbers: Iterable[int] = _FROM_ONE) -> None:
        self.name = f"{PACKAGE}.{name}"
        self.topic = topic
        self.columns = tuple(columns)
        self._numbers = tuple(islice(numbers, len(self.columns)))
        form = "<"
        offsets: list[int] = []
        keys: list[bytes] = []
        for number, column in zip(self._numbers, self.columns, strict=True):
            keys.append(tag(number, column.kind.wire_type))
            form += f"{len(keys[-1])}s"
            offsets.append(struct.calcsize(form))
            form += column.kind.code
        self._struct = struct.Struct(form)
        self._arguments: list[Any] = [part for key in keys for part in (key, 0)]
        self.size = self._struct.size
        self._offsets = offsets
        self._keys = keys
        choices = [(False, True) if column.kind is BOOL else column.kind.members for column in self.columns]
        self._choices = {offset: len(members) for offset, members in zip(offsets, choices, strict=True) if members}

    def pack_into(self, buffer: bytearray, offset: int, values: Sequence[Any]) -> None:
        """Write the message with `values`, one per column, at `offset`."""
        arguments = self._arguments
        arguments[1::2] = values
        self._struct.pack_into(buffer, offset, *arguments)

    def pack(self, values: Sequence[Any]) -> bytes:
        """The message with `values`, one per column."""
        buffer = bytearray(self.size)
        self.pack_into(buffer, 0, values)
        return bytes(buffer)

    def unpack(self, data: bytes | bytearray) -> tuple[Any, ...]:
        """Values of one message."""
        return self._struct.unpack(data)[1::2]

    def values(self, data: bytes | memoryview, names: Collection[str]) -> Iterator[tuple[Any, ...]]:
        """Values of the columns `names` of each message in `data`, in the order of the columns."""
        return self._keyless(names).iter_unpack(data)

    def array_of(self, rows: Iterable[Sequence[Any]]) -> npt.NDArray[np.void]:
        """New structured array with a row for each of `rows`. Its bytes have no keys, so they are not messages."""
        pack = self._keyless({column.name for column in self.columns}).pack
        return self.array(bytearray().join(starmap(pack, rows)))

    def _keyless(self, names: Collection[str]) -> struct.Struct:
        """The layout with padding for the keys and for all other columns."""
        form = "<"
        for column, key in zip(self.columns, self._keys, strict=True):
            code = column.kind.code
            form += f"{len(key)}x{code if column.name in names else f'{struct.calcsize(code)}x'}"
        return struct.Struct(form)

    @cached_property
    def dtype(self) -> np.dtype[np.void]:
        """Layout for numpy."""
        layout: np.dtype[np.void] = _numpy().dtype(
            {
                "names": [column.name for column in self.columns],
                "formats": [column.kind.dtype for column in self.columns],
                "offsets": self._offsets,
                "itemsize": self.size,
            }
        )
        return layout

    def array(self, data: bytes | bytearray | memoryview) -> npt.NDArray[np.void]:
        """Structured array over the messages in `data`, back to back; no copy."""
        view: npt.NDArray[np.void] = _numpy().frombuffer(data, self.dtype)
        return view

    def blank(self, rows: int) -> bytearray:
        """`rows` messages back to back, with zero in every column."""
        return bytearray(self.pack([0] * len(self.columns))) * rows

    def well_formed(self, data: bytes) -> bool:
        """Whether every message in `data` has this layout: length, all keys, and valid enum values."""
        if len(data) % self.size:
            return False
        numpy = _numpy()
        raw = numpy.frombuffer(data, numpy.uint8).reshape(-1, self.size)
        key_places, keys, enum_places, members = self._fixed
        return bool((raw.take(key_places, axis=1) == keys).all() and (raw.take(enum_places, axis=1) < members).all())

    @cached_property
    def _fixed(self) -> tuple[npt.NDArray[Any], ...]:
        """Places and values of the keys' bytes; places and numbers of members of the enums."""
        places = [at for end, key in zip(self._offsets, self._keys, strict=True) for at in range(end - len(key), end)]
        array = _numpy().array
        return (
            array(places, "i8"),
            array(list(b"".join(self._keys)), "u1"),
            array(list(self._choices), "i8"),
            array(list(self._choices.values()), "u1"),
        )

    def repacked(self, data: bytes) -> bytes:
        """A message that another program encoded again without zeros, in the constant layout, bit for bit as packed.

        Raises ValueError for an unknown or repeated field, or an empty message.
        """
        widths = {
            number: struct.calcsize(column.kind.code)
            for number, column in zip(self._numbers, self.columns, strict=True)
        }
        found: dict[int, bytes] = {}
        for number, value in fields(data):
            raw = bytes([value & 0xFF]) if isinstance(value, int) else value
            if number in found or len(raw) != widths.get(number):
                raise ValueError(f"field {number} is not in {self.name}, or is there twice")
            found[number] = raw
        kept = zip(self._numbers, self._keys, strict=True)
        parts = [(key, found.get(number, bytes(widths[number])), number in found) for number, key in kept]
        if not found or len(data) != sum(len(key) + len(raw) for key, raw, there in parts if there):
            raise ValueError(f"a {self.name} of {len(data)} bytes is not valid")
        return b"".join(key + raw for key, raw, _ in parts)

    def descriptor(self) -> bytes:
        """FileDescriptorSet with this message and its enums, as MCAP requires."""
        return self._descriptor

    @cached_property
    def _descriptor(self) -> bytes:
        members = dict.fromkeys(column.kind.members for column in self.columns if column.kind.members)
        enums = b"".join(chunk(5, _enum(kind)) for kind in members)
        fields = [_field(number, column) for number, column in zip(self._numbers, self.columns, strict=True)]
        body = chunk(4, message(self.name.rpartition(".")[2], fields)) + enums
        return chunk(1, proto_file(f"{self.name}.proto", PACKAGE, body))


def _numpy() -> Any:
    """numpy, imported on the first read: the loop's process only packs, and dies faster without 80 MB more."""
    return import_module("numpy")


def _field(number: int, column: Column) -> bytes:
    members = column.kind.members
    return field(column.name, number, column.kind.type_number, f"{PACKAGE}.{members.__name__}" if members else "")


def _enum(members: type[IntEnum]) -> bytes:
    prefix = members.__name__.upper()  # proto3 enum values share one name space
    return enum(members.__name__, [(f"{prefix}_{member.name}", int(member)) for member in members])


INTERNALS: Final = ("c0", "c1", "c2", "c3")
"""Columns of a tick with the controller's own values."""
_D, _F = DOUBLE, FLOAT
_IN, _T = Role.INPUT, Role.TIMING

TICK: Final = Message(
    "Tick",
    "/abs/tick",
    (
        Column("time_ns", FIXED64, "ns", "monotonic clock when the board had been read", _IN),
        Column("tick", FIXED32, "1", "number of the exchange, from 0", _IN),
        Column("dt_s", _D, "s", "time since the previous sample", _IN),
        Column("wheel_count", SFIXED64, "{count}", "upper, braked wheel, unwrapped", _IN),
        Column("road_count", SFIXED64, "{count}", "lower wheel, the road, unwrapped", _IN),
        Column(
            "board_flags",
            FIXED32,
            "1",
            "bit set: " + ", ".join(f"{f.value} {f.name}" for f in BoardFlags),
            _IN,
        ),
        Column("stop_request", REASON, "1", "why somebody outside the decision asked to stop", _IN),
        Column("wheel_speed_rad_s", _D, "rad/s", "estimated speed of the braked wheel"),
        Column("road_speed_rad_s", _D, "rad/s", "estimated speed of the road wheel"),
        Column("slip", _D, "1", "estimated slip, 0..1"),
        Column("estimate_valid", BOOL, "1", "the estimator had enough samples"),
        Column("phase", PHASE, "1", "where the experiment stands"),
        Column("slip_reference", _D, "1", "reference slip while braking, else NaN"),
        Column("switching", _D, "1", "switching function: slip error, or the controller's own"),
        Column("torque_demand_nm", _D, "N.m", "brake torque that the law asks for, before any limit"),
        Column("drive_request", _D, "1", "drive duty that the sequence asks for"),
        Column("brake_request", _D, "1", "brake duty that the controller asks for"),
        Column("drive", _D, "1", "drive duty admitted by the guard, written at the next tick"),
        Column("brake", _D, "1", "brake duty admitted by the guard, written at the next tick"),
        Column("reason", REASON, "1", "why the outputs were taken away"),
        *(Column(name, _D, "", "controller internal, not declared") for name in INTERNALS),
        Column("late_us", _F, "us", "start of the tick minus its deadline", _T),
        Column("io_us", _F, "us", "duration of the exchange with the board", _T),
        Column("busy_us", _F, "us", "what the previous tick took after its exchange", _T),
        Column("skipped", FIXED32, "1", "whole periods left out before this tick", _T),
    ),
)
"""One tick. The columns are the fields of `signals.Tick`, in the same order."""

TRUTH: Final = Message(
    "Truth",
    "/sim/truth",
    (
        Column("time_ns", FIXED64, "ns", "monotonic clock, as in the tick", _IN),
        Column("wheel_speed_rad_s", _D, "rad/s", "true speed of the braked wheel", _IN),
        Column("road_speed_rad_s", _D, "rad/s", "true speed of the road wheel", _IN),
        Column("slip", _D, "1", "true slip", _IN),
        Column("brake_torque_nm", _D, "N.m", "torque that the brake can hold", _IN),
        Column("drive", _D, "1", "duty at the drive's terminals from now on", _IN),
        Column("brake", _D, "1", "duty at the brake's terminals from now on", _IN),
        Column("adhesion", _D, "1", "adhesion coefficient of the road at the true slip", _IN),
    ),
)
"""State of the simulated rig at each write of the host, with the new outputs; a real rig has none."""

if tuple(column.name for column in TICK.columns) != Tick._fields:
    raise TypeError("the columns of TICK must be the fields of signals.Tick")


def pack_tick(buffer: bytearray, offset: int, tick: Tick) -> None:
    """Record of `tick` into `buffer` at `offset`: `TICK.size` bytes."""
    TICK.pack_into(buffer, offset, tick)


PARAMETERS_TOPIC: Final = "/abs/params"
PARAMETERS_NAME: Final = f"{PACKAGE}.Params"


def parameters_descriptor() -> bytes:
    """Schema of `/abs/params`: map<string, double> values = 1; fixed32 tick = 2."""
    map_entry = chunk(7, integer(7, 1))  # the option that makes a repeated message a map
    entry = message("ValuesEntry", [field("key", 1, TEXT), field("value", 2, DOUBLE.type_number)]) + map_entry
    fields = [
        field("values", 1, MESSAGE, f"{PARAMETERS_NAME}.ValuesEntry", repeated=True),
        field("tick", 2, FIXED32.type_number),
    ]
    body = chunk(4, message("Params", fields) + chunk(3, entry))
    return chunk(1, proto_file(f"{PARAMETERS_NAME}.proto", PACKAGE, body))


LOG_TOPIC: Final = "/abs/event"
LOG_NAME: Final = "foxglove.Log"


def log_descriptor() -> bytes:
    """Schema of `foxglove.Log`, which viewers show as a log; fields as published by its owners."""
    stamp_file, stamp = "google/protobuf/timestamp.proto", "google.protobuf.Timestamp"
    stamp_fields = [field("seconds", 1, INT64), field("nanos", 2, INT32)]
    levels = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")
    level = enum("Level", [(name, number) for number, name in enumerate(levels)])
    fields = [
        field("timestamp", 1, MESSAGE, stamp),
        field("level", 2, ENUM, f"{LOG_NAME}.Level"),
        field("message", 3, TEXT),
        field("name", 4, TEXT),
        field("file", 5, TEXT),
        field("line", 6, FIXED32.type_number),
    ]
    log = chunk(3, stamp_file) + chunk(4, message("Log", fields) + chunk(4, level))
    return chunk(1, proto_file(stamp_file, "google.protobuf", chunk(4, message("Timestamp", stamp_fields)))) + chunk(
        1, proto_file("foxglove/Log.proto", "foxglove", log)
    )
