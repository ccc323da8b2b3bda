import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol import ProtocolError, open_board, open_board_reference
from firmware_protocol.open_board import (
    ARM,
    CLEAR,
    COMMAND,
    CONFIGURE,
    DISARM,
    HEAD_BYTES,
    HELLO,
    IDENTITY,
    LINES,
    MESSAGES,
    MOST_PAYLOAD_BYTES,
    OVERHEAD_BYTES,
    QUERY,
    REFUSAL,
    REPORT,
    STATUS,
    SYNC,
    Receiver,
    crc16,
    decode,
)

VECTORS = [
    (HELLO, {}, 0, "A5 01 00 00 AC FB"),
    (
        CONFIGURE,
        {"watchdog_ms": 20, "tick_hz": 2000, "stop_pins": 0x8001, "pwm_mode": 1, "pwm_prescaler": 2},
        1,
        "A5 02 08 01 14 D0 07 01 80 01 02 00 19 48",
    ),
    (ARM, {"answer": 0x1234 ^ 0x5AC3}, 2, "A5 03 02 02 F7 48 4C 3F"),
    (COMMAND, {"width0": 0x0123, "width1": 0x0FFF}, 255, "A5 04 04 FF 23 01 FF 0F B4 05"),
    (DISARM, {}, 0xA5, "A5 05 00 A5 23 C2"),
    (QUERY, {}, 3, "A5 06 00 03 5F 4E"),
    (CLEAR, {}, 4, "A5 07 00 04 88 09"),
    (
        IDENTITY,
        {
            "protocol": 1,
            "logic_version": 0x0B01,
            "name": "OPENABS",
            "date": "20261124",
            "unique_id": "E661A4D41723372B",
            "clock_hz": 1_000_000,
            "counters": 4,
            "pwms": 2,
        },
        0,
        (
            "A5 81 21 00 01 0B 01 4F 50 45 4E 41 42 53 00 32 30 32 36 31 31 32 34 E6 61 A4 D4 17 23 37 2B 40 42 0F 00"
            " 04 02 EF 17"
        ),
    ),
    (
        STATUS,
        {
            "state": 3,
            "trip": 1,
            "challenge": 0xBEEF,
            "watchdog_ms": 100,
            "tick_hz": 1000,
            "stop_pins": 2,
            "width0": 1,
            "width1": 2,
            "count0": -1,
            "count1": 2**31 - 1,
            "count2": -(2**31),
            "count3": 7,
            "clock": 0xFFFFFFFE,
            "trips": 3,
            "late": 4,
            "bad_frames": 5,
            "refused": 6,
            "pins": 0x0102,
            "pwm_mode": 1,
            "pwm_prescaler": 0x0203,
        },
        9,
        (
            "A5 83 2E 09 03 01 EF BE 64 E8 03 02 00 01 00 02 00 FF FF FF FF FF FF FF 7F 00 00 00 80 07 00 00 00 FE FF"
            " FF FF 03 00 04 00 05 00 06 00 02 01 01 03 02 8C 1C"
        ),
    ),
    (
        REPORT,
        {
            "tick": 0x01020304,
            "clock": 0x0A0B0C0D,
            "count0": -2,
            "count1": 3,
            "width0": 0x0FFF,
            "width1": 0,
            "state": 2,
            "trip": 0,
            "applied": 3,
            "late": 0x0100,
        },
        4,
        "A5 84 19 04 04 03 02 01 0D 0C 0B 0A FE FF FF FF 03 00 00 00 FF 0F 00 00 02 00 03 00 01 6E 2C",
    ),
    (REFUSAL, {"refused": 3, "reason": 3, "state": 1, "trip": 0}, 2, "A5 8F 04 02 03 03 01 00 41 63"),
]
FRAMES = [bytes.fromhex(text) for *_, text in VECTORS]


@pytest.mark.parametrize(("message", "values", "sequence", "text"), VECTORS, ids=lambda it: getattr(it, "name", None))
def test_frames_are_those_bytes_in_both_directions(message, values, sequence, text):
    frame = bytes.fromhex(text)
    assert message.encode(values, sequence=sequence).hex(" ").upper() == text
    assert decode(frame) == (message, {"sequence": sequence, **values})


def test_every_kind_has_a_vector():
    assert [message for message, *_ in VECTORS] == list(MESSAGES.values())


def test_the_crc_is_the_usual_one():
    assert crc16(b"123456789") == 0x29B1  # the catalogues' check value of CRC-16/CCITT-FALSE


def by_bits(data):
    """Compute the CRC from its definition."""
    crc = 0xFFFF
    for byte in data:
        for bit in range(7, -1, -1):
            out = crc >> 15 ^ byte >> bit & 1
            crc = crc << 1 & 0xFFFF ^ (0x1021 if out else 0)
    return crc


@given(st.binary(max_size=64))
def test_the_crc_is_the_polynomials(data):
    assert crc16(data) == by_bits(data)


def test_payloads_fit_into_the_buffers():
    assert all(message.payload_bytes <= MOST_PAYLOAD_BYTES for message in MESSAGES.values())


def flipped(frame, *bits):
    damaged = bytearray(frame)
    for bit in bits:
        damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


def received(data, *, from_host):
    return Receiver(from_host=from_host).feed(data)


@pytest.mark.parametrize("frame", FRAMES, ids=[message.name for message, *_ in VECTORS])
def test_every_flipped_bit_and_every_pair_nearby_is_found(frame):
    message = MESSAGES[frame[1]]
    for bit in range(8 * len(frame)):
        for other in [(), *((bit + step,) for step in range(1, 18) if bit + step < 8 * len(frame))]:
            damaged = flipped(frame, bit, *other)
            assert received(damaged, from_host=message.from_host) == []
            with pytest.raises(ProtocolError):
                message.decode(damaged)


@given(st.data())
def test_three_flipped_bits_are_found(data):
    frame = data.draw(st.sampled_from(FRAMES))
    bits = data.draw(st.sets(st.integers(0, 8 * len(frame) - 1), min_size=3, max_size=3))
    assert received(flipped(frame, *bits), from_host=MESSAGES[frame[1]].from_host) == []


host_frames = st.sampled_from([frame for frame in FRAMES if frame[1] < 0x80])


@given(st.lists(host_frames, max_size=5), st.binary(max_size=20), host_frames)
def test_frames_arrive_in_order_and_the_line_recovers_after_noise(frames, noise, last):
    receiver = Receiver(from_host=True)
    assert receiver.feed(b"".join(frames)) == frames
    assert receiver.bad_frames == 0
    receiver.feed(noise)
    receiver.drop()  # silence
    assert receiver.feed(last) == [last]


@given(st.binary(max_size=300))
@example(bytes([SYNC, SYNC, *FRAMES[0]]))
def test_what_a_receiver_returns_can_be_decoded(data):
    for frame in received(data, from_host=True):
        message, values = decode(frame)
        assert message.from_host
        assert (
            message.encode({k: v for k, v in values.items() if k != "sequence"}, sequence=values["sequence"]) == frame
        )


@pytest.mark.parametrize("cut", range(1, HEAD_BYTES))
def test_a_byte_that_ends_a_frame_may_begin_one(cut):
    receiver = Receiver(from_host=True)
    begun = FRAMES[1][:cut]
    expected = [FRAMES[0]] if cut < HEAD_BYTES - 1 else []  # behind the length, SYNC may be a sequence
    assert receiver.feed(begun + FRAMES[0]) == expected
    assert receiver.unfinished is not bool(expected)


def test_each_side_receives_only_the_others_kinds():
    report, hello = REPORT.encode(), HELLO.encode()
    assert received(report + hello, from_host=True) == [hello]
    assert received(hello + report, from_host=False) == [report]


def test_damage_is_counted():
    receiver = Receiver(from_host=True)
    receiver.feed(flipped(FRAMES[0], 30) + bytes([SYNC, 0x7F]) + FRAMES[3][:5])
    assert receiver.bad_frames == 2
    receiver.drop()
    receiver.drop()
    assert (receiver.bad_frames, receiver.unfinished) == (3, False)


@pytest.mark.parametrize(
    ("frame", "problem"),
    [
        (b"", "not the beginning"),
        (bytes([SYNC, 0x55, 0, 0, 0, 0]), "a5 55: not the beginning"),
        (FRAMES[0][:-1], "5 bytes, must be 6"),
        (bytes([0xA4, *FRAMES[0][1:]]), "command byte 0xA4"),
        (bytes([*FRAMES[0][:-1], 0]), "CRC"),
        (bytes([SYNC, 0x01, 9, 0, 0, 0]), "length = 0x0009, must be 0x0000"),
    ],
)
def test_a_damaged_frame_is_refused_with_the_reason(frame, problem):
    with pytest.raises(ProtocolError, match=problem):
        decode(frame)


def test_a_value_out_of_range_is_named():
    with pytest.raises(ProtocolError, match=r"width0 = 65536: must be an integer in 0\.\.65535"):
        COMMAND.encode({"width0": 65536})


@pytest.mark.parametrize(
    ("line", "us"),
    [
        ("serial line, 2000000 baud", (31 * 10 / 2, 10 * 10 / 2)),
        ("USB full speed", ((31 + 13) * 8 / 12, (10 + 13) * 8 / 12)),
        ("USB high speed", ((31 + 55) * 8 / 480, (10 + 55) * 8 / 480)),
    ],
)
def test_the_cost_of_a_tick(line, us):
    (found,) = [one for one in LINES if one.name == line]
    assert open_board_reference.cost_us(found) == pytest.approx(us)


@pytest.mark.parametrize(("line", "most"), [("USB full speed", 19), ("USB high speed", 13)])
def test_full_transfers_fill_a_frame_as_the_standard_says(line, most):  # tables 5-9 and 5-10 of USB 2.0
    (found,) = [one for one in LINES if one.name == line]
    frame_us = 1000 if line == "USB full speed" else 125
    assert frame_us // found.microseconds(found.packet_bytes) == most


def test_the_document_has_every_field_where_the_frames_have_it():
    document = open_board_reference.section()
    for message in MESSAGES.values():
        (part,) = [part for part in document.split("\n#### ")[1:] if part.startswith(f"{message.name}, ")]
        rows = [line.split(" | ") for line in part.splitlines() if line.startswith("| `")]
        assert [(row[0][3:-1], int(row[1])) for row in rows] == [
            (field.name, min(part.word for part in (field.read or field.send))) for field in message.payload
        ]
        assert f"{OVERHEAD_BYTES + message.payload_bytes} bytes" in part
    assert f"0x{open_board.LOGIC_VERSION:04X}" in document
