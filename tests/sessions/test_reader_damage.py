"""A damaged file is refused, or read up to the damage and called incomplete, or is what it was.

Sweeps over every bit take long; `test_broken_files` draws cuts and changes from all of a file.
"""

import zlib
from itertools import product

import pytest

from inteco_abs.errors import SessionError
from inteco_abs.sessions import TICK, read_session

CHUNK, MESSAGE, ATTACHMENT, DATA_END = 6, 5, 9, 15
TICK_CHANNEL, TRUTH_CHANNEL = 1, 4


def lies(session, whole):
    """What a session claims that the undamaged one does not say."""
    if session.incomplete:
        found = {"ticks": session.payload, "truth": session.truth.tobytes()}
        return [name for name, data in found.items() if contents(whole)[name][: len(data)] != data]
    return [name for name, value in contents(session).items() if value != contents(whole)[name]]


def contents(session):
    return {
        "ticks": session.payload,
        "rows": session.ticks.tobytes(),
        "truth": session.truth.tobytes(),
        "metadata": session.metadata,
        "attachments": session.attachments,
        "channels": session.channels,
        "events": session.events,
    }


class Reading:
    """Reads variants of one file and remembers every damaged one that was accepted."""

    def __init__(self, run, altered) -> None:
        self.data, self.whole, self.altered = run.path.read_bytes(), run.session, altered
        self.wrong, self.refused, self.incomplete, self.accepted = [], 0, 0, 0

    def read(self, data, what):
        try:
            session = read_session(self.altered(data))
        except SessionError:
            self.refused += 1
            return None
        except Exception as error:  # noqa: BLE001  which variant made it fail says more than the traceback
            self.wrong.append((what, repr(error)))
            return None
        if session.incomplete:
            self.incomplete += 1
        else:
            self.accepted += 1
        wrong = lies(session, self.whole)
        if wrong:
            self.wrong.append((what, wrong))
        return session

    def flip(self, offset, bit):
        data = bytearray(self.data)
        data[offset] ^= 1 << bit
        self.read(bytes(data), (offset, bit))


@pytest.fixture
def reading(altered):
    return lambda run: Reading(run, altered)


def boundaries(container, data):
    """Offsets at which some record begins or ends."""
    records = container.split(data)
    return sorted({at for record in records for at in (record.at, record.end)})


def messages_in(container, chunk, channel):
    """Messages of one channel in a chunk record."""
    inner = container.split(container.unpack(chunk), 0) if chunk.opcode == CHUNK else []
    return [e for e in inner if e.opcode == MESSAGE and e.content[:2] == channel.to_bytes(2, "little")]


def whole_ticks(container, data, end):
    """Ticks in the chunks that lie whole before `end`."""
    chunks = [record for record in container.split(data) if record.opcode == CHUNK and record.end <= end]
    return sum(len(messages_in(container, chunk, TICK_CHANNEL)) for chunk in chunks)


@pytest.mark.untraced
def test_a_cut_file_keeps_the_ticks_of_every_whole_chunk(reading, container, chunked):
    variants = reading(chunked)
    middles = [(record.at + record.end) // 2 for record in container.split(variants.data) if record.opcode == CHUNK]
    ends = boundaries(container, variants.data) + middles
    counts = {}
    for end in ends:
        session = variants.read(variants.data[:end], end)
        counts[end] = None if session is None else len(session.ticks)
        assert session is None or session.incomplete, end
    assert variants.wrong == []
    whole = {end: whole_ticks(container, variants.data, end) for end in ends if end >= len(container.magic)}
    assert max(whole.values()) == chunked.stop.card["ticks"]
    assert counts == whole


def test_a_file_with_bytes_after_its_end_is_not_called_whole_and_has_no_wrong_tick(reading, tiny):
    variants = reading(tiny)
    session = variants.read(variants.data + b"\0" * 100, "tail")
    assert session.incomplete
    assert session.payload == variants.whole.payload
    assert variants.wrong == []


@pytest.mark.long
@pytest.mark.untraced
def test_every_bit_of_the_first_200_bytes(reading, tiny):
    variants = reading(tiny)
    for offset, bit in product(range(200), range(8)):
        variants.flip(offset, bit)
    assert variants.wrong == []
    assert variants.refused > 1000


@pytest.mark.long
@pytest.mark.untraced
def test_every_bit_of_every_record_head_in_the_data(reading, container, tiny):
    variants = reading(tiny)
    for record, place, bit in product(container.split(variants.data), range(9), range(8)):
        variants.flip(record.at + place, bit)
        if record.opcode == DATA_END and (place, bit) == (8, 7):
            break
    assert variants.wrong == []
    assert variants.refused > 600
    assert not variants.incomplete


@pytest.mark.long
@pytest.mark.untraced
def test_the_index_after_the_data_is_not_trusted(reading, container, tiny):
    variants = reading(tiny)
    (end,) = (record.end for record in container.split(variants.data) if record.opcode == DATA_END)
    for offset in range(end, len(variants.data) - len(container.magic), 7):
        variants.flip(offset, offset % 8)
    assert variants.wrong == []
    assert (variants.refused, variants.incomplete) == (0, 0)


@pytest.mark.long
@pytest.mark.untraced
def test_every_bit_of_every_fixed_field_of_a_chunk(reading, container, tiny):
    variants = reading(tiny)
    chunks = [record for record in container.split(variants.data) if record.opcode == CHUNK]
    for record, place, bit in product(chunks, range(48), range(8)):
        variants.flip(record.at + 9 + place, bit)
    assert variants.wrong == []
    assert variants.accepted == 0


@pytest.mark.long
@pytest.mark.untraced
def test_every_bit_around_the_attachment(reading, container, tiny):
    variants = reading(tiny)
    record = next(record for record in container.split(variants.data) if record.opcode == ATTACHMENT)
    for place, bit in product([*range(64), *range(len(record.content) - 8, len(record.content))], range(8)):
        variants.flip(record.at + 9 + place, bit)
    assert variants.wrong == []
    assert variants.accepted == 0


def test_a_wrong_bit_in_a_tick_of_a_cut_file_is_found_by_the_checksum_of_its_chunk(container, altered, tiny):
    records = container.split(tiny.path.read_bytes())
    at = next(at for at, record in enumerate(records) if messages_in(container, record, TICK_CHANNEL))
    raw = container.unpack(records[at])
    wrong = bytearray(raw)
    wrong[raw.find(tiny.session.payload[: TICK.size]) + TICK.size - 1] ^= 1

    def read(data):
        return read_session(altered(cut_after(container, records[:at], container.chunk(data, len(raw), "", crc))))

    crc = zlib.crc32(raw)
    assert len(read(raw).ticks) > 10
    with pytest.raises(SessionError, match="fails its checksum"):
        read(bytes(wrong))


def cut_after(container, before, chunk):
    """A file that ends after `chunk`, without anything that says how the run ended."""
    facts = [record for record in before if b"inteco_abs.integrity" not in record.content]
    return container.magic + b"".join(map(bytes, [*facts, chunk]))


def test_a_wrong_bit_in_an_attachment_is_found_by_its_own_checksum(container, altered, tiny):
    records = container.split(tiny.path.read_bytes())
    at = next(at for at, record in enumerate(records) if record.opcode == ATTACHMENT)
    content = records[at].content
    wrong = content.replace(b"sim_usb2", b"sim_usb3")
    assert wrong != content
    records[at] = container.record(ATTACHMENT, wrong)
    with pytest.raises(SessionError, match=r"config\.toml.* fails its checksum"):
        read_session(altered(container.join(records)))


def without_the_last(container, data, channel):
    """The file without the last message of a channel, every checksum right."""
    records = container.split(data)
    last = max(at for at, r in enumerate(records) if r.opcode == CHUNK and messages_in(container, r, channel))
    lost = messages_in(container, records[last], channel)[-1]
    raw = b"".join(bytes(e) for e in container.split(container.unpack(records[last]), 0) if e != lost)
    records[last] = container.chunk(raw, len(raw), "")
    return container.join(records)


def test_a_file_that_lost_a_tick_is_refused(container, altered, tiny):
    path = altered(without_the_last(container, tiny.path.read_bytes(), TICK_CHANNEL))
    with pytest.raises(SessionError, match="do not match the hash"):
        read_session(path)


def test_a_file_that_lost_a_truth_keeps_its_ticks(container, altered, tiny):
    session = read_session(altered(without_the_last(container, tiny.path.read_bytes(), TRUTH_CHANNEL)))
    assert session.payload == tiny.session.payload
    assert session.truth.tobytes() == tiny.session.truth[:-1].tobytes()
