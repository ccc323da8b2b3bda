from firmware_protocol.rtdac_usb2 import (
    READ,
    SEND,
    SEND_COMMAND,
    decode_read,
    decode_send,
    encode_read,
    encode_send,
)

READ_PLACES = [
    # header
    ("logic_version", {0: 0x0103}, 0x0103),
    ("application_name", {1: 0x4546, 2: 0x4344, 3: 0x4142}, "ABCDEF"),
    ("synthesis_date", {4: 0x0606, 5: 0x2011}, "20110606"),
    ("pwm_channels", {6: 0x0008}, 8),
    ("encoder_channels", {6: 0x0070}, 7),
    ("encoder_index_channels", {6: 0x0600}, 6),
    ("timer_channels", {6: 0x5000}, 5),
    ("counter_channels", {7: 0x0001}, 1),
    ("timer_counter_channels", {7: 0x0020}, 2),
    ("pulse_generator_channels", {7: 0x0300}, 3),
    ("frequency_meter_channels", {7: 0x4000}, 4),
    ("chronometer_channels", {8: 0x0008}, 8),
    ("further_counts", {8: 0x3210}, 0x321),
    # digital pins
    ("pin_mode", {10: 0x8001, 11: 0x0200}, 0x2008001),
    ("pin_direction", {12: 0xFFFF, 13: 0x03FF}, 0x3FFFFFF),
    ("pin_output", {14: 0x0000, 15: 0x0001}, 0x10000),
    ("pin_input", {16: 0x1234, 17: 0x0156}, 0x1561234),
    # PWM
    ("pwm0_prescaler", {20: 0xFFFF}, 0xFFFF),
    ("pwm0_mode", {21: 0x0001}, 1),
    ("pwm0_width", {22: 0x0FFF}, 4095),
    ("pwm1_prescaler", {23: 0x8000}, 0x8000),
    ("pwm3_width", {31: 0x0003}, 3),
    ("pwm7_prescaler", {41: 0x0201}, 0x0201),
    ("pwm7_mode", {42: 0x0001}, 1),
    ("pwm7_width", {43: 0x0100}, 256),
    # encoders
    ("encoder_reset", {50: 0x0081}, 0x81),
    ("encoder_index_active", {51: 0x0042}, 0x42),
    ("encoder_index_invert", {52: 0x0024}, 0x24),
    ("encoder0_count", {53: 0x5678, 54: 0x1234}, 0x12345678),
    ("encoder0_count", {53: 0xFFFF, 54: 0x7FFF}, 2**31 - 1),
    ("encoder1_count", {55: 0x0000, 56: 0x8000}, -(2**31)),
    ("encoder2_count", {57: 0x0000, 58: 0xFFFF}, -65536),
    ("encoder7_count", {67: 0xFFFE, 68: 0xFFFF}, -2),
    # timers
    ("timer_reset", {70: 0x0002}, 2),
    ("timer_mode", {71: 0x0003}, 3),
    ("timer0_value", {72: 0xFFFF, 73: 0xFFFF}, 2**32 - 1),
    ("timer1_value", {74: 0x0001, 75: 0x8000}, 0x80000001),
    # frequency meters
    ("frequency_meter_enable", {80: 0x0080}, 0x80),
    ("frequency_meter_mode", {81: 0x0001}, 1),
    ("frequency_meter_infinite", {82: 0x0002}, 2),
    ("frequency_meter_software_start", {83: 0x0003}, 3),
    ("frequency_meter_start_invert", {84: 0x0004}, 4),
    ("frequency_meter_software_gate", {85: 0x0005}, 5),
    ("frequency_meter_hardware_gate_select", {86: 0x0006}, 6),
    ("frequency_meter_gate_invert", {87: 0x0007}, 7),
    ("frequency_meter_gate_mode", {88: 0x0008}, 8),
    ("frequency_meter_input_invert", {89: 0x0009}, 9),
    ("frequency_meter0_timer", {90: 0x8000, 91: 0x8000}, 0x80008000),
    ("frequency_meter7_timer", {104: 0x0001, 105: 0x0002}, 0x20001),
    ("frequency_meter_ready", {106: 0x00FF}, 0xFF),
    ("frequency_meter0_counter", {107: 0x0001, 108: 0x0002}, 0x20001),
    ("frequency_meter7_counter", {121: 0x0003, 122: 0x0004}, 0x40003),
    ("frequency_meter0_result", {123: 0x0005, 124: 0x0006}, 0x60005),
    ("frequency_meter7_result", {137: 0x0007, 138: 0x0008}, 0x80007),
    # chronometers
    ("chronometer0_control", {140: 0x0DD7}, 0x0DD7),
    ("chronometer0_status", {140: 0xA000}, 5),
    ("chronometer7_control", {147: 0x0800}, 0x800),
    ("chronometer0_divider", {148: 0xFFFF, 149: 0xFFFF}, 2**32 - 1),
    ("chronometer7_divider", {162: 0x0001, 163: 0x0002}, 0x20001),
    ("chronometer0_counter", {164: 0x0001, 165: 0x0002}, 0x20001),
    ("chronometer7_counter", {178: 0x0001, 179: 0x0002}, 0x20001),
    ("chronometer0_result", {180: 0x0001, 181: 0x0002}, 0x20001),
    ("chronometer7_result", {194: 0x0001, 195: 0x0002}, 0x20001),
    # analogue
    ("ad0_gain", {200: 0x0004}, 4),
    ("ad1_gain", {200: 0x0030}, 3),
    ("ad2_gain", {200: 0x0200}, 2),
    ("ad3_gain", {200: 0x1000}, 1),
    ("ad4_gain", {201: 0x0004}, 4),
    ("ad15_gain", {203: 0x4000}, 4),
    ("ad0_result", {204: 0x07FF}, 2047),
    ("ad1_result", {205: 0x0800}, -2048),
    ("ad15_result", {219: 0x0FFF}, -1),
    ("ad0_busy", {204: 0x1000}, 1),
    ("ad15_busy", {219: 0x1000}, 1),
    ("da0_output", {220: 0x2000}, 8192),
    ("da3_output", {223: 0x3FFF}, 16383),
]

SEND_PLACES = [
    # digital pins
    ("pin_mode", {10: 0x0024, 11: 0x0000}, 0x24),
    ("pin_direction", {12: 0x7FFF, 13: 0x07FF}, 0x3FFFFFF),
    ("pin_output", {14: 0x0000, 15: 0x0001}, 0x8000),
    # PWM
    ("pwm0_prescaler", {20: 0x7FFF, 21: 0x0001}, 0xFFFF),
    ("pwm0_mode", {21: 0x0002}, 1),
    ("pwm0_width", {22: 0x0FFF}, 4095),
    ("pwm7_prescaler", {41: 0x002C}, 44),
    ("pwm7_mode", {42: 0x0002}, 1),
    ("pwm7_width", {43: 0x0100}, 256),
    # encoders
    ("encoder_reset", {50: 0x00FF}, 0xFF),
    ("encoder_index_active", {51: 0x0001}, 1),
    ("encoder_index_invert", {52: 0x0080}, 0x80),
    # timers
    ("timer_reset", {70: 0x0001}, 1),
    ("timer_mode", {71: 0x0002}, 2),
    # frequency meters
    ("frequency_meter_enable", {80: 0x0080}, 0x80),
    ("frequency_meter_input_invert", {89: 0x0001}, 1),
    ("frequency_meter0_timer", {90: 0x7FFF, 91: 0x7FFF}, 2**30 - 1),
    ("frequency_meter7_timer", {104: 0x0000, 105: 0x0001}, 0x8000),
    # chronometers
    ("chronometer0_control", {140: 0x0C01}, 0xC01),
    ("chronometer7_divider", {162: 0x0000, 163: 0x4000}, 2**29),
    # analogue
    ("ad0_gain", {200: 0x0004}, 4),
    ("ad15_gain", {203: 0x1000}, 1),
    ("da0_output", {220: 0x2000}, 8192),
    ("da3_output", {223: 0x3FFF}, 16383),
]

READ_ONLY = {
    "logic_version",
    "application_name",
    "synthesis_date",
    "further_counts",
    "pin_input",
    "frequency_meter_ready",
    *(f"{what}_channels" for what in ("pwm", "encoder", "encoder_index", "timer", "counter", "timer_counter")),
    *(f"{what}_channels" for what in ("pulse_generator", "frequency_meter", "chronometer")),
    *(f"timer{i}_value" for i in range(2)),
    *(f"ad{i}_{what}" for i in range(16) for what in ("result", "busy")),
    *(f"encoder{i}_count" for i in range(8)),
    *(f"frequency_meter{i}_{what}" for i in range(8) for what in ("counter", "result")),
    *(f"chronometer{i}_{what}" for i in range(8) for what in ("counter", "result", "status")),
}


def test_read_field_owns_these_bits_and_no_others(frame_of):
    for name, words, value in READ_PLACES:
        frame = frame_of(words, command=words.get(0, 0))
        assert decode_read(frame) == {**decode_read(bytes(504)), name: value}
        assert encode_read({name: value}) == frame, name


def test_send_field_owns_these_bits_and_no_others(frame_of):
    for name, words, value in SEND_PLACES:
        frame = frame_of(words, command=SEND_COMMAND)
        assert decode_send(frame) == {**decode_send(encode_send({})), name: value}
        assert encode_send({name: value}) == frame, name


def test_fields_that_only_the_board_writes_are_in_no_send_frame():
    assert set(READ.fields) - set(SEND.fields) == READ_ONLY


def test_every_field_that_the_host_writes_can_be_read_back():
    assert set(SEND.fields) <= set(READ.fields)


def test_words_that_no_source_uses_are_sent_as_zero(words_of):
    largest = {name: field.range(layout)[1] for name, (field, layout) in SEND.fields.items()}
    sent = words_of(encode_send(largest))
    unused = [*range(1, 10), *range(16, 20), *range(44, 50), 69, *range(76, 80), 106, 139]
    unused += [*range(196, 200), *range(224, 252)]
    assert {word: sent[word] for word in unused if sent[word]} == {}


def test_unused_words_of_a_read_frame_change_no_value(frame_of):
    unused = [9, 18, 19, *range(44, 50), 69, *range(76, 80), 139, *range(196, 200), *range(224, 252)]
    assert decode_read(frame_of(dict.fromkeys(unused, 0xFFFF))) == decode_read(bytes(504))
