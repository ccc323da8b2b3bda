"""Whole stops of many rigs: who decides, where shards run, and the progress of the stops."""

import math
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import ensemble_parts as parts
import numpy as np
import pytest

from inteco_abs.config import load_config
from inteco_abs.control import CONTROLLERS, control_check
from inteco_abs.errors import ConfigError
from inteco_abs.montecarlo import (
    ESTIMATOR_NAMES,
    LONGEST_BRAKING_S,
    METRICS,
    ConfiguredPolicy,
    Experiment,
    StopResults,
    bootstrap_ranks,
    run_all,
    run_stops,
)
from inteco_abs.rig import EncoderVariation, RigVariation, draw, wheel_slip
from inteco_abs.sessions import FALL_BACKS, TICK, TRUTH, result_card
from inteco_abs.signals import EXPLANATIONS, BrakeDemand, Command, Phase, Reason

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

PERIOD_S = 0.0005
OWN = {**CONTROLLERS, "constant": parts.Constant}
RIGS = [draw("rough", seed) for seed in range(5)]


def configured(*settings, controllers=OWN):
    return load_config(settings=settings, checks=[control_check(controllers, ESTIMATOR_NAMES)])


SHORT = configured("experiment.start_speed_rad_s=40")
"""Stops that take half a second."""


def short_stops(rigs=RIGS, config=SHORT, run_up_from_rad_s=38.0, **options):
    return run_stops(rigs, config, run_up_from_rad_s=run_up_from_rad_s, **options)


def assert_equal(first, second):
    assert first.metrics.tobytes() == second.metrics.tobytes()  # a NaN, too, equals itself
    assert (first.errors, first.ticks, first.traces.keys()) == (second.errors, second.ticks, second.traces.keys())
    for place, trace in first.traces.items():
        for name, values in trace._asdict().items():
            np.testing.assert_array_equal(values, getattr(second.traces[place], name))


@pytest.fixture(scope="module")
def together():
    return short_stops(traced=[0, 3])


@pytest.mark.parametrize("shard", [1, 2, 3, 4, 100])
def test_shards_of_any_size_give_the_same(together, shard):
    assert_equal(together, short_stops(traced=[0, 3], shard=shard))


def test_threads_give_the_same(together):
    with ThreadPoolExecutor(2) as threads:
        assert_equal(together, short_stops(traced=[0, 3], shard=2, executor=threads))


@pytest.fixture(scope="module")
def processes():
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        yield pool


def test_independent_processes_give_the_same_result(together, processes):
    assert_equal(together, short_stops(traced=[0, 3], shard=3, executor=processes))


def test_a_factory_can_be_sent_to_other_processes(processes):
    here = short_stops(RIGS[:2], maker=parts.torque_oracle)
    assert_equal(here, short_stops(RIGS[:2], maker=parts.torque_oracle, executor=processes))


def test_a_controllers_error_is_reported_from_other_processes_too(processes):
    config = configured("controller.name=refusing", controllers={"refusing": parts.Refusing})
    with pytest.raises(ConfigError, match="refusing cannot be made: ValueError: not today") as caught:
        run_stops(RIGS, config, controllers={"refusing": parts.Refusing}, executor=processes)
    assert [mistake.path for mistake in caught.value.mistakes] == ["controller.name"]


def test_experiments_are_done_in_order_and_progress_counts_them_all():
    written = []
    others = [draw("hard", 30)]
    maker = ConfiguredPolicy(SHORT)
    both = run_all(
        [Experiment(tuple(rigs), SHORT, maker, 38.0) for rigs in (RIGS, others)],
        shard=2,
        progress=lambda *counts: written.append(counts),
    )
    assert written == [(2, 6), (4, 6), (5, 6), (6, 6)]
    assert_equal(both[0], short_stops())
    assert_equal(both[1], short_stops(others))


def test_an_estimator_gets_what_was_written_with_its_sample():
    log = []
    run_stops(
        [draw("hard", 1)], SHORT, maker=lambda *_: (parts.CommandLog(log), parts.Counting()), run_up_from_rad_s=38.0
    )
    assert [tick for tick, _ in log] == list(range(len(log)))
    written = [command for _, command in log]
    driven = sum(command.drive > 0.0 for command in written)
    assert driven >= 40
    assert written[: driven + 2] == [Command.SAFE, *[Command(1.0, 0.0)] * driven, Command.SAFE]
    # braking is decided from the tick on that got SAFE, and each decision is passed on at the next
    assert [command.brake for command in written[driven + 2 :]] == [
        0.5 + 1e-4 * (number + 1) for number in range(len(written) - driven - 2)
    ]


def test_braking_begins_for_each_rig_when_its_own_road_is_fast_enough():
    stops = short_stops(traced=range(5))
    starts = [trace.road_speed_rad_s[0] for trace in stops.traces.values()]
    assert starts == pytest.approx([40.2] * 5, abs=0.3)  # the mean of the last 20 ms is at the start speed
    assert len({len(trace.time_s) for trace in stops.traces.values()}) > 1
    for trace in stops.traces.values():
        assert trace.time_s[:2].tolist() == [0.0, PERIOD_S]
        assert trace.road_angle_rad[0] == 0.0
        assert trace.brake[0] == 0.0
        assert trace.road_speed_rad_s[-1] < 0.5 <= trace.road_speed_rad_s[-2]


def test_without_run_up_braking_begins_at_the_start_speed():
    config = configured("experiment.start_speed_rad_s=40", "controller.name=constant")
    stops = run_stops(RIGS[:1], config, controllers=OWN, run_up_from_rad_s=None, traced=[0])
    trace = stops.traces[0]
    assert (trace.road_speed_rad_s[0], trace.slip[0], trace.brake[0]) == (40.0, pytest.approx(0.0, abs=1e-12), 0.7)


@pytest.mark.long
def test_the_ideal_estimator_knows_the_true_slip():
    stops = short_stops(config=configured("experiment.start_speed_rad_s=40", "estimator.name=ideal"), traced=[1])
    trace = stops.traces[1]
    np.testing.assert_array_equal(trace.slip_estimated[:-1], trace.slip[:-1])
    np.testing.assert_array_equal(stops["slip_rms_estimated"], stops["slip_rms_true"])


def test_the_ideal_estimator_is_not_a_product_estimator():
    with pytest.raises(ConfigError, match="no estimator 'ideal'"):
        load_config(settings=["estimator.name=ideal"], checks=[control_check()])


def test_an_oracle_sees_the_true_state_of_its_own_rig():
    seen = []

    class Looking:
        def __init__(self, state, place):
            self.state, self.place = state, place

        def update(self, _estimate, _dt_s):
            state = self.state
            seen.append((self.place, state.wheel_speed, state.road_speed, state.slip, state.brake_torque))
            return BrakeDemand(0.6)

    rigs = RIGS[:2]
    stops = run_stops(
        rigs,
        SHORT,
        maker=lambda rig, state: (parts.CommandLog([]), Looking(state, rigs.index(rig))),
        run_up_from_rad_s=None,
        traced=[0, 1],
    )
    for place, rig in enumerate(rigs):
        trace = stops.traces[place]
        mine = [each[1:] for each in seen if each[0] == place]
        columns = (trace.wheel_speed_rad_s, trace.road_speed_rad_s, trace.slip, trace.brake_torque_nm)
        assert mine == [tuple(row) for row in np.array(columns).T[:-1]]
        assert mine[50][2] == wheel_slip(*mine[50][:2], rig.parameters)


def test_a_controller_that_fails_ends_its_own_stop_only():
    rigs = [RigVariation(seed=seed) for seed in range(3)]
    stops = run_stops(rigs, configured(), maker=parts.failing, run_up_from_rad_s=None)
    assert [bool(error) for error in stops.errors] == [False, True, False]
    assert "ZeroDivisionError: speed of nothing (ensemble_parts.py" in stops.errors[1]
    assert np.isnan(stops.metrics[1].tolist()).all()
    assert stops["stop_time_s"][0] == stops["stop_time_s"][2] > 1.0
    summary = stops.summary()
    assert (summary.failed, summary.never_entered) == (1, pytest.approx(1 / 3))
    assert (summary.spreads["stop_time_s"].largest, summary.spreads["stop_time_s"].worst) == (math.inf, 1)


@pytest.mark.parametrize("duty", [math.nan, -math.inf, None, np.float64("nan")])
def test_a_duty_that_the_guard_would_not_let_pass_ends_the_stop(duty):
    stops = short_stops(RIGS[:1], maker=parts.OneDuty(duty))
    assert stops.errors[0] == "the controller asked for a duty that is not a finite number"


@pytest.mark.parametrize(("asked", "given"), [(1.5, 1.0), (-0.5, 0.0), (1, 1.0), (np.float64(1.5), 1.0)])
def test_a_duty_outside_0_to_1_is_cut_to_it(asked, given):
    config = configured("experiment.start_speed_rad_s=10")
    stops = run_stops([RigVariation()], config, maker=parts.OneDuty(asked), run_up_from_rad_s=None, traced=[0])
    assert set(stops.traces[0].brake.tolist()) == {given}


@pytest.mark.parametrize(("limit", "cap", "given"), [(0.6, 1.0, 0.6), (1.0, 0.7, 0.7), (0.8, 0.7, 0.7)])
def test_the_duty_is_limited_as_by_a_guard_that_knows_the_amplifier(limit, cap, given):
    config = configured("experiment.start_speed_rad_s=10", f"guard.brake_limit={limit}")
    rig = RigVariation(brake_duty_cap=cap)
    stops = run_stops([rig], config, maker=parts.OneDuty(0.95), run_up_from_rad_s=None, traced=[0])
    assert set(stops.traces[0].brake.tolist()) == {given}


def test_the_guard_of_a_run_ends_a_stop_of_its_own_rig_only():
    fine = EncoderVariation(counts_per_turn=4096)  # not in the configuration
    rigs = [RigVariation(), RigVariation(wheel_encoder=fine, road_encoder=fine)]
    stops = run_stops(rigs, configured())
    assert stops.errors == ("", EXPLANATIONS[Reason.OVER_SPEED])
    assert np.isnan(stops.metrics[1].tolist()).all()
    assert stops["stop_time_s"][0] > 1.0


def test_a_stop_that_does_not_end_is_given_up():
    stops = run_stops([RigVariation()], configured(), maker=parts.OneDuty(0.0), run_up_from_rad_s=None, traced=[0])
    assert stops.traces[0].time_s[-1] == pytest.approx(LONGEST_BRAKING_S)
    assert np.isnan(stops["stop_time_s"][0])
    assert stops.errors == ("",)


def test_a_start_speed_that_the_drive_does_not_reach_is_reported():
    weak = configured("experiment.drive_duty=0.2", "experiment.spin_up_timeout_s=0.1")
    stops = run_stops([RigVariation()], weak)
    assert "the start speed was not reached in time" in stops.errors[0]


@pytest.mark.parametrize("speed", [180.0, 200.0, -1.0, math.nan])
def test_a_run_up_must_begin_below_the_start_speed(speed):
    with pytest.raises(ValueError, match=rf"run_up_from_rad_s = {speed!r}.*below experiment\.start_speed_rad_s = 180"):
        run_stops(RIGS, configured(), run_up_from_rad_s=speed)


def test_no_rigs_and_empty_shards_are_refused():
    with pytest.raises(ValueError, match="no rigs"):
        run_stops([], SHORT, run_up_from_rad_s=38.0)
    with pytest.raises(ValueError, match="shard = 0"):
        short_stops(shard=0)


def test_metrics_are_those_of_a_sessions_card():
    settings = ("estimator.name=kalman", "controller.gains.Mk=5", "experiment.start_speed_rad_s=120")
    step = ("controller.reference_points=[0.2, 0.2, 0.15]", "controller.reference_at_s=[0, 0.30025, 0.30025]")
    config = configured(*settings, *step)
    stops = run_stops(RIGS[:2], config, run_up_from_rad_s=None, traced=[0, 1])
    for place, trace in stops.traces.items():
        reference = np.where(trace.time_s < 0.30025, 0.2, 0.15)
        ticks, truth = np.zeros(len(trace.time_s), TICK.dtype), np.zeros(len(trace.time_s), TRUTH.dtype)
        ticks["phase"], ticks["brake"], ticks["slip"] = Phase.BRAKING, trace.brake, trace.slip_estimated
        ticks["slip_reference"] = reference
        ticks["time_ns"] = truth["time_ns"] = np.round(trace.time_s * 1e9)
        ticks["road_count"] = np.floor(trace.road_angle_rad * 2048 / (2.0 * math.pi))
        truth["slip"], truth["road_speed_rad_s"] = trace.slip, trace.road_speed_rad_s
        card = result_card(config, ticks, truth)
        assert all(np.isnan(stops[name][place]) and card[name] is None for name in FALL_BACKS)
        for name in set(METRICS) & card.keys() - {"stop_distance_m", *FALL_BACKS}:
            assert stops[name][place] == card[name], name
        assert stops["stop_distance_m"][place] == pytest.approx(card["stop_distance_m"], abs=0.001)
        error = trace.slip - reference
        entered = trace.time_s >= stops["band_entry_s"][place]
        above = entered & (trace.road_speed_rad_s >= 10.0)
        assert stops["overshoot"][place] == error[above].max()
        fast = (trace.time_s >= stops["band_entry_s"][place] + 0.0199) & (trace.road_speed_rad_s > 60.0)
        assert stops["slip_rms_above_60"][place] == pytest.approx(math.sqrt(np.mean(error[fast] ** 2)), rel=1e-3)


def made_up(**columns):
    count = len(next(iter(columns.values())))
    metrics = np.full(count, math.nan, dtype=[(name, float) for name in METRICS])
    for name, values in columns.items():
        metrics[name] = values
    return StopResults(metrics, ("",) * count, 0, {})


def test_quantiles_are_numpys_where_all_stops_have_the_metric():
    values = np.random.default_rng(1).uniform(size=137)
    spread = made_up(slip_rms_true=values).summary().spreads["slip_rms_true"]
    assert spread.median == np.median(values)
    assert spread.p99 == pytest.approx(np.percentile(values, 99), rel=1e-12)
    assert (spread.largest, spread.worst) == (values.max(), values.argmax())


def test_a_stop_that_never_entered_the_band_ranks_as_infinite_and_is_counted():
    stops = made_up(slip_rms_true=[0.1, math.nan, 0.2, 0.3], band_entry_s=[0.2, math.nan, 0.2, 0.2])
    summary = stops.summary()
    spread = summary.spreads["slip_rms_true"]
    assert (spread.median, spread.p99, spread.largest, spread.worst) == (pytest.approx(0.25), math.inf, math.inf, 1)
    assert (summary.stops, summary.never_entered, summary.failed) == (4, 0.25, 0)


@pytest.mark.parametrize("never", [1, 2])
def test_the_99th_percentile_of_101_stops_is_the_last_but_one(never):
    values = [*np.linspace(0.0, 1.0, 101 - never), *[math.nan] * never]
    spread = made_up(slip_rms_true=values).summary().spreads["slip_rms_true"]
    assert spread.p99 == (1.0 if never == 1 else math.inf)


def test_locked_stops_are_counted_by_share():
    assert made_up(lock_fraction=[0.0, 0.001, 0.5, math.nan]).summary().locked == 0.5


@pytest.mark.parametrize(
    ("count", "share", "confidence"),
    [(20, 0.5, 0.95), (300, 0.5, 0.9), pytest.param(300, 0.99, 0.9, marks=pytest.mark.long)],
)
def test_the_interval_is_that_of_stops_drawn_again(count, share, confidence):
    noise = np.random.default_rng(3)
    ranked = np.sort(noise.lognormal(size=count))
    drawn = np.quantile(noise.choice(ranked, (4000, count)), share, axis=1)
    expected = np.quantile(drawn, (0.5 - confidence / 2.0, 0.5 + confidence / 2.0))
    places = np.searchsorted(ranked, expected)
    assert np.abs(np.array(bootstrap_ranks(count, share, confidence)) - places).max() <= max(2, 0.02 * count)
