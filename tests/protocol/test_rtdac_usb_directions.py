import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.rtdac_usb import encode_read, encode_send, logic_of

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

each_logic = pytest.mark.parametrize("logic", [0x0111, 0x0112], ids=hex)


def data_of(frame):
    """Data bytes of a SEND frame, numbered as those of a READ frame."""
    return frame[1:]


@pytest.mark.parametrize(("name", "byte"), [("pin_direction", 9), ("pin_output", 13)])
@each_logic
@given(value=st.integers(0, 2**26 - 1))
def test_pins_are_cut_in_bytes_on_read_and_in_sevens_on_send(logic, name, byte, value):
    read, sent = encode_read({name: value}, logic=logic), data_of(encode_send({name: value}, logic=logic))
    assert read[byte : byte + 4] == value.to_bytes(4, "little")
    assert list(sent[byte : byte + 4]) == [value % 128, value // 2**7 % 128, value // 2**14 % 128, value // 2**21]


@pytest.mark.parametrize(("logic", "channel"), [*((0x0111, i) for i in range(4)), (0x0112, 0), (0x0112, 1)])
@given(prescaler=st.integers(0, 2**16 - 1), mode=st.integers(0, 1), width=st.integers(0, 4095))
def test_pwm_is_cut_differently_by_direction(logic, channel, prescaler, mode, width):
    values = {f"pwm{channel}_prescaler": prescaler, f"pwm{channel}_mode": mode, f"pwm{channel}_width": width}
    byte = 21 + 5 * channel
    read, sent = encode_read(values, logic=logic), data_of(encode_send(values, logic=logic))
    assert list(read[byte : byte + 5]) == [prescaler % 256, prescaler // 256, mode, width % 256, width // 256]
    assert list(sent[byte : byte + 5]) == [
        prescaler % 128,
        prescaler // 128 % 128,
        64 * mode + prescaler // 2**14,
        width % 128,
        width // 128,
    ]


@given(reset=st.integers(0, 2**12 - 1))
def test_twelve_reset_bits_are_cut_at_8_on_read_and_at_7_on_send(reset):
    assert list(encode_read({"encoder_reset": reset}, logic=0x0112)[31:33]) == [reset % 256, reset // 256]
    assert list(data_of(encode_send({"encoder_reset": reset}, logic=0x0112))[31:33]) == [reset % 128, reset // 128]


@pytest.mark.parametrize(
    ("name", "byte"), [("generator_length1", 78), ("generator_length2", 83), ("generator_periods", 88)]
)
@given(value=st.integers(0, 2**32 - 1))
def test_the_generators_numbers_need_a_fifth_byte_on_send(name, byte, value):
    read, sent = encode_read({name: value}, logic=0x0111), data_of(encode_send({name: value}, logic=0x0111))
    assert read[byte : byte + 5] == value.to_bytes(5, "little")
    assert list(sent[byte : byte + 5]) == [value >> 7 * part & 127 for part in range(5)]


@each_logic
def test_bit_7_of_every_sent_data_byte_is_zero_even_for_the_largest_values(logic):
    largest = {name: field.range(layout)[1] for name, (field, layout) in logic_of(logic).send.fields.items()}
    sent = encode_send(largest, logic=logic)
    assert sent[0] == 0x81
    assert max(sent[1:]) == 0x7F
