import math
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.signals import Phase
from inteco_abs.views.envelope import LABEL, envelope
from inteco_abs.views.figure import FORMATS, check_figure, draw_stops, figure_of, highest_slip, slip_top, svg_of
from inteco_abs.views.figure_options import STYLES, FigureOptions

DUTY = "duty"
MAGIC = {"png": b"\x89PNG\r\n\x1a\n", "svg": b"<?xml", "pdf": b"%PDF-", "pgf": b"%% In the preamble"}


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Draws sessions and gives the figure instead of saving it."""

    def draw(*sessions, **options) -> Figure:
        saved = []
        monkeypatch.setattr(Figure, "savefig", lambda self, file, **_: (saved.append(self), file.touch()))
        draw_stops(sessions, tmp_path / "stop.png", FigureOptions(**options))
        (tmp_path / "stop.png").unlink()
        (figure,) = saved
        return figure

    return draw


def lines_of(axes):
    return {line.get_label(): line for line in axes.get_lines()}


def without_phases(session, *phases):
    ticks = session.ticks[~np.isin(session.ticks["phase"], phases)]
    return session.with_rows(ticks)


def test_formats_are_those_that_are_tested():
    assert set(FORMATS) == set(MAGIC)


@pytest.mark.parametrize("suffix", MAGIC)
def test_the_file_is_what_its_name_says(session, tmp_path, suffix):
    path = tmp_path / f"stop.{suffix}"
    draw_stops([session], path)
    data = path.read_bytes()
    assert data.startswith(MAGIC[suffix])
    assert len(data) > 10_000


@pytest.mark.parametrize("name", ["stop.jpg", "stop", "stop.", "png", ".png", "stop.mcap", "stop.png.gz"])
def test_another_suffix_is_refused_and_nothing_is_written(session, tmp_path, name):
    for refuse in (check_figure, lambda path: draw_stops([session], path)):
        with pytest.raises(ConfigError, match=r"--figure: .* must end in \.png, \.svg, \.pdf, \.pgf"):
            refuse(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_refused_and_not_made(session, tmp_path):
    for refuse in (check_figure, lambda path: draw_stops([session], path)):
        with pytest.raises(ConfigError, match="missing does not exist; create it first"):
            refuse(tmp_path / "missing" / "stop.png")
    assert list(tmp_path.iterdir()) == []


def test_a_figure_that_is_there_stays(session, tmp_path):
    path = tmp_path / "stop.svg"
    path.write_text("mine")
    for refuse in (check_figure, lambda path: draw_stops([session], path)):
        with pytest.raises(
            ConfigError, match=r"--figure: .*stop\.svg: exists already, and files are never overwritten"
        ):
            refuse(path)
    assert path.read_text() == "mine"


def test_a_mistake_is_reported_under_the_option_that_has_it(tmp_path):
    with pytest.raises(ConfigError, match=r"--out: .* must end in"):
        check_figure(tmp_path / "stop.eps", "--out")


def test_a_folder_with_the_name_of_a_figure_is_an_error(session, tmp_path):
    path = tmp_path / "stop.png"
    path.mkdir()
    with pytest.raises(AbsError, match=r"stop\.png"):
        draw_stops([session], path)


def test_without_matplotlib_the_error_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(AbsError, match=r"pip install 'inteco-abs\[figures\]'"):
        check_figure(tmp_path / "stop.png")


def test_a_session_without_braking_is_refused(session, tmp_path):
    with pytest.raises(AbsError, match="ended before braking"):
        draw_stops([without_phases(session, Phase.BRAKING, Phase.STOPPED)], tmp_path / "stop.png")
    assert list(tmp_path.iterdir()) == []


def test_a_session_without_ticks_is_refused(session, tmp_path):
    empty = session.with_rows(session.ticks[:0])
    with pytest.raises(AbsError, match="ended before braking"):
        draw_stops([empty], tmp_path / "stop.png")


def test_every_axis_has_a_label_with_its_unit(session, drawn):
    axes = drawn(session).axes
    assert [panel.get_ylabel() for panel in axes] == [
        "speed [rad/s]",
        "slip",
        "brake torque [N m]",
        "brake duty",
    ]
    assert axes[2].get_xlabel() == "time since braking began [s]"


def slip_shown(rows):
    """Nothing of the slip of a road at rest: it is noise."""
    return np.where(rows["road_speed_rad_s"] >= 1.0, rows["slip"], np.nan)


def test_every_panel_shows_its_signals(session, drawn):
    speeds, slip, torque, duty = drawn(session).axes
    assert lines_of(speeds).keys() == {"road wheel (car)", "braked wheel"}
    assert lines_of(slip).keys() == {"estimated", "true", "reference"}
    assert lines_of(torque).keys() == {"asked", "true", DUTY}
    assert lines_of(duty).keys() == {"brake duty"}


@pytest.mark.parametrize(
    ("panel", "label", "column"),
    [
        (0, "road wheel (car)", "road_speed_rad_s"),
        (0, "braked wheel", "wheel_speed_rad_s"),
        (1, "estimated", "slip"),
        (1, "reference", "slip_reference"),
        (2, "asked", "torque_demand_nm"),
        (3, "brake duty", "brake"),
    ],
)
def test_a_line_is_its_column_over_the_time_since_braking_began(session, drawn, panel, label, column):
    line, ticks = lines_of(drawn(session, envelope=False).axes[panel])[label], session.ticks
    first = int(np.flatnonzero(ticks["phase"] == Phase.BRAKING)[0])
    expected = slip_shown(ticks) if column == "slip" else ticks[column]
    np.testing.assert_array_equal(line.get_ydata(), expected)
    assert line.get_xdata()[first] == 0.0
    np.testing.assert_allclose(np.diff(line.get_xdata()), 0.0005, rtol=1e-6)


def test_true_lines_are_the_truth(session, drawn):
    _, slip, torque, _ = drawn(session, envelope=False).axes
    np.testing.assert_array_equal(lines_of(slip)["true"].get_ydata(), slip_shown(session.truth))
    np.testing.assert_array_equal(lines_of(torque)["true"].get_ydata(), session.truth["brake_torque_nm"])


def test_a_real_rig_has_no_true_lines(session, drawn):
    _, slip, torque, _ = drawn(session.with_rows(truth=session.truth[:0])).axes
    assert "true" not in lines_of(slip)
    assert lines_of(torque).keys() == {"asked", DUTY}


def test_the_panels_share_the_time_from_just_before_braking_to_the_end(session, drawn):
    ticks = session.ticks
    braking = np.flatnonzero(np.isin(ticks["phase"], (Phase.BRAKING, Phase.STOPPED)))
    end_s = (int(ticks["time_ns"][braking[-1]]) - int(ticks["time_ns"][braking[0]])) * 1e-9
    for panel in drawn(session).axes:
        assert panel.get_xlim() == pytest.approx((-0.2, end_s))


def test_everything_drawn_lies_within_its_panel_and_slip_as_long_as_the_road_rolls(session, drawn):
    axes = drawn(session).axes
    assert slip_top(map(highest_slip, [session.ticks, session.truth])) == axes[1].get_ylim()[1]
    for panel in (axes[0], *axes[2:]):
        (left, right), (low, high) = panel.get_xlim(), panel.get_ylim()
        for line in (line for line in panel.get_lines() if len(line.get_xdata())):
            x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
            shown = y[(x >= left) & (x <= right) & np.isfinite(y)]
            assert low <= shown.min(), line.get_label()
            assert shown.max() <= high, line.get_label()


def rolling(slips, reference=0.2):
    """Ticks with these slips at 50 rad/s, and a last one at rest whose slip is anything."""
    ticks = np.zeros(len(slips) + 1, [("road_speed_rad_s", float), ("slip", float), ("slip_reference", float)])
    ticks["slip"], ticks["slip_reference"] = [*slips, 1.0], reference
    ticks["road_speed_rad_s"][:-1] = 50.0
    return ticks


@pytest.mark.parametrize(
    ("slips", "top"),
    [
        ([0.0, 0.21, 0.2], 0.3),
        ([0.0, 0.1], 0.25),
        ([0.0, 0.44], 0.55),
        ([0.0, 0.89], 1.02),
        ([0.0, 0.95], 1.02),
        ([math.nan, math.nan], 0.25),
        ([], 1.02),
    ],
)
def test_slip_has_the_whole_axis_where_a_wheel_locks_and_else_as_much_as_it_needs(slips, top):
    assert slip_top([highest_slip(rolling(slips))]) == pytest.approx(top)


def test_sessions_that_lie_over_one_another_have_one_axis_of_slip():
    assert slip_top(map(highest_slip, [rolling([0.2]), rolling([0.44])])) == slip_top([highest_slip(rolling([0.44]))])


def test_every_line_is_named_in_a_legend_or_by_the_colour_of_its_axis(session, drawn):
    for panel in drawn(session).axes:
        legend = panel.get_legend()
        if legend:
            assert {text.get_text() for text in legend.get_texts()} - {LABEL} == lines_of(panel).keys()
        else:
            assert {line.get_color() for line in panel.get_lines()} == {panel.yaxis.label.get_color()}


def test_the_title_names_controller_and_estimator(session, drawn):
    assert drawn(session).get_suptitle() == "reaching-law on moving-window"


@pytest.mark.parametrize("suffix", ["svg", pytest.param("pdf", marks=pytest.mark.long)])
def test_the_same_sessions_give_the_same_file(session, others, tmp_path, suffix):
    files = [tmp_path / f"{name}.{suffix}" for name in ("first", "second")]
    for file in files:
        draw_stops([session, others[0]], file)
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.parametrize(
    ("style", "width", "millimetres"),
    [
        ("plain", "one", 88.0),
        ("plain", "two", 180.0),
        ("ieee", "one", 88.9),
        ("ieee", "two", 182.0),
        ("elsevier", "one", 90.0),
        ("elsevier", "two", 190.0),
    ],
)
def test_a_figure_is_as_wide_as_the_columns_of_a_journal(style, width, millimetres):
    assert FigureOptions(style=style, width=width).size.width_mm == millimetres


def test_a_journals_figure_has_its_font_and_no_title(session, drawn):
    figure = drawn(session, style="ieee", width="one")
    speeds = figure.axes[0]
    assert figure.get_size_inches()[0] * 25.4 == pytest.approx(88.9)
    assert figure.get_suptitle() == ""
    assert "serif" in speeds.yaxis.label.get_family()
    assert speeds.yaxis.label.get_size() == 9.0
    assert speeds.get_ylabel() == "speed (rad/s)"


def test_panels_range_title_and_font_are_chosen(session, drawn):
    figure = drawn(session, panels=["slip"], range_s=(0.1, 0.2), font="DejaVu Serif", font_size_pt=11.0, title=False)
    (slip,) = figure.axes
    assert figure.get_suptitle() == ""
    assert slip.get_xlim() == (0.1, 0.2)
    assert slip.get_xlabel() == "time since braking began [s]"
    assert slip.get_ylabel() == "slip"
    assert slip.yaxis.label.get_family() == ["DejaVu Serif", "serif"]
    assert slip.yaxis.label.get_size() == 11.0
    assert figure.get_size_inches()[1] * 25.4 == pytest.approx(25.0 + 140.0 / 3.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"style": "nature"}, "--style: 'nature': must be one of plain, ieee, elsevier"),
        ({"width": "three"}, "--width: 'three': must be one of one, two"),
        ({"panels": ["slip", "speeds"]}, "--panels: .*must be one or several of speed, slip, torque"),
        ({"panels": []}, "--panels"),
        ({"panels": "slip"}, "--panels"),
        ({"font": "Comic Papyrus"}, "--font: Comic Papyrus: not an installed font"),
        ({"font_size_pt": 2.0}, r"--font-size: 2\.0: must be in 5\.\.20 pt"),
        ({"range_s": (1.0, 0.5)}, r"--range: \(1\.0, 0\.5\): must be two times that rise"),
        ({"range_s": (0.0, math.nan)}, "--range"),
        ({"range_s": (1.0,)}, "--range"),
        ({"range_s": 5}, "--range: 5: must be two times"),
        ({"range_s": ("a", "b")}, "--range"),
        ({"font_size_pt": "8"}, "--font-size: '8': must be in"),
        ({"panels": None}, "--panels"),
        ({"font": 3}, "--font: 3: not an installed font"),
        ({"range_s": (99.0, 100.0)}, r"--range: 99 100: .*\.mcap ends .* s after braking began"),
    ],
)
def test_an_option_that_is_not_possible_is_refused(session, options, words):
    with pytest.raises(ConfigError, match=words):
        figure_of([session], FigureOptions(**options))


def test_what_chatters_has_a_range_and_a_mean_and_nothing_else_has():
    time_s = np.arange(2000) * 0.0005
    square = np.where(np.arange(2000) // 2 % 2, 4.0, 2.0)
    ramp = time_s * 10.0 + 0.01 * (np.arange(2000) % 2)
    found = envelope(square, 14, 0.3)
    assert found.chatters[20:-20].all()
    assert (found.low[20:-20], found.high[20:-20]) == (pytest.approx(2.0), pytest.approx(4.0))
    assert found.values[20:-20] == pytest.approx(3.0, abs=0.15)
    for calm in (ramp, np.sin(time_s * 60.0), np.ones(2000), square[:3], np.where(time_s < 0.5, 2.0, 4.0)):
        found = envelope(calm, 14, 0.3)
        assert not found.chatters.any()
        np.testing.assert_array_equal(found.values, calm)
    mixed = envelope(np.concatenate([ramp, square]), 14, 0.3)
    assert not mixed.chatters[:1980].any()
    assert mixed.chatters[2020:-20].all()


def test_a_chattering_torque_is_drawn_as_a_range(session, drawn):
    ticks = session.ticks.copy()
    ticks["torque_demand_nm"] = np.where(np.arange(len(ticks)) % 2, 6.0, 2.0)
    _, _, torque, _ = drawn(session.with_rows(ticks)).axes
    assert LABEL in torque.get_legend_handles_labels()[1]
    asked = np.asarray(lines_of(torque)["asked"].get_ydata())
    assert asked[20:-20] == pytest.approx(4.0, abs=0.7)
    _, _, torque, _ = drawn(session.with_rows(ticks), envelope=False).axes
    assert LABEL not in torque.get_legend_handles_labels()[1]


def test_the_text_of_an_svg_is_text(session, tmp_path):
    draw_stops([session], tmp_path / "stop.svg")
    assert "time since braking began [s]</text>" in (tmp_path / "stop.svg").read_text()


def test_pgf_has_the_documents_fonts_and_no_command_in_a_name(session, others, with_facts, tmp_path):
    odd = with_facts(others[1], "controller", name=r"50 %_#{$\x^~")
    draw_stops([session, odd], tmp_path / "stop.pgf", FigureOptions(style="ieee"))
    text = (tmp_path / "stop.pgf").read_text()
    assert r"50 \%\_\#\{\$\textbackslash{}x\textasciicircum{}\textasciitilde{}" in text
    assert r"\rmfamily" in text
    assert "fontspec" not in text
    assert text.count(r"\begin{pgfscope}") == text.count(r"\end{pgfscope}") > 100


@pytest.mark.long
def test_latex_typesets_pgf(session, others, with_facts, tmp_path):
    odd = with_facts(others[1], "controller", name=r"50 %_#{$\x^~ −1")
    draw_stops([session, odd], tmp_path / "stop.pgf", FigureOptions(style="elsevier", width="one"))
    document = r"\documentclass{article}\usepackage{pgf}\begin{document}\input{stop.pgf}\end{document}"
    (tmp_path / "paper.tex").write_text(document)
    words = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert (tmp_path / "paper.pdf").read_bytes().startswith(b"%PDF-")


def test_two_columns_are_the_default(session, drawn):
    assert drawn(session).get_size_inches()[0] * 25.4 == pytest.approx(STYLES["plain"].widths["two"].width_mm)


def legend_of(figure):
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def test_several_sessions_lie_over_one_another_and_are_named_by_what_differs(session, others, drawn):
    figure = drawn(session, *others, envelope=False)
    assert legend_of(figure) == ["reaching-law, Mk 2, Mq 1", "reaching-law, Mk 10, Mq 4", "relay"]
    speeds, slip, torque = figure.axes
    assert [panel.get_ylabel() for panel in figure.axes] == [
        "speed [rad/s]",
        "slip, true",
        "brake torque, true [N m]",
    ]
    for each in (session, *others):
        assert any(np.array_equal(line.get_ydata(), each.ticks["road_speed_rad_s"]) for line in speeds.get_lines())
        assert any(
            np.array_equal(line.get_ydata(), slip_shown(each.truth), equal_nan=True) for line in slip.get_lines()
        )
        assert any(np.array_equal(line.get_ydata(), each.truth["brake_torque_nm"]) for line in torque.get_lines())


def test_sessions_differ_in_grey_too(session, others, drawn):
    (legend,) = drawn(session, *others).legends
    looks = {str(line.get_linestyle()) + str(line._unscaled_dash_pattern) for line in legend.get_lines()}
    assert len(looks) == 3


def test_a_curve_that_one_session_lacks_is_shown_for_none(session, others, drawn):
    real = others[0].with_rows(truth=others[0].truth[:0])
    _, slip, torque = drawn(session, real).axes
    assert (slip.get_ylabel(), torque.get_ylabel()) == ("slip, estimated", "brake torque, asked [N m]")
    assert not any(
        np.array_equal(line.get_ydata(), slip_shown(session.truth), equal_nan=True) for line in slip.get_lines()
    )


def test_a_name_is_not_a_formula_and_a_long_one_is_cut(session, others, with_facts, tmp_path):
    odd = with_facts(others[1], "controller", name=r"$\nothing{$ " + "very " * 200 + "long")
    for name, sessions in (("alone.svg", [odd]), ("beside.svg", [session, odd])):
        draw_stops(sessions, tmp_path / name, FigureOptions(width="one"))


def test_a_session_that_never_braked_is_named(session, others, tmp_path):
    early = replace(without_phases(others[0], Phase.BRAKING, Phase.STOPPED), path=tmp_path / "early.mcap")
    with pytest.raises(AbsError, match=r"early\.mcap: the run ended before braking"):
        draw_stops([session, early], tmp_path / "stop.png")


def test_the_printed_figure_has_the_same_lines_in_fewer_points(session, tmp_path):
    draw_stops([session], tmp_path / "all.svg")
    printed = svg_of([session])
    assert printed.startswith(b"<?xml")
    assert len(printed) > 10_000
    assert printed.count(b" L ") <= (tmp_path / "all.svg").read_bytes().count(b" L ")


class TestVerb:
    def test_it_draws_several_sessions(self, verb, session, others):
        done = verb("figure", session.path, others[0].path, "-o", "both.pdf", "--width", "one")
        assert (done.code, done.out, done.err) == (0, "", "figure: both.pdf\n")

    def test_it_draws_a_part_as_a_journal_wants_it(self, verb, session, tmp_path):
        options = ["--style", "ieee", "--width", "one", "--panels", "slip, torque", "--range", 0.0, 0.2]
        done = verb("figure", session.path, "-o", "part.svg", *options, "--font-size", 8, "--title", "--no-envelope")
        assert done.code == 0, done.err
        drawing = (tmp_path / "part.svg").read_text()
        assert "reaching-law on moving-window</text>" in drawing
        assert "speed (rad/s)" not in drawing

    def test_an_unknown_panel_is_named(self, verb, session):
        done = verb("figure", session.path, "-o", "x.png", "--panels", "speed,force")
        assert done.code == 2
        assert "--panels: ['speed', 'force']: must be one or several of speed, slip, torque" in done.err

    def test_another_width_is_usage(self, verb, session):
        done = verb("figure", session.path, "-o", "x.png", "--width", "three")
        assert done.code == 2
        assert "'one', 'two'" in done.err

    def test_no_session_is_usage(self, verb):
        assert verb("figure", "-o", "x.png").code == 2

    def test_a_session_that_was_cut_is_drawn_and_reported(self, verb, session, tmp_path):
        (tmp_path / "cut.mcap").write_bytes(session.path.read_bytes()[:-300])
        done = verb("figure", "cut.mcap", "-o", "x.png")
        assert done.code == 3
        assert "the file ends early" in done.err
        assert (tmp_path / "x.png").exists()
