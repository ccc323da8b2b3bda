"""The notation of faults: parsing, printing, errors."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.errors import ConfigError
from inteco_abs.mock_board.faults import KINDS, Fault, FaultEvent, Span, parse_fault, parse_faults

SPANS = st.one_of(
    st.builds(Span, exchanges=st.just(0), ns=st.integers(0, 10**14)),
    st.builds(Span, ns=st.just(0), exchanges=st.integers(1, 10**6)),
)


def values_of(kind):
    if kind.value is None:
        return st.just(math.nan)
    if kind.value.words:
        return st.integers(0, len(kind.value.words) - 1).map(float)
    return st.integers(math.ceil(kind.value.low), math.floor(kind.value.high)).map(float)


@st.composite
def any_fault(draw):
    name = draw(st.sampled_from(sorted(KINDS)))
    kind = KINDS[name]
    some = SPANS.filter(any)
    lasts = draw(st.one_of(st.none(), some) if kind.lasting else some)
    return Fault(name, draw(st.sampled_from(FaultEvent)), draw(SPANS), lasts, draw(values_of(kind)))


@given(any_fault())
def test_what_is_said_of_a_fault_is_read_as_the_same_fault(fault):
    again = parse_fault(str(fault))
    assert str(again) == str(fault)
    assert again == fault or math.isnan(fault.value)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("lose@brake+20ms", Fault("lose", FaultEvent.BRAKE, Span(ns=20_000_000), Span(exchanges=1))),
        ("road-stuck@3.5s", Fault("road-stuck", FaultEvent.START, Span(ns=3_500_000_000))),
        ("late=2@drive+#100/#5", Fault("late", FaultEvent.DRIVE, Span(exchanges=100), Span(exchanges=5), 2.0)),
        ("stall@coast/500us", Fault("stall", FaultEvent.COAST, Span(), Span(ns=500_000))),
        ("reset=held@brake", Fault("reset", FaultEvent.BRAKE, Span(), Span(exchanges=1), 1.0)),
    ],
)
def test_a_fault_is_read(text, fault):
    assert str(parse_fault(text)) == str(fault)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "must be KIND"),
        ("lose", "must be KIND"),
        ("loose@1s", "no fault 'loose'; did you mean lose?"),
        ("lose=3@1s", "lose takes no value"),
        ("late@1s", "late needs a value, as in late=20: a number in 0.001..60000 ms"),
        ("corrupt=1.5@1s", "'1.5': corrupt takes a whole number in 0..16384 bit"),
        ("cut=3.7@1s", "'3.7': cut takes a whole number in 0..2048 bytes"),
        ("road-jump=1e12@1s", "a whole number in -2147483648..2147483648 counts"),
        ("alarm@1s", "alarm needs a value, as in alarm=7: a whole number in 1..7 bits"),
        ("alarm=8@1s", "a whole number in 1..7 bits"),
        ("alarm=0@1s", "a whole number in 1..7 bits"),
        ("supply=30.1@1s", "a number in 0..30 V"),
        ("supply=-1@1s", "a number in 0..30 V"),
        ("heat=151@1s", "a number in -40..150 degC"),
        ("heat=-41@1s", "a number in -40..150 degC"),
        ("late=nan@1s", "a number in 0.001..60000 ms"),
        ("late=x@1s", "a number in 0.001..60000 ms"),
        ("brake-stuck=1.5@1s", "a number in 0..1"),
        ("reset=hot@1s", "reset takes one of zero, held, random"),
        ("lose@1", "'1' is not a time"),
        ("lose@braek", "the events are: start, drive, coast, brake"),
        ("lose@1h", "'1h' is not a time"),
        ("lose@#-1", "'#-1' is not a time"),
        ("lose@1000000s", "longer than any run: at most 100000s"),
        ("lose@lunch+1s", "'lunch' is not an event; the events are: start, drive, coast, brake"),
        ("lose@brake/1e9s", "is not a time"),
        ("stall@brake/0s", "of zero duration never acts"),
        ("stall@brake/#0", "of zero duration never acts"),
    ],
)
def test_a_fault_that_cannot_be_is_refused_with_what_can(text, expected):
    with pytest.raises(ConfigError) as refusal:
        parse_faults([text, "lose@1s"])
    assert expected in str(refusal.value)
    assert "--inject" in str(refusal.value)


def test_all_that_is_wrong_is_said_at_once():
    with pytest.raises(ConfigError) as refusal:
        parse_faults(["loose@1s", "late@1s"])
    assert len(refusal.value.mistakes) == 2


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_has_a_meaning_and_an_example_that_is_read(name):
    kind = KINDS[name]
    wanted = kind.value
    number = "1" if wanted and wanted.whole else "0.5"
    value = "" if wanted is None else f"={wanted.words[0] if wanted.words else number}"
    assert kind.meaning
    assert parse_fault(f"{name}{value}@drive+1s").name == name
