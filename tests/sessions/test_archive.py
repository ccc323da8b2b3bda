"""Sessions of every version of the format, kept for ever, and what is in them."""

import hashlib
import json
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from inteco_abs import elementary
from inteco_abs.sessions import TICK, TRUTH, migration, read_session, validate

ARCHIVE = Path(__file__).with_name("archive")
RECORDED = tomllib.loads((ARCHIVE / "archive.toml").read_text())
VERSIONS = [f"v{version}" for version in range(migration.FIRST, migration.newest() + 1)]
LARGEST_BYTES = 60_000


def path_of(version):
    return ARCHIVE / f"{version}.mcap"


def total(values):
    """Exact sum of a column, rounded once; what is not a number is left out."""
    if values.dtype.kind == "f":
        return math.fsum(values[~np.isnan(values)].tolist()).hex()
    return sum(map(int, values.tolist()))


@pytest.fixture(params=VERSIONS)
def version(request):
    return request.param


@pytest.fixture
def kept(version):
    return read_session(path_of(version))


def test_every_version_has_its_session():
    assert sorted(path.stem for path in ARCHIVE.glob("*.mcap")) == sorted(RECORDED) == sorted(VERSIONS)


def test_a_file_is_the_one_that_was_kept(version):
    data = path_of(version).read_bytes()
    assert hashlib.sha256(data).hexdigest() == RECORDED[version]["file_sha256"]
    assert len(data) < LARGEST_BYTES


def test_every_column_that_it_had_has_the_values_that_it_had(version, kept):
    for name, rows in (("tick", kept.ticks), ("truth", kept.truth)):
        assert len(rows) == RECORDED[version]["rows"][name]
        assert {column: total(rows[column]) for column in RECORDED[version][name]} == RECORDED[version][name]


def test_nothing_is_missing_or_unknown(kept):
    assert (kept.incomplete, kept.unsupported) == ("", "")


def test_metadata_log_and_configuration_are_there(version, kept):
    recorded = RECORDED[version]
    assert kept.metadata["session"]["format_version"] == version.removeprefix("v")
    for name in ("session_id", "started_utc"):
        assert kept.metadata["session"][name] == recorded[name]
    assert kept.metadata["controller"]["name"] == "reaching-law"
    assert kept.metadata["integrity"]["payload_sha256"] == recorded["payload_sha256"]
    assert [event.text for event in kept.log] == recorded["events"]
    assert json.loads(kept.metadata["result"]["card"])["ticks"] == recorded["rows"]["tick"]


def test_it_is_valid(version):
    inspection = validate(path_of(version))
    assert (inspection.findings, inspection.verdict) == ([], "well")


def test_it_can_be_replayed(kept, replayed):
    """The golden sessions say whether the decisions are those of then; here it is the inputs that must be usable."""
    assert replayed(kept).ticks == len(kept.ticks)


def test_since_format_5_it_replays_bit_for_bit_on_every_machine(version, kept, replayed):
    portable = int(version.removeprefix("v")) >= 5
    assert (kept.metadata["software"]["arithmetic"] == elementary.PORTABLE) == portable
    assert not portable or replayed(kept).differing == 0


def test_the_newest_is_declared_as_this_version_declares_its_messages(officially):
    """Who changes a table adds a step and a session, or files of two kinds would say that they are of one version."""
    schemas = {schema.name: schema.data for schema, *_ in officially(path_of(VERSIONS[-1])).messages}
    assert {message.name: schemas[message.name] for message in (TICK, TRUTH)} == {
        message.name: message.descriptor() for message in (TICK, TRUTH)
    }
