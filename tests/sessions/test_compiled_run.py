"""Compiled ticks of a virtual run, through frames, are those of the loop in Python, bit for bit."""

import json
import math
import sys

import pytest

from inteco_abs import warm_up
from inteco_abs.control import CONTROLLERS, ESTIMATORS
from inteco_abs.experiment import compiled_run, virtual_run
from inteco_abs.mock_board import parse_faults
from inteco_abs.rig import POPULATIONS
from inteco_abs.signals import Phase, Reason

pytestmark = pytest.mark.untraced  # other tests reach these lines, too


@pytest.fixture
def both(run, monkeypatch):
    """Session and card of a run that is compiled from its second tick on, and of one in Python; the compiled bytes."""
    ticks = []
    slice_of = compiled_run.CompiledRun.run

    def watched(self, most):
        rows, truths = slice_of(self, most)
        ticks.append(len(rows))
        return rows, truths

    monkeypatch.setattr(compiled_run.CompiledRun, "run", watched)

    def make(*settings, **options):
        found = []
        for worth, name in ((0, "compiled.mcap"), (math.inf, "python.mcap")):
            monkeypatch.setattr(warm_up, "WORTH_LOADING", worth)
            monkeypatch.setattr(warm_up, "WORTH_COMPILING", worth)
            made = run(*settings, name=f"{options.get('seed')}-{name}", **options)
            found.append((made.session, made.stop.card))
        return *found, sum(ticks)

    return make


DEFECTIVE = """base = "wild"
[rig]
road = "wet-cobblestone"
later_road = "snow"
later_road_after_s = 0.2
adhesion_tilt = 0.3
"""


def assert_same(both, *settings, compiled=True, **options):
    """Every byte of ticks and truths, and the card."""
    (session, card), (python, python_card), bytes_ = both(*settings, **options)
    assert (bytes_ > 0) is compiled
    assert bytes(session.payload) == bytes(python.payload)
    assert session.truth.tobytes() == python.truth.tobytes()
    assert {**card, "session": ""} == {**python_card, "session": ""}
    return session


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param((), marks=pytest.mark.long),
        pytest.param(
            (
                "experiment.stops=2",
                'simulation.rig="rough:2"',
                "controller.name=boundary-layer",
                "estimator.name=kalman",
            ),
            marks=pytest.mark.long,
        ),
        pytest.param(
            ('experiment.changes=["reference_slip=0.3@#40", "Mk=9@#90"]', "controller.name=boundary-layer"),
            marks=pytest.mark.long,
        ),
        ('simulation.rig="own:1"', f"simulation.population={json.dumps(DEFECTIVE)}"),
        pytest.param(
            ("simulation.wheel_sign=-1", "board.wheel_sign=-1", 'board.pwm_mode="8-bit"', "loop.rate_hz=1000.0"),
            marks=pytest.mark.long,
        ),
    ],
    ids=["default", "two stops", "gains that have changed", "defects and roads", "other wiring"],
)
def test_a_compiled_run_has_the_bits_of_python(both, settings):
    session = assert_same(both, *settings, seed=5)
    assert session.ticks["phase"][-1] == Phase.DONE


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (("experiment.start_speed_rad_s=120.0", "experiment.spin_up_timeout_s=0.5"), Reason.SPIN_UP_TIMEOUT),
        (("experiment.braking_timeout_s=0.1",), Reason.BRAKING_TIMEOUT),
    ],
)
def test_a_compiled_run_that_the_guard_ends_has_the_bits_of_python(both, settings, reason):
    assert assert_same(both, *settings).ticks["reason"][-1] == reason


@pytest.mark.long
@pytest.mark.parametrize("population", POPULATIONS)
@pytest.mark.parametrize(
    ("controller", "estimator"),
    [
        *((controller, "moving-window") for controller in CONTROLLERS if controller != "predictive-reaching"),
        *(("reaching-law", estimator) for estimator in ESTIMATORS),
        ("predictive-reaching", "observer"),
        ("predictive-reaching", "adaptive-observer"),
    ],
)
def test_compiled_runs_of_every_part_have_the_bits_of_python(both, controller, estimator, population):
    for seed in range(5):
        rig = f'simulation.rig="{population}:{seed}"'
        assert_same(both, f"controller.name={controller}", f"estimator.name={estimator}", rig, seed=seed)


@pytest.mark.parametrize("slices", [pytest.param(1, marks=pytest.mark.long), 3])
def test_python_can_go_on_at_any_tick_with_the_same_bits(both, monkeypatch, slices):
    watched, left = compiled_run.CompiledRun.run, [slices]

    def ended(self, most):
        left[0] -= 1
        return watched(self, most) if left[0] >= 0 else (b"", b"")

    monkeypatch.setattr(virtual_run, "_COMPILED_TICKS", 700)
    monkeypatch.setattr(compiled_run.CompiledRun, "run", ended)
    assert_same(both, "experiment.stops=2", 'simulation.rig="hard:17"')
    assert left[0] < 0


def test_a_number_that_is_not_finite_is_left_to_python_with_the_state_before(both, monkeypatch):
    monkeypatch.setattr(virtual_run, "_COMPILED_TICKS", 500)
    run_loop = compiled_run.KeptLoop.run
    asked = []

    def failing(self, *arguments):
        asked.append(run_loop(self, *arguments))
        return asked[-1] and len(asked) < 3  # what has been computed counts for nothing

    monkeypatch.setattr(compiled_run.KeptLoop, "run", failing)
    assert_same(both)
    assert asked == [True, True, True]


@pytest.mark.parametrize(
    "options", [{"faults": parse_faults(["lose@brake+20ms"])}, {"frames": True}], ids=["fault", "frames"]
)
def test_frames_that_are_changed_or_kept_go_through_python(both, options):
    assert_same(both, compiled=False, **options)


def test_without_numba_python_runs(both, monkeypatch):
    for name in (
        "inteco_abs.kept_loop",
        "inteco_abs.experiment.compiled_run",
        "inteco_abs.analysis.compiled_replay",
    ):
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    assert_same(both, compiled=False)


def test_a_run_is_compiled_once_that_has_paid_for_itself(run, monkeypatch):
    """A program that runs one stop does not wait for numba."""
    asked = []
    monkeypatch.setattr(warm_up, "import_module", asked.append)
    monkeypatch.setattr(warm_up, "WORTH_LOADING", 10**9)
    assert run().stop.card["outcome"] == "completed"
    assert not asked
