"""Several brakings in one run, each on its own road of the mock board."""

import numpy as np
import pytest

from inteco_abs.config import load_config
from inteco_abs.errors import ConfigError
from inteco_abs.mock_board import rig_check
from inteco_abs.rig import ROADS, RigParameters, RigVariation, adhesion, on_road
from inteco_abs.signals import Phase

SMALL = (
    *("experiment.start_speed_rad_s=15.0", "experiment.idle_s=0.01", "experiment.hold_s=0.0", "loop.rate_hz=400.0"),
    *("experiment.stops=4", "controller.name=pi"),
)
MASK = RigParameters.named("mask")


@pytest.fixture(scope="module")
def session(run_at, tmp_path_factory):
    """Four brakings on three roads, the last of which changes."""
    roads = 'simulation.roads=["own", "own*0.5", "wet-asphalt>*0.4@100ms"]'
    return run_at(tmp_path_factory.mktemp("roads") / "roads.mcap", (*SMALL, roads)).session


def brakings_of(session):
    """Truths of each braking from the first brake command on, but for the tick in which the road changes; the rest."""
    phases, truth = session.ticks["phase"], session.truth
    truth = truth[np.searchsorted(truth["time_ns"], session.ticks["time_ns"])]
    held = phases == Phase.BRAKING
    edges = np.flatnonzero(np.diff(held.astype(int)))
    stops = [truth[first + 1 : end + 1] for first, end in edges.reshape(-1, 2)]
    # the change shows once the brake's command has acted
    return [stop[stop["brake"].cumsum() > 0][1:] for stop in stops], truth[~held]


def own(rows):
    return np.array([adhesion(slip, MASK) for slip in rows["slip"]])


def burckhardt(rows, name):
    c1, c2, c3 = ROADS[name]
    return c1 * (1.0 - np.exp(-c2 * rows["slip"])) - c3 * rows["slip"]


def test_each_stop_brakes_on_its_own_road_in_turn_and_runs_up_on_the_rigs_own(session):
    (first, second, third, fourth), _ = brakings_of(session)
    assert np.allclose(first["adhesion"], own(first), rtol=1e-12)
    assert np.allclose(second["adhesion"], 0.5 * own(second), rtol=1e-12)
    since_s = (third["time_ns"] - third["time_ns"][0]) * 1e-9
    before, after = third[since_s < 0.09], third[since_s > 0.11]
    assert min(len(before), len(after)) > 0
    assert np.allclose(before["adhesion"], burckhardt(before, "wet-asphalt"), rtol=1e-9)
    assert np.allclose(after["adhesion"], 0.4 * burckhardt(after, "wet-asphalt"), rtol=1e-9)
    assert np.allclose(fourth["adhesion"], own(fourth), rtol=1e-12)
    phases = session.ticks["phase"]
    driven = session.truth[np.searchsorted(session.truth["time_ns"], session.ticks["time_ns"])][phases == Phase.SPIN_UP]
    driven = driven[driven["drive"] > 0.0][1:]
    assert np.allclose(driven["adhesion"], own(driven), rtol=1e-12)


def test_it_replays_and_says_on_which_roads_it_was(session, replayed):
    assert replayed(session).differing == 0
    assert session.metadata["rig"]["roads"] == "own, own*0.5, wet-asphalt>*0.4@100ms"


def test_a_change_within_a_stop_comes_again_in_the_next_one_on_that_road(run_at, tmp_path):
    made = run_at(tmp_path / "again.mcap", (*SMALL, 'simulation.roads=["own>*0.5@100ms"]'))
    for stop in brakings_of(made.session)[0]:
        since_s = (stop["time_ns"] - stop["time_ns"][0]) * 1e-9
        before, after = stop[since_s < 0.09], stop[since_s > 0.11]
        assert np.allclose(before["adhesion"], own(before), rtol=1e-12)
        assert np.allclose(after["adhesion"], 0.5 * own(after), rtol=1e-12)


def test_the_rigs_own_road_in_each_stop_has_the_bits_of_no_road(run_at, tmp_path):
    plain = run_at(tmp_path / "plain.mcap", SMALL)
    same = run_at(tmp_path / "own.mcap", (*SMALL, 'simulation.roads=["own"]'))
    assert same.session.payload == plain.session.payload


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("mud", "must begin with a road, one of own, dry-asphalt"),
        ("", "must begin with a road"),
        ("ice@1s", "must begin with a road"),
        ("own*", "must begin with a road"),
        ("own*9", "adhesion_scale = 9.0: must be in 0.1..2"),
        ("own>", "behind the > must stand"),
        ("own>ice", "behind the > must stand"),
        ("own>own@1s", "behind the > must stand"),
        ("own>mud@1s", "behind the > must stand"),
        ("own>ice*2@1s", "behind the > must stand"),
        ("own>*0.5@0ms", "behind the > must stand"),
        ("own>*5@1s", "grip_step = 4.0: must be in -0.9..1"),
        ("own>ice@99s", "later_road_after_s = 99.0: must be in 0..60"),
    ],
)
def test_a_road_that_is_not_possible_is_refused_with_what_is(text, problem):
    with pytest.raises(ValueError, match="must") as error:
        on_road(RigVariation(), text)
    assert problem in str(error.value)
    with pytest.raises(ConfigError, match=r"simulation\.roads"):
        load_config(settings=[f'simulation.roads=["own", "{text}"]'], checks=[rig_check])
