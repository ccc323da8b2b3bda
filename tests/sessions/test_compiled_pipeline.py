"""The loop's decisions in machine code: those of Python, bit for bit, also where machine code leaves them to Python."""

import math

import pytest

from inteco_abs.config import load_config
from inteco_abs.control import build_pipeline
from inteco_abs.errors import AbsError
from inteco_abs.realtime.compiled_pipeline import CompiledPipeline
from inteco_abs.sessions import TICK, session_config
from inteco_abs.signals import BoardFlags, Phase, Reason, Sample, Timing

pytestmark = pytest.mark.untraced  # the machine code is that of the replays, and in Python other tests reach the lines

LAW = ("estimator.name=kalman", "controller.name=boundary-layer")
QUICK = ("experiment.start_speed_rad_s=20.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")


@pytest.fixture(scope="module")
def two_stops(run_at, tmp_path_factory):
    return run_at(tmp_path_factory.mktemp("two") / "stops.mcap", (*QUICK, "experiment.stops=2", *LAW)).session


@pytest.fixture(scope="module")
def late(two_stops):
    """A tick while the wheel brakes."""
    return int((two_stops.ticks["phase"] == Phase.BRAKING).argmax()) + 60


@pytest.fixture(scope="module")
def compiled(two_stops):
    """A new pipeline that decides in machine code."""

    def make():
        config = session_config(two_stops, ())
        return CompiledPipeline(config, build_pipeline(config), may_make=True)

    return make


def seen(session):
    """What each tick gave its decision."""
    for values in session.ticks.tolist():
        row = dict(zip(session.ticks.dtype.names, values, strict=True))
        counts = row["wheel_count"], row["road_count"]
        sample = Sample(row["tick"], row["time_ns"], row["dt_s"], *counts, BoardFlags(row["board_flags"]))
        yield sample, Reason(row["stop_request"]), Timing(row["late_us"], row["io_us"], row["busy_us"], row["skipped"])


def decided(pipeline, inputs, changes=()):
    """All that the loop takes of each tick; `changes` are made before the tick of their number."""
    for number, each in enumerate(inputs):
        for _, name, value in (change for change in changes if change[0] == number):
            pipeline.change(name, value)
        tick = pipeline.step(*each)
        state = pipeline.phase, pipeline.reason, pipeline.finished, type(pipeline.error)
        assert isinstance(pipeline.phase, Phase)
        assert isinstance(pipeline.reason, Reason)
        yield TICK.pack(tick), pipeline.command, state


def assert_as_in_python(compiled, session, inputs, changes=(), *, left=False):
    """The moments of both, which it returns; `left` says whether the machine code leaves some to Python."""
    pipeline = compiled()
    assert pipeline.decides_in == "machine code"
    own = list(decided(pipeline, inputs, changes))
    assert pipeline.decides_in == ("Python" if left else "machine code")
    assert own == list(decided(build_pipeline(session_config(session, ())), inputs, changes))
    return own


def test_two_stops_are_those_of_python_and_of_the_session(compiled, two_stops):
    own = assert_as_in_python(compiled, two_stops, list(seen(two_stops)))
    assert b"".join(packed for packed, *_ in own) == two_stops.ticks.tobytes()
    assert own[-1][2] == (Phase.DONE, Reason.NONE, True, type(None))


def test_gains_change_at_the_same_ticks_and_stay_so_for_the_next_stop(compiled, two_stops, late):
    changes = [(0, "Mk", 3.0), (late, "reference_slip", 0.3), (late, "Mq", 0.5), (late + 7, "Mk", 5.0)]
    own = assert_as_in_python(compiled, two_stops, list(seen(two_stops)), changes)
    references = [TICK.array(packed)["slip_reference"][0] for packed, *_ in own]
    assert references[late - 1 : late + 1] == [0.2, 0.3]


@pytest.mark.parametrize("changed", [{"wheel_count": 1 << 41}, {"time_ns": 1}, {"dt_s": math.nan}], ids=str)
@pytest.mark.parametrize("gains", [(), [(3, "Mk", 5.0)]], ids=["no change", "a change after it"])
def test_what_machine_code_cannot_decide_python_decides_from_the_same_state(compiled, two_stops, late, changed, gains):
    inputs = list(seen(two_stops))
    inputs[late] = inputs[late][0]._replace(**changed), *inputs[late][1:]
    own = assert_as_in_python(compiled, two_stops, inputs, [(late + after, *rest) for after, *rest in gains], left=True)
    assert own[late - 1][2][0] is Phase.BRAKING


@pytest.mark.parametrize("after", [-1000, -100, 0])
def test_a_request_to_stop_is_safe_in_its_tick(compiled, two_stops, late, after):
    inputs = list(seen(two_stops))
    at = max(0, late + after)
    inputs[at] = inputs[at][0], Reason.OPERATOR_STOP, inputs[at][2]
    own = assert_as_in_python(compiled, two_stops, inputs)
    assert own[at][1:] == ((0.0, 0.0), (Phase.FAULT, Reason.OPERATOR_STOP, True, type(None)))


def test_a_change_that_fails_ends_the_run_as_in_python(compiled, two_stops, late):
    own = assert_as_in_python(compiled, two_stops, list(seen(two_stops)), [(late, "nothing", 1.0)], left=True)
    assert own[late][1:] == ((0.0, 0.0), (Phase.FAULT, Reason.CONTROLLER_ERROR, True, AttributeError))


def test_without_machine_code_on_disk_it_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    config = load_config(settings=LAW)
    with pytest.raises(AbsError, match=r"loop\.compiled.*boundary-layer with kalman.*set it to false"):
        CompiledPipeline(config, build_pipeline(config))
