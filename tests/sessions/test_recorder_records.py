import hashlib
import io
import json
import re
import sys
import zipfile
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from uuid import UUID

import pytest
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

import inteco_abs
from inteco_abs import control
from inteco_abs.config import parse_config
from inteco_abs.control import gains_in_force
from inteco_abs.sessions import TICK, FileWriter, read_session
from inteco_abs.sessions.file_writer import FORMAT_VERSION

BEFORE = {"inteco_abs.session", "inteco_abs.software", "inteco_abs.host", "inteco_abs.rig", "inteco_abs.controller"}
AFTER = {"inteco_abs.session", "inteco_abs.timing", "inteco_abs.result", "inteco_abs.integrity"}
FILES = {"law.zip", "rig.json", "config.toml", "profile.toml", "requirements.txt"}
CHANGES = {"git.diff"}
"""Attachment of a source tree with changes."""


def records_of(path):
    """All records in the order of the file, chunks opened."""
    with path.open("rb") as file:
        return list(StreamReader(file, validate_crcs=True).records)


def ticks_of(records):
    """Places of the tick messages among `records`."""
    topics = {record.id: record.topic for record in records if isinstance(record, Channel)}
    return [
        at
        for at, record in enumerate(records)
        if isinstance(record, Message) and topics[record.channel_id] == TICK.topic
    ]


@pytest.fixture(scope="module")
def metadata(quick):
    return quick.session.metadata


def test_session_record(metadata, quick):
    facts = metadata["session"]
    assert facts["format_version"] == FORMAT_VERSION
    assert str(UUID(facts["session_id"])) == facts["session_id"]
    assert (facts["outcome"], facts["reason"]) == ("completed", "no fault")
    assert facts["ticks"] == str(len(quick.session.ticks))
    assert (facts["overruns"], facts["lost_ticks"]) == ("0", "0")
    started, ended = (datetime.fromisoformat(facts[key]) for key in ("started_utc", "ended_utc"))
    assert started.utcoffset() == ended.utcoffset()
    assert not started.utcoffset()


def test_software_record(metadata):
    facts = metadata["software"]
    assert facts["version"] == inteco_abs.__version__
    assert facts["python"] == ".".join(map(str, sys.version_info[:3]))
    assert facts["seed"] == "1"
    assert facts["package.numpy"] == version("numpy")
    assert {"libc", "argv", "package.mcap", "package.pydantic"} <= facts.keys()


def test_host_record(metadata):
    assert {"hostname", "os", "kernel", "machine", "cores"} <= metadata["host"].keys()
    assert int(metadata["host"]["cores"]) > 0


def test_rig_record(metadata):
    facts = metadata["rig"]
    expected = {
        "board": "sim:",
        "logic_version": "0x0103",
        "application_name": "ABSSIM",
        "profile": "sim_usb2",
        "counts_per_turn": "2048",
        "parameters": "mask",
        "simulated": "true",
        "virtual_time": "true",
    }
    assert {key: facts[key] for key in expected} == expected
    assert (float(facts["r1_m"]), float(facts["r2_m"])) == (0.0995, 0.099)


@pytest.mark.parametrize(
    "settings",
    [
        ("controller.gains.Mk=0.1", "controller.reference_slip=0.3", "loop.rate_hz=1000.0"),
        ("controller.name=relay", "estimator.name=euler", "controller.gains.on_duty=0.7"),
    ],
    ids=["reaching-law", "relay"],
)
def test_controller_record_has_every_gain_in_decimal_and_in_hex(run, settings):
    made = run(*settings)
    facts, gains = made.session.metadata["controller"], gains_in_force(made.config)
    assert facts["name"] == made.config.controller.name
    assert facts["estimator"] == made.config.estimator.name
    assert facts["reference_slip"] == repr(made.config.controller.reference_slip)
    assert float(facts["sample_time_s"]) == 1.0 / made.config.loop.rate_hz
    named = {key.removeprefix("gain.") for key in facts if key.startswith("gain.")}
    assert named == {*gains, *(f"{name}.hex" for name in gains)}
    for name, value in gains.items():
        assert facts[f"gain.{name}"] == repr(value)
        assert facts[f"gain.{name}.hex"] == value.hex()


def test_timing_record(metadata, quick):
    late = quick.stop.card["lateness_us"]
    assert metadata["timing"] == {f"late_us.{key}": repr(value) for key, value in late.items()}
    assert set(late) == {"p50", "p99", "p999", "max"}


def test_integrity_record_is_the_hash_of_the_payloads_and_of_each_attachment(metadata, quick):
    expected = hashlib.sha256(quick.session.payload).hexdigest()
    files = {f"sha256.{name}": hashlib.sha256(data).hexdigest() for name, data in quick.session.attachments.items()}
    assert metadata["integrity"] == {"payload_sha256": expected, **files}
    assert quick.stop.card["payload_sha256"] == expected


def test_result_record_is_the_card(metadata, quick):
    assert json.loads(metadata["result"]["card"]) == quick.stop.card


def test_official_reader_finds_the_same_metadata(metadata, quick, officially):
    merged = {}
    for record in officially(quick.path).metadata:
        merged.setdefault(record.name.removeprefix("inteco_abs."), {}).update(record.metadata)
    assert merged == metadata


def test_configuration_is_attached_whole(quick, officially):
    found = {attachment.name: attachment for attachment in officially(quick.path).attachments}
    attachment = found["config.toml"]
    assert attachment.media_type == "application/toml"
    assert attachment.data == quick.config.to_toml().encode()
    assert parse_config(attachment.data.decode()) == quick.config
    assert quick.session.attachments == {name: each.data for name, each in found.items()}


def test_source_of_a_users_controller_is_attached(run):
    source = b"class Mine: ...\n"
    session = run(controller_source=source).session
    assert session.attachments["controller.py"] == source
    assert session.metadata["controller"]["source_sha256"] == hashlib.sha256(source).hexdigest()


@pytest.mark.parametrize(
    ("controller", "estimator", "decisive"),
    [("pi", "kalman", {"linear", "kalman"}), ("predictive-reaching", "observer", {"predictive", "observer"})],
)
def test_modules_of_a_shipped_law_and_all_that_they_use_are_attached(run, tmp_path, controller, estimator, decisive):
    session = run(f"controller.name='{controller}'", f"estimator.name='{estimator}'").session
    archive = zipfile.ZipFile(io.BytesIO(session.attachments["law.zip"]))
    archive.extractall(tmp_path)
    package = Path(control.__file__).parent
    files = {file.relative_to(tmp_path / "inteco_abs/control"): file for file in tmp_path.rglob("*.py")}
    assert {name.stem for name in files} >= {*decisive, "slip_dynamics"}
    for name, file in files.items():
        assert file.read_bytes() == (package / name).read_bytes()
        used = re.findall(r"^from inteco_abs\.control\.([\w.]+) import", file.read_text(), re.MULTILINE)
        assert {Path(*each.split(".")).with_suffix(".py") for each in used} <= {*files}


@pytest.mark.untraced
def test_what_explains_the_run_comes_before_the_first_tick(chunked):
    records = records_of(chunked.path)
    before = records[: ticks_of(records)[0]]
    assert {record.name for record in before if isinstance(record, Metadata)} == BEFORE
    assert {record.topic for record in before if isinstance(record, Channel)} >= {
        "/abs/tick",
        "/abs/event",
        "/abs/params",
    }
    schemas = {record.id for record in before if isinstance(record, Schema)}
    assert schemas >= {record.schema_id for record in before if isinstance(record, Channel)}
    assert {record.name for record in before if isinstance(record, Attachment)} - CHANGES == FILES


def test_outcome_timing_and_integrity_come_after_the_last_tick(chunked):
    records = records_of(chunked.path)
    after = records[ticks_of(records)[-1] :]
    assert {record.name for record in after if isinstance(record, Metadata)} == AFTER


def test_what_was_logged_first_is_on_the_disk_before_the_first_tick(tmp_path):
    path = tmp_path / "stop.mcap"
    with FileWriter(path, 0) as recorder:
        recorder.describe("rig", {"board": "sim:"})
        recorder.attach("config.toml", "application/toml", b"profile = 'sim_usb2'\n")
        recorder.begin({"Mk": 2.0})
        session = read_session(path)  # as if the power failed now
    assert session.incomplete
    assert not len(session.ticks)
    assert session.metadata["rig"] == {"board": "sim:"}
    assert session.metadata["session"]["session_id"] == recorder.session_id
    assert session.attachments == {"config.toml": b"profile = 'sim_usb2'\n"}


def test_a_later_fact_of_one_name_replaces_and_the_others_stay(tmp_path, quick):
    path = tmp_path / "stop.mcap"
    with FileWriter(path, 0) as recorder:
        recorder.describe("rig", {"board": "a", "serial": "7"})
        recorder.begin({})
        recorder.describe("rig", {"board": "b"})
        recorder.finish("completed", "no fault", quick.stop.card)
    assert read_session(path).metadata["rig"] == {"board": "b", "serial": "7"}


def test_ticks_in_portions_make_the_same_payload(tmp_path, quick):
    payload, path = quick.session.payload, tmp_path / "stop.mcap"
    with FileWriter(path, 0) as recorder:
        recorder.begin({})
        for first in range(0, len(payload), 7 * TICK.size):
            recorder.ticks(payload[first : first + 7 * TICK.size])
        recorder.ticks(b"")
        recorder.finish("completed", "no fault", quick.stop.card)
    session = read_session(path)
    assert not session.incomplete
    assert session.payload == payload
    assert session.events == 6
    assert recorder.payload_sha256 == hashlib.sha256(payload).hexdigest()


def test_a_session_may_have_no_ticks_and_no_truth(tmp_path, quick):
    path = tmp_path / "stop.mcap"
    with FileWriter(path, 0) as recorder:
        recorder.begin({})
        recorder.finish("fault", "nothing ran", quick.stop.card)
    session = read_session(path)
    assert (session.incomplete, len(session.ticks), len(session.truth), session.events) == ("", 0, 0, 0)


def test_discard_leaves_no_file(tmp_path):
    path = tmp_path / "stop.mcap"
    with FileWriter(path, 0) as recorder:
        recorder.begin({})
        recorder.discard()
    assert list(tmp_path.iterdir()) == []
