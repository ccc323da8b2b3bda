"""What is said of gains: reaching, existence, the brake's budget, chattering; and that following the advice helps."""

import math
import re

import numpy as np
import pytest

from inteco_abs.config import load_config
from inteco_abs.control import BrakingModel, control_check, reaching_time_bound
from inteco_abs.errors import ConfigError
from inteco_abs.gain_design import judge_gains, stated_box
from inteco_abs.rig import RigParameters

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

MASK = RigParameters.named("mask")
RANGE = (10.0, 180.0)
CAPPED = "guard.brake_limit=0.7"
LARGE = "controller.gains={Mk = 10.0, Mq = 4.0}"
LAYER = "controller.name=boundary-layer"


@pytest.fixture(scope="session")
def judge():
    def run(*settings, uncertain=("mu=1%",), speeds=RANGE, **options):
        config = load_config(settings=settings, checks=[control_check()])
        return judge_gains(config, stated_box(uncertain, MASK), speeds, **options)

    return run


def about(judgement, subject):
    return [one for one in judgement.advice if one.about == subject]


def number_after(text, words):
    return float(re.search(rf"{re.escape(words)}\s*([-\d.]+)", text)[1])


def test_good_gains_on_a_well_known_rig_get_no_advice(judge):
    judgement = judge()
    assert not judgement.advice
    assert not judgement.fails_25
    assert not judgement.fails_26


def test_on_the_way_from_zero_slip_the_torque_peaks_at_the_published_value(judge):
    (way,) = judge().reaching
    assert way.bound_s == pytest.approx(0.1682, abs=0.0001)
    assert way.bound_s < way.time_s <= way.bound_s + 0.001
    assert way.peak_torque_nm == pytest.approx(6.11, abs=0.01)
    assert way.lowest_torque_nm == 0.0


def test_advice_gives_the_published_reaching_time_at_the_vendors_duty_limit(judge):
    judgement = judge(CAPPED)
    (way,) = judgement.reaching
    assert way.time_s == pytest.approx(0.724, abs=0.003)
    assert way.peak_torque_nm == pytest.approx(6.11, abs=0.01)
    (advice,) = about(judgement, "reaching")
    for words in ("0.723 s", "0.168 s", "6.11 N m", "4.46 N m", "0.7"):
        assert words in advice.found
    assert number_after(advice.next_step, "guard.brake_limit =") == pytest.approx(0.81)
    assert not about(judge("guard.brake_limit=0.81"), "reaching")


def test_reaching_from_above_is_limited_by_a_released_brake(judge):
    low, high = judge(LARGE, from_slips=(0.0, 0.4)).reaching
    assert low.time_s == pytest.approx(0.061)
    assert high.bound_s == pytest.approx(low.bound_s)
    assert high.lowest_torque_nm < 0.0 == high.peak_torque_nm
    assert high.time_s > 1.5 * high.bound_s
    (advice,) = [one for one in about(judge(LARGE, from_slips=(0.4,)), "reaching") if "slip 0.4" in one.found]
    assert advice.next_step == "smaller gains"
    assert "does not succeed" in about(judge(LARGE, "guard.brake_limit=0.6"), "reaching")[0].found


def test_reaching_from_the_reference_takes_no_time(judge):
    (way,) = judge(from_slips=(0.2,)).reaching
    assert (way.bound_s, way.time_s) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("settings", "bound_s"),
    [
        (["controller.name=constant-rate", "controller.gains.Mq=2"], 0.1),
        (["controller.gains={Mk = 0.0, Mq = 2.0}"], 0.1),
        (["controller.gains.Mq=0"], math.inf),
        ([LAYER], reaching_time_bound(0.0, 0.2, 2.0, 1.0) - reaching_time_bound(0.0, 0.02, 2.0, 1.0)),
        ([LAYER, "controller.gains.width=0.3"], 0.0),
    ],
)
def test_eq20_reaching_bound_fits_each_law(judge, settings, bound_s):
    (way,) = judge(*settings).reaching
    assert way.bound_s == pytest.approx(bound_s)
    assert way.time_s <= way.bound_s + 0.001


@pytest.mark.parametrize(
    ("settings", "speed"), [([], 71.4), (["controller.gains.Mq=4"], 17.8), ([LAYER], 71.4)], ids=["1", "4", "layer"]
)
def test_where_sliding_is_not_guaranteed_is_said_with_the_gain_that_is_missing(judge, settings, speed):
    judgement = judge(*settings, uncertain=["mu=10%"])
    (advice,) = about(judgement, "existence")
    assert number_after(advice.found, "below") == pytest.approx(speed)
    assert number_after(advice.found, "above") == pytest.approx(7.14)
    (lost,) = judgement.fails_25
    assert lost == pytest.approx((10.0, speed), abs=0.05)


@pytest.mark.parametrize("gains", ["{Mk = 2.0, Mq = 1.0}", "{Mk = 2.0, Mq = 0.2}", "{Mk = 2.0, Mq = 0.0}"])
@pytest.mark.parametrize("uncertain", [["mu=10%"], ["J1=5%", "d2=20%", "brake_gain=5%"]])
def test_either_way_that_is_advised_makes_sliding_guaranteed(judge, gains, uncertain):
    (advice,) = about(judge(f"controller.gains={gains}", uncertain=uncertain), "existence")
    constant, scheduled = advice.next_step.split("or the controller")
    Mq, grown_Mq, v = number_after(constant, "Mq ="), number_after(scheduled, "Mq ="), number_after(scheduled, "v =")
    assert not judge(f"controller.gains.Mq={Mq}", uncertain=uncertain).fails_25
    assert not judge(LAYER, f"controller.gains.Mq={grown_Mq}", f"controller.gains.v={v}", uncertain=uncertain).fails_25


def test_without_uncertainty_any_switching_is_enough(judge):
    (advice,) = about(judge("controller.gains.Mq=0", uncertain=["mu=0%"]), "existence")
    assert advice.next_step == "any Mq above 0"


def test_a_band_of_slips_asks_for_at_least_as_much_as_the_reference(judge):
    at_reference, in_band = judge(uncertain=["J1=5%"]), judge(uncertain=["J1=5%"], slip_band=(0.05, 0.6))
    for name in ("F_per_s", "eps_f_per_s", "eps_g", "mq_25_per_s", "mq_26_per_s"):
        assert np.all(in_band.curves[name] >= at_reference.curves[name] * 0.999)
    assert np.all(in_band.curves["mq_25_per_s"] > at_reference.curves["mq_25_per_s"])
    assert np.array_equal(in_band.curves["torque_eq_nm"], at_reference.curves["torque_eq_nm"])


@pytest.mark.parametrize(
    ("settings", "what", "speed"),
    [([LARGE], "M1eq + Mq/g", 133.0), ([LARGE], "M1eq - Mq/g", 115.0), ([CAPPED], "M1eq + Mq/g", 29.0)],
)
def test_where_switching_saturates_the_brake_is_said(judge, settings, what, speed):
    (advice,) = [one for one in about(judge(*settings), "saturation") if what in one.found]
    assert number_after(advice.found, "above") == pytest.approx(speed, abs=0.5)


def test_the_gain_that_is_advised_against_saturation_does_not_saturate(judge):
    gains = [number_after(one.next_step, "Mq up to") for one in about(judge(LARGE), "saturation")]
    assert gains == pytest.approx([2.96 / 1.01, 2.56 / 1.01], abs=0.01)
    assert not about(judge(f"controller.gains.Mq={min(gains)}"), "saturation")
    assert about(judge(f"controller.gains.Mq={1.05 * min(gains)}"), "saturation")
    (capped,) = about(judge(CAPPED), "saturation")
    assert number_after(capped.next_step, "Mq up to") < 0.2
    assert not about(judge(CAPPED, "controller.gains.Mq=0.16"), "saturation")


def test_the_largest_gain_that_never_saturates_is_among_the_curves(judge):
    model = BrakingModel(MASK)
    assert judge().curves["mq_unsaturated_per_s"][-1] == pytest.approx(abs(model.f(0.2, 180.0)))
    room = 4.458 + model.f(0.2, 180.0) / model.g(0.2, 180.0)
    assert judge(CAPPED).curves["mq_unsaturated_per_s"][-1] == pytest.approx(model.g(0.2, 180.0) * room)


def test_a_brake_that_is_held_in_its_dead_zone_gives_nothing(judge):
    judgement = judge("guard.brake_limit=0.3")
    assert judgement.report()["largest_torque_nm"] == 0.0
    assert {"holding", "saturation", "reaching"} <= {one.about for one in judgement.advice}


def test_advice_names_the_duty_that_holds_where_the_brake_limit_is_too_low(judge):
    (advice,) = about(judge(CAPPED, uncertain=["mu=10%"]), "holding")
    assert "at every speed" in advice.found
    assert "4.84 N m" in advice.found
    duty = number_after(advice.next_step, "guard.brake_limit above")
    assert not about(judge(f"guard.brake_limit={duty + 0.001}", uncertain=["mu=10%"]), "holding")
    assert about(judge(f"guard.brake_limit={duty - 0.01}", uncertain=["mu=10%"]), "holding")


def test_a_brake_that_no_duty_makes_strong_enough_is_said_to_be_too_weak(judge):
    judgement = judge(uncertain=["mu=85%"])
    assert any("no duty is enough" in one.next_step for one in about(judgement, "holding"))
    assert any("brake that can hold" in one.next_step for one in about(judge("guard.brake_limit=0.6"), "saturation"))


def test_a_rig_that_slows_down_too_much_without_brake_is_said(judge):
    judgement = judge("controller.reference_slip=0.02", uncertain=["b2=4.5"])
    assert any("released" in one.found for one in about(judgement, "holding"))


def test_assumptions_that_do_not_hold_are_said(judge):
    (advice,) = about(judge(uncertain=["J1=70%"]), "assumption")
    assert "eps_g = 2.43" in advice.found
    lost = judge(uncertain=["L=90%", "J1=90%", "J2=50%"])
    assert "no gain is enough" in about(lost, "existence")[0].found
    assert not about(lost, "assumption")
    assert not about(lost, "holding")
    report = lost.report()
    assert report["g_positive"] is False
    assert report["mq_25_per_s"] is None
    assert report["fails_25_rad_s"] == [[10.0, 180.0]]


def test_chattering_is_predicted_as_in_an_ideal_loop(judge):
    curves = judge().curves
    model = BrakingModel(MASK)
    assert curves["slip_ripple_rms"] == pytest.approx(np.full(171, 2.5e-4))
    ripple_nm = [1.0 / model.g(0.2, speed) for speed in curves["road_speed_rad_s"]]
    assert curves["torque_ripple_nm"].tolist() == pytest.approx(ripple_nm)


def test_a_boundary_layer_does_not_chatter_unless_it_is_too_thin(judge):
    assert not judge(LAYER).curves["torque_ripple_nm"].any()
    thin = judge(LAYER, "controller.gains={v = 50.0, width = 0.0005}")
    (advice,) = about(thin, "chattering")
    assert number_after(advice.found, "below") == pytest.approx(50.0 * 0.0005 / (2.0 * 0.0005 - 1e-6), abs=0.3)
    width = number_after(advice.next_step, "width =")
    assert not about(judge(LAYER, f"controller.gains={{v = 50.0, width = {1.01 * width}}}"), "chattering")
    assert thin.curves["slip_ripple_rms"][0] == pytest.approx(5.0 * 0.0005 / 2.0)
    assert thin.curves["slip_ripple_rms"][-1] == 0.0


def test_a_gain_that_grows_as_v_over_the_speed_is_judged_as_it_grows(judge):
    curves = judge(LAYER, "controller.gains.v=72", uncertain=["mu=10%"]).curves
    assert curves["mq_per_s"][0] == pytest.approx(7.2)
    assert curves["mq_per_s"][-1] == 1.0


def test_a_controller_without_a_switching_gain_is_refused(judge):
    with pytest.raises(ConfigError, match=r"'pi' has no switching gain.*reaching-law, constant-rate, boundary-layer"):
        judge("controller.name=pi")


def test_a_short_range_of_speeds_is_looked_at_too(judge):
    curves = judge(speeds=(50.0, 52.0)).curves
    assert curves["road_speed_rad_s"][[0, -1]].tolist() == [50.0, 52.0]
    assert len(curves["road_speed_rad_s"]) == 11
