import pytest

from firmware_protocol import Access, Conversion, ProtocolError, Register, RegisterMap, TableError, ValueKind, Write


def register(name, offset=0, **options):
    return Register(name, offset, "meaning", "unit", "source", **options)


def both(name, offset=0, **options):
    return register(name, offset, access=Access.READ_WRITE, **options)


def table(*registers, size=16):
    return RegisterMap("test map", registers, size=size)


INDEX = both("index", 0, channels=3)
DATA = both("data", 4, width=12, index=INDEX)
COUNT = register("count", 8, kind=ValueKind.SIGNED, index=INDEX)
FLAG = register("flag", 12, low=1, width=1)
PLAIN = register("plain", 12, low=4, width=8, conversion=Conversion("V", "plain / 2", lambda n: n / 2, ("plain",)))
MAP = table(INDEX, DATA, COUNT, FLAG, PLAIN)


def test_index_then_data():
    assert MAP.write(DATA, 4095, channel=2) == (Write(0, 2), Write(4, 4095))
    assert MAP.select(COUNT, 1) == (Write(0, 1),)


def test_a_register_without_an_index_is_accessed_at_once():
    assert MAP.select(PLAIN) == ()
    assert MAP.write(INDEX, 2) == (Write(0, 2),)


@pytest.mark.parametrize("channel", [None, -1, 3, True, "0", 1.0])
def test_a_channel_that_is_missing_or_too_high_is_refused(channel):
    with pytest.raises(ProtocolError, match=rf"data: channel {channel!r}, must be an integer in 0\.\.2"):
        MAP.write(DATA, 0, channel=channel)


def test_a_channel_that_does_not_exist_is_refused():
    with pytest.raises(ProtocolError, match="plain: channel 0, but it has no channels"):
        MAP.select(PLAIN, 0)


@pytest.mark.parametrize("value", [-1, 4096, True, None, 1.0, "1"])
def test_a_value_that_does_not_fit_is_refused(value):
    with pytest.raises(ProtocolError, match=rf"data = {value!r}: must be an integer in 0\.\.4095"):
        MAP.write(DATA, value, channel=0)


def test_an_index_takes_only_its_channels():
    with pytest.raises(ProtocolError, match=r"index = 3: must be an integer in 0\.\.2"):
        MAP.write(INDEX, 3)


@pytest.mark.parametrize("only_read", [FLAG, PLAIN])
def test_a_register_that_is_only_read_is_not_written(only_read):
    with pytest.raises(ProtocolError, match=f"{only_read.name} is read-only"):
        MAP.write(only_read, 0)


def test_a_register_of_another_map_is_refused_with_what_is_there():
    for stranger, here in (
        (both("stranger", 4), "data"),
        (both("data", 12), "flag and plain"),
        (both("x", 0x40), "unknown"),
    ):
        with pytest.raises(ProtocolError, match=f"test map has no {stranger.name}: 0x{stranger.offset:02X} is {here}"):
            MAP.write(stranger, 0)


@pytest.mark.parametrize(
    ("register", "raw", "value"),
    [
        (FLAG, 0xFFFFFFFD, 0),
        (FLAG, 0x00000002, 1),
        (PLAIN, 0x00000AB0, 0xAB),
        (PLAIN, 0xFFFFF00F, 0),
        (DATA, 0xFFFFF123, 0x123),
        (COUNT, 0x7FFFFFFF, 2**31 - 1),
        (COUNT, 0x80000000, -(2**31)),
        (COUNT, 0xFFFFFFFF, -1),
    ],
)
def test_a_value_is_cut_out_of_32_bits(register, raw, value):
    assert register.decode(raw) == value
    assert register.decode(register.encode(value)) == value
    assert register.encode(value) == raw & register.mask


@pytest.mark.parametrize("raw", [-1, 1 << 32, None, True, 1.0])
def test_a_value_wider_than_the_register_is_refused(raw):
    with pytest.raises(ProtocolError, match=rf"count: read {raw!r}, must be an integer in 0\.\.4294967295"):
        COUNT.decode(raw)


def test_registers_are_found_by_name_and_by_offset():
    assert MAP.find("data") is DATA
    assert MAP.at(12) == (FLAG, PLAIN)
    assert MAP.at(13) == ()
    with pytest.raises(ProtocolError, match="test map has no register 'dat'; did you mean data"):
        MAP.find("dat")
    with pytest.raises(ProtocolError, match=r"test map has no register 'zzz'$"):
        MAP.find("zzz")


def test_a_quantity_is_converted_from_the_values_it_needs():
    assert MAP.quantity(PLAIN, {"plain": 7, "data": 1}) == 3.5
    with pytest.raises(ProtocolError, match="plain is converted with plain, which is not given"):
        MAP.quantity(PLAIN, {})
    with pytest.raises(ProtocolError, match="data has no conversion"):
        MAP.quantity(DATA, {"data": 1})


@pytest.mark.parametrize(
    "stray",
    [
        register("stray", 16),
        register("stray", -4),
        register("stray", 2),
        register("stray", 0, width=33),
        register("stray", 0, low=31, width=2),
        register("stray", 0, low=-1, width=2),
        register("stray", 0, width=0),
    ],
)
def test_a_register_may_not_leave_the_range(stray):
    with pytest.raises(TableError, match="stray leaves the registers"):
        table(stray)


def test_the_last_register_may_be_used():
    assert table(register("last", 12)).at(12)[0].name == "last"


@pytest.mark.parametrize("name", ["", "two words", "a-b"])
def test_a_name_must_be_an_identifier(name):
    with pytest.raises(TableError, match="is not a name"):
        table(register(name))


def test_a_name_may_not_be_declared_twice():
    with pytest.raises(TableError, match="'twin' is declared twice"):
        table(register("twin", 0), register("twin", 4))


def test_two_registers_may_not_share_a_bit():
    with pytest.raises(TableError, match="second and first share bits at 0x04"):
        table(register("first", 4, width=8), register("second", 4, low=7, width=2))


@pytest.mark.parametrize(("one", "other"), [(register, both), (both, register), (both, both)])
def test_what_is_written_has_its_32_bits_for_itself(one, other):
    with pytest.raises(TableError, match="high and low cannot be written apart"):
        table(one("low", 4, width=8), other("high", 4, low=8, width=8))


@pytest.mark.parametrize("kind", [ValueKind.TEXT, ValueKind.HEX])
def test_a_register_is_a_number(kind):
    with pytest.raises(TableError, match="named is not a number"):
        table(register("named", kind=kind))


@pytest.mark.parametrize("channels", [-1, 5])
def test_an_index_must_be_able_to_count_its_channels(channels):
    with pytest.raises(TableError, match="narrow is not a number, or cannot count its channels"):
        table(both("narrow", width=2, channels=channels))


@pytest.mark.parametrize(
    "index",
    [
        both("index", 0),
        register("index", 0, channels=3),
        both("index", 0, channels=3, index=both("outer", 12, channels=2)),
    ],
)
def test_what_selects_a_channel_is_a_writable_index(index):
    with pytest.raises(TableError, match=r"reached through (index|outer), which is not an index here"):
        table(index, register("data", 4, index=index))


def test_an_index_must_be_declared():
    with pytest.raises(TableError, match="data is reached through index, which is not an index here"):
        table(DATA)


def test_a_conversion_must_rest_on_declared_registers():
    conversion = Conversion("V", "here / elsewhere", lambda a, b: a / b, ("here", "elsewhere"))
    with pytest.raises(TableError, match="here is converted with undeclared registers"):
        table(register("here", conversion=conversion))
