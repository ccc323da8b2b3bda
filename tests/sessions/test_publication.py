"""A published folder: valid by the formats' own checkers, read without this program, and without private names."""

import csv
import io
import json
import os
import re
import shutil
import subprocess
import sys
from datetime import date

import numpy as np
import pytest
from rocrate.rocrate import ROCrate

from inteco_abs.analysis import publish
from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.sessions import annotate, read_session, validate
from inteco_abs.signals import Phase

ADA = "Ada Lovelace <0000-0002-1825-0097>"
ON = date(2026, 3, 1)
VALID = """
import json, sys
from importlib.resources import files
from requests import Response
from rocrate_validator import models, services
from rocrate_validator.utils.http import HttpRequester

def context(*_arguments, **_named):
    answer = Response()
    answer.status_code = 200
    answer.headers["Content-Type"] = "application/ld+json"
    answer._content = (files("rocrate") / "data/ro-crate.jsonld").read_bytes()
    return answer

HttpRequester.get = context  # instead of asking the network for it
severity = models.Severity.RECOMMENDED
settings = services.ValidationSettings(
    rocrate_uri=sys.argv[1], profile_identifier="ro-crate-1.1", requirement_severity=severity
)
print(json.dumps([issue.message for issue in services.validate(settings).get_issues()]))
"""


@pytest.fixture
def folder(quick, tiny, tmp_path):
    sessions = tmp_path / "spring"
    sessions.mkdir()
    for run, name in ((quick, "dry"), (tiny, "wet")):
        shutil.copy(run.path, sessions / f"{name}.mcap")
    notes = {
        "operator": "Jan Řehoř",
        "institution": "Lab | 7",
        "licence": "CC-BY-4.0",
        "note": "new pads",
        "tags": '["a"]',
    }
    annotate(sessions / "dry.mcap", notes, "", "2026-03-01T00:00:00+00:00")
    return sessions


@pytest.fixture
def published(folder, tmp_path):
    files = sorted(folder.iterdir())
    publish(files, tmp_path / "out", title="Stops on two roads", on=ON)
    return tmp_path / "out"


def mean_slips(folder):
    """The numbers that the scripts print, from the sessions."""
    for path in sorted((folder / "sessions").iterdir()):
        ticks = read_session(path).ticks
        braking = ticks[ticks["phase"] == Phase.BRAKING]
        yield f"{path.stem}.csv", len(ticks), len(braking), f"{np.mean(braking['slip']):.6f}"


def printed(command, text):
    """The same numbers, as printed."""
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return re.findall(text, done.stdout)


def test_the_script_reads_it_with_pythons_standard_library_alone(published):
    found = printed(
        [sys.executable, "-I", "-S", published / "read_tables.py"],
        r"(\S+\.csv): (\d+) ticks, (\d+) of them braking.*\nmean slip (\S+)",
    )
    assert found == [(name, str(n), str(braking), slip) for name, n, braking, slip in mean_slips(published)]
    assert len((published / "read_tables.py").read_text().splitlines()) <= 20


@pytest.mark.long
def test_the_script_reads_it_with_octave(published):
    octave = shutil.which("octave-cli") or shutil.which("octave")
    if octave is None and "CI" not in os.environ:
        pytest.skip("octave is not installed")
    found = printed(
        [octave, "--no-gui", "-q", published / "read_tables.m"],
        r"(\S+\.csv): (\d+) ticks, (\d+) of them braking\nmean slip (\S+)",
    )
    assert found == [(name, str(n), str(braking), slip) for name, n, braking, slip in mean_slips(published)]
    assert len((published / "read_tables.m").read_text().splitlines()) <= 20


def test_checksums_cover_every_file(published):
    done = subprocess.run(["sha256sum", "-c", "--strict", "SHA256SUMS"], cwd=published, capture_output=True, check=True)
    files = {each.relative_to(published).as_posix() for each in published.rglob("*") if each.is_file()}
    assert {line.split(b":")[0].decode() for line in done.stdout.splitlines()} == files - {"SHA256SUMS"}


def test_the_crate_lists_every_file_with_people_and_licence(published):
    crate = ROCrate(published)
    listed = {each.id for each in crate.get_entities() if each.type == "File"}
    assert listed == {each.relative_to(published).as_posix() for each in published.rglob("*") if each.is_file()} - {
        "SHA256SUMS",
        "ro-crate-metadata.json",
    }
    assert crate.name == "Stops on two roads"
    (person,) = crate.get_by_type("Person")
    assert (person["name"], person["affiliation"]["name"]) == ("Jan Řehoř", "Lab | 7")
    assert crate.root_dataset["license"].id == "https://spdx.org/licenses/CC-BY-4.0"


def test_datacite_takes_its_metadata(published, folder, tmp_path):
    from datacite import schema45

    publish(
        sorted(folder.iterdir()), tmp_path / "two", authors=[ADA, "Plato"], publisher="Lab", licence="https://a.org/l"
    )
    for place in (published, tmp_path / "two"):
        schema45.validator.validate(json.loads((place / "datacite.json").read_text()))


def test_tables_are_as_their_metadata_say(published):
    from csvw import TableGroup

    for metadata in sorted((published / "tables").glob("*-metadata.json")):
        for table in TableGroup.from_file(metadata).tables:
            assert sum(1 for _ in table.iterdicts(strict=True)) > 0


@pytest.mark.long
def test_the_validators_of_crate_and_citation_ask_for_nothing_that_is_known(published, tmp_path):
    """They need other versions of packages that this program has, so they get an environment of their own."""
    python = tmp_path / "venv/bin/python"
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    subprocess.run([python, "-m", "pip", "install", "-q", "roc-validator", "rocrate", "cffconvert"], check=True)
    done = subprocess.run([python, "-c", VALID, published], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout.splitlines()[-1]) == ["The organization SHOULD have a URL."]  # not known here
    subprocess.run([python.with_name("cffconvert"), "--validate"], cwd=published, check=True)


def test_pages_show_people_sessions_and_columns(published):
    readme = (published / "README.md").read_text()
    assert readme.startswith("# Stops on two roads\n\nnew pads\n\nJan Řehoř. Lab | 7, 2026-03-01.\n")
    assert "| dry | " in readme
    schema = (published / "SCHEMA.md").read_text()
    assert "| wheel_speed_rad_s | float64 | rad/s | " in schema
    assert "Of dry, wet." in schema
    rows = list(csv.DictReader(io.StringIO((published / "sessions.csv").read_text())))
    assert [row["session"] for row in rows] == ["dry", "wet"]
    for row in rows:
        session = read_session(published / f"sessions/{row['session']}.mcap")
        assert row["payload_sha256"] == session.metadata["integrity"]["payload_sha256"]


class TestAnonymous:
    HOST, HOME = "turing-pc-3", "/home/ada lovelace/braking/q"

    @pytest.fixture
    def private(self, run, monkeypatch):
        """A session that names computer and folders wherever a session can."""
        monkeypatch.setattr("platform.node", lambda: self.HOST)
        monkeypatch.setattr("sys.argv", ["inteco-abs", "run", "--out", f"{self.HOME}/s.mcap"])
        return run(f"description.note='see {self.HOME}/notes.txt on {self.HOST}'", "description.operator='Ada'")

    def test_no_name_of_a_computer_or_folder_is_left_and_every_tick_is(self, private, tmp_path):
        publish([private.path], tmp_path / "out", licence="CC0-1.0", anonymous=True)
        copy = tmp_path / "out/sessions/stop.mcap"
        assert not validate(copy).findings
        found, session = read_session(copy), private.session
        texts = [str(found.metadata), str(found.log), *(str(data) for data in found.attachments.values())]
        texts += [each.read_text() for each in (tmp_path / "out").rglob("*") if each.suffix not in {".mcap", ""}]
        for text in texts:
            assert self.HOST not in text
            assert "lovelace" not in text
            assert str(tmp_path) not in text
        assert (tmp_path / "out/README.md").read_text().startswith("# out\n\nsee notes.txt on host\n")
        assert found.metadata["description"]["note"] == "see notes.txt on host"
        assert found.payload == session.payload
        assert found.metadata["integrity"]["payload_sha256"] == session.metadata["integrity"]["payload_sha256"]
        assert np.array_equal(found.truth, session.truth)
        assert (found.log, found.parameters) == (session.log, session.parameters)

    def test_a_controller_that_names_a_folder_is_refused(self, run, tmp_path):
        session = run(controller_source=b"import math\nTABLE = '/home/ada/table.csv'\n")
        with pytest.raises(SessionError, match=r"line 2 of controller.py .* names a folder"):
            publish([session.path], tmp_path / "out", authors=[ADA], licence="CC0-1.0", anonymous=True)
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"authors": ["<x>"]}, "Ada Lovelace"),
        ({"licence": "do as you like"}, "SPDX name"),
        ({"files": []}, "no session there"),
        ({"files": ["dry", "dry"]}, "has the name of"),
    ],
)
def test_what_cannot_be_published_leaves_nothing(folder, tmp_path, changes, problem):
    files = [folder / f"{name}.mcap" for name in changes.pop("files", ["dry", "wet"])]
    with pytest.raises(ConfigError, match=problem):
        publish(files, tmp_path / "out", **changes)
    assert sorted(each.name for each in tmp_path.iterdir() if each.name.startswith("out")) == []


def test_what_is_missing_is_asked_for(folder, cut_short, altered, tmp_path):
    with pytest.raises(ConfigError, match="--author"):
        publish([folder / "wet.mcap"], tmp_path / "out", licence="MIT")
    with pytest.raises(ConfigError, match="no session has one"):
        publish([folder / "wet.mcap"], tmp_path / "out", authors=[ADA])
    with pytest.raises(SessionError, match=r"inteco-abs recover"):
        publish([altered(cut_short)], tmp_path / "out", authors=[ADA], licence="MIT")
    with pytest.raises(ConfigError, match="exists already"):
        publish([folder / "wet.mcap"], folder, authors=[ADA], licence="MIT")


def test_the_verb_says_what_it_wrote(folder, verb, tmp_path):
    done = verb("publish", tmp_path / "out", folder, "--json")
    assert done.json["sessions"] == 2
    assert {*done.json["files"]} >= {"README.md", "CITATION.cff", "LICENSE.txt", "tables/dry.truth.csv"}
