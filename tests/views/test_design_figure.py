import warnings

import numpy as np
import pytest

from inteco_abs.config import load_config
from inteco_abs.gain_design import judge_gains, stated_box
from inteco_abs.gain_design.figure import figure_of_design
from inteco_abs.rig import RigParameters
from inteco_abs.views.figure import save_figure


def report_of(*settings, uncertain=("mu=10%", "J1=5%")):
    box = stated_box(uncertain, RigParameters.named("mask"))
    return judge_gains(load_config(settings=settings), box, (10.0, 180.0)).report()


@pytest.fixture(scope="module")
def report():
    return report_of()


@pytest.mark.parametrize(("suffix", "magic"), [("png", b"\x89PNG"), ("pdf", b"%PDF-")])
def test_the_file_is_what_its_name_says(report, tmp_path, suffix, magic):
    path = tmp_path / f"design.{suffix}"
    save_figure(figure_of_design(report), path)
    assert path.read_bytes().startswith(magic)


def test_every_panel_shows_its_curves_over_the_road_speed(report):
    gain, torque, uncertainty = figure_of_design(report).axes
    assert [panel.get_ylabel() for panel in (gain, torque)] == ["Mq [1/s]", "brake torque [N m]"]
    assert uncertainty.get_xlabel() == "road speed [rad/s]"
    for panel, label, key in (
        (gain, "minimum by (25)", "mq_25_per_s"),
        (gain, "minimum by (26)", "mq_26_per_s"),
        (gain, "given", "mq_per_s"),
        (torque, "M1eq, nominal", "torque_eq_nm"),
        (uncertainty, "F [1/s]", "F_per_s"),
        (uncertainty, "eps_f [1/s]", "eps_f_per_s"),
        (uncertainty, "eps_g [1]", "eps_g"),
    ):
        (line,) = [line for line in panel.get_lines() if line.get_label() == label]
        np.testing.assert_array_equal(line.get_ydata(), report["curves"][key])
        np.testing.assert_array_equal(line.get_xdata(), report["curves"]["road_speed_rad_s"])
        assert panel.get_xlim() == (10.0, 180.0)


def test_lines_of_a_panel_differ_in_grey_too(report):
    for panel in figure_of_design(report).axes:
        named = [line for line in panel.get_lines() if not line.get_label().startswith("_")]
        looks = [(line.get_linestyle(), line.get_linewidth()) for line in named]
        assert len(set(looks)) == len(looks)


def test_the_torques_swing_by_the_gain_over_g(report):
    _, torque, _ = figure_of_design(report).axes
    upper, lower = (line.get_ydata() for line in torque.get_lines() if line.get_linestyle() == "-.")
    np.testing.assert_allclose(upper - lower, 2.0 * np.array(report["curves"]["torque_swing_nm"]))


@pytest.mark.parametrize("uncertain", ["J1=70%", "mu=0%"])
def test_infinite_or_missing_bounds_are_left_out_quietly(uncertain):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = figure_of_design(report_of("controller.gains.Mq=0", uncertain=[uncertain]))
        figure._repr_png_()
    assert len(figure.axes) == 3
