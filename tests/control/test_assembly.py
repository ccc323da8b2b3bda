import math

import pytest

from inteco_abs.config import load_config, parse_config
from inteco_abs.control import (
    CONTROLLERS,
    ESTIMATORS,
    BrakingModel,
    build_pipeline,
    control_check,
    gains_in_force,
    make_controller,
    preferred_estimator,
)
from inteco_abs.errors import ConfigError
from inteco_abs.rig import RigParameters, nominal_parameters
from inteco_abs.signals import BrakeDemand, Phase

pytestmark = pytest.mark.untraced  # other tests reach these lines, too


class Own:
    """Controller of a user."""

    gains = (CONTROLLERS["relay"].gains[0]._replace(name="Kp", default=0.5, low=0.1, high=0.9),)
    internals = ("p",)

    def __init__(self, setup, Kp) -> None:
        self.setup, self.Kp = setup, Kp

    def update(self, _estimate, _dt_s):
        return BrakeDemand(self.Kp, internals=(self.setup.reference_slip, 0.0, 0.0, 0.0))


OWN = {**CONTROLLERS, "own": Own}


def mistakes(*settings: str, controllers=CONTROLLERS) -> dict[str, str]:
    with pytest.raises(ConfigError) as caught:
        load_config(settings=settings, checks=[control_check(controllers)])
    return {mistake.path: mistake.problem for mistake in caught.value.mistakes}


def test_gains_that_are_not_named_have_their_defaults():
    config = load_config(settings=["controller.gains.Mk=10"], checks=[control_check()])
    assert gains_in_force(config) == {"Mk": 10.0, "Mq": 1.0, "lag_s": 0.0}


def test_the_gains_of_the_papers_simulation_are_the_default_without_a_lag():
    assert gains_in_force(load_config()) == {"Mk": 2.0, "Mq": 1.0, "lag_s": 0.0}


def test_each_controller_has_its_own_gains():
    config = load_config(settings=["controller.name=relay"], checks=[control_check()])
    assert gains_in_force(config) == {"on_duty": 1.0, "off_duty": 0.0}


def test_an_unknown_controller_is_named_with_the_nearest():
    assert mistakes("controller.name=reaching_law") == {
        "controller.name": "no controller 'reaching_law'; did you mean reaching-law?"
    }


def test_an_unknown_estimator_is_named_with_the_nearest():
    assert mistakes("estimator.name=moving-windows") == {
        "estimator.name": "no estimator 'moving-windows'; did you mean moving-window?"
    }


def test_names_that_are_near_nothing_get_the_known_ones():
    found = mistakes("estimator.name=xyz", "controller.name=xyz")
    assert found["estimator.name"].endswith(f"; known: {', '.join(sorted(ESTIMATORS))}")
    assert found["controller.name"].endswith(f"; known: {', '.join(sorted(CONTROLLERS))}")


def test_an_unknown_gain_is_named_with_the_nearest():
    assert mistakes("controller.gains.Mkk=2") == {
        "controller.gains.Mkk": "unknown gain of reaching-law; did you mean Mk?"
    }


def test_a_gain_of_another_controller_is_unknown():
    assert mistakes("controller.name=relay", "controller.gains.Mk=2") == {
        "controller.gains.Mk": "unknown gain of relay; known: off_duty, on_duty"
    }


RANGES = [
    ("reaching-law", "Mk", 0.0, 1000.0, "1/s"),
    ("reaching-law", "Mq", 0.0, 1000.0, "1/s"),
    ("relay", "on_duty", 0.0, 1.0, "1"),
    ("relay", "off_duty", 0.0, 1.0, "1"),
]


@pytest.mark.parametrize(("controller", "gain", "low", "high", "unit"), RANGES)
def test_a_gain_out_of_range_is_named_with_value_range_unit_and_meaning(controller, gain, low, high, unit):
    unit = "" if unit == "1" else f" {unit}"
    for value in (low - 0.001, high + 0.001):
        problem = mistakes(f"controller.name={controller}", f"controller.gains.{gain}={value}")
        assert list(problem) == [f"controller.gains.{gain}"]
        assert problem[f"controller.gains.{gain}"].startswith(f"{value}: must be a number in {low:g}..{high:g}{unit} (")


@pytest.mark.parametrize(("controller", "gain", "low", "high"), [case[:4] for case in RANGES])
def test_a_gain_at_the_edge_of_its_range_is_allowed(controller, gain, low, high):
    for value in (low, high):
        settings = [f"controller.name={controller}", f"controller.gains.{gain}={value:g}"]
        in_force = gains_in_force(load_config(settings=settings, checks=[control_check()]))[gain]
        assert (in_force, type(in_force)) == (value, float)


@pytest.mark.parametrize("value", ["true", '"2"', "nan", "inf", "[1.0]", "1979-05-27"])
def test_a_gain_that_is_not_a_number_is_named_once(value):
    assert list(mistakes(f"controller.gains.Mk={value}")) == ["controller.gains.Mk"]


@pytest.mark.parametrize("setting", ["controller=relay", "estimator=euler", "controller.gains=2"])
def test_a_section_that_is_a_value_is_named_once(setting):
    assert list(mistakes(setting)) == [setting.partition("=")[0]]


@pytest.mark.parametrize("value", ["3", "[1]", "{a = 1}"])
@pytest.mark.parametrize("key", ["controller.name", "estimator.name"])
def test_a_name_that_is_not_text_is_named_once(key, value):
    assert list(mistakes(f"{key}={value}")) == [key]
    assert mistakes(f"{key}={value}")[key].endswith(": must be text")


def test_wrong_names_wrong_gains_and_wrong_values_are_all_reported_at_once():
    found = mistakes(
        "estimator.name=xyz",
        "controller.gains.Mq=-1",
        "controller.gains.Mz=1",
        "guard.brake_limit=2",
        "experiment.start_sped_rad_s=100",
    )
    assert set(found) == {
        "estimator.name",
        "controller.gains.Mq",
        "controller.gains.Mz",
        "guard.brake_limit",
        "experiment.start_sped_rad_s",
    }


def test_a_controller_of_the_users_own_is_checked_and_built():
    assert "controller.name" in mistakes("controller.name=own")
    assert mistakes("controller.name=own", "controller.gains.Kp=1.0", controllers=OWN) == {
        "controller.gains.Kp": "1.0: must be a number in 0.1..0.9 (duty while the slip is below the reference)"
    }
    config = load_config(settings=["controller.name=own"], checks=[control_check(OWN)])
    assert gains_in_force(config, OWN) == {"Kp": 0.5}
    assert build_pipeline(config, OWN).phase is Phase.IDLE


def test_the_controller_assumes_the_model_section_and_not_the_simulated_rig(experiment):
    def first_terms(*settings: str):
        run = experiment("experiment.start_speed_rad_s=60", *settings)
        for moment in run.moments():
            if moment.tick.c1:
                return moment.tick
        raise AssertionError("never braked")

    for name in ("mask", "table"):
        tick = first_terms(f"model.parameters={name}")
        f, g = BrakingModel(RigParameters.named(name)).terms(tick.slip, tick.road_speed_rad_s)
        assert (tick.c0, tick.c1) == (f, g)


def test_reference_and_gains_reach_the_law(experiment):
    settings = ("controller.reference_slip=0.35", "controller.gains={Mk=7.0, Mq=3.0}")
    run = experiment("experiment.start_speed_rad_s=60", "controller.hold_below_rad_s=20", *settings)
    for moment in run.moments():
        tick = moment.tick
        if tick.phase is Phase.BRAKING and tick.road_speed_rad_s > 20.0 and tick.c1:
            error = tick.slip - 0.35
            wanted = -(tick.c0 + 7.0 * error + math.copysign(3.0, error)) / tick.c1
            assert tick.slip_reference == 0.35
            assert tick.switching == error
            assert tick.torque_demand_nm == pytest.approx(wanted, rel=1e-12)
            held = tick
        elif tick.phase is Phase.BRAKING and tick.c1:
            assert tick.torque_demand_nm == held.torque_demand_nm


# a controller that needs an estimator


def chosen(*settings, file=None, controllers=CONTROLLERS):
    """Controller and estimator of a configuration, as a run makes it."""
    checks, follows = [control_check(controllers)], preferred_estimator(controllers)
    config = load_config(file, settings, checks, follows=follows)
    return config.controller.name, config.estimator.name


def test_a_controller_brings_the_estimator_that_it_needs():
    assert chosen("controller.name=predictive-reaching") == ("predictive-reaching", "observer")


def test_a_controller_without_a_preferred_estimator_leaves_the_default():
    assert chosen() == ("reaching-law", "moving-window")
    assert chosen("estimator.name=observer") == ("reaching-law", "observer")


def test_other_keys_of_the_estimator_do_not_choose_one():
    settings = ("controller.name=predictive-reaching", "estimator.window_s=0.02")
    assert chosen(*settings) == ("predictive-reaching", "observer")


@pytest.mark.parametrize("name", sorted(set(ESTIMATORS) - {"observer", "adaptive-observer"}))
def test_another_estimator_than_the_one_that_is_needed_is_refused(name):
    settings = ["controller.name=predictive-reaching", f"estimator.name={name}"]
    with pytest.raises(ConfigError) as caught:
        chosen(*settings)
    (mistake,) = caught.value.mistakes
    assert mistake.path == "estimator.name"
    assert mistake.problem == (
        f"'{name}': the controller predictive-reaching needs 'observer'; choose it, or another controller"
    )


def test_an_unknown_estimator_is_reported_once():
    with pytest.raises(ConfigError) as caught:
        chosen("controller.name=predictive-reaching", "estimator.name=observr")
    assert [mistake.problem for mistake in caught.value.mistakes] == ["no estimator 'observr'; did you mean observer?"]


def test_a_rig_file_chooses_as_the_command_line_does(tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text('[controller]\nname = "predictive-reaching"\n')
    assert chosen(file=file) == ("predictive-reaching", "observer")
    assert chosen("controller.name=relay", file=file) == ("relay", "moving-window")
    file.write_text('[estimator]\nname = "kalman"\n')
    assert chosen(file=file) == ("reaching-law", "kalman")
    with pytest.raises(ConfigError, match="'kalman': the controller predictive-reaching needs 'observer'"):
        chosen("controller.name=predictive-reaching", file=file)
    settings = ("controller.name=predictive-reaching", "estimator.name=observer")
    assert chosen(*settings, file=file) == ("predictive-reaching", "observer")


def test_the_effective_configuration_names_it_and_reads_back_unchanged():
    config = load_config(settings=["controller.name=predictive-reaching"], follows=preferred_estimator())
    assert parse_config(config.to_toml(), [control_check()]) == config
    assert 'name = "observer"' in config.to_toml()


class Needy(Own):
    estimator = "kalman"


def test_a_controller_of_the_users_own_can_need_one_too():
    assert chosen("controller.name=needy", controllers={**CONTROLLERS, "needy": Needy}) == ("needy", "kalman")


NONE = ["controller.name=no-such", "controller.name=3", "controller.name=[1]", "controller=3"]


@pytest.mark.parametrize("setting", NONE)
def test_an_unknown_controller_implies_no_defaults(setting):
    with pytest.raises(ConfigError) as caught:
        chosen(setting)
    assert [mistake.path for mistake in caught.value.mistakes] == [setting.partition("=")[0]]


def test_observer_and_law_believe_in_the_identified_brake():
    settings = [
        "controller.name=predictive-reaching",
        "estimator.name=observer",
        "model.identified.brake_duties=[0.3,0.9]",
        "model.identified.brake_torques_nm=[0.0,6.0]",
        "model.identified.J1=0.008",
    ]
    config = load_config(settings=settings, checks=[control_check()])
    controller = make_controller(config)
    assert controller.duty(3.0) == pytest.approx(0.6)
    assert nominal_parameters(config.model).J1 == 0.008
    assert nominal_parameters(config.model).J2 == RigParameters.named("mask").J2
