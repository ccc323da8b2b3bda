"""What is said of two laws on the same rigs."""

import numpy as np
import pytest

from inteco_abs.montecarlo import METRICS, StopResults
from inteco_abs.paper import compare, compare_with_simulation, verdict

RIGS = 20


def stops(fixed_rms, **others):
    """As many as there are values; every metric that is not given is 1."""
    rows = np.ones(len(fixed_rms), [(name, float) for name in METRICS])
    for name, values in {"slip_rms_fixed_true": fixed_rms, **others}.items():
        rows[name] = values
    return StopResults(rows, ("",) * len(rows), 0, {})


def better_on(count, ratio=0.9):
    """Rivals are 1 everywhere; these are better on so many rigs, and as much worse on the others."""
    return stops([ratio] * count + [2.0 - ratio] * (RIGS - count))


def against_one(ours):
    return compare(ours, stops([1.0] * len(ours)))


@pytest.mark.parametrize(("count", "confirmed"), [(20, True), (15, True), (14, False)])
def test_the_claim_takes_more_wins_than_chance_gives(count, confirmed):
    found = against_one(better_on(count))
    assert (found.confirmed, found.better, found.worse) == (confirmed, count, RIGS - count)
    assert found.words.startswith("better, slip" if confirmed else "better, as chance may have it, slip")
    assert f"0.90 times that of constant rate (median of 20 rigs; better on {count})" in found.words


def test_one_ideal_stop_knows_no_chance():
    found = against_one(stops([0.8]))
    assert found.confirmed
    assert found.words == "better, slip RMS 0.80 times that of constant rate, reaching time 1.00 times"


@pytest.mark.parametrize(("rms", "reason"), [(0.991, "alike within 1 %"), (1.009, "alike within 1 %"), (1.02, "worse")])
def test_an_equal_or_worse_result_does_not_confirm_the_claim(rms, reason):
    found = against_one(stops([rms] * RIGS))
    assert not found.confirmed
    assert found.words.startswith(f"{reason}, slip RMS {rms:.2f} times")


def test_ratios_are_medians_of_rig_by_rig():
    ours, rival = stops([1.0, 2.0, 9.0], stop_distance_m=[3.0, 3.0, 3.0]), stops([2.0, 8.0, 3.0])
    found = compare(ours, rival)
    assert found.ratios["slip_rms_fixed_true"] == 0.5
    assert found.ratios["stop_distance_m"] == 3.0


def test_a_metric_that_one_stop_does_not_have_has_no_ratio():
    found = against_one(stops([0.8, 0.8], reaching_time_s=[0.1, np.nan]))
    assert found.ratios["reaching_time_s"] is None
    assert "reaching time" not in found.words


def test_a_stop_that_failed_confirms_nothing():
    found = against_one(stops([0.8] * 19 + [np.nan]))
    assert not found.confirmed
    assert found.words.startswith("a stop has no slip RMS")


@pytest.mark.parametrize(("lost", "confirmed"), [(9, True), (10, False), (20, False)])
def test_laws_that_both_never_arrive_on_the_median_rig_confirm_nothing(lost, confirmed):
    entry = [np.nan] * lost + [0.2] * (RIGS - lost)
    found = compare(stops([0.8] * RIGS, band_entry_s=entry), stops([1.0] * RIGS, band_entry_s=entry))
    assert (found.confirmed, found.neither_arrived) == (confirmed, lost)
    if not confirmed:
        assert found.words.startswith(f"neither law ever comes within 0.01 of the reference on {lost} of 20 rigs, slip")


def test_a_rig_on_which_one_of_the_laws_arrives_counts():
    found = compare(stops([0.8] * RIGS), stops([1.0] * RIGS, band_entry_s=[np.nan] * RIGS))
    assert (found.confirmed, found.neither_arrived) == (True, 0)


@pytest.mark.parametrize(
    ("rms", "reaching", "confirmed"),
    [(1.9, 1.9, True), (2.1, 1.0, False), (1.0, 2.1, False), (1.0, np.nan, False), (np.nan, 1.0, False)],
)
def test_an_experiment_is_similar_up_to_twice_the_simulations_figures(rms, reaching, confirmed):
    entry = [0.2] * (RIGS - 1) + [np.nan]
    experiment = stops([rms] * RIGS, reaching_time_s=[reaching] * RIGS, band_entry_s=entry)
    found = compare_with_simulation(experiment, stops([1.0]))
    assert (found.confirmed, found.never_arrived) == (confirmed, 1)
    assert found.words.startswith("claim confirmed;" if confirmed else "claim not confirmed;")
    assert found.words.endswith("; 1 of 20 rigs never come within 0.01 of the reference")


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [(0.8, 0.8, "claim confirmed;"), (0.8, 1.0, "claim confirmed in part;"), (1.0, 1.0, "claim not confirmed;")],
)
def test_the_verdict_counts_every_rival(first, second, expected):
    rivals = {"equal Mq": against_one(stops([first])), "equal time": against_one(stops([second]))}
    found = verdict(rivals)
    assert found.startswith(expected)
    assert f"against equal Mq: {rivals['equal Mq'].words}; against equal time:" in found
