import pytest

from firmware_protocol.rtdac_usb import decode_read, decode_send, encode_read, encode_send, logic_of

# data byte n: value. READ frames have byte n at n, SEND frames at n + 1 behind the command.
READ_COMMON = [
    ("application_name", {3: 0x45, 4: 0x44, 5: 0x43, 6: 0x42, 7: 0x41}, "ABCDE"),
    ("pin_mode", {8: 0x03}, 3),
    ("pin_direction", {9: 0xFF, 10: 0xFF, 11: 0xFF, 12: 0x03}, 0x3FFFFFF),
    ("pin_direction", {9: 0x60, 10: 0x30, 11: 0x03, 12: 0x00}, 0x0033060),
    ("pin_output", {13: 0x01, 14: 0x02, 15: 0x04, 16: 0x02}, 0x2040201),
    ("pin_input", {17: 0x34, 18: 0x12, 19: 0x56, 20: 0x01}, 0x1561234),
    ("pwm0_prescaler", {21: 0xCD, 22: 0xAB}, 0xABCD),
    ("pwm0_mode", {23: 0x01}, 1),
    ("pwm0_width", {24: 0xFF, 25: 0x0F}, 4095),
    ("pwm1_prescaler", {26: 0xFF, 27: 0xFF}, 0xFFFF),
    ("pwm1_mode", {28: 0x01}, 1),
    ("pwm1_width", {29: 0x00, 30: 0x01}, 256),
    ("ad0_gain", {93: 0x04}, 4),
    ("ad1_gain", {93: 0x30}, 3),
    ("ad2_gain", {94: 0x02}, 2),
    ("ad15_gain", {100: 0x10}, 1),
    ("ad0_result", {101: 0xFF, 102: 0xFF}, 0xFFFF),
    ("ad15_result", {131: 0x34, 132: 0x12}, 0x1234),
    ("da0_output", {133: 0x00, 134: 0x20}, 8192),
    ("da3_output", {139: 0xFF, 140: 0x3F}, 16383),
]

READ_0111 = [
    ("pin_mode", {8: 0x1F}, 31),
    ("pwm2_prescaler", {31: 0x41, 32: 0x00}, 65),
    ("pwm2_mode", {33: 0x01}, 1),
    ("pwm2_width", {34: 0x80, 35: 0x00}, 128),
    ("pwm3_prescaler", {36: 0x01, 37: 0x80}, 0x8001),
    ("pwm3_mode", {38: 0x01}, 1),
    ("pwm3_width", {39: 0xFF, 40: 0x0F}, 4095),
    ("encoder_reset", {41: 0x0F}, 15),
    ("encoder_index_active", {42: 0x08}, 8),
    ("encoder_index_invert", {43: 0x01}, 1),
    ("encoder0_count", {44: 0x78, 45: 0x56, 46: 0x34, 47: 0x12}, 0x12345678),
    ("encoder1_count", {49: 0xFF, 50: 0xFF, 51: 0xFF, 52: 0x7F}, 2**31 - 1),
    ("encoder2_count", {54: 0x00, 55: 0x00, 56: 0x00, 57: 0x80}, -(2**31)),
    ("encoder3_count", {59: 0xFE, 60: 0xFF, 61: 0xFF, 62: 0xFF}, -2),
    ("timer_reset", {64: 0x03}, 3),
    ("timer_mode", {65: 0x02}, 2),
    ("timer0_value", {66: 0xFF, 67: 0xFF, 68: 0xFF, 69: 0xFF}, 2**32 - 1),
    ("timer1_value", {71: 0x01, 72: 0x00, 73: 0x00, 74: 0x80}, 0x80000001),
    ("generator_enable", {76: 0x01}, 1),
    ("generator_hardware_select", {76: 0x02}, 1),
    ("generator_software_gate", {76: 0x04}, 1),
    ("generator_software_start", {76: 0x08}, 1),
    ("generator_gate_invert", {76: 0x10}, 1),
    ("generator_start_invert", {76: 0x20}, 1),
    ("generator_infinite", {76: 0x40}, 1),
    ("generator_level", {77: 0x01}, 1),
    ("generator_initial_level", {77: 0x02}, 1),
    ("generator_terminate_level", {77: 0x04}, 1),
    ("generator_length1", {78: 0xFF, 79: 0xFF, 80: 0xFF, 81: 0xFF}, 2**32 - 1),
    ("generator_length2", {83: 0x04, 84: 0x03, 85: 0x02, 86: 0x01}, 0x01020304),
    ("generator_periods", {88: 0x01, 89: 0x00, 90: 0x00, 91: 0x80}, 0x80000001),
]

READ_0112 = [
    ("encoder_reset", {31: 0xFF, 32: 0x0F}, 0xFFF),
    ("encoder_reset", {31: 0x80, 32: 0x00}, 0x80),
    ("encoder0_count", {33: 0x78, 34: 0x56, 35: 0x34, 36: 0x12}, 0x12345678),
    ("encoder1_count", {37: 0xFF, 38: 0xFF, 39: 0xFF, 40: 0xFF}, -1),
    ("encoder7_count", {61: 0x00, 62: 0x00, 63: 0x00, 64: 0x80}, -(2**31)),
    ("encoder11_count", {77: 0xFE, 78: 0xFF, 79: 0xFF, 80: 0x7F}, 2**31 - 2),
]

SEND_COMMON = [
    ("pin_mode", {8: 0x03}, 3),
    ("pin_direction", {9: 0x7F, 10: 0x7F, 11: 0x7F, 12: 0x1F}, 0x3FFFFFF),
    ("pin_direction", {9: 0x60, 10: 0x60, 11: 0x0C, 12: 0x00}, 0x0033060),
    ("pin_output", {13: 0x00, 14: 0x01, 15: 0x00, 16: 0x10}, 0x2000080),
    ("pwm0_prescaler", {21: 0x7F, 22: 0x7F, 23: 0x03}, 0xFFFF),
    ("pwm0_prescaler", {21: 0x4D, 22: 0x57, 23: 0x02}, 0xABCD),
    ("pwm0_mode", {23: 0x40}, 1),
    ("pwm0_width", {24: 0x7F, 25: 0x1F}, 4095),
    ("pwm1_prescaler", {26: 0x2C}, 44),
    ("pwm1_mode", {28: 0x40}, 1),
    ("pwm1_width", {29: 0x00, 30: 0x01}, 128),
    ("ad0_gain", {93: 0x04}, 4),
    ("ad15_gain", {100: 0x30}, 3),
    ("da0_output", {133: 0x00, 134: 0x40}, 8192),
    ("da3_output", {139: 0x7F, 140: 0x7F}, 16383),
]

SEND_0111 = [
    ("pin_mode", {8: 0x1F}, 31),
    ("pwm2_prescaler", {31: 0x41}, 65),
    ("pwm3_prescaler", {36: 0x01, 37: 0x00, 38: 0x02}, 0x8001),
    ("pwm3_mode", {38: 0x40}, 1),
    ("pwm3_width", {39: 0x7F, 40: 0x01}, 255),
    ("encoder_reset", {41: 0x0F}, 15),
    ("encoder_index_active", {42: 0x01}, 1),
    ("encoder_index_invert", {43: 0x08}, 8),
    ("timer_reset", {64: 0x01}, 1),
    ("timer_mode", {65: 0x02}, 2),
    ("generator_infinite", {76: 0x40}, 1),
    ("generator_terminate_level", {77: 0x04}, 1),
    ("generator_length1", {78: 0x7F, 79: 0x7F, 80: 0x7F, 81: 0x7F, 82: 0x0F}, 2**32 - 1),
    ("generator_length2", {83: 0x00, 84: 0x01}, 0x80),
    ("generator_periods", {92: 0x08}, 2**31),
]

SEND_0112 = [
    ("encoder_reset", {31: 0x7F, 32: 0x1F}, 0xFFF),
    ("encoder_reset", {31: 0x00, 32: 0x01}, 0x80),
]

_ANALOGUE_READ_ONLY = {f"ad{i}_result" for i in range(16)}
READ_ONLY = {
    0x0111: {
        "logic_version",
        "application_name",
        "pin_input",
        *(f"encoder{i}_count" for i in range(4)),
        "timer0_value",
        "timer1_value",
        *_ANALOGUE_READ_ONLY,
    },
    0x0112: {
        "logic_version",
        "application_name",
        "pin_input",
        *(f"encoder{i}_count" for i in range(12)),
        *_ANALOGUE_READ_ONLY,
    },
}

# bytes of which the vendor's library names no bit (docs/facts/sources.md#s2)
UNUSED_READ = {
    0x0111: [2, 48, 53, 58, 63, 70, 75, 82, 87, 92, *range(141, 150)],
    0x0112: [2, *range(81, 93), *range(141, 150)],
}
UNUSED_SEND = {
    0x0111: [*range(8), *range(17, 21), *range(44, 64), *range(66, 76), *range(101, 133), *range(141, 149)],
    0x0112: [*range(8), *range(17, 21), *range(33, 93), *range(101, 133), *range(141, 149)],
}

each_logic = pytest.mark.parametrize("logic", [0x0111, 0x0112], ids=hex)


def of_each_logic(common, first, second):
    return [(0x0111, *row) for row in (*common, *first)] + [(0x0112, *row) for row in (*common, *second)]


def read_frame(logic, data):
    frame = bytearray(150)
    frame[:2] = logic.to_bytes(2, "little")
    for n, value in data.items():
        frame[n] = value
    return bytes(frame)


def send_frame(data):
    frame = bytearray(150)
    frame[0] = 0x81
    for n, value in data.items():
        frame[n + 1] = value
    return bytes(frame)


def test_read_field_owns_these_bits_and_no_others():
    for logic, name, data, value in of_each_logic(READ_COMMON, READ_0111, READ_0112):
        frame = read_frame(logic, data)
        assert decode_read(frame, logic=logic) == {**decode_read(read_frame(logic, {}), logic=logic), name: value}
        assert encode_read({name: value}, logic=logic) == frame, (logic, name)


def test_send_field_owns_these_bits_and_no_others():
    for logic, name, data, value in of_each_logic(SEND_COMMON, SEND_0111, SEND_0112):
        frame = send_frame(data)
        assert decode_send(frame, logic=logic) == {**decode_send(send_frame({}), logic=logic), name: value}
        assert encode_send({name: value}, logic=logic) == frame, (logic, name)


@each_logic
def test_the_logic_version_is_in_the_first_two_bytes(logic):
    assert decode_read(read_frame(logic, {}), logic=logic)["logic_version"] == logic


@each_logic
def test_the_map_above_names_every_kind_of_field(logic):
    rows = {row[1] for row in of_each_logic(READ_COMMON, READ_0111, READ_0112) if row[0] == logic}
    declared = {"".join(c for c in name if not c.isdigit()) for name in logic_of(logic).read.fields}
    assert {"".join(c for c in name if not c.isdigit()) for name in rows} == declared - {"logic_version"}


@each_logic
def test_fields_that_only_the_board_writes_are_in_no_send_frame(logic):
    tables = logic_of(logic)
    assert set(tables.read.fields) - set(tables.send.fields) == READ_ONLY[logic]


@each_logic
def test_every_field_that_the_host_writes_can_be_read_back(logic):
    tables = logic_of(logic)
    assert set(tables.send.fields) <= set(tables.read.fields)


@each_logic
def test_bytes_that_the_source_does_not_use_are_sent_as_zero(logic):
    send = logic_of(logic).send
    largest = {name: field.range(layout)[1] for name, (field, layout) in send.fields.items()}
    sent = encode_send(largest, logic=logic)
    assert {n: sent[n + 1] for n in UNUSED_SEND[logic] if sent[n + 1]} == {}
    assert [n for n in range(149) if n not in UNUSED_SEND[logic] and not sent[n + 1]] == []


@each_logic
def test_unused_bytes_of_a_read_frame_change_no_value(logic):
    frame = read_frame(logic, dict.fromkeys(UNUSED_READ[logic], 0xFF))
    assert decode_read(frame, logic=logic) == decode_read(read_frame(logic, {}), logic=logic)


@each_logic
def test_every_other_byte_of_a_read_frame_belongs_to_a_field(logic):
    owned = {part.word for _, layout in logic_of(logic).read.fields.values() for part in layout}
    assert owned == set(range(150)) - set(UNUSED_READ[logic])


def test_the_logics_agree_in_what_they_share():
    first, second = logic_of(0x0111), logic_of(0x0112)
    shared = {*(f"pwm{i}_{what}" for i in range(2) for what in ("prescaler", "mode", "width")), "application_name"}
    shared |= {"pin_direction", "pin_output", "pin_input", "logic_version"}
    shared |= {name for name in first.read.fields if name.startswith(("ad", "da"))}
    for table in ("read", "send"):
        fields = [getattr(tables, table).fields for tables in (first, second)]
        assert {n: p for n, p in fields[0].items() if n in shared} == {
            n: p for n, p in fields[1].items() if n in shared
        }
