import statistics

import numpy as np
import pytest

from inteco_abs.control import CONTROLLERS
from inteco_abs.sessions import TICK, TRUTH, result_card
from inteco_abs.sessions.card import RunningCard
from inteco_abs.sessions.rows import in_step
from inteco_abs.signals import BrakeDemand, Phase

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

STOPS = 3
METRICS = (
    "start_speed_rad_s",
    "reaching_time_s",
    "band_entry_s",
    "stop_time_s",
    "stop_distance_m",
    "slip_rms_true",
    "slip_rms_estimated",
    "slip_rms_low_speed_true",
    "slip_rms_fixed_true",
    "lock_fraction",
    "torque_variation_nm_per_s",
    "duty_variation_per_s",
)


class Counting:
    """Controller that brakes by the number of its updates."""

    gains = ()
    internals = ("updates",)

    def __init__(self, _setup) -> None:
        self._updates = 0

    def update(self, estimate, dt_s):
        self._updates += 1
        return BrakeDemand(min(0.9, 0.3 + 1e-3 * self._updates), dt_s, estimate.slip, (float(self._updates), 0, 0, 0))


@pytest.fixture(scope="module")
def several(tmp_path_factory, run_at):
    """A session of three stops from 60 rad/s."""
    settings = ("experiment.start_speed_rad_s=60.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")
    return run_at(tmp_path_factory.mktemp("several") / "stop.mcap", (*settings, f"experiment.stops={STOPS}"))


def separately(session):
    """Ticks of each stop, what comes before its braking included."""
    phase = session.ticks["phase"]
    starts = np.flatnonzero((phase == Phase.IDLE) & (np.roll(phase, 1) != Phase.IDLE))
    return np.split(session.ticks, starts[1:])


def test_a_replay_of_several_stops_is_exact(several, replayed):
    session = several.session
    found = replayed(session)
    assert (found.ticks, found.differing, found.by_field) == (len(session.ticks), 0, {})
    assert found.braking_ticks == int((session.ticks["phase"] == Phase.BRAKING).sum())


def test_a_replay_of_a_users_controller_with_a_state_is_exact(run, replayed):
    controllers = {**CONTROLLERS, "counting": Counting}
    made = run("controller.name=counting", "experiment.stops=3", controllers=controllers)
    assert made.stop.outcome == "completed"
    session = made.session
    firsts = [stop[stop["phase"] == Phase.BRAKING]["c0"][1] for stop in separately(session)]
    assert firsts == [1.0] * 3
    assert replayed(session, controllers).differing == 0


@pytest.mark.parametrize("stops", [1, 2])
def test_the_card_counts_the_stops(run, stops):
    card = run(f"experiment.stops={stops}").stop.card
    assert card["stops"] == stops


@pytest.mark.parametrize("rows", [10, 4096, *(pytest.param(each, marks=pytest.mark.long) for each in (1, 997))])
def test_the_card_is_the_same_in_however_many_pieces_the_run_came(several, rows):
    session, card = several.session, RunningCard(several.config)
    for ticks, truth in in_step([(session.ticks, session.truth)], rows):
        card.add(ticks, truth)
    expected = several.stop.card
    assert {name: expected[name] for name in card.card()} == card.card()


def test_each_metric_is_the_median_of_the_stops(several):
    session, card = several.session, several.stop.card
    assert card["stops"] == STOPS
    parts = [result_card(several.config, ticks, session.truth) for ticks in separately(session)]
    assert [part["stops"] for part in parts] == [1] * STOPS
    for name in METRICS:
        values = [part[name] for part in parts if part[name] is not None]
        assert card[name] == (statistics.median(values) if values else None), name
    assert len({part["stop_time_s"] for part in parts}) > 1


def test_ticks_are_those_of_the_whole_session(several):
    assert several.stop.card["ticks"] == len(several.session.ticks) == sum(map(len, separately(several.session)))


PERIOD_NS = 500_000


def made_up(*speeds):
    """Ticks and truth of stops that each last 100 ticks, from these speeds; a speed of None is a stop that fails."""
    ticks, truth = np.zeros(150 * len(speeds), TICK.dtype), np.zeros(150 * len(speeds), TRUTH.dtype)
    ticks["time_ns"] = truth["time_ns"] = 10**9 + np.arange(len(ticks)) * PERIOD_NS
    ticks["phase"] = Phase.SPIN_UP
    for number, speed in enumerate(speeds):
        stop = slice(150 * number + 50, 150 * (number + 1))
        ticks["phase"][stop] = Phase.BRAKING
        truth["road_speed_rad_s"][stop] = 100.0 if speed is None else np.linspace(speed, 0.0, 100)
    return ticks, truth


@pytest.mark.parametrize(
    ("speeds", "start", "stops"),
    [
        ((120.0,), 120.0, 1),
        ((120.0, 100.0), 110.0, 2),
        ((120.0, 100.0, 30.0), 100.0, 3),
        ((30.0, 120.0, 100.0, 40.0), 70.0, 4),
    ],
)
def test_the_median_of_an_even_count_is_the_mean_of_the_middle_two(quick, speeds, start, stops):
    card = result_card(quick.config, *made_up(*speeds))
    assert (card["start_speed_rad_s"], card["stops"]) == (start, stops)


def test_a_metric_that_some_stops_do_not_have_is_the_median_of_the_others(quick):
    complete, failing = (result_card(quick.config, *made_up(*speeds)) for speeds in ((60.0,), (60.0, None, 60.0)))
    assert failing["stop_time_s"] == complete["stop_time_s"]
    assert failing["stops"] == 3


def test_a_metric_that_no_stop_has_is_missing(quick):
    card = result_card(quick.config, *made_up(None, None))
    assert (card["stop_time_s"], card["stop_distance_m"], card["stops"]) == (None, None, 2)


def test_a_session_that_never_braked_has_no_stops(quick):
    ticks, truth = made_up(60.0)
    card = result_card(quick.config, ticks[:50], truth)
    assert card["stops"] == 0
    assert all(card[name] is None for name in METRICS)
