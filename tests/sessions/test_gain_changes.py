"""Gains and reference slip that change while a run lasts: at one tick each, recorded, and replayed bit for bit."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from inteco_abs.analysis import (
    alternative,
    continued,
    diff_sessions,
    gain_changes,
    listed_changes,
    replay_session,
    times_of_changes_ns,
    what_if,
)
from inteco_abs.analysis.compiled_replay import CompiledReplay
from inteco_abs.analysis.replay import decisions
from inteco_abs.config import load_config
from inteco_abs.control import CONTROLLERS, GainChange, build_pipeline, control_check, gains_to_change
from inteco_abs.errors import ConfigError
from inteco_abs.format import TICK
from inteco_abs.plugins import Controllers, Origin
from inteco_abs.sessions import card_of, changes_among, read_session, recover_session, session_config, write_copy
from inteco_abs.sessions.content import Parameters
from inteco_abs.signals import BrakeDemand, Phase, Reason
from inteco_abs.views.figure import figure_of
from inteco_abs.views.report.plots import time_plots
from inteco_abs.views.report.traces import traces_of

SMALL = (
    *("experiment.start_speed_rad_s=15.0", "experiment.idle_s=0.01", "experiment.hold_s=0.0", "loop.rate_hz=400.0"),
    *("experiment.stops=2", "controller.hold_below_rad_s=1.0"),
)
LAWS = ("reaching-law", "boundary-layer", "pi", "relay", "super-twisting")


def planned(*changes):
    return f"experiment.changes={list(changes)!r}".replace("'", '"')


def changes_of(session):
    return changes_among(session.parameters)


@pytest.fixture
def small(run_at, tmp_path):
    """Runs two short brakings at 400 Hz with planned changes."""
    number = itertools.count()

    def make(*changes, law="reaching-law", **options):
        chosen = (*SMALL, f"controller.name={law}", *([planned(*changes)] if changes else []))
        return run_at(tmp_path / f"{next(number)}.mcap", chosen, **options)

    return make


@st.composite
def plans(draw):
    """A law, and changes of any of its gains at any times, as texts."""
    law = draw(st.sampled_from(LAWS))
    gains = [("reference_slip", 0.001, 0.999), *((gain.name, gain.low, gain.high) for gain in CONTROLLERS[law].gains)]
    whens = st.one_of(
        st.integers(0, 900).map("#{}".format),
        st.integers(0, 60).map("brake+#{}".format),
        st.integers(0, 60).map("brake2+#{}".format),
    )
    found = []
    for name, low, high in draw(st.lists(st.sampled_from(gains), min_size=1, max_size=6)):
        value = draw(st.one_of(st.sampled_from([low, high]), st.floats(low, high)))
        found.append(f"{name}={value!r}@{draw(whens)}")
    return law, found


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(plans())
def test_a_run_with_any_changes_replays_bit_for_bit(small, replayed, plan):
    law, changes = plan
    session = small(*changes, law=law).session
    found = changes_of(session)
    assert {(each.name, each.value) for each in found} <= {
        (text.partition("=")[0], float(text.partition("=")[2].partition("@")[0])) for text in changes
    }
    assert replayed(session).differing == 0
    if found:  # without the changes it is another run, unless they had no effect on any tick
        without = replace(session, parameters=())
        assert replayed(without).agreeing_ticks >= min(each.tick for each in found)


def test_each_change_takes_effect_at_its_tick_and_is_recorded_with_it(small, replayed):
    session = small(
        "reference_slip=0.3@brake+#20", "reference_slip=0.1@brake2", "Mk=30@brake2+25ms", "Mq=0.5@#0"
    ).session
    ticks = session.ticks
    begins = [int(tick) for tick, before, now in zip(
        ticks["tick"][1:], ticks["phase"][:-1], ticks["phase"][1:], strict=True
    ) if now == Phase.BRAKING != before]  # fmt: skip
    first, second = begins
    assert changes_of(session) == [
        GainChange(1, "Mq", 0.5),
        GainChange(first + 20, "reference_slip", 0.3),
        GainChange(second + 1, "reference_slip", 0.1),
        GainChange(second + 10, "Mk", 30.0),
    ]
    reference = ticks["slip_reference"][ticks["phase"] == Phase.BRAKING]
    numbers = ticks["tick"][ticks["phase"] == Phase.BRAKING]
    assert set(reference[numbers < first + 20]) == {0.2}
    assert set(reference[(numbers >= first + 20) & (numbers <= second)]) == {0.3}
    assert set(reference[numbers > second]) == {0.1}
    assert [entry.text for entry in session.log if "=" in entry.text] == [
        "Mq = 0.5 from tick 1",
        f"reference_slip = 0.3 from tick {first + 20}",
        f"reference_slip = 0.1 from tick {second + 1}",
        f"Mk = 30 from tick {second + 10}",
    ]
    assert session.metadata["result"]["card"].find('"reference_slip": null') > 0
    assert replayed(session).differing == 0


@pytest.mark.parametrize("law", ["reaching-law", pytest.param("boundary-layer", marks=pytest.mark.long)])
def test_a_compiled_replay_makes_the_changes_with_the_bits_of_python(small, law):
    changes = ("reference_slip=0.3@brake+#20", "reference_slip=0.1@brake2", "Mk=30@brake2+25ms", "Mk=3@#0", "Mq=0.5@#0")
    session = small(*changes, law=law).session
    config = session_config(session, ())
    compiled = CompiledReplay(build_pipeline(config), True, gain_changes(session))
    parts = [compiled.decide(session.ticks[first : first + 300]) for first in range(0, len(session.ticks), 300)]
    again = decisions(session, build_pipeline(config))
    for column in TICK.columns:
        if column.role.value != "timing":
            found = np.concatenate([part[column.name] for part in parts])
            assert found.tobytes() == again[column.name].tobytes(), column.name
    rest = tuple(part for part in session.parameters if not part.tick)
    for name in ("nothing", "lag_s"):
        other = replace(session, parameters=(*rest, Parameters(400, {name: 0.05})))
        found = [replay_session(other, build_pipeline(config), compiled=way) for way in (True, False)]
        assert found[0] == found[1]
        assert found[0].differing > 0


def test_another_record_of_a_change_is_a_difference_from_its_tick_on(small, replayed):
    session = small("reference_slip=0.3@brake+#20").session
    (change,) = changes_of(session)
    rest = tuple(part for part in session.parameters if not part.tick)
    for tick, value, first in (
        (change.tick, 0.31, change.tick),
        (change.tick + 3, 0.3, change.tick),
        (change.tick - 3, 0.3, change.tick - 3),
    ):
        other = replace(session, parameters=(*rest, Parameters(tick, {"reference_slip": value})))
        assert replayed(other).first.tick == first
    unknown = replace(session, parameters=(*rest, Parameters(change.tick, {"nothing": 1.0})))
    assert replayed(unknown).first.tick == change.tick


def test_a_run_without_changes_has_the_bits_of_one_whose_changes_change_nothing(small):
    plain, same = small(), small("Mk=2@brake+#5", "reference_slip=0.2@brake+#5")
    assert same.session.payload == plain.session.payload


def test_a_recovered_session_keeps_its_changes(small, replayed, altered, tmp_path):
    made = small("reference_slip=0.3@brake+#20")
    cut = altered(made.path.read_bytes()[:-20_000])
    recover_session(cut, tmp_path / "again.mcap")
    session = made._replace(path=tmp_path / "again.mcap").session
    assert changes_of(session) == changes_of(made.session)
    assert replayed(session).differing == 0


class Own:
    """Keeps one gain as it is, one in another unit, one by a property; refuses the last."""

    gains = tuple(CONTROLLERS["pi"].gains)
    internals = ()

    def __init__(self, setup, Kp, Ki, bias):
        self.reference, self.Kp, self.per_tick, self._bias = setup.reference_slip, Kp, Ki * 0.001, bias

    @property
    def bias(self):
        return self._bias

    @bias.setter
    def bias(self, value):
        if value > 0.9:
            raise RuntimeError("too much")
        self._bias = value

    def update(self, estimate, _dt_s):
        return BrakeDemand(max(0.0, min(1.0, self._bias + self.Kp * (self.reference - estimate.slip))))


OWN = Controllers({"Own": (Own, Origin(b""))})


def test_gains_that_a_users_class_keeps_can_change():
    config = load_config(settings=["controller.name=Own"], checks=[control_check(OWN)])
    assert [gain.name for gain in gains_to_change(build_pipeline(config, OWN), config, OWN)] == [
        "reference_slip",
        "Kp",
        "bias",
    ]


def test_no_change_of_a_gain_takes_a_duty_beyond_the_guards_limit(run_at, tmp_path):
    limited = (*SMALL, "controller.name=pi", "guard.brake_limit=0.5", planned("bias=1@brake+#5", "Kp=100@brake+#5"))
    ticks = run_at(tmp_path / "limited.mcap", limited).session.ticks
    assert ticks["brake_request"].max() == 1.0
    assert ticks["brake"].max() == 0.5


def test_a_class_that_raises_at_a_change_ends_the_run_safely_and_replays(small, replayed):
    made = small("Kp=0.5@brake+#3", "bias=0.95@brake+#9", law="Own", controllers=OWN)
    assert made.stop.reason is Reason.CONTROLLER_ERROR
    assert "too much" in made.stop.explanation
    ticks = made.session.ticks
    fault = changes_of(made.session)[-1].tick
    assert ticks["phase"][ticks["tick"] == fault][0] == Phase.FAULT
    assert not np.any(ticks["brake"][ticks["tick"] >= fault])
    assert replayed(made.session, OWN).differing == 0


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("Mk=5", "must be NAME=VALUE@WHEN"),
        ("Mk=5@7", "in ticks (#)"),
        ("Mk=5@brake0", "or since a braking began"),
        ("Mk=5@brake+", "or since a braking began"),
        ("Mk=2,5@1s", "write 2.5"),
        ("Mk=1001@1s", "must be in 0..1000 1/s"),
        ("Mk=nan@1s", "must be in 0..1000 1/s"),
        ("reference_slip=1@1s", "must be in 0.001..0.999"),
        ("Mkk=5@1s", "did you mean Mk?"),
        ("guard.brake_limit=1@1s", "the guard's limits cannot change while a run lasts"),
    ],
)
def test_a_change_that_is_not_possible_is_refused_with_what_is(change, problem):
    with pytest.raises(ConfigError, match=r"experiment\.changes") as error:
        load_config(settings=[planned(change)], checks=[control_check()])
    assert problem in str(error.value)


@pytest.mark.parametrize(
    ("change", "law"),
    [
        ("reference_slip=0.3@1s", ('controller.reference_formula="0.2"',)),
        ("dead_time_s=0.01@1s", ("controller.name=smith-relay",)),
        ("Ki=1@1s", ("controller.name=Own",)),
    ],
)
def test_what_a_controller_cannot_change_is_refused_before_the_run(run_at, tmp_path, change, law):
    with pytest.raises(ConfigError, match="not a gain that can change while a run lasts"):
        run_at(tmp_path / "no.mcap", (*SMALL, *law, planned(change)), controllers=OWN)
    assert not (tmp_path / "no.mcap").exists()


def test_a_changed_gain_goes_to_the_law_behind_a_reference_that_moves(run_at, tmp_path, replayed):
    moves = (*SMALL, 'controller.reference_formula="0.2 + 0.05*sin(20*t)"', "controller.name=pi")
    made = run_at(tmp_path / "moves.mcap", (*moves, planned("bias=0.9@brake+#10")))
    ticks, (change,) = made.session.ticks, changes_of(made.session)
    plain = run_at(tmp_path / "plain.mcap", moves).session.ticks
    differs = ticks["brake_request"][: len(plain)] != plain["brake_request"][: len(ticks)]
    assert ticks["tick"][np.argmax(differs)] == change.tick
    assert replayed(made.session).differing == 0


def test_a_what_if_repeats_the_changes_of_what_it_keeps(small):
    session = small("reference_slip=0.3@brake+#10", "Mk=30@brake2+#5").session

    def horizon_s(*settings):
        return what_if(session, alternative(session, settings, CONTROLLERS), CONTROLLERS).horizon_s

    assert horizon_s() is None
    assert horizon_s("controller.gains.lag_s=0.0") is None
    second = braking_times_s(session)[1]
    assert horizon_s("controller.gains.Mk=300.0") < second
    closed = continued(session, session_config(session, ()), alternative(session, (), CONTROLLERS), CONTROLLERS)
    assert closed.ticks["slip_reference"].tobytes() == session.ticks["slip_reference"].tobytes()


def braking_times_s(session):
    ticks = session.ticks
    begins = np.flatnonzero((ticks["phase"][1:] == Phase.BRAKING) & (ticks["phase"][:-1] != Phase.BRAKING)) + 1
    return (ticks["time_ns"][begins] - ticks["time_ns"][begins[0]]) * 1e-9


def test_lists_of_facts_name_each_change(small):
    made, plain = small("Mk=30@brake+#5"), small()
    key = f"Mk from tick {changes_of(made.session)[0].tick}"
    assert listed_changes(made.session) == {key: "30.0"}
    gains = diff_sessions(made.session, plain.session, ("gains",)).changes["gains"]
    assert [(each.key, each.a, each.b) for each in gains] == [(key, "30.0", None)]
    times_ns = times_of_changes_ns(made.session)
    assert made.session.ticks["tick"][made.session.ticks["time_ns"] == times_ns[0]] == changes_of(made.session)[0].tick


def test_stops_of_many_rigs_refuse_changes(verb):
    done = verb("sweep", "--rigs", "hard:0-1", "--set", planned("Mk=3@brake"))
    assert done.code == 2
    assert "stops of many rigs keep their gains" in done.err


def test_a_copy_of_a_session_keeps_its_changes(small, replayed, tmp_path):
    session = small("reference_slip=0.3@brake+#10").session
    write_copy(
        session,
        tmp_path / "copy.mcap",
        session.blocks(),
        metadata=session.metadata,
        attachments=session.attachments,
        card=card_of(session),
        log=session.log,
    )
    copy = read_session(tmp_path / "copy.mcap")
    assert changes_of(copy) == changes_of(session)
    assert [entry.text for entry in copy.log] == [entry.text for entry in session.log]
    assert replayed(copy).differing == 0


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("Mk=5@brake3", "the run has 2 stops"),
        ("Mk=5@brake+99999s", "lasts at most"),
        ("Mk=5@#999999999", "lasts at most"),
    ],
)
def test_a_change_that_can_never_come_is_refused(small, change, problem):
    with pytest.raises(ConfigError, match=problem):
        small(change)


@pytest.mark.long
def test_a_change_whose_time_does_not_come_is_named_at_the_end(small, verb, tmp_path):
    made = small("Mk=5@brake+#5", "Mk=6@60s", "Mk=5@brake+9s")
    assert made.stop.not_made == ("Mk=6@60s", "Mk=5@brake+9s")
    done = verb("run", "--virtual", "--change", "Mk=6@20s", "--out", tmp_path / "late.mcap", "--quiet")
    assert (done.code, done.err) == (0, "inteco-abs: the change Mk=6@20s was not made: the run was over before\n")


class Reads(Own):
    """Has a property without a setter, and a method for all other gains."""

    @property
    def Kp(self):
        return self._kp

    def __init__(self, setup, Kp, **_others):
        self.reference, self._kp, self.changed = setup.reference_slip, Kp, {}


class Handles(Reads):
    def change_gain(self, name, value):
        self.changed[name] = value


@pytest.mark.parametrize(("kind", "can"), [(Reads, []), (Handles, ["Kp", "Ki", "bias"])])
def test_a_method_changes_every_gain_and_a_property_needs_a_setter(kind, can):
    known = Controllers({"Own": (kind, Origin(b""))})
    config = load_config(settings=["controller.name=Own"], checks=[control_check(known)])
    pipeline = build_pipeline(config, known)
    assert [gain.name for gain in gains_to_change(pipeline, config, known)] == ["reference_slip", *can]
    pipeline.change("reference_slip", 0.3)
    for name in can:
        pipeline.change(name, 0.5)
    controller = pipeline.machine.controller
    assert (controller.reference, controller.changed) == (0.3, dict.fromkeys(can, 0.5))


def test_a_rehearsal_refuses_what_the_run_would(verb):
    fixed = ("--set", "controller.name=smith-relay", "--change", "dead_time_s=0.01@1s")
    done = verb("run", "--virtual", "--dry-run", *fixed)
    assert done.code == 2
    assert "dead_time_s: not a gain that can change while a run lasts" in " ".join(done.out.split())


def test_figure_and_report_mark_each_change(run_at, tmp_path):
    session = run_at(tmp_path / "marked.mcap", (*SMALL, planned("Mk=30@brake+#5", "Mk=3@brake2"))).session
    panel = figure_of([session]).axes[2]
    (marks,) = (each for each in panel.collections if each.get_label() == "gain changed")
    wanted = pytest.approx([0.0125, braking_times_s(session)[1]], abs=0.003)
    assert [path.vertices[0][0] for path in marks.get_paths()] == wanted
    (trace,) = traces_of([session])
    assert list(trace.changes_s) == wanted
    for drawing in time_plots([trace]):
        (spans,) = (each for each in drawing.plot.renderers if each.name == "change")
        assert tuple(spans.data_source.data["x"]) == trace.changes_s
        assert "a gain changed" in drawing.caption
