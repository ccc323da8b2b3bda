import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from inteco_abs.realtime import Histogram

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

LAST = 2047
lateness_us = st.floats(-50.0, 3000.0) | st.floats(0.0, 20.0) | st.integers(0, 2100).map(float)
shares = st.lists(st.floats(0.0, 1.0, exclude_min=True), max_size=5).map(sorted)


def filled(*values):
    histogram = Histogram()
    histogram.add(values)
    return histogram


def bins(values):
    """Bin of each value, by another way than the histogram's."""
    return np.clip(np.trunc(np.asarray(values, float)), 0, LAST).astype(int)


@given(values=st.lists(lateness_us, min_size=1, max_size=300), wanted=shares)
@example(values=[0.0, 1.0, 2.0, 3.0], wanted=[0.25, 0.5, 0.500001, 0.75, 1.0])
@example(values=[5.25], wanted=[0.5, 0.99, 0.999])
def test_quantiles_are_the_upper_edges_of_the_bins_in_which_numpy_finds_them(values, wanted):
    greatest = max(0.0, *values)
    expected = [min(edge + 1.0, greatest) for edge in np.quantile(bins(values), wanted, method="inverted_cdf")]
    assert filled(*values).quantiles_us(wanted) == expected


@given(values=st.lists(lateness_us, max_size=300))
def test_sparse_has_every_value_once_by_the_lower_edge_of_its_bin(values):
    edges, counts = np.unique(bins(values), return_counts=True)
    assert filled(*values).sparse() == {str(edge): count for edge, count in zip(edges, counts, strict=True)}


@given(parts=st.lists(st.tuples(st.lists(lateness_us, max_size=20), st.integers(0, 1000)), max_size=10))
def test_adding_in_parts_is_adding_all(parts):
    whole, histogram = Histogram(), Histogram()
    whole.add([value for values, _ in parts for value in values], sum(skipped for _, skipped in parts))
    for values, skipped in parts:
        histogram.add(iter(values), skipped)
    assert histogram.sparse() == whole.sparse()
    assert histogram.greatest_us == whole.greatest_us == max([0.0, *(v for values, _ in parts for v in values)])
    assert histogram.skipped == whole.skipped == sum(skipped for _, skipped in parts)


@pytest.mark.parametrize(
    ("value", "edge"),
    [
        (0.0, "0"), (0.999, "0"), (1.0, "1"), (2046.999, "2046"), (2047.0, "2047"), (2048.0, "2047"), (1e9, "2047"),
        (-0.5, "0"), (-1.0, "0"), (-1e9, "0"),
    ],
)  # fmt: skip
def test_what_is_beyond_the_bins_is_counted_in_the_first_or_the_last(value, edge):
    assert filled(value).sparse() == {edge: 1}


def test_the_greatest_value_is_kept_even_beyond_the_last_bin():
    histogram = filled(3.0, 123_456.75, 5.0)
    assert histogram.greatest_us == 123_456.75
    assert histogram.quantiles_us([0.5, 1.0]) == [6.0, 2048.0]


def test_before_the_first_value_there_are_no_quantiles():
    histogram = Histogram()
    histogram.add([], 3)
    assert histogram.quantiles_us([0.5, 0.99]) == [None, None]
    assert (histogram.sparse(), histogram.greatest_us, histogram.skipped) == ({}, 0.0, 3)


def test_a_second_view_of_the_same_memory_sees_the_same_while_it_grows():
    memory = bytearray(Histogram.BYTES)
    writer, screen = Histogram(memory), Histogram(memory)
    for value in range(10):
        writer.add([float(value), 5000.0 + value], skipped=2)
        assert screen.sparse() == writer.sparse()
        assert (screen.greatest_us, screen.skipped) == (5000.0 + value, 2 * (value + 1))
    assert screen.quantiles_us([0.2, 1.0]) == writer.quantiles_us([0.2, 1.0]) == [4.0, 2048.0]


def test_it_fills_its_memory_and_touches_nothing_beyond():
    memory = bytearray(b"\0" * Histogram.BYTES + b"next")
    Histogram(memory).add([0.0, 1e6], skipped=2**62)
    assert memory[Histogram.BYTES :] == b"next"
    assert Histogram(memory[: Histogram.BYTES]).skipped == 2**62
