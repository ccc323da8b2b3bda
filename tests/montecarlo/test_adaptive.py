"""predictive-reaching with the adaptive observer, one step outside what `hard` varies: one factor at a time."""

import numpy as np
import pytest

from inteco_abs.config import load_config
from inteco_abs.control import control_check, preferred_estimator
from inteco_abs.montecarlo import SampleSet, run_stops

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

FIRST = 700_000
FACTORS = {
    "nothing": ("", 0.0012),
    "no lag": ("[rig]\nbrake_lag_s = 0", 0.002),
    "no lag and no dead time": ("[rig]\nbrake_lag_s = 0\nbrake_dead_time_s = 0", 0.0012),
    "a lag of 5 ms": ("[rig]\nbrake_lag_s = 0.005", 0.002),
    "a lag of 100 ms": ("[rig]\nbrake_lag_s = 0.1", 0.002),
    "a dead time of 35 ms": ("[rig]\nbrake_dead_time_s = 0.035", 0.003),
    "a dead time of 50 ms": ("[rig]\nbrake_dead_time_s = 0.05", 0.005),
    "a dead time of 60 ms": ("[rig]\nbrake_dead_time_s = 0.06", 0.01),
    "a dead time of 80 ms": ("[rig]\nbrake_dead_time_s = 0.08", 0.025),
    "a dead time of 150 ms": ("[rig]\nbrake_dead_time_s = 0.15", 0.08),
    "a slow release": ("[rig]\nbrake_release_ratio = 3", 0.0025),
    "a slow release of a slow brake": ("[rig]\nbrake_release_ratio = 3\nbrake_lag_s = 0.1", 0.0025),
    "a small tyre": ("[parameters]\nr1 = { factor = 0.96 }", 0.0015),
    "a large tyre": ("[parameters]\nr1 = { factor = 1.04 }", 0.0015),
    "a bent disc": ("[encoders]\nsecond_harmonic_counts = 0.5", 0.002),
    "latching jitter": ("[rig]\nlatch_jitter_s = 0.000125", 0.004),
}


def slip_rms(text, estimator, count):
    settings = ["controller.name=predictive-reaching", f"estimator.name={estimator}"]
    config = load_config(settings=settings, checks=[control_check()], follows=preferred_estimator())
    rigs = SampleSet("own", FIRST, FIRST + count - 1, f'base = "hard"\n{text}\n').rigs
    stops = run_stops(rigs, config, run_up_from_rad_s=165.0)
    assert set(stops.errors) == {""}
    assert stops["lock_fraction"].max() < 0.01
    return float(np.median(stops["slip_rms_fixed_true"]))


@pytest.mark.long
@pytest.mark.parametrize(
    "factor", ["no lag", "a dead time of 50 ms", "a slow release of a slow brake", "latching jitter"]
)
def test_each_hard_factor_alone_is_held(factor):
    text, bound = FACTORS[factor]
    assert slip_rms(text, "adaptive-observer", 6) < bound


@pytest.mark.long
@pytest.mark.parametrize("factor", FACTORS)
def test_each_factor_alone_is_held_on_many_rigs(factor):
    text, bound = FACTORS[factor]
    assert slip_rms(text, "adaptive-observer", 200) < bound
