"""Sessions of other versions of the format: more columns, fewer, renamed, renumbered; newer files and older ones."""

import hashlib
from dataclasses import replace
from enum import IntEnum

import numpy as np
import pytest
from mcap.writer import Writer

from inteco_abs.errors import SessionError
from inteco_abs.format.schema import DOUBLE, FIXED32, FLOAT, Column, Message, MessageKind
from inteco_abs.sessions import TICK, TRUTH, migration, read_session, recover_session, validate
from inteco_abs.sessions.file_writer import FORMAT_VERSION
from inteco_abs.sessions.migration import Migration, NewColumn, not_measured
from inteco_abs.signals import Phase, Reason

NOW, NEXT = str(migration.newest()), str(migration.newest() + 1)
NO_REASON = max(Reason) + 1
"""A number that no reason has yet."""
TYRE = Column("tyre_c", DOUBLE, "Cel", "temperature of the tyre")


def table(of=TICK, *, without=(), kinds=None, also=(), numbers=None):
    """The table of ticks or truths as another version may have it."""
    kinds = kinds or {}
    columns = [replace(column, kind=kinds.get(column.name, column.kind)) for column in of.columns]
    columns = [column for column in columns if column.name not in without]
    name = of.name.rpartition(".")[2]
    return Message(name, of.topic, [*columns, *also], numbers or range(1, 100))


def enum(name, members):
    return MessageKind(14, 0, "B", "u1", IntEnum(name, members))


def write(path, run, version=NEXT, tick=TICK, truth=TRUTH, **values):
    """The session of `run` with other tables; `values` by column, where they are not those of the run."""
    session = run.session
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(library="inteco-abs/9.9 mcap-python/1.6")
        facts = {**session.metadata, "session": {**session.metadata["session"], "format_version": version}}
        for name in [name for name in facts if name != "integrity"]:
            writer.add_metadata(f"inteco_abs.{name}", facts[name])
        for name, data in session.attachments.items():
            writer.add_attachment(0, 0, name, "application/toml", data)
        digest = hashlib.sha256()
        for message, rows in ((tick, session.ticks), (truth, session.truth)):
            schema = writer.register_schema(message.name, "protobuf", message.descriptor())
            channel = writer.register_channel(message.topic, "protobuf", schema)
            for number, row in enumerate(rows):
                values_now = {name: row[name].item() for name in rows.dtype.names} | values
                data = message.pack([values_now[column.name] for column in message.columns])
                stamp = session.epoch_ns + int(row["time_ns"])
                writer.add_message(channel, stamp, data, stamp, number)
                if message is tick:
                    digest.update(data)
        writer.add_metadata("inteco_abs.integrity", {"payload_sha256": digest.hexdigest()})
        writer.finish()
    return path


@pytest.fixture
def later(tmp_path, tiny):
    """Writes the tiny session as another version of this program would have."""

    def make(version=NEXT, name="later.mcap", **tables):
        return write(tmp_path / name, tiny, version, **tables)

    return make


@pytest.fixture
def steps(monkeypatch):
    """Gives this program the steps of later versions."""
    return lambda *steps: monkeypatch.setattr(migration, "STEPS", steps)


def same_bits(array, other, names=None):
    return all(array[name].tobytes() == other[name].tobytes() for name in names or other.dtype.names)


def test_the_version_that_is_written_is_the_newest_that_is_known():
    assert str(migration.newest()) == FORMAT_VERSION


def test_a_newer_session_is_read_as_far_as_it_is_known(later, tiny):
    session = read_session(later(tick=table(also=[TYRE]), tyre_c=20.0))
    assert same_bits(session.ticks, tiny.session.ticks)
    assert session.truth.tobytes() == tiny.session.truth.tobytes()
    assert session.payload == tiny.session.payload
    assert session.unsupported == (
        f"its format {NEXT} is newer than {NOW}, the newest known here; /abs/tick.tyre_c is left out; "
        "inteco-abs/9.9 mcap-python/1.6 wrote it"
    )


def test_a_session_of_this_version_holds_nothing_beyond_it(tiny):
    assert tiny.session.unsupported == ""


def test_verbs_that_only_look_work_on_a_newer_session(later, verb, tmp_path):
    path = later(tick=table(also=[TYRE]), tyre_c=20.0)
    info = verb("info", path, "--json")
    assert (info.code, info.json["ticks"]) == (3, 242)
    assert "tyre_c is left out" in info.json["beyond"]
    assert "tyre_c is left out" in info.err
    listed = verb("list", tmp_path, "--json")
    (row,) = listed.json["sessions"]
    assert (listed.code, row["ticks"], row["outcome"]) == (3, 242, "completed")
    assert row["problem"].startswith(f"its format {NEXT} is newer than {NOW}")
    exported = verb("export", path, "--format", "csv", "--json")
    assert (exported.code, exported.json["files"][0]["rows"]) == (3, 242)
    assert "tyre_c" not in path.with_suffix(".csv").read_text().splitlines()[0]
    assert "tyre_c is left out" in exported.err


@pytest.mark.parametrize(
    "arguments",
    [
        ("figure", "--out", "stop.svg"),
        pytest.param(("report", "--out", "stop.html"), marks=pytest.mark.long),
        ("extract",),
    ],
)
def test_a_verb_that_shows_a_newer_session_ends_with_3(later, verb, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    name, *options = arguments
    assert verb(name, later(), *options).code == 3


def test_a_newer_session_is_valid_as_far_as_it_is_known(later):
    inspection = validate(later(tick=table(also=[TYRE]), tyre_c=20.0))
    (finding,) = [found for found in inspection.findings if found.place == "schema"]
    assert (inspection.verdict, finding.severity) == ("losses", "loss")
    assert finding.problem.startswith(f"not all of it could be checked: its format {NEXT} is newer")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("replay", "FILE"), f"cannot be replayed: its format {NEXT} is newer"),
        (
            ("what-if", "FILE", "--set", "controller.gains.Mk=3"),
            f"cannot be replayed: its format {NEXT} is newer",
        ),
        (("recover", "FILE", "-o", "out.mcap"), f"cannot be recovered here without losses: its format {NEXT} is newer"),
    ],
    ids=["replay", "what-if", "recover"],
)
def test_verbs_that_run_a_session_again_refuse_a_newer_one(later, verb, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    path = later()
    refusal = verb(*(path if word == "FILE" else word for word in arguments))
    assert refusal.code == 1
    assert words in refusal.err
    assert "inteco-abs/9.9 mcap-python/1.6 wrote it" in refusal.err
    assert not (tmp_path / "out.mcap").exists()


def test_numbers_and_order_of_columns_may_be_others(later, tiny, replayed):
    other = Message("Tick", TICK.topic, TICK.columns[::-1], range(2, 100, 3))
    session = read_session(later("1", tick=other))
    assert session.payload == tiny.session.payload
    assert session.unsupported == ""
    assert replayed(session).differing == 0


def test_a_missing_column_of_floating_point_is_nan_and_reported(later, tiny):
    session = read_session(later("1", truth=table(TRUTH, without={"brake_torque_nm"})))
    assert np.isnan(session.truth["brake_torque_nm"]).all()
    assert same_bits(session.truth, tiny.session.truth, ("time_ns", "slip", "brake"))
    assert session.unsupported.startswith("/sim/truth.brake_torque_nm is missing")


@pytest.mark.parametrize("name", ["wheel_count", "phase", "estimate_valid", "time_ns"])
def test_a_missing_column_that_has_no_stand_in_is_refused(later, name):
    with pytest.raises(SessionError, match=f"cannot be read: /abs/tick has another layout .*: it has no {name}"):
        read_session(later(tick=table(without={name})))


def test_a_narrower_column_is_widened(later, tiny):
    session = read_session(later("1", tick=table(kinds={"slip": FLOAT, "tick": FIXED32})))
    assert session.ticks["slip"].tolist() == tiny.session.ticks["slip"].astype(np.float32).tolist()
    assert session.unsupported == ""


def test_a_wider_column_is_another_one(later):
    session = read_session(later("1", tick=table(kinds={"late_us": DOUBLE})))
    assert session.unsupported.startswith("/abs/tick.late_us is missing")


def test_members_of_enumerations_go_by_name(later, tiny):
    other = enum("Phase", {member.name: 20 + member for member in Phase})
    ticks = tiny.session.ticks
    run = replace_ticks(tiny, phase=ticks["phase"] + 20)
    session = read_session(write(later("1"), run, "1", tick=table(kinds={"phase": other})))
    assert session.ticks["phase"].tolist() == ticks["phase"].tolist()
    assert session.unsupported == ""


def replace_ticks(run, **columns):
    """A run whose session has other values in some columns."""
    ticks = run.session.ticks.copy()
    for name, values in columns.items():
        ticks[name] = values

    class Altered:
        session = run.session.with_rows(ticks)

    return Altered


def test_members_that_are_not_known_are_reported_and_stand_for_no_known_one(later):
    phases = enum("Phase", {**{member.name: int(member) for member in Phase}, "PARKED": 8})
    reasons = enum("Reason", {**{member.name: int(member) for member in Reason}, "TYRE_LOST": NO_REASON})
    path = later("1", tick=table(kinds={"phase": phases, "reason": reasons}), phase=8, reason=NO_REASON)
    session = read_session(path)
    assert set(session.ticks["phase"].tolist()) == {Phase.UNKNOWN}
    assert set(session.ticks["reason"].tolist()).isdisjoint(set(Reason))
    assert "/abs/tick.phase PARKED is not known; /abs/tick.reason TYRE_LOST is not known" in session.unsupported


@pytest.mark.parametrize(("name", "value"), [("phase", 8), ("reason", NO_REASON), ("stop_request", 127)])
@pytest.mark.parametrize("also", [(), (TYRE,)], ids=["this version", "another"])
def test_a_number_that_the_file_itself_does_not_declare_is_damage(later, also, name, value):
    path = later("1", tick=table(also=also), tyre_c=20.0, **{name: value})
    with pytest.raises(SessionError, match=r"is damaged: chunk at byte .* or has an unknown value"):
        read_session(path)


def test_a_step_supplies_a_column_that_older_sessions_have_not(later, steps, tiny, replayed):
    steps(Migration(2, columns=(NewColumn(TRUTH.topic, "brake_torque_nm", not_measured),)))
    session = read_session(later("1", truth=table(TRUTH, without={"brake_torque_nm"})))
    assert np.isnan(session.truth["brake_torque_nm"]).all()
    assert session.unsupported == ""
    assert replayed(session).differing == 0
    assert session.payload == tiny.session.payload


def test_a_migration_computes_a_column_from_others(later, steps, tiny):
    brake_percent = Column("brake_percent", DOUBLE, "%", "brake duty")
    steps(
        Migration(
            2, columns=(NewColumn(TICK.topic, "brake_part", lambda _rows, percent: percent / 64.0, ("brake_percent",)),)
        ),
        Migration(3, columns=(NewColumn(TICK.topic, "brake", lambda _rows, part: part, ("brake_part",)),)),
    )
    old = table(without={"brake"}, also=[brake_percent])
    run = tiny.session.ticks["brake"].max()
    session = read_session(later("1", tick=old, brake_percent=64.0 * run))
    assert set(session.ticks["brake"].tolist()) == {run}
    assert session.unsupported == ""


def test_a_column_that_a_step_has_dropped_is_not_missed(later, steps):
    steps(Migration(2, dropped=((TICK.topic, "tyre_c"),)))
    assert read_session(later("1", tick=table(also=[TYRE]), tyre_c=20.0)).unsupported == ""


def test_steps_bring_metadata_up_to_date_in_order_and_only_those_that_are_due(later, steps, tmp_path, verb):
    def renamed(to):
        return lambda metadata: {**metadata, "trail": {"steps": metadata.get("trail", {}).get("steps", "") + to}}

    paths = [later(version, f"{version}.mcap") for version in "124"]
    steps(*(Migration(to, metadata=renamed(str(to))) for to in (2, 3, 4)))
    trails = [read_session(path).metadata.get("trail") for path in paths]
    assert trails == [{"steps": "234"}, {"steps": "34"}, None]
    assert [row["problem"] for row in verb("list", tmp_path, "--json").json["sessions"]] == [None] * 3


def test_an_older_session_is_recovered_as_one_of_this_version(later, steps, tmp_path, tiny):
    steps(Migration(2, columns=(NewColumn(TICK.topic, "c3", not_measured),)))
    path = later("0", tick=table(without={"c3"}))
    recovery = recover_session(path, tmp_path / "out.mcap")
    session = read_session(tmp_path / "out.mcap")
    assert recovery.losses == ()
    assert session.metadata["session"]["format_version"] == FORMAT_VERSION
    assert same_bits(session.ticks, tiny.session.ticks, set(TICK.dtype.names) - {"c3"})
    assert np.isnan(session.ticks["c3"]).all()


def test_a_topic_that_is_declared_twice_is_damage(later, tiny, container, altered):
    other = container.split(later(tick=table(also=[TYRE]), tyre_c=20.0).read_bytes())
    records = container.split(tiny.path.read_bytes())
    chunks = [record for record in other if record.opcode == 6][:1]
    at = next(i for i, record in enumerate(records) if record.opcode == 15)
    raw = b"".join(
        bytes(container.record(entry.opcode, b"\x09\x00" + entry.content[2:]))
        if entry.opcode == 3
        else bytes(container.record(4, b"\x09\x00\x09\x00" + entry.content[4:]))
        for entry in container.split(container.unpack(chunks[0]), 0)[:2]
    )
    with pytest.raises(SessionError, match="/abs/tick is declared twice"):
        read_session(altered(container.join([*records[:at], container.chunk(raw, len(raw), ""), *records[at:]])))
