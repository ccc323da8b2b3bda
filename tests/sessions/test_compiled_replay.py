"""A compiled loop replays a session with the bits of Python, and leaves to Python what it cannot replay."""

import random
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from inteco_abs import warm_up
from inteco_abs.analysis import alternative, compiled_replay, replay_session, what_if
from inteco_abs.analysis.arithmetic import recorded_with
from inteco_abs.analysis.compiled_replay import CompiledReplay
from inteco_abs.analysis.replay import decisions
from inteco_abs.control import CONTROLLERS, ESTIMATORS, build_pipeline, control_check
from inteco_abs.sessions import TICK, read_session, session_config
from inteco_abs.signals import BoardFlags, BrakeDemand, Phase, Reason

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

TESTS = Path(__file__).parents[1]
GOLDEN = list((TESTS / "golden").glob("*.mcap"))
ARCHIVED = TESTS / "sessions" / "archive" / "v5.mcap"
TWO_STOPS = ("experiment.stops=2", "estimator.name=kalman", "controller.name=boundary-layer")


@pytest.fixture(scope="module")
def two_stops(run_at, tmp_path_factory):
    """A run of two stops, each with a new controller."""
    quick = ("experiment.start_speed_rad_s=20.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")
    return run_at(tmp_path_factory.mktemp("two") / "stops.mcap", (*quick, *TWO_STOPS)).session


def pipeline_of(session, controllers=CONTROLLERS):
    return build_pipeline(session_config(session, (control_check(controllers),)), controllers)


def assert_same_bits(session):
    """Every column of every row, compiled and in Python."""
    compiled = CompiledReplay(pipeline_of(session), may_compile=True).decide(session.ticks)
    python = decisions(session, pipeline_of(session))
    assert compiled is not None
    for column in TICK.columns:
        if column.role.value != "timing":
            assert compiled[column.name].tobytes() == python[column.name].tobytes(), column.name
    return compiled


def both(session, **options):
    """The findings of a replay, compiled and in Python."""
    return [replay_session(session, pipeline_of(session), compiled=way, **options) for way in (True, False)]


@pytest.mark.parametrize("path", [*GOLDEN, pytest.param(ARCHIVED, marks=pytest.mark.long)], ids=lambda path: path.stem)
def test_every_kept_session_has_the_same_replay(path):
    session = read_session(path)
    if recorded_with(session) == "portable":
        assert_same_bits(session)
    compiled, python = both(session)
    assert compiled == python


def test_a_golden_session_has_portable_arithmetic():
    assert "portable" in {recorded_with(read_session(path)) for path in GOLDEN}


@pytest.mark.long
@pytest.mark.parametrize("rig", ["", "hard:17", "rough:2"])
@pytest.mark.parametrize(
    ("controller", "estimator"),
    [
        *((controller, "moving-window") for controller in CONTROLLERS if controller != "predictive-reaching"),
        *(("reaching-law", estimator) for estimator in ESTIMATORS),
        ("predictive-reaching", "observer"),
    ],
)
def test_every_estimator_and_controller_has_the_same_replay(run, controller, estimator, rig):
    session = run(f"controller.name={controller}", f"estimator.name={estimator}", f'simulation.rig="{rig}"').session
    assert_same_bits(session)
    assert replay_session(session, pipeline_of(session), compiled=True).differing == 0


def disturbed(session, seed):
    """The session with some of its inputs changed: flags, jumps and slips of the counts, late samples, stops."""
    draws, ticks = random.Random(seed), session.ticks.view(np.uint8).copy().view(TICK.dtype)
    for _ in range(draws.choice((0, 1, 3, 30))):
        row, end = draws.randrange(len(ticks)), draws.randrange(1, 6)
        match draws.choice(("flags", "count", "slip", "late", "stop")):
            case "flags":
                ticks["board_flags"][row : row + end] = draws.choice((BoardFlags.STALE, BoardFlags.SLOW, 7))
            case "count":
                ticks[draws.choice(("wheel_count", "road_count"))][row] += draws.choice((-3, 2, 5000))
            case "slip":
                ticks[draws.choice(("wheel_count", "road_count"))][row:] += draws.choice((-3, 1, 400))
            case "late":
                ticks["time_ns"][row:] += draws.choice((100, 400_000, 10**9))
                ticks["dt_s"][row] += draws.choice((1e-7, 4e-4, 1.0))
            case "stop":
                if draws.random() < 0.3:
                    ticks["stop_request"][row] = draws.choice(list(Reason))
    return session.with_rows(ticks)


@pytest.mark.long
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_replay_of_any_inputs_has_the_bits_of_python(two_stops, seed):
    assert_same_bits(disturbed(two_stops, seed))


def test_two_stops_are_replayed_with_a_new_controller_each(two_stops):
    phases = assert_same_bits(two_stops)["phase"]
    assert (np.diff(phases.astype(int)) == Phase.IDLE - Phase.STOPPED).sum() == 1, "a second stop"
    assert both(two_stops)[0].differing == 0


@pytest.mark.parametrize("seed", range(3))
def test_a_session_that_differs_has_the_same_differences(two_stops, seed):
    session = disturbed(two_stops, seed + 100)
    ticks = session.ticks.view(np.uint8).copy().view(TICK.dtype)
    ticks["brake"][len(ticks) // 2] += 1e-9
    compiled, python = both(session.with_rows(ticks))
    assert compiled == python
    assert python.differing > 0


@pytest.mark.parametrize(
    "change",
    [
        lambda ticks: ticks["time_ns"].__setitem__(slice(900, None), ticks["time_ns"][900:] - 10**6),
        lambda ticks: ticks["road_count"].__setitem__(900, -(1 << 62)),
        lambda ticks: ticks["time_ns"].__iadd__(1 << 62),
    ],
    ids=["time that goes back", "count of 63 bits", "time of 63 bits"],
)
def test_what_integers_of_64_bits_may_not_hold_is_left_to_python(two_stops, change):
    ticks = two_stops.ticks.view(np.uint8).copy().view(TICK.dtype)
    change(ticks)
    session = two_stops.with_rows(ticks)
    assert CompiledReplay(pipeline_of(session), may_compile=True).decide(ticks) is None
    compiled, python = both(session)
    assert compiled == python


@dataclass(frozen=True, slots=True)
class Constants:
    duty: float


@dataclass(slots=True)
class State:
    ticks: float = 100.0


def with_a_power(k, s, estimate, _dt_s):
    """`x**2` is the C library's power in Python, and x*x as machine code."""
    s.ticks -= 1.0
    return BrakeDemand(k.duty, estimate.road_speed_rad_s**2, s.ticks, (0.0, 0.0, 0.0, 0.0))


def dividing(k, s, estimate, _dt_s):
    s.ticks -= 1.0
    return BrakeDemand(k.duty, estimate.slip / s.ticks, 0.0, (0.0, 0.0, 0.0, 0.0))


def uncompilable(k, s, _estimate, _dt_s):
    return BrakeDemand(k.duty, float(str(s.ticks)), 0.0, (0.0, 0.0, 0.0, 0.0))


def without(_k, s, _estimate, _dt_s):
    s.ticks -= 1.0
    return BrakeDemand(0.5, s.ticks)


class Law(State):
    gains = ()
    internals = ()

    def __init__(self, _setup):
        super().__init__()
        self.k = Constants(0.6)

    def update(self, estimate, dt_s):
        return type(self).law(self.k, self, estimate, dt_s)


def law_of(law, *, a_function=True):
    """Controllers with a user's of this law."""
    body = {"law": staticmethod(law)} | ({"function": staticmethod(law)} if a_function else {})
    return {**CONTROLLERS, "own": type("Own", (Law,), body)}


@pytest.mark.parametrize(
    ("law", "a_function"),
    [
        pytest.param(with_a_power, True, marks=pytest.mark.long),
        pytest.param(dividing, True, marks=pytest.mark.long),
        (uncompilable, True),
        (without, False),
    ],
)
def test_a_users_controller_has_the_same_replay_and_what_if(run, law, a_function):
    controllers = law_of(law, a_function=a_function)
    session = run("controller.name=own", controllers=controllers).session
    found = [replay_session(session, pipeline_of(session, controllers), compiled=way) for way in (True, False)]
    assert found[0] == found[1]
    assert (found[0].differing, session.ticks["phase"][-1]) == (0, Phase.FAULT if law is dividing else Phase.DONE)
    if law is not dividing:  # which a what-if reports
        other = alternative(session, (), controllers)
        compiled, python = (what_if(session, other, controllers, compiled=way) for way in (True, False))
        assert compiled.requests.tobytes() == python.requests.tobytes()


@pytest.mark.parametrize("settings", [(), ("controller.gains.Mk=5.0",), ("estimator.name=moving-window",)])
def test_what_if_has_the_same_bits(two_stops, settings):
    for session in (two_stops, disturbed(two_stops, 7)):
        other = alternative(session, settings, CONTROLLERS)
        compiled, python = (what_if(session, other, CONTROLLERS, compiled=way) for way in (True, False))
        assert compiled.requests.tobytes() == python.requests.tobytes()
        assert compiled.divergences == python.divergences


@pytest.fixture
def asked(monkeypatch):
    """How often a compiled loop was asked, and whether it might compile."""
    calls, replay = [], compiled_replay.CompiledReplay

    def watched(pipeline, may_compile, changes):
        calls.append(may_compile)
        return replay(pipeline, may_compile, changes)

    monkeypatch.setattr(compiled_replay, "CompiledReplay", watched)
    return calls


def test_machine_code_is_used_once_it_has_paid_for_itself(two_stops, asked, monkeypatch):
    ticks = len(two_stops.ticks)
    monkeypatch.setattr(warm_up, "WORTH_LOADING", 2 * ticks)
    monkeypatch.setattr(warm_up, "WORTH_COMPILING", 4 * ticks)
    for _ in range(5):
        assert replay_session(two_stops, pipeline_of(two_stops)).differing == 0
    assert asked == [False, False, True, True]


def test_without_numba_python_replays(two_stops, monkeypatch):
    for name in ("inteco_abs.kept_loop", "inteco_abs.analysis.compiled_replay"):
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    assert both(two_stops)[0] == both(two_stops)[1]
