import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
import tomli_w

from inteco_abs.analysis.golden import TABLE_NAME, GoldenFolder
from inteco_abs.control import CONTROLLERS
from inteco_abs.control.controllers import ReachingLaw
from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.sessions import read_session
from inteco_abs.signals import Phase

OURS = Path(__file__).parent.parent / "golden"


class Stronger(ReachingLaw):
    """The paper's law, changed."""

    def approach(self, switching, road_speed, dt_s):
        return 1.5 * super().approach(switching, road_speed, dt_s)


CHANGED = {**CONTROLLERS, "reaching-law": Stronger}


@pytest.fixture
def folder(tmp_path, quick):
    """A folder with one golden session, `quick`."""
    goldens = GoldenFolder(tmp_path / "golden")
    goldens.add(quick.session, "quick", "a first one", CONTROLLERS)
    return goldens


def contents(folder):
    return {file.name: file.read_bytes() for file in folder.path.iterdir()}


def test_the_decisions_of_today_are_those_of_our_golden_sessions():
    verdicts = GoldenFolder(OURS).test([], CONTROLLERS)
    assert len(verdicts) == 3
    for verdict in verdicts:
        assert verdict.problem == ""
        assert verdict.replay.first is None
        assert verdict.replay.braking_ticks > 100


def test_our_golden_sessions_are_small():
    assert sum(file.stat().st_size for file in OURS.iterdir()) < 400_000


def test_a_change_of_the_law_is_found_by_our_golden_sessions():
    (verdict,) = GoldenFolder(OURS).test(["published-rig"], CHANGED)
    assert verdict.replay.first.field == "torque_demand_nm"


def test_a_copy_has_the_ticks_but_neither_truth_nor_host(folder, quick):
    copy = read_session(folder.path / "quick.mcap")
    original = quick.session
    assert bytes(copy.payload) == bytes(original.payload)
    assert len(copy.truth) == 0
    assert "host" not in copy.metadata
    assert "argv" not in copy.metadata["software"]
    assert copy.attachments == original.attachments
    assert copy.media_types == original.media_types
    assert copy.media_types["requirements.txt"] == "text/plain"
    assert copy.metadata["controller"] == original.metadata["controller"]
    kept = ("session_id", "outcome", "reason")
    assert [copy.metadata["session"][key] for key in kept] == [original.metadata["session"][key] for key in kept]


def test_the_table_has_hash_reason_date_and_versions(folder):
    table = tomllib.loads((folder.path / TABLE_NAME).read_text())
    (version,) = table["golden"]["quick"]["history"]
    assert (version["reason"], version["changed_ticks"], len(version["file_sha256"])) == ("a first one", 0, 64)
    assert version["date"].startswith("20")
    assert {"version", "python"} <= version["software"].keys()


def test_a_cut_copy_ends_the_requested_time_after_braking_begins(folder, quick):
    kept = folder.add(quick.session, "cut", "small", CONTROLLERS, until_s=0.06)
    braking = int((read_session(folder.file(kept)).ticks["phase"] == Phase.BRAKING).sum())
    assert braking == 121
    assert [verdict.replay.differing for verdict in folder.test([], CONTROLLERS)] == [0, 0]


def test_a_changed_decision_is_found_and_named(folder):
    (verdict,) = folder.test([], CHANGED)
    assert verdict.replay.first.field == "torque_demand_nm"
    assert verdict.replay.differing > 100


def test_a_stored_tolerance_is_used(folder, quick):
    folder.add(quick.session, "loose", "any torque will do", CONTROLLERS, tolerances=["*=100"])
    exact, loose = folder.test(["quick", "loose"], CHANGED)
    assert exact.replay.differing > 0
    assert (loose.replay.differing, loose.problem) == (0, "")


def test_an_update_takes_the_new_decisions_and_keeps_the_history(folder, quick):
    updated = folder.update("quick", "the law is stronger now", CHANGED)
    assert [version.reason for version in updated.history] == ["a first one", "the law is stronger now"]
    assert updated.history[1].changed_ticks > 100
    again = GoldenFolder(folder.path)
    assert again.test([], CHANGED)[0].replay.differing == 0
    assert again.test([], CONTROLLERS)[0].replay.differing > 0
    copy = read_session(folder.path / "quick.mcap")
    for name in ("time_ns", "wheel_count", "road_count", "late_us"):
        assert copy.ticks[name].tolist() == quick.session.ticks[name].tolist()


def test_an_update_that_changes_nothing_is_refused(folder):
    before = contents(folder)
    with pytest.raises(ConfigError, match="nothing to update"):
        folder.update("quick", "no reason", CONTROLLERS)
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("name", "reason", "tolerances", "words"),
    [
        ("quick", "again", (), "exists already, and is never overwritten"),
        ("other", "  ", (), "--reason: is empty"),
        ("a b", "why not", (), "must be up to 64 letters"),
        ("../x", "why not", (), "must be up to 64 letters"),
        ("other", "why not", ("brke=1",), "did you mean brake"),
    ],
)
def test_what_cannot_be_added_is_reported_and_changes_nothing(folder, quick, name, reason, tolerances, words):
    before = contents(folder)
    with pytest.raises(ConfigError, match=words):
        folder.add(quick.session, name, reason, CONTROLLERS, tolerances)
    assert contents(folder) == before


def test_a_folder_that_cannot_be_made_is_named(tmp_path, quick):
    (tmp_path / "file").write_text("no folder")
    place = GoldenFolder(tmp_path / "place")
    place.path.symlink_to("file/below")
    with pytest.raises(ConfigError, match="place cannot be made: "):
        place.add(quick.session, "quick", "why not", CONTROLLERS)


def test_a_file_outside_the_table_is_not_overwritten(folder, quick):
    (folder.path / "stray.mcap").write_bytes(b"mine")
    with pytest.raises(ConfigError, match="never overwritten"):
        folder.add(quick.session, "stray", "why not", CONTROLLERS)
    assert (folder.path / "stray.mcap").read_bytes() == b"mine"


def test_a_session_that_proves_nothing_is_refused(folder, quick, run):
    before = contents(folder)
    with pytest.raises(SessionError, match="21 ticks of braking: must be at least 100"):
        folder.add(quick.session, "short", "too short", CONTROLLERS, until_s=0.01)
    steady = run("controller.name=steps").session
    with pytest.raises(SessionError, match="the brake hardly ever changes"):
        folder.add(steady, "steady", "no decisions", CONTROLLERS)
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"incomplete": "the file ends early"}, "would prove nothing: the file ends early"),
        ({}, "would prove nothing: 0 ticks of braking"),
        ({"unsupported": "tyre_c is left out"}, "cannot be replayed: tyre_c is left out"),
    ],
)
def test_a_session_without_ticks_or_with_what_is_not_known_is_refused(folder, quick, change, words):
    before = contents(folder)
    session = replace(quick.session, **change)
    if not session.unsupported:
        session = session.with_rows(session.ticks[:0])
    with pytest.raises(SessionError, match=words):
        folder.add(session, "other", "why not", CONTROLLERS)
    assert contents(folder) == before


def test_a_session_that_does_not_replay_is_refused(folder, quick):
    with pytest.raises(SessionError, match=r"does not replay: \d+ ticks differ, first at tick \d+: torque_demand_nm"):
        folder.add(quick.session, "other", "why not", CHANGED)


def test_a_golden_session_that_differs_from_the_table_is_refused(folder, tiny):
    (folder.path / "quick.mcap").write_bytes(tiny.path.read_bytes())
    (verdict,) = folder.test([], CONTROLLERS)
    assert verdict.replay is None
    assert "is not the file that golden.toml knows" in verdict.problem


def test_a_missing_golden_session_is_refused(folder):
    (folder.path / "quick.mcap").unlink()
    (verdict,) = folder.test([], CONTROLLERS)
    assert "cannot be read" in verdict.problem


@pytest.mark.parametrize(
    "text",
    ["not = = toml", "x = 1", "golden = 3", "[golden.quick]", "[golden.quick]\nticks=1\ntolerances=[]\nhistory=[]"],
)
def test_an_invalid_table_is_reported(tmp_path, text):
    (tmp_path / TABLE_NAME).write_text(text)
    with pytest.raises(SessionError, match="is not a table of golden sessions"):
        GoldenFolder(tmp_path)


def test_an_unknown_name_and_an_empty_folder_are_reported(folder, tmp_path):
    with pytest.raises(ConfigError, match=r"no 'quik' in .*; did you mean quick"):
        folder.test(["quik"], CONTROLLERS)
    with pytest.raises(ConfigError, match="has no golden sessions; add one"):
        GoldenFolder(tmp_path / "none").test([], CONTROLLERS)


def test_a_table_of_another_hand_is_read(folder):
    path = folder.path / TABLE_NAME
    path.write_text(tomli_w.dumps(tomllib.loads(path.read_text())))
    assert [golden.name for golden in GoldenFolder(folder.path)] == ["quick"]
