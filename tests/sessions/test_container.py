"""Messages of a chunk come in runs, and the runs are the messages."""

import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from inteco_abs.sessions.container import DamagedError, Entry, FixedRun, Opcode, chunk_parts, fields, text_map

MESSAGES = st.lists(st.tuples(st.integers(0, 3), st.sampled_from([0, 1, 7, 255, 256, 70_000]), st.integers(1, 80)))


def message(channel, size, number):
    content = struct.pack("<HIQQ", channel, number, number * 1000, 0) + bytes([number % 256]) * size
    return struct.pack("<BQ", Opcode.MESSAGE, len(content)) + content


@pytest.mark.untraced
@given(MESSAGES, st.booleans())
@example([(0, 0, 1), (1, 0, 1), (0, 0, 1), (1, 0, 1)], False)
def test_runs_are_the_messages_each_channel_in_order(groups, between):
    written = []
    for channel, size, count in groups:
        written += [(channel, size)] * (count if size < 1000 else 1)
    raw, metadata = b"", []
    for number, (channel, size) in enumerate(written):
        raw += message(channel, size, number)
        if between and number % 5 == 0:
            metadata.append(number)
            raw += struct.pack("<BQ", Opcode.METADATA, 3) + b"abc"
    found, last, first = {}, {}, -1
    for part in chunk_parts(raw):
        if isinstance(part, FixedRun):
            assert part.rows["sequence"][0] > first
            first = int(part.rows["sequence"][0])
            for row in part.rows:
                number = int(row["sequence"])
                assert number > last.get(part.channel, -1)
                last[part.channel] = number
                found[number] = part.channel, row["data"].dtype.itemsize
                assert row["channel"] == part.channel
                assert row["log_time"] == 1000 * number
                assert set(bytes(row["data"])) <= {number % 256}
        else:
            assert (part.opcode, bytes(part.data)) == (Opcode.METADATA, b"abc")
            assert sorted(found) == list(range(metadata.pop(0) + 1))
    assert [found[number] for number in sorted(found)] == written
    assert not metadata


@given(MESSAGES, st.data())
def test_a_chunk_that_ends_within_a_record_is_damaged(groups, data):
    raw = b"".join(message(channel, min(size, 300), 1) for channel, size, _ in groups)
    ends, at = {0}, 0
    for channel, size, _ in groups:
        at += len(message(channel, min(size, 300), 1))
        ends.add(at)
    cut = data.draw(st.integers(0, len(raw)))
    if cut in ends:
        assert all(isinstance(part, FixedRun) for part in chunk_parts(raw[:cut]))
    else:
        with pytest.raises(DamagedError):
            list(chunk_parts(raw[:cut]))


@given(st.sampled_from([opcode for opcode in Opcode if opcode != Opcode.MESSAGE]), st.binary(max_size=120))
def test_any_bytes_decode_to_a_record_or_are_damage(opcode, content):
    try:
        found = fields(opcode, memoryview(content), exact=True)
    except DamagedError:
        return
    assert sum(
        len(part.encode() if isinstance(part, str) else part) for part in found if not isinstance(part, int)
    ) <= (len(content))


@given(st.dictionaries(st.text(max_size=5), st.text(max_size=5), max_size=4), st.integers(0, 60))
def test_a_map_of_texts_is_what_was_written_or_damage(facts, cut):
    raw = b"".join(struct.pack("<I", len(text.encode())) + text.encode() for pair in facts.items() for text in pair)
    assert text_map(memoryview(raw)) == facts
    try:
        found = text_map(memoryview(raw[:cut]))
    except DamagedError:
        return
    assert found.items() <= facts.items()


def test_a_record_knows_where_it_ends():
    entry = Entry(Opcode.HEADER, 109, memoryview(bytes(20)))
    assert (entry.start, entry.end) == (100, 129)


class TestStretches:
    RAW = message(7, 1, 0) + message(7, 0, 1) + message(7, 3, 2)

    def parts(self, raw):
        return list(chunk_parts(raw, {7}))

    def test_messages_of_many_sizes_are_one_run(self):
        (stretch,) = self.parts(self.RAW)
        assert (stretch.channel, stretch.number) == (7, 3)
        assert list(stretch.messages()) == [(0, 0, b"\0"), (1, 1000, b""), (2, 2000, b"\2\2\2")]

    def test_another_channel_or_another_record_ends_it(self):
        other, schema = message(8, 1, 0), struct.pack("<BQ", Opcode.SCHEMA, 30) + bytes([7, 0]) * 15
        first, run, second, record, third = self.parts(self.RAW + other + self.RAW + schema + self.RAW)
        assert [stretch.number for stretch in (first, second, third)] == [3, 3, 3]
        assert (run.channel, record.opcode) == (8, Opcode.SCHEMA)

    @pytest.mark.parametrize(
        ("end", "problem"),
        [
            (b"\5", "1 bytes after its last record"),
            (message(7, 9, 0)[:-1], "which leaves it"),
            (struct.pack("<BQ", Opcode.MESSAGE, 21) + bytes([7, 0]) * 11, "less than a message"),
        ],
    )
    def test_what_is_not_a_message_behind_it_is_damage(self, end, problem):
        with pytest.raises(DamagedError, match=problem):
            self.parts(self.RAW + end)
