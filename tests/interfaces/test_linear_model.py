"""The symbolic model is the engine's, and its linearisation what the engine does near a point."""

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import sympy

from inteco_abs.control import BrakingModel
from inteco_abs.interfaces.linear_model import linearised
from inteco_abs.interfaces.symbolic_model import DUTY, SYMBOLS, equations, symbolic_model
from inteco_abs.rig import Plant, RigParameters, accelerations, brake_torque, draw, wheel_slip

MASK = RigParameters.named("mask")
DRAWN = [draw("hard", seed).parameters for seed in range(40)]
"""Rigs with their own masses, frictions and lags."""


def numbers(model, expressions):
    """Function of parameters and state, by SymPy's own evaluation."""
    names = [*SYMBOLS, "duty"]
    function = sympy.lambdify([*SYMBOLS.values(), DUTY, *model.states], expressions, modules="math", cse=True)
    return lambda parameters, duty, *states: function(
        *(getattr(parameters, name) for name in names[:-1]), duty, *states
    )


def engine_rates(parameters, wheel, road, torque, duty):
    motion = accelerations(wheel, road, torque, 0.0, parameters)
    lag = parameters.c31 * (brake_torque(duty, parameters) - torque)
    return np.array([motion.wheel_acceleration, motion.road_acceleration, lag])


def points(seed, count=200):
    pick = np.random.default_rng(seed)
    for i in range(count):
        slip, road = pick.uniform(0.001, 0.999), pick.uniform(1.0, 240.0)
        parameters = DRAWN[i % len(DRAWN)]
        wheel = (1.0 - slip) * parameters.r2 / parameters.r1 * road
        yield parameters, wheel, road, pick.uniform(0.0, 9.0), pick.uniform(0.42, 1.0)


def test_the_symbolic_rates_are_the_engines_at_drawn_points_of_drawn_rigs():
    model = symbolic_model()
    rates = numbers(model, list(model.rates))
    slip = numbers(model, model.slip)
    for parameters, wheel, road, torque, duty in points(1):
        found = rates(parameters, duty, wheel, road, torque)
        assert found == pytest.approx(engine_rates(parameters, wheel, road, torque, duty), rel=1e-11, abs=1e-9)
        assert slip(parameters, duty, wheel, road, torque) == pytest.approx(
            wheel_slip(wheel, road, parameters), abs=1e-14
        )


def test_the_symbolic_slip_rate_is_the_papers_f_plus_g_times_torque():
    model = symbolic_model()
    rate = numbers(model, model.slip_rate)
    for parameters, wheel, road, torque, duty in points(2):
        f, g = BrakingModel(parameters).terms(wheel_slip(wheel, road, parameters), road)
        assert rate(parameters, duty, wheel, road, torque) == pytest.approx(f + g * torque, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("lag", [True, False])
@pytest.mark.parametrize(("slip", "road"), [(0.2, 180.0), (0.2, 20.0), (0.05, 100.0), (0.6, 60.0), (0.9, 150.0)])
def test_the_matrices_are_the_central_differences_of_the_engine(lag, slip, road):
    parameters = MASK if lag else replace(MASK, c31=math.inf)
    model = linearised(parameters, slip, road)
    point = model.point
    states = np.array([point.wheel_speed_rad_s, point.road_speed_rad_s, point.brake_torque_nm][: len(model.states)])

    def rates(states, duty):
        if lag:
            return engine_rates(parameters, *states, duty)
        return np.array(accelerations(*states, brake_torque(duty, parameters), 0.0, parameters)[:2])

    steps = 1e-5 * states
    for column, step in enumerate(np.diag(steps)):
        found = (rates(states + step, point.brake) - rates(states - step, point.brake)) / (2.0 * steps[column])
        assert model.A[:, column] == pytest.approx(found, rel=1e-6, abs=1e-6)
        slips = [wheel_slip(*(states + sign * step)[:2], parameters) for sign in (1.0, -1.0)]
        assert model.C[0, column] == pytest.approx((slips[0] - slips[1]) / (2.0 * steps[column]), rel=1e-6, abs=1e-9)
    found = (rates(states, point.brake + 1e-6) - rates(states, point.brake - 1e-6)) / 2e-6
    assert model.B[:, 0] == pytest.approx(found, rel=1e-6, abs=1e-6)
    assert model.D.tolist() == [[0.0]]
    assert model.drift == pytest.approx(rates(states, point.brake), rel=1e-9, abs=1e-9)
    assert model.C @ model.drift == pytest.approx([0.0], abs=1e-9), "the torque does not hold the slip"


@pytest.mark.parametrize(("slip", "road"), [(0.2, 150.0), (0.5, 100.0)])
def test_a_step_of_the_duty_moves_the_plant_as_the_state_space_says(slip, road):
    import control

    model = linearised(MASK, slip, road)
    step, times_s = 0.002, np.arange(0.0, 0.03, 0.0005)
    predicted = control.forced_response(model.to_control(), times_s, np.full(times_s.shape, step)).outputs

    def slips(duty):
        plant = Plant(MASK, model.point.wheel_speed_rad_s, road)
        plant.brake_torque = model.point.brake_torque_nm
        for _ in times_s:
            yield plant.slip
            plant.advance(0.0, duty, 0.0005)

    moved = np.array(list(slips(model.point.brake + step))) - np.array(list(slips(model.point.brake)))
    assert predicted[-1] > 1e-5
    assert predicted == pytest.approx(moved, rel=0.05, abs=1e-6)


def test_the_state_space_has_names_and_the_poles_of_the_model():
    import control

    system = linearised(MASK, 0.2, 100.0).to_control()
    assert isinstance(system, control.StateSpace)
    assert system.state_labels == ["wheel_speed_rad_s", "road_speed_rad_s", "brake_torque_nm"]
    assert (system.input_labels, system.output_labels) == (["brake"], ["slip"])
    assert min(abs(system.poles() + MASK.c31)) < 1e-9


def test_a_brake_without_lag_is_not_a_state():
    assert linearised(replace(MASK, c31=math.inf), 0.2, 100.0).A.shape == (2, 2)


def test_the_equations_are_there_for_a_paper():
    found = equations()
    assert list(found) == ["(11)", "(8)", "(5)", "(2)", "(3)", "brake"]
    assert sympy.latex(found["(2)"].rhs) == r"\frac{F_{n} \mu r_{1} - M_{1} - M_{10} - d_{1} x_{1}}{J_{1}}"
    assert "d_{1}" in sympy.latex(symbolic_model().A[0, 0])


@pytest.mark.parametrize(
    ("slip", "road", "message"),
    [
        (0.0, 100.0, "slip 0.0, road speed 100.0 rad/s: the slip must be above 0 and below 1, the speed above 0"),
        (1.0, 100.0, "slip 1.0"),
        (0.2, 0.0, "the slip must be above 0 and below 1, the speed above 0"),
        (math.nan, 100.0, "slip nan"),
        (0.2, math.inf, "road speed inf"),
        (0.0005, 100.0, r"needs .* N m and so a duty of .*: the brake gives 0.415..1; choose another point"),
    ],
)
def test_a_point_that_cannot_be_held_is_refused(slip, road, message):
    with pytest.raises(ValueError, match=message):
        linearised(MASK, slip, road)


@pytest.mark.parametrize(
    ("missing", "call", "message"),
    [
        ("sympy", "", "the model's equations need SymPy: pip install 'inteco-abs[control]'"),
        pytest.param(
            "control",
            ".to_control()",
            "a StateSpace needs python-control: pip install 'inteco-abs[control]'",
            marks=pytest.mark.long,
        ),
    ],
)
def test_without_the_extra_the_error_names_it(missing, call, message):
    code = (
        f"import sys; sys.modules[{missing!r}] = None\n"
        "from inteco_abs.interfaces.linear_model import linearised\n"
        "from inteco_abs.rig import RigParameters\n"
        f"linearised(RigParameters.named('mask'), 0.2, 100.0){call}\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert f"AbsError: {message}" in done.stderr
