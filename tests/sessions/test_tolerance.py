import math

import numpy as np
import pytest

from inteco_abs.analysis import Shift, Tolerance, parse_tolerances
from inteco_abs.errors import ConfigError
from inteco_abs.sessions import TICK
from inteco_abs.signals import Phase

PERIOD_NS = 500_000
NAN, INF = math.nan, math.inf


def times(count):
    return np.arange(count, dtype=np.uint64) * PERIOD_NS


def accepted(tolerance, logged, replayed):
    logged, replayed = np.array(logged), np.array(replayed)
    return tolerance.accepts(logged, replayed, times(len(logged))).tolist()


@pytest.mark.parametrize(
    ("tolerance", "logged", "replayed", "right"),
    [
        (Tolerance(abs=0.1), 2.0, 2.0999, True),
        (Tolerance(abs=0.1), 2.0, 2.1001, False),
        (Tolerance(rel=0.1), -20.0, -21.9, True),
        (Tolerance(rel=0.1), -20.0, -17.9, False),
        (Tolerance(abs=0.5, rel=0.1), 1.0, 1.4, True),
        (Tolerance(abs=0.5, rel=0.1), 10.0, 10.9, True),
        (Tolerance(abs=0.5, rel=0.1), 10.0, 11.1, False),
        (Tolerance(), 0.0, -0.0, True),
        (Tolerance(), NAN, NAN, True),
        (Tolerance(abs=9.0), NAN, 1.0, False),
        (Tolerance(abs=9.0), 1.0, NAN, False),
        (Tolerance(), INF, INF, True),
        (Tolerance(rel=0.5), INF, -INF, False),
        (Tolerance(rel=0.5), INF, 1e308, False),
        (Tolerance(rel=0.5), 1e308, INF, False),
    ],
)
def test_a_number_is_near_by_the_larger_of_both_tolerances(tolerance, logged, replayed, right):
    assert accepted(tolerance, [logged], [replayed]) == [right]


STEP = [0.0] * 5 + [1.0] * 5


@pytest.mark.parametrize(("ticks", "right"), [(-3, False), (-2, True), (0, True), (1, True), (2, False)])
@pytest.mark.parametrize("dtype", [float, bool])
def test_a_step_may_lead_or_lag_by_so_much(ticks, right, dtype):
    tolerance = Tolerance(lead_s=2 * PERIOD_NS * 1e-9, lag_s=1 * PERIOD_NS * 1e-9)
    moved = np.array([0.0] * (5 + ticks) + [1.0] * (5 - ticks), dtype)
    assert all(accepted(tolerance, np.array(STEP, dtype), moved)) is right


def test_between_two_logged_values_of_about_that_time_is_near():
    assert accepted(Tolerance(lag_s=0.001), STEP, [*STEP[:5], 0.5, *STEP[6:]]) == [True] * 10
    assert accepted(Tolerance(lag_s=0.001), STEP, [*STEP[:5], 1.5, *STEP[6:]])[5] is False


def test_time_is_that_of_the_ticks_and_not_their_number():
    logged, replayed = np.array([0.0, 1.0, 1.0]), np.array([0.0, 0.0, 1.0])
    late = np.array([0, 10 * PERIOD_NS, 11 * PERIOD_NS], np.uint64)
    tolerance = Tolerance(lag_s=0.001)
    assert tolerance.accepts(logged, replayed, late).tolist() == [True, False, True]
    assert tolerance.accepts(logged, replayed, times(3)).tolist() == [True] * 3


def test_a_text_gives_the_four_numbers_and_empty_ones_are_zero():
    assert parse_tolerances(["brake=1e-9"]) == {"brake": Tolerance(1e-9)}
    assert parse_tolerances(["slip=1:0.5:0.25:0.125"]) == {"slip": Tolerance(1.0, 0.5, 0.25, 0.125)}
    assert parse_tolerances(["phase=::0.002"]) == {"phase": Tolerance(lead_s=0.002)}


def test_a_star_matches_every_output_and_the_last_pattern_wins():
    found = parse_tolerances(["*=1e-9", "brake=0.5"])
    assert found["slip"] == found["phase"] == Tolerance(1e-9)
    assert found["brake"] == Tolerance(0.5)
    assert not {"time_ns", "wheel_count", "late_us"} & found.keys()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("brake", "must look like brake=1e-9"),
        ("=1", "must look like"),
        ("brake=", "must look like"),
        ("brake=1:2:3:4:5", "must look like"),
        ("brke=1", "no output 'brke'; did you mean brake"),
        ("road_count=1", "no output 'road_count'"),
        ("brake=x", "'x' is not a number"),
        ("brake=-1", "-1: must be finite and at least 0"),
        ("brake=nan", "nan: must be finite"),
        ("brake=inf", "inf: must be finite"),
        ("brake=::2", "a lead of 2 s: must be at most 1 s"),
        ("brake=:::2", "a lag of 2 s"),
        ("phase=1", "phase is not a number and can only come early or late"),
    ],
)
def test_an_invalid_tolerance_is_reported_with_the_valid_form(text, words):
    with pytest.raises(ConfigError, match=words):
        parse_tolerances([text])


def test_all_mistakes_are_reported_at_once():
    with pytest.raises(ConfigError) as caught:
        parse_tolerances(["brake=x", "slip=1e-9", "brke=1"])
    assert [mistake.path for mistake in caught.value.mistakes] == ["--tol brake=x", "--tol brke=1"]


def braking_from(session, retouched, row):
    """The session as if braking had begun at another row; nothing else is changed."""
    phases = session.ticks["phase"].copy()
    began = int(np.flatnonzero(phases == Phase.BRAKING)[0])
    changed = session
    for each in range(min(row, began), max(row, began)):
        changed = retouched(changed, each, phase=int(Phase.BRAKING if row < began else Phase.SPIN_UP))
    return changed, began


@pytest.mark.parametrize("ticks", [-3, 2])
def test_a_phase_that_comes_early_or_late_is_reported_by_how_many_ticks(quick, retouched, replayed, ticks):
    began = int(np.flatnonzero(quick.session.ticks["phase"] == Phase.BRAKING)[0])
    changed, _ = braking_from(quick.session, retouched, began + ticks)
    found = replayed(changed)
    assert found.shifts == (Shift("phase", "BRAKING", began + ticks, began, -ticks),)
    assert (found.differing, found.by_field) == (abs(ticks), {"phase": abs(ticks)})


def test_a_phase_within_lead_and_lag_differs_in_nothing_but_is_still_reported(quick, retouched, replayed):
    began = int(np.flatnonzero(quick.session.ticks["phase"] == Phase.BRAKING)[0])
    changed, _ = braking_from(quick.session, retouched, began + 2)
    late = replayed(changed, tolerances=parse_tolerances(["phase=::0.001"]))
    assert (late.differing, late.first, late.tolerated) == (0, None, {"phase": 2})
    assert len(late.shifts) == 1
    assert replayed(changed, tolerances=parse_tolerances(["phase=:::0.001"])).differing == 2


def test_a_flag_that_only_one_side_shows_is_reported(quick, retouched, replayed):
    found = replayed(retouched(quick.session, 200, estimate_valid=False))
    assert found.shifts == (
        Shift("estimate_valid", "false", 200, None, None),
        Shift("estimate_valid", "true", 201, None, None),
    )


def test_numbers_within_tolerance_are_counted_separately(quick, retouched, replayed):
    session = quick.session
    row = int(np.flatnonzero(session.ticks["phase"] == Phase.BRAKING)[200])
    brake = session.ticks["brake"][row].item()
    changed = retouched(retouched(session, row, brake=brake + 1e-3), row + 50, brake=0.9)
    found = replayed(changed, tolerances=parse_tolerances(["brake=2e-3"]))
    assert (found.differing, found.by_field, found.tolerated) == (1, {"brake": 1}, {"brake": 1})
    assert found.first.tick == row + 50


def test_the_longest_agreeing_beginning_is_reported_in_ticks_and_seconds(quick, retouched, replayed):
    session = quick.session
    whole = replayed(session)
    assert whole.agreeing_ticks == len(session.ticks)
    assert whole.agreeing_s == pytest.approx((len(session.ticks) - 1) * 0.0005)
    cut = replayed(retouched(session, 301, slip=0.5))
    assert (cut.agreeing_ticks, cut.agreeing_s) == (301, pytest.approx(0.15))
    none = replayed(retouched(session, 0, slip=0.5))
    assert (none.agreeing_ticks, none.agreeing_s) == (0, 0.0)


def test_every_column_of_the_table_can_be_distinguished():
    assert set(parse_tolerances(["*=0"])) <= {column.name for column in TICK.columns}
