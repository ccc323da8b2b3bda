"""What differs between two sessions is named, and what does not is not."""

from dataclasses import replace

import numpy as np
import pytest

from inteco_abs.analysis import SECTIONS, diff_sessions
from inteco_abs.format.schema import TICK, TRUTH
from inteco_abs.signals import Phase


@pytest.fixture
def changed(quick):
    """The quick session with other metadata, configuration, ticks or truths."""

    def make(metadata=None, config=None, ticks=None, truth=None):
        session = quick.session
        facts = {name: dict(values) for name, values in session.metadata.items()}
        for name, values in (metadata or {}).items():
            facts.setdefault(name, {}).update(values)
        data, truths = bytearray(session.payload), bytearray(session.truth.tobytes())
        if ticks:
            ticks(np.frombuffer(data, TICK.dtype))
        if truth:
            truth(np.frombuffer(truths, TRUTH.dtype))
        attachments = session.attachments | ({} if config is None else {"config.toml": config})
        rows = session.with_rows(TICK.array(bytes(data)), TRUTH.array(bytes(truths)))
        return replace(rows, metadata=facts, attachments=attachments)

    return make


def keys(found):
    return {name: [change.key for change in changes] for name, changes in found.changes.items() if changes}


def test_a_session_does_not_differ_from_itself(quick):
    found = diff_sessions(quick.session, quick.session)
    assert found.equal
    assert tuple(found.changes) == SECTIONS


def test_a_repeated_run_is_identical(quick, run):
    assert keys(diff_sessions(quick.session, run(name="again.mcap").session)) == {}


def test_another_gain_shows_in_gains_configuration_result_and_signals(quick, run):
    found = diff_sessions(quick.session, run("controller.gains.Mk=9.0").session)
    assert found.changes["gains"] == [("Mk", "2.0", "9.0")] or keys(found)["gains"] == ["Mk"]
    assert keys(found)["configuration"] == ["controller.gains.Mk"]
    signals = {change.key: change for change in found.changes["signals"]}
    assert {"brake", "torque_eq_nm"} <= set(signals)
    assert signals["torque_eq_nm"].unit == "N.m"
    assert not {"c0", "c1", "c2"} & set(signals)
    assert set(keys(found)) == {"result", "signals", "gains", "configuration"}


@pytest.mark.parametrize(
    ("section", "record", "key"),
    [
        ("outcome", "session", "outcome"),
        ("software", "software", "git_commit"),
        ("software", "controller", "source_sha256"),
        ("host", "host", "kernel"),
        ("host", "realtime", "governor"),
        ("rig", "rig", "profile"),
        ("gains", "controller", "gain.Mk"),
    ],
)
def test_metadata_is_compared_in_its_section(quick, changed, section, record, key):
    found = diff_sessions(quick.session, changed({record: {key: "another"}}))
    assert list(keys(found)) == [section]
    ((change,),) = (changes for changes in found.changes.values() if changes)
    assert change.b == "another"


@pytest.mark.parametrize("key", ["session_id", "started_utc", "ended_utc"])
def test_what_differs_in_any_two_runs_is_not_listed(quick, changed, key):
    assert diff_sessions(quick.session, changed({"session": {key: "another"}, "software": {"argv": "x"}})).equal


def test_only_the_requested_sections_are_compared(quick, changed):
    other = changed({"host": {"kernel": "another"}})
    assert diff_sessions(quick.session, other, ("gains", "signals")).equal
    assert not diff_sessions(quick.session, other, ("gains", "host")).equal


def test_a_signal_is_compared_from_the_start_of_braking_on(quick, changed):
    first = int(np.flatnonzero(quick.session.ticks["phase"] == Phase.BRAKING)[0])

    def spoil(ticks):
        ticks["slip"][first - 10] += 0.5
        ticks["slip"][first + 100] += 0.25

    (change,) = diff_sessions(quick.session, changed(ticks=spoil)).changes["signals"]
    assert (change.key, change.unit, change.one_sided) == ("slip", "1", 0)
    assert change.max_difference == pytest.approx(0.25)
    assert change.at_s == pytest.approx(100 * 0.0005)
    assert change.rms_difference == pytest.approx(0.25 / np.sqrt(change.ticks))


def test_what_is_different_only_as_one_has_stopped_does_not_hide_the_rest(quick, changed):
    braking = np.flatnonzero(quick.session.ticks["phase"] == Phase.BRAKING)

    def sooner(ticks):
        ticks["phase"][braking[-20:]] = Phase.STOPPED
        ticks["brake"][braking[-20:]] += 0.5
        ticks["brake"][braking[40]] += 0.01

    def of_truth(truth):
        truth["brake"][braking[-20:]] += 0.5
        truth["brake"][braking[40]] += 0.01

    found = diff_sessions(quick.session, changed(ticks=sooner, truth=of_truth)).changes["signals"]
    for change in found:
        assert change.max_difference == pytest.approx(0.01)
        assert change.at_s == pytest.approx(40 * 0.0005, abs=1e-3)
        assert change.other_phase == 20
    assert [change.key for change in found] == ["brake", "truth.brake"]


def test_an_earlier_start_of_braking_changes_no_signal(quick, changed):
    def later(rows):
        rows["time_ns"] += np.uint64(10**9)

    assert diff_sessions(quick.session, changed(ticks=later, truth=later), ("signals",)).equal


def test_a_number_that_is_nan_in_one_session_is_counted(quick, changed):
    def spoil(ticks):
        ticks["torque_demand_nm"][-20:-10] = np.nan

    (change,) = diff_sessions(quick.session, changed(ticks=spoil)).changes["signals"]
    assert (change.key, change.one_sided, change.max_difference) == ("torque_demand_nm", 10, 0.0)


def test_the_truth_is_a_signal_too(quick, changed):
    def spoil(truth):
        truth["slip"][-50] += 0.1

    assert keys(diff_sessions(quick.session, changed(truth=spoil))) == {"signals": ["truth.slip"]}


def test_a_truth_that_is_missing_is_reported(quick):
    without = quick.session.with_rows(truth=quick.session.truth[:0])
    assert diff_sessions(quick.session, without).changes["signals"] == [("truth", True, False)]


def test_within_rel_of_the_peak_signals_are_equal(quick, changed):
    def spoil(ticks):
        ticks["road_speed_rad_s"][-50] += 0.5  # of some 20

    other = changed(ticks=spoil)
    assert not diff_sessions(quick.session, other, ("signals",), rel=0.01).equal
    assert diff_sessions(quick.session, other, ("signals",), rel=0.05).equal


def test_within_rel_metrics_are_equal(quick, run):
    other = run("controller.gains.Mk=2.2").session
    assert not diff_sessions(quick.session, other, ("result",)).equal
    assert diff_sessions(quick.session, other, ("result",), rel=1.0).equal


def test_settings_are_named_by_their_dotted_keys(quick, changed):
    text = quick.session.attachments["config.toml"].decode()
    other = changed(config=text.replace("brake_limit = 1.0", "brake_limit = 0.5").encode())
    assert text != other.attachments["config.toml"].decode()
    assert diff_sessions(quick.session, other).changes["configuration"] == [("guard.brake_limit", 1.0, 0.5)]


@pytest.mark.parametrize("config", [b"\xff", b"no = = toml", b"a = " + b"[" * 5000])
def test_a_configuration_that_cannot_be_read_differs(quick, changed, config):
    found = diff_sessions(quick.session, changed(config=config), ("configuration",))
    assert "config.toml" in keys(found)["configuration"]
    assert diff_sessions(changed(config=config), changed(config=config), ("configuration",)).equal


def test_without_braking_signals_are_compared_from_the_first_tick(quick, changed):
    def never(ticks):
        ticks["phase"] = Phase.IDLE

    assert diff_sessions(changed(ticks=never), changed(ticks=never), ("signals",)).equal
    assert diff_sessions(quick.session, changed(ticks=never), ("signals",)).equal


def test_an_empty_session_has_no_signals_to_compare(quick):
    empty = quick.session.with_rows(quick.session.ticks[:0], quick.session.truth[:0])
    assert diff_sessions(empty, empty, ("signals",)).equal
    assert keys(diff_sessions(quick.session, empty, ("signals",))) == {"signals": ["ticks"]}
