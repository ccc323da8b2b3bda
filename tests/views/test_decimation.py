import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.views.decimation import decimate

values = st.floats(-1e6, 1e6, width=32)
courses = st.lists(values, min_size=1, max_size=200).map(np.array)


def thinned(column, matters=None, most=20):
    matters = np.zeros(len(column), bool) if matters is None else matters
    return decimate({"x": column}, np.arange(len(column)) * 0.5, matters, most)


def test_few_rows_stay_as_they_are():
    column = np.array([3.0, 1.0, np.nan, 2.0])
    few = thinned(column)
    np.testing.assert_array_equal(few.columns["x"], column)
    np.testing.assert_array_equal(few.time_s, [0.0, 0.5, 1.0, 1.5])
    assert few.outside == 1


@given(courses, st.integers(4, 50))
def test_extremes_are_kept(column, most):
    few = thinned(column, most=most).columns["x"]
    assert few.min() == column.astype(np.float32).min()
    assert few.max() == column.astype(np.float32).max()


@given(courses, st.integers(0, 199), st.integers(0, 199), st.integers(8, 60))
def test_times_never_go_back_and_span_the_whole(column, first, end, most):
    matters = np.zeros(len(column), bool)
    matters[first:end] = True
    few = thinned(column, matters, most)
    assert len(few.time_s) == len(few.columns["x"])
    assert (np.diff(few.time_s) >= 0.0).all()
    assert (few.time_s[0], few.time_s[-1]) == (0.0, (len(column) - 1) * 0.5)


def test_there_are_about_as_many_points_as_were_requested():
    matters = np.zeros(100_000, bool)
    matters[60_000:80_000] = True
    few = thinned(np.sin(np.arange(100_000.0)), matters, most=1000)
    assert 700 <= len(few.time_s) <= 1010


def test_what_matters_keeps_every_row_where_there_is_room():
    column, matters = np.random.default_rng(1).normal(size=10_000), np.zeros(10_000, bool)
    matters[5000:5500] = True
    few = thinned(column, matters, most=1000)
    inside = (few.time_s >= 2500.0) & (few.time_s < 2750.0)
    assert few.inside == 1
    assert few.outside > 1
    np.testing.assert_array_equal(few.columns["x"][inside], column[5000:5500].astype(np.float32))


def test_a_falling_signal_falls_and_a_rising_one_rises():
    rising = np.arange(1000.0)
    assert (np.diff(thinned(rising).columns["x"]) > 0.0).all()
    assert (np.diff(thinned(-rising).columns["x"]) < 0.0).all()


def test_nan_stays_only_where_there_is_no_number():
    column = np.full(1000, np.nan)
    column[123] = 7.0
    few = thinned(column).columns["x"]
    assert np.nanmax(few) == 7.0
    assert np.isnan(few).sum() >= len(few) - 2


@pytest.mark.parametrize("value", [1e300, -1e300, np.inf, -np.inf])
def test_what_float32_cannot_hold_stays_finite(value):
    few = thinned(np.array([0.0, value])).columns["x"]
    assert np.isfinite(few).all()
    assert np.sign(few[1]) == np.sign(value)


def test_nothing_stays_nothing():
    few = decimate({"x": np.zeros(0)}, np.zeros(0), np.zeros(0, bool), 10)
    assert len(few.time_s) == len(few.columns["x"]) == 0
