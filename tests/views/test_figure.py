from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.signals import Phase
from inteco_abs.views.figure import FORMATS, check_figure, draw_stop

MAGIC = {"png": b"\x89PNG\r\n\x1a\n", "svg": b"<?xml", "pdf": b"%PDF-"}


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """Draws a session and gives the figure instead of saving it."""

    def draw(session) -> Figure:
        saved = []
        monkeypatch.setattr(Figure, "savefig", lambda self, *_args, **_options: saved.append(self))
        draw_stop(session, tmp_path / "stop.png")
        (figure,) = saved
        return figure

    return draw


def lines_of(axes):
    return {line.get_label(): line for line in axes.get_lines()}


def without_phases(session, *phases):
    ticks = session.ticks[~np.isin(session.ticks["phase"], phases)]
    return replace(session, ticks=ticks, payload=ticks.tobytes())


def test_formats_are_those_that_are_tested():
    assert set(FORMATS) == set(MAGIC)


@pytest.mark.parametrize("suffix", MAGIC)
def test_the_file_is_what_its_name_says(session, tmp_path, suffix):
    path = tmp_path / f"stop.{suffix}"
    draw_stop(session, path)
    data = path.read_bytes()
    assert data.startswith(MAGIC[suffix])
    assert len(data) > 10_000


@pytest.mark.parametrize("name", ["stop.jpg", "stop", "stop.", "png", ".png", "stop.mcap", "stop.png.gz"])
def test_another_suffix_is_refused_and_nothing_is_written(session, tmp_path, name):
    for refuse in (check_figure, lambda path: draw_stop(session, path)):
        with pytest.raises(ConfigError, match=r"--figure: .* must end in \.png, \.svg, \.pdf"):
            refuse(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_refused_and_not_made(session, tmp_path):
    for refuse in (check_figure, lambda path: draw_stop(session, path)):
        with pytest.raises(ConfigError, match="missing does not exist; create it first"):
            refuse(tmp_path / "missing" / "stop.png")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_the_name_of_a_figure_is_an_error(session, tmp_path):
    path = tmp_path / "stop.png"
    path.mkdir()
    with pytest.raises(AbsError, match=r"stop\.png"):
        draw_stop(session, path)


def test_without_matplotlib_it_is_said_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(AbsError, match=r"pip install 'inteco-abs\[figures\]'"):
        check_figure(tmp_path / "stop.png")


def test_a_session_without_braking_is_refused(session, tmp_path):
    with pytest.raises(AbsError, match="ended before braking"):
        draw_stop(without_phases(session, Phase.BRAKING, Phase.STOPPED), tmp_path / "stop.png")
    assert list(tmp_path.iterdir()) == []


def test_a_session_without_ticks_is_refused(session, tmp_path):
    empty = replace(session, ticks=session.ticks[:0], payload=b"")
    with pytest.raises(AbsError, match="ended before braking"):
        draw_stop(empty, tmp_path / "stop.png")


def test_every_axis_has_a_label_with_its_unit(session, drawn):
    axes = drawn(session).axes
    assert [panel.get_ylabel() for panel in axes] == [
        "speed [rad/s]",
        "slip [1]",
        "brake torque [N m]",
        "brake duty [1]",
    ]
    assert axes[2].get_xlabel() == "time since braking began [s]"


def test_every_panel_shows_its_signals(session, drawn):
    speeds, slip, torque, duty = drawn(session).axes
    assert lines_of(speeds).keys() == {"road wheel (car)", "braked wheel"}
    assert lines_of(slip).keys() == {"slip, estimated", "slip, true", "reference"}
    assert lines_of(torque).keys() == {"torque, asked", "torque, true"}
    assert lines_of(duty).keys() == {"brake duty"}


@pytest.mark.parametrize(
    ("panel", "label", "column"),
    [
        (0, "road wheel (car)", "road_speed_rad_s"),
        (0, "braked wheel", "wheel_speed_rad_s"),
        (1, "slip, estimated", "slip"),
        (1, "reference", "slip_reference"),
        (2, "torque, asked", "torque_demand_nm"),
        (3, "brake duty", "brake"),
    ],
)
def test_a_line_is_its_column_over_the_time_since_braking_began(session, drawn, panel, label, column):
    line, ticks = lines_of(drawn(session).axes[panel])[label], session.ticks
    first = int(np.flatnonzero(ticks["phase"] == Phase.BRAKING)[0])
    np.testing.assert_array_equal(line.get_ydata(), ticks[column])
    assert line.get_xdata()[first] == 0.0
    np.testing.assert_allclose(np.diff(line.get_xdata()), 0.0005, rtol=1e-6)


def test_true_lines_are_the_truth(session, drawn):
    _, slip, torque, _ = drawn(session).axes
    np.testing.assert_array_equal(lines_of(slip)["slip, true"].get_ydata(), session.truth["slip"])
    np.testing.assert_array_equal(lines_of(torque)["torque, true"].get_ydata(), session.truth["brake_torque_nm"])


def test_a_real_rig_has_no_true_lines(session, drawn):
    _, slip, torque, _ = drawn(replace(session, truth=session.truth[:0])).axes
    assert "slip, true" not in lines_of(slip)
    assert lines_of(torque).keys() == {"torque, asked"}


def test_the_panels_share_the_time_from_just_before_braking_to_the_end(session, drawn):
    ticks = session.ticks
    braking = np.flatnonzero(np.isin(ticks["phase"], (Phase.BRAKING, Phase.STOPPED)))
    end_s = (int(ticks["time_ns"][braking[-1]]) - int(ticks["time_ns"][braking[0]])) * 1e-9
    for panel in drawn(session).axes:
        assert panel.get_xlim() == pytest.approx((-0.2, end_s))


def test_everything_drawn_lies_within_its_panel(session, drawn):
    for panel in drawn(session).axes:
        (left, right), (low, high) = panel.get_xlim(), panel.get_ylim()
        for line in panel.get_lines():
            x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
            shown = y[(x >= left) & (x <= right) & np.isfinite(y)]
            assert low <= shown.min(), line.get_label()
            assert shown.max() <= high, line.get_label()


def test_every_line_is_named_in_a_legend_or_by_the_colour_of_its_axis(session, drawn):
    for panel in drawn(session).axes:
        legend = panel.get_legend()
        if legend:
            assert {text.get_text() for text in legend.get_texts()} == lines_of(panel).keys()
        else:
            assert {line.get_color() for line in panel.get_lines()} == {panel.yaxis.label.get_color()}


def test_the_title_names_controller_and_estimator(session, drawn):
    assert drawn(session).get_suptitle() == "reaching-law on moving-window"
