import json
import math
import struct
from datetime import datetime

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from inteco_abs.format.result_message import RESULT_NAME, pack_result, result_descriptor
from inteco_abs.sessions import TICK, TRUTH
from inteco_abs.signals import EXPLANATIONS, Phase, Reason

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

INFO, ERROR = 2, 4
TOPICS = {
    "/abs/tick": "inteco_abs.v1.Tick",
    "/abs/event": "foxglove.Log",
    "/abs/params": "inteco_abs.v1.Params",
    "/sim/truth": "inteco_abs.v1.Truth",
    "/abs/result": "inteco_abs.v1.Result",
}


@pytest.fixture(scope="module")
def seen(quick, officially):
    return officially(quick.path)


def exact(columns, values):
    return [struct.pack("<" + column.kind.code, value) for column, value in zip(columns, values, strict=True)]


def decoded_rows(messages, columns):
    return [exact(columns, [getattr(decoded, column.name) for column in columns]) for *_, decoded in messages]


def our_rows(array, columns):
    return [exact(columns, row) for row in array.tolist()]


def log_of(messages):
    return [(decoded.level, decoded.message) for *_, decoded in messages]


def test_topics_with_their_schemas(seen):
    assert {channel.topic: schema.name for schema, channel, *_ in seen.messages} == TOPICS
    assert {(schema.encoding, channel.message_encoding) for schema, channel, *_ in seen.messages} == {
        ("protobuf", "protobuf")
    }


def test_schemas_are_descriptor_sets_of_their_message(seen):
    for schema, *_ in seen.messages:
        files = FileDescriptorSet.FromString(schema.data).file
        assert schema.name in {f"{file.package}.{message.name}" for file in files for message in file.message_type}


def test_counts(seen, quick):
    ticks = quick.stop.card["ticks"]
    counts = {topic: len(seen.of(topic)) for topic in TOPICS}
    assert counts == {"/abs/tick": ticks, "/sim/truth": ticks + 1, "/abs/params": 1, "/abs/event": 6, "/abs/result": 1}
    statistics = seen.summary.statistics
    by_topic = {seen.summary.channels[n].topic: count for n, count in statistics.channel_message_counts.items()}
    assert by_topic == counts
    assert statistics.message_count == sum(counts.values())


def test_every_field_of_every_tick_equals_our_readers(seen, quick):
    theirs = decoded_rows(seen.of("/abs/tick"), TICK.columns)
    assert theirs == our_rows(quick.session.ticks, TICK.columns)


def test_payload_is_the_messages_back_to_back(seen, quick):
    assert b"".join(message.data for _, _, message, _ in seen.of("/abs/tick")) == quick.session.payload


def test_every_field_of_every_truth_equals_our_readers(seen, quick):
    theirs = decoded_rows(seen.of("/sim/truth"), TRUTH.columns)
    assert theirs == our_rows(quick.session.truth, TRUTH.columns)


def test_each_tick_has_one_truth_of_its_instant_and_so_has_the_last_write(quick):
    session = quick.session
    assert session.truth["time_ns"][:-1].tolist() == session.ticks["time_ns"].tolist()
    assert (session.truth["drive"][-1], session.truth["brake"][-1]) == (0.0, 0.0)


@pytest.mark.parametrize("topic", ["/abs/tick", "/sim/truth"])
def test_log_time_is_the_instant_of_the_sample_on_the_wall_clock(seen, topic):
    offsets = {message.log_time - decoded.time_ns for _, _, message, decoded in seen.of(topic)}
    assert len(offsets) == 1
    assert offsets == {message.log_time for _, _, message, _ in seen.of("/abs/params")}  # virtual time starts at 0


def test_tick_zero_is_on_the_wall_clock_where_the_session_started(seen):
    facts = {key: value for record in seen.metadata for key, value in record.metadata.items()}
    started_ns = datetime.fromisoformat(facts["started_utc"]).timestamp() * 1e9
    ((_, _, message, _),) = seen.of("/abs/params")
    assert started_ns == pytest.approx(message.log_time, abs=60e9)  # the file is opened first, the board looked at


def test_sequence_is_the_tick(seen):
    sequences = [message.sequence for _, _, message, _ in seen.of("/abs/tick")]
    assert sequences == [decoded.tick for *_, decoded in seen.of("/abs/tick")] == list(range(len(sequences)))


def test_phases_are_logged_in_order(seen):
    phases = ("IDLE", "ARMED", "SPIN_UP", "BRAKING", "STOPPED", "DONE")
    assert log_of(seen.of("/abs/event")) == [(INFO, f"phase {phase}") for phase in phases]


def test_an_event_has_the_time_of_its_tick(seen):
    first = {}
    for _, _, message, decoded in seen.of("/abs/tick"):
        first.setdefault(f"phase {Phase(decoded.phase).name}", message.log_time)
    found_values = {decoded.message: message.log_time for _, _, message, decoded in seen.of("/abs/event")}
    assert found_values == first


def test_an_event_carries_its_time_and_its_source(seen):
    for _, _, message, decoded in seen.of("/abs/event"):
        assert decoded.timestamp.seconds * 10**9 + decoded.timestamp.nanos == message.log_time
        assert decoded.name == "inteco-abs"


def test_a_fault_is_logged_with_its_explanation(run, officially):
    faulted = run("experiment.braking_timeout_s=0.1")
    phases = ("IDLE", "ARMED", "SPIN_UP", "BRAKING", "FAULT")
    expected = [(INFO, f"phase {phase}") for phase in phases]
    expected.append((ERROR, f"BRAKING_TIMEOUT: {EXPLANATIONS[Reason.BRAKING_TIMEOUT]}"))
    assert log_of(officially(faulted.path).of("/abs/event")) == expected


@pytest.mark.parametrize(
    ("settings", "parameters"),
    [
        (("controller.gains.Mk=3.5",), {"reference_slip": 0.2, "Mk": 3.5, "Mq": 1.0, "lag_s": 0.0}),
        (
            ("controller.name=relay", "controller.gains.on_duty=0.6", "controller.reference_slip=0.3"),
            {"reference_slip": 0.3, "on_duty": 0.6, "off_duty": 0.0},
        ),
    ],
    ids=["reaching-law", "relay"],
)
def test_parameters_are_the_gains_in_force(run, officially, settings, parameters):
    ((_, _, _, decoded),) = officially(run(*settings).path).of("/abs/params")
    assert dict(decoded.values) == parameters
    assert decoded.tick == 0


@pytest.mark.parametrize("message", [TICK, TRUTH], ids=["tick", "truth"])
def test_units_and_descriptions_cover_every_column(seen, message):
    metadata = seen.of(message.topic)[0][1].metadata
    units, describe = json.loads(metadata["units"]), json.loads(metadata["describe"])
    names = [column.name for column in message.columns]
    assert list(describe) == names
    assert set(names) - set(units) == ({"c3"} if message is TICK else set())  # the law does not use it
    assert units.items() >= {(column.name, column.unit) for column in message.columns if column.unit}
    assert all(units.values())
    assert all(describe.values())


@pytest.mark.parametrize(("suffix", "unit"), [("_rad_s", "rad/s"), ("_ns", "ns"), ("_us", "us"), ("_nm", "N.m")])
def test_units_agree_with_the_names(seen, suffix, unit):
    units = [json.loads(seen.of(topic)[0][1].metadata["units"]) for topic in (TICK.topic, TRUTH.topic)]
    assert {value for table in units for name, value in table.items() if name.endswith(suffix)} == {unit}


def test_bits_of_the_board_flags_are_described(seen):
    describe = json.loads(seen.of("/abs/tick")[0][1].metadata["describe"])
    assert "1 STALE" in describe["board_flags"]


def test_internals_are_named(seen, run, officially):
    relay = officially(run("controller.name=relay").path)
    named = [json.loads(found.of("/abs/tick")[0][1].metadata["internals"]) for found in (seen, relay)]
    assert named == [["f_per_s", "g_per_s_nm", "torque_eq_nm"], []]
    units = json.loads(seen.of("/abs/tick")[0][1].metadata["units"])
    assert (units["c0"], units["c1"], units["c2"], units.get("c3")) == ("1/s", "1/(s.N.m)", "N.m", None)


def test_header_names_the_program_and_no_profile(seen):
    assert seen.header.profile == ""
    assert seen.header.library.startswith("inteco-abs/")


def test_the_result_is_the_card_in_a_message(seen, quick):
    ((_, _, message, found),) = seen.of("/abs/result")
    found_values = {field.name: getattr(found, field.name) for field in found.DESCRIPTOR.fields}
    card = quick.stop.card
    expected = {**card, **{f"lateness_us_{name}": value for name, value in card["lateness_us"].items()}}
    assert found_values.pop("rig") == ""  # there was none
    known = {name: value for name, value in found_values.items() if str(value) != "nan"}
    assert known == {name: expected[name] for name in known}
    assert [expected[name] for name in found_values.keys() - known.keys()] == [None] * (len(found_values) - len(known))
    assert found_values.keys() >= card.keys() - {"schema_version", "lateness_us", "rig"}
    assert message.log_time == seen.of("/abs/tick")[-1][2].log_time


def test_an_unknown_value_is_not_zero_in_the_result(message_class):
    card = {"outcome": "aborted", "stop_time_s": None, "ticks": 3, "lateness_us": {"p50": None, "max": 0.0}}
    found = message_class(result_descriptor(), RESULT_NAME).FromString(pack_result(card))
    assert math.isnan(found.stop_time_s)
    assert math.isnan(found.lateness_us_p50)
    assert (found.lateness_us_max, found.ticks, found.outcome) == (0.0, 3, "aborted")
