"""The laws of others: each runs compiled with the bits of Python, is known by name, and names its source."""

import importlib
import re
from dataclasses import replace

import numpy as np
import pytest

from inteco_abs.benchmark import Law, shipped_laws, time_decisions
from inteco_abs.control import Setup
from inteco_abs.montecarlo import ConfiguredPolicy, Experiment, parse_draws, run_all
from inteco_abs.plugins import Controllers
from inteco_abs.published import PUBLISHED
from inteco_abs.published.fitted_q import MOST
from inteco_abs.published.fitted_q_weights import LAYERS
from inteco_abs.published.grey_sliding import predict
from inteco_abs.rig import RigParameters
from inteco_abs.signals import Estimate

KNOWN = Controllers()
RIGS = parse_draws("hard:700000").rigs


@pytest.mark.long
@pytest.mark.parametrize("name", PUBLISHED)
def test_a_compiled_stop_has_the_bits_of_python(name):
    config = Law(name, name, "kalman").config(KNOWN)
    (compiled,) = run_all([Experiment(RIGS, config, ConfiguredPolicy(config), 165.0)])
    assert compiled.errors == ("",)
    assert compiled.metrics.tobytes() == time_decisions(config, RIGS, KNOWN).stops.metrics.tobytes()


@pytest.mark.long
def test_a_compiled_stop_follows_a_changing_reference_with_the_bits_of_python():
    config = Law("lqr", "lqr", "kalman").config(KNOWN)
    config = replace(
        config, controller=replace(config.controller, reference_points=[0.3, 0.1], reference_at_rad_s=[20.0, 90.0])
    )
    (compiled,) = run_all([Experiment(RIGS, config, ConfiguredPolicy(config), 165.0)])
    assert compiled.errors == ("",)
    assert compiled.metrics.tobytes() == time_decisions(config, RIGS, KNOWN).stops.metrics.tobytes()


def test_each_is_in_the_benchmark_and_gives_its_source_with_a_year():
    assert set(PUBLISHED) <= {law.controller for law in shipped_laws()}
    for place in PUBLISHED.values():
        module = importlib.import_module(place.partition(":")[0])
        assert re.search(r"[A-Z]\. [A-Z][a-z]+.*: .*\b(19|20)\d\d\b", module.__doc__, re.DOTALL)


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize("slip", [0.0, 0.2, 1.0])
def test_the_duty_is_within_its_range_for_any_slip_and_speed(name, slip):
    kind = KNOWN[name]
    law = kind(Setup(0.2, RigParameters.named("mask"), 5.0), **{gain.name: gain.default for gain in kind.gains})
    for speed in (180.0, 30.0, 1.0, 0.0):
        for _ in range(20):
            assert 0.0 <= law.update(Estimate((1.0 - slip) * speed, speed, slip, valid=True), 0.0005).brake <= 1.0


@pytest.mark.parametrize("name", [name for name in PUBLISHED if name != "five-phase"])
def test_less_slip_than_wanted_gets_more_brake_in_the_end(name):
    kind, ends = KNOWN[name], []
    for slip in (0.1, 0.3):
        law = kind(Setup(0.2, RigParameters.named("mask"), 5.0), **{gain.name: gain.default for gain in kind.gains})
        for _ in range(600):
            duty = law.update(Estimate((1.0 - slip) * 100.0, 100.0, slip, valid=True), 0.0005).brake
        ends.append(duty)
    assert ends[0] > ends[1]


def test_the_grey_model_continues_an_exponential():
    slips = [0.05 * 1.1**i for i in range(5)]
    assert predict(slips, 3.0) == pytest.approx(0.05 * 1.1**7, rel=0.01)
    assert predict([0.0] * 5, 3.0) == 0.0
    assert predict([0.2] * 5, 3.0) == pytest.approx(0.2)


def test_the_learned_policy_is_its_network_and_holds_each_duty():
    kind, inputs = KNOWN["fitted-q"], np.array([-0.8, 0.0, -5.0 / 3.0, 0.0, 0.0, 1.0 / 9.0])  # slip 0.12 at 100 rad/s
    law = kind(Setup(0.2, RigParameters.named("mask"), 5.0))
    for layer in LAYERS:
        inputs = np.tanh(np.array(layer) @ [*inputs, 1.0])
    duties = [law.update(Estimate(88.0, 100.0, 0.12, valid=True), 0.0005).brake for _ in range(21)]
    assert duties[:20] == [pytest.approx(MOST * inputs[0])] * 20
    assert duties[20] != duties[0] > 0.0


def test_a_published_law_keeps_its_source_and_the_package_that_has_it():
    source, package = KNOWN.origin("lqr")
    assert package.startswith("inteco-abs ")
    assert b"class Lqr" in source
