"""Hints on numbers: helpful where the guess is good, silent where it is none."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.quantities import number_hint, other_unit, unit_of

UNITS = ["", "s", "rad/s", "Hz", "N m", "1/s"]


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("start_speed_rad_s", "rad/s"),
        ("window_s", "s"),
        ("brake_rate_per_s", "1/s"),
        ("rate_hz", "Hz"),
        ("drive_stall_torque_nm", "N m"),
        ("brake_limit", ""),
    ],
)
def test_the_unit_is_what_the_keys_name_ends_with(key, unit):
    assert unit_of(key) == unit


@pytest.mark.parametrize(
    ("text", "unit", "hint"),
    [
        ("0,7", "", "; a comma is not a decimal point: write 0.7"),
        ("1,800 rpm", "rad/s", "; a comma is not a decimal point: write 1.800 or 1800"),
        (" -1.5e3 ms ", "s", "; write the number alone in s: -1.5"),
        ("70 %", "", "; write the number alone: 0.7"),
        ("20 m/s", "rad/s", "; write the number alone in rad/s, without 'm/s'"),
        ("180 rad/s", "rad/s", "; write the number alone"),
        ("fast", "rad/s", ""),
        ("1,2,3", "", ""),
        ("", "s", ""),
    ],
)
def test_a_text_gets_the_likely_number_as_a_hint(text, unit, hint):
    assert number_hint(text, unit) == hint


@given(st.text(), st.sampled_from(UNITS))
def test_any_text_has_a_hint_or_none(text, unit):
    hint = number_hint(text, unit)
    assert not hint or hint.startswith("; ")


@pytest.mark.parametrize(
    ("value", "unit", "limits", "hint"),
    [
        (1800, "rad/s", (10, 240), "; looks like rpm: 1800 rpm is 188.5 rad/s"),
        (500, "s", (0, 10), "; looks like ms: 500 ms is 0.5 s"),
        (2, "Hz", (50, 10_000), "; looks like kHz: that is 2000 Hz"),
        (300, "rad/s", (10, 240), ""),  # too fast, and slow in rpm: not decidable
        (1.5, "", (0, 1), ""),
        (7, "", (0, 5), ""),
        (1e6, "rad/s", (10, 240), ""),
        (-1800, "rad/s", (10, 240), ""),
    ],
)
def test_only_a_number_that_is_far_out_looks_like_another_unit(value, unit, limits, hint):
    assert other_unit(value, unit, *limits) == hint


@given(st.floats() | st.integers(), st.sampled_from(UNITS))
def test_any_number_has_a_hint_or_none(value, unit):
    hint = other_unit(value, unit, 0.5, 100.0)
    assert not hint or hint.startswith("; looks like ")


@pytest.mark.parametrize("value", [10**400, -(10**400), math.inf, math.nan])
def test_a_value_in_no_known_unit_has_no_hint(value):
    assert other_unit(value, "s", 0.0, 1.0) == ""
