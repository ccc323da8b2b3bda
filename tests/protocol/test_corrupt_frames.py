import random
from collections import Counter

import pytest

from firmware_protocol import ProtocolError, rtdac_usb, rtdac_usb2

FRAMES = 400_000
SHARES = 4
"""Parts that the long test is cut into, so that it uses several cores."""
WHOLE_DECODES = 16
"""One in so many accepted frames of the long test has each of its values looked at."""


class Usb2:
    """RT-DAC/USB2."""

    read, send = rtdac_usb2.READ, rtdac_usb2.SEND
    command = b"\x0f\x8f"
    header = b""
    decode_read = staticmethod(rtdac_usb2.decode_read)
    decode_send = staticmethod(rtdac_usb2.decode_send)


class Usb:
    """RT-DAC/USB with one of its logics."""

    command = b"\x81"

    def __init__(self, logic):
        self.logic = logic
        self.read, self.send = rtdac_usb.logic_of(logic).read, rtdac_usb.logic_of(logic).send
        self.header = logic.to_bytes(2, "little")

    def decode_read(self, frame):
        return rtdac_usb.decode_read(frame, logic=self.logic)

    def decode_send(self, frame):
        return rtdac_usb.decode_send(frame, logic=self.logic)


BOARDS = [
    pytest.param(Usb2(), id="usb2"),
    pytest.param(Usb(0x0111), id="usb-0111"),
    pytest.param(Usb(0x0112), id="usb-0112"),
]


def sides(board):
    """Table, decoder, and the bytes that any frame it accepts begins with, by direction."""
    return (board.read, board.decode_read, board.header), (board.send, board.decode_send, board.command)


def filled(table, seed):
    """A frame of `table` with all its fields set to something."""
    generator = random.Random(seed)
    values = {}
    for name, (field, layout) in table.fields.items():
        width = sum(part.width for part in layout)
        values[name] = table.fixed.get(name, field.from_bits(generator.getrandbits(width) | 1, layout))
    return table.encode(values)


def check_values(table, values):
    for name, (field, layout) in table.fields.items():
        width = sum(part.width for part in layout)
        assert 0 <= field.to_bits(values[name], layout) < 1 << width, name


@pytest.mark.untraced
@pytest.mark.parametrize("board", BOARDS)
def test_every_flipped_bit_is_refused_or_changes_one_field_within_its_range(board):
    for table, decode, _ in sides(board):
        frame = filled(table, 1)
        before = decode(frame)
        refused = Counter()
        for bit in range(8 * len(frame)):
            flipped = bytearray(frame)
            flipped[bit // 8] ^= 1 << bit % 8
            try:
                after = decode(flipped)
            except ProtocolError:
                refused[bit // 8] += 1
                continue
            changed = {name: value for name, value in after.items() if before[name] != value}
            assert len(changed) <= 1
            for name, value in changed.items():
                field, layout = table.fields[name]
                assert (field.to_bits(value, layout) ^ field.to_bits(before[name], layout)).bit_count() == 1
        assert refused == refusals(board, table)


def refusals(board, table):
    """By byte, how many of its 8 flipped bits must be refused."""
    if table is board.read:
        return dict.fromkeys(range(len(board.header)), 8)
    word = len(board.command)
    marks = range(2 * word - 1, table.size, word)  # last byte of each data word
    return {**dict.fromkeys(range(word), 8), **dict.fromkeys(marks, 1)}


@pytest.mark.parametrize("board", BOARDS)
def test_every_truncation_and_extension_is_refused(board):
    for table, decode, _ in sides(board):
        frame = filled(table, 2)
        assert decode(frame)
        for length in [*range(table.size), *range(table.size + 1, 2 * table.size)]:
            with pytest.raises(ProtocolError, match=f"{length} bytes, must be {table.size}"):
                decode((frame + frame)[:length])


@pytest.mark.parametrize("board", BOARDS)
def test_every_frame_of_the_other_side_is_refused_as_a_send_frame(board):
    with pytest.raises(ProtocolError, match="command"):
        board.decode_send(filled(board.read, 3))


def corrupted(generator, valid):
    """Endless frames: valid ones with up to 8 bits flipped, cut, or replaced by noise of any length."""
    size = len(valid[0])
    while True:
        kind = generator.random()
        if kind < 0.5:
            frame = bytearray(generator.choice(valid))
            for _ in range(generator.randint(0, 8)):
                frame[generator.randrange(size)] ^= 1 << generator.randrange(8)
            yield bytes(frame)
        elif kind < 0.7:
            yield generator.choice(valid)[: generator.randrange(size)]
        elif kind < 0.8:
            yield generator.choice(valid)[generator.randrange(size) :]
        else:
            length = size if kind < 0.95 else generator.randrange(2 * size)
            yield generator.randbytes(length)


@pytest.mark.long
@pytest.mark.parametrize("share", range(SHARES))
@pytest.mark.parametrize("board", BOARDS)
def test_400_000_corrupt_frames_are_refused_or_decoded_within_range(board, share):
    directions = sides(board)
    valid = [filled(table, seed) for table, *_ in directions for seed in range(4)]
    accepted = Counter()
    frames = corrupted(random.Random(share), valid)
    for _ in range(FRAMES // SHARES):
        frame = next(frames)
        for table, decode, start in directions:
            try:
                values = decode(frame)
            except ProtocolError:
                continue
            assert len(frame) == table.size
            assert frame.startswith(start)
            accepted[table.title] += 1
            if accepted[table.title] % WHOLE_DECODES == 0:
                check_values(table, values)
    assert all(accepted[table.title] > 1000 for table, *_ in directions)
