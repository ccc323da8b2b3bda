import math
import struct

import numpy as np
import pytest
from google.protobuf.empty_pb2 import Empty
from google.protobuf.unknown_fields import UnknownFieldSet
from hypothesis import example, given
from hypothesis import strategies as st

from inteco_abs.sessions import TICK, TRUTH, pack_tick
from inteco_abs.signals import BoardFlags, Phase, Reason, Tick

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

NAN = math.nan
LARGEST, SMALLEST, DENORMAL = 1.7976931348623157e308, 2.2250738585072014e-308, 5e-324
FLOAT_LARGEST, FLOAT_DENORMAL = 3.4028234663852886e38, 1.401298464324817e-45
STRATEGIES = {
    "d": st.one_of(st.floats(), st.sampled_from([NAN, math.inf, -math.inf, -0.0, DENORMAL, LARGEST])),
    "f": st.floats(width=32, allow_nan=False) | st.just(NAN),
    "Q": st.integers(0, (1 << 64) - 1),
    "q": st.integers(-(1 << 63), (1 << 63) - 1),
    "I": st.integers(0, (1 << 32) - 1),
    "?": st.booleans(),
}
LOWEST = {"d": -0.0, "f": -0.0, "Q": 0, "q": -(1 << 63), "I": 0, "?": False, "B": 0}
HIGHEST = {"d": LARGEST, "f": FLOAT_LARGEST, "Q": (1 << 64) - 1, "q": (1 << 63) - 1, "I": (1 << 32) - 1, "?": True}
ODD = {**HIGHEST, "d": NAN, "f": NAN}
UNBOUNDED = {**HIGHEST, "d": -math.inf, "f": -math.inf}
TINIEST = {**LOWEST, "d": DENORMAL, "f": FLOAT_DENORMAL, "q": -1}
TINIEST_BUT_TRUE = {**HIGHEST, "d": DENORMAL, "f": FLOAT_DENORMAL, "q": -1}
SMALL = {**LOWEST, "d": -SMALLEST, "f": -1.1754943508222875e-38, "q": 1}


def row_of(message, values):
    """A row with the same value in every column of a kind, and the last member in every enum."""
    return [max(c.kind.members) if c.kind.members else values[c.kind.code] for c in message.columns]


def rows(message):
    """Strategy for the values of one message, one per column."""
    return st.tuples(
        *(st.sampled_from(c.kind.members) if c.kind.members else STRATEGIES[c.kind.code] for c in message.columns)
    )


def exact(message, values):
    """Bits of every value, in its own width."""
    return [struct.pack("<" + column.kind.code, value) for column, value in zip(message.columns, values, strict=True)]


def tags_of(data):
    return [(field.field_number, field.wire_type) for field in UnknownFieldSet(Empty.FromString(data))]


def extremes(test):
    for values in (LOWEST, HIGHEST, ODD, UNBOUNDED, TINIEST, SMALL):
        test = example(values=row_of(TICK, values))(test)
    return test


@pytest.fixture(scope="module")
def tick_class(message_class):
    return message_class(TICK.descriptor(), TICK.name)


@pytest.fixture(scope="module")
def truth_class(message_class):
    return message_class(TRUTH.descriptor(), TRUTH.name)


@extremes
@given(values=rows(TICK))
def test_official_parser_reads_the_same_bits_in_every_field(tick_class, values):
    parsed = tick_class.FromString(TICK.pack(values))
    assert exact(TICK, [getattr(parsed, column.name) for column in TICK.columns]) == exact(TICK, values)


@given(values=rows(TRUTH))
def test_official_parser_reads_the_same_bits_in_every_field_of_the_truth(truth_class, values):
    parsed = truth_class.FromString(TRUTH.pack(values))
    assert exact(TRUTH, [getattr(parsed, column.name) for column in TRUTH.columns]) == exact(TRUTH, values)


@extremes
@given(values=rows(TICK))
def test_layout_is_the_same_for_all_values(values):
    data = TICK.pack(values)
    assert len(data) == TICK.size
    assert tags_of(data) == [(number, column.kind.wire_type) for number, column in enumerate(TICK.columns, 1)]


@pytest.mark.parametrize(
    "values", [HIGHEST, ODD, UNBOUNDED, TINIEST_BUT_TRUE], ids=["highest", "nan", "inf", "tiniest"]
)
def test_official_serialiser_writes_the_same_where_no_field_is_zero(tick_class, values):
    data = TICK.pack(row_of(TICK, values))
    assert tick_class.FromString(data).SerializeToString(deterministic=True) == data


def test_zeros_are_written_which_the_official_serialiser_leaves_out(tick_class):
    data = TICK.pack([0] * len(TICK.columns))
    assert len(data) == TICK.size
    assert tick_class.FromString(data).SerializeToString() == b""


@extremes
@given(values=rows(TICK))
def test_numpy_reads_the_same_bits_and_packing_them_again_changes_nothing(values):
    data = TICK.pack(values)
    (row,) = TICK.array(data).tolist()
    assert exact(TICK, row) == exact(TICK, values)
    assert TICK.pack(row) == data


@given(messages=st.lists(rows(TICK), min_size=2, max_size=4))
def test_messages_back_to_back_are_rows_of_one_array(messages):
    data = b"".join(map(TICK.pack, messages))
    assert [exact(TICK, row) for row in TICK.array(data).tolist()] == [exact(TICK, values) for values in messages]
    assert TICK.well_formed(data)


def test_array_does_not_copy():
    data = bytes(TICK.pack(row_of(TICK, HIGHEST)) * 3)
    assert np.shares_memory(TICK.array(data), np.frombuffer(data, np.uint8))


def test_pack_tick_writes_its_own_bytes_only():
    tick = Tick(*row_of(TICK, HIGHEST))._replace(board_flags=BoardFlags.STALE, phase=Phase.FAULT, reason=Reason.NONE)
    buffer = bytearray(b"\xa5" * (TICK.size + 20))
    pack_tick(buffer, 7, tick)
    assert buffer == b"\xa5" * 7 + TICK.pack(tick) + b"\xa5" * 13


@pytest.mark.parametrize("size", [1, TICK.size - 1, TICK.size + 1, 2 * TICK.size - 1])
def test_a_length_that_is_not_a_multiple_is_not_well_formed(size):
    assert not TICK.well_formed((TICK.pack(row_of(TICK, LOWEST)) * 2)[:size])


def test_a_wrong_bit_in_any_tag_of_any_message_is_not_well_formed():
    data = TICK.pack(row_of(TICK, HIGHEST)) * 2
    values = {at for offset, width in spans() for at in range(offset, offset + width)}
    tags = [at for at in range(TICK.size) if at not in values]
    assert len(tags) == 15 + 2 * (len(TICK.columns) - 15)  # fields 1..15 have a tag of one byte, others of two
    for start in (0, TICK.size):
        for at in tags:
            wrong = bytearray(data)
            wrong[start + at] ^= 1
            assert not TICK.well_formed(bytes(wrong)), (start, at)


def spans():
    """(offset, width) of the value of every column."""
    return [(TICK.dtype.fields[name][1], TICK.dtype.fields[name][0].itemsize) for name in TICK.dtype.names]


@given(values=rows(TICK))
def test_values_of_some_columns_are_taken_out_of_messages_without_the_others(values):
    names = ("dt_s", "tick", "reason", "skipped")  # in any order, they come in that of the columns
    taken = [TICK.columns.index(column) for column in TICK.columns if column.name in names]
    (found, again) = TICK.values(TICK.pack(values) * 2, names)
    packed = struct.Struct("<" + "".join(TICK.columns[i].kind.code for i in taken))
    assert packed.pack(*found) == packed.pack(*again) == packed.pack(*(values[i] for i in taken))


@given(values=rows(TICK))
def test_an_array_of_rows_has_the_values_of_the_messages(values):
    found, expected = TICK.array_of([values, values]), TICK.array(TICK.pack(values) * 2)
    for name in expected.dtype.names:
        assert found[name].tobytes() == expected[name].tobytes()
    found["tick"][1] = 7  # one's own
    assert found["tick"].tolist() == [expected["tick"][0], 7]


@pytest.mark.parametrize("name", ["phase", "reason", "stop_request", "estimate_valid"])
def test_a_tick_with_a_value_outside_its_enum_is_not_a_tick(name):
    number = next(at for at, column in enumerate(TICK.columns) if column.name == name)
    members = TICK.columns[number].kind.members or (False, True)
    values = row_of(TICK, SMALL)
    for value, known in ((len(members) - 1, True), (len(members), False), (255, False)):
        data = bytearray(TICK.pack(values))
        data[TICK.dtype.fields[name][1]] = value
        assert TICK.well_formed(bytes(data)) is known
