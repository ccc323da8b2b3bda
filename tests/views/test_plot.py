import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inteco_abs.views.plot import MARGIN, Curve, PlotAxes, plot
from inteco_abs.views.text_lines import length

WIDTH, ROWS = 46, 9
COLUMNS = WIDTH - MARGIN
AXES = PlotAxes(2.0, 200.0)
TIMES = np.linspace(0.0, 2.0, 401)


def curve(values, times=TIMES, **options):
    return Curve(times, np.asarray(values, float), **{"style": "cyan", "mark": "*", **options})


def cells(curves, axes=AXES, width=WIDTH, rows=ROWS, *, plain=True):
    """The area of the curves, as lines of text."""
    lines = plot(curves, axes, width, rows, plain=plain)[:-1]
    return ["".join(text for text, _ in line)[MARGIN:] for line in lines]


def dots(curves):
    """All dots of a braille plot as a grid of booleans."""
    grid = np.zeros((4 * ROWS, 2 * COLUMNS), bool)
    places = {0: (0, 0), 1: (1, 0), 2: (2, 0), 3: (0, 1), 4: (1, 1), 5: (2, 1), 6: (3, 0), 7: (3, 1)}
    for row, line in enumerate(cells(curves, plain=False)):
        for column, letter in enumerate(line):
            for bit, (down, right) in places.items():
                if letter != " " and (ord(letter) - 0x2800) >> bit & 1:
                    grid[4 * row + down, 2 * column + right] = True
    return grid


def test_a_curve_goes_from_corner_to_corner():
    lines = cells([curve(200.0 - 100.0 * TIMES)])
    assert lines[0].startswith("*")
    assert lines[-1].endswith("*")
    assert all("*" in line for line in lines)


def test_it_begins_at_the_left_and_the_rest_stays_empty():
    half = TIMES[TIMES <= 1.0]
    for line in cells([curve(np.full(len(half), 100.0), half)]):
        assert not line[COLUMNS // 2 + 1 :].strip()
    assert cells([curve(np.full(len(half), 100.0), half)])[ROWS // 2].startswith("*" * (COLUMNS // 2 - 1))


def test_the_axes_stay_where_they_are_while_it_grows():
    empty = plot([], AXES, WIDTH, ROWS, plain=False)
    for upto in (1, 10, 400):
        grown = plot([curve(TIMES[:upto], TIMES[:upto])], AXES, WIDTH, ROWS, plain=False)
        assert grown[-1] == empty[-1]
        assert [line[0] for line in grown] == [line[0] for line in empty]


def test_both_axes_are_labelled_at_their_ends_and_in_the_middle():
    heads = [line[0][0] for line in plot([], AXES, WIDTH, ROWS, plain=False)]
    assert [head.split()[0] for head in heads if "┤" in head] == ["200", "100", "0"]
    assert heads[-1].replace("─", " ").split() == ["└", "0", "1", "2", "s"]
    assert heads[-1].index(" 1 ") + 1 - MARGIN == pytest.approx(COLUMNS / 2, abs=1)


def test_a_step_hangs_together():
    values = np.where(TIMES < 1.0, 0.0, 200.0)
    column = dots([curve(values)])
    assert all(column[row].any() for row in range(4 * ROWS))


def test_a_solid_curve_is_in_every_column_and_a_dashed_one_in_about_half_of_them():
    flat = np.full(len(TIMES), 100.0)
    solid = dots([curve(flat)]).any(axis=0)
    dashed = dots([curve(flat, dashed=True)]).any(axis=0)
    assert solid.all()
    assert 0.4 < dashed.mean() < 0.6
    assert dots([curve(flat)]).sum() > 2 * dots([curve(flat, dashed=True)]).sum()


def test_where_two_curves_meet_the_first_sets_the_colour():
    first, second = curve(np.full(401, 100.0)), curve(np.full(401, 100.0), style="magenta", mark="o", dashed=True)
    styles = {style for line in plot([first, second], AXES, WIDTH, ROWS, plain=False)[:-1] for _, style in line[1:]}
    assert styles == {"cyan", ""}
    assert "o" not in "".join(cells([first, second]))
    assert (dots([first, second]) >= dots([second])).all()


def test_what_is_beyond_an_axis_is_drawn_at_its_end():
    lines = cells([curve(np.where(TIMES < 1.0, 1e9, -1e9))])
    assert lines[0][: COLUMNS // 2 - 1] == "*" * (COLUMNS // 2 - 1)
    assert lines[-1].endswith("*" * (COLUMNS // 2 - 1))


def test_what_is_not_a_number_is_left_out():
    values = np.where(TIMES < 1.0, np.nan, 100.0)
    assert cells([curve(values)])[ROWS // 2].startswith(" " * (COLUMNS // 2 - 1))
    assert not "".join(cells([curve(np.full(401, np.inf))])).strip()


def test_without_points_there_is_an_empty_plot():
    assert not "".join(cells([curve([], np.array([]))])).strip()


def test_a_plain_one_is_ascii():
    text = "".join(part for line in plot([curve(TIMES * 100.0)], AXES, WIDTH, ROWS, plain=True) for part, _ in line)
    assert text.isascii()


@pytest.mark.parametrize("plain", [True, False])
@settings(max_examples=40)
@given(
    values=st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=60),
    width=st.integers(24, 130),
    rows=st.integers(2, 20),
    span=st.sampled_from([0.1, 0.5, 1.0, 20.0]),
)
def test_every_line_has_the_requested_width(plain, values, width, rows, span):
    times = np.linspace(0.0, 1.0, len(values))
    lines = plot(
        [curve(values, times), curve(values, times, dashed=True)], PlotAxes(span, 1.0), width, rows, plain=plain
    )
    assert {length(line) for line in lines} == {width}
    assert len(lines) == rows + 1
