"""What a run was for: kept by the session, changed afterwards without a tick, with its history."""

import json

import pytest
from mcap.reader import make_reader

from inteco_abs.config import load_config
from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.sessions import annotate, open_session, read_session, validate

WORDS = {
    "purpose": "figure 3", "note": 'rain on "the" roof', "tags": '["wet", "new pads"]', "operator": "J. Carberry",
    "orcid": "0000-0002-1825-0097", "institution": "Brown", "licence": "CC-BY-4.0",
}  # fmt: skip
NOW = "2026-11-23T12:00:00.000+00:00"


@pytest.fixture
def described(run):
    settings = (f"description.{key}={text if key == 'tags' else json.dumps(text)}" for key, text in WORDS.items())
    return run(*settings)


def test_a_session_says_what_it_was_for(described):
    assert described.session.metadata["description"] == WORDS


def test_a_run_without_description_has_none(quick):
    assert "description" not in quick.session.metadata
    assert "description" not in quick.session.attachments["config.toml"].decode().replace("[description]", "")


@pytest.mark.parametrize("orcid", ["0000-0002-1825-0098", "0000000218250097", "https://orcid.org/0000-0002-1825-0097"])
def test_an_orcid_has_its_check_digit(orcid):
    with pytest.raises(ConfigError, match="no ORCID iD"):
        load_config(settings=[f"description.orcid={orcid!r}"])


def test_the_check_digit_may_be_ten():
    assert load_config(settings=["description.orcid='0000-0002-1694-233X'"]).description.orcid


def test_an_annotation_changes_no_tick_and_keeps_the_history(described, replayed):
    before, data = described.session, described.path.read_bytes()
    annotate(described.path, {"note": "dry after all", "licence": ""}, "K.", NOW)
    annotate(described.path, {"purpose": "figure 4"}, "", NOW.replace("12:", "13:"))
    after = read_session(described.path)
    assert after.payload == before.payload
    assert after.metadata["description"] == {**WORDS, "note": "dry after all", "licence": "", "purpose": "figure 4"}
    history = {when: json.loads(text) for when, text in after.metadata["annotations"].items()}
    assert history[NOW] == {"by": "K.", "before": {"note": WORDS["note"], "licence": "CC-BY-4.0"}}
    assert validate(described.path).verdict == "well"
    assert open_session(described.path).metadata == after.metadata
    assert replayed(after).differing == 0
    assert after.path.read_bytes().startswith(data[: data.index(b"inteco_abs.integrity")])
    with described.path.open("rb") as file:
        names = [each.name for each in make_reader(file, validate_crcs=True).iter_metadata()]
    assert names.count("inteco_abs.annotations") == 2


def test_a_cut_session_is_not_annotated_and_stays(described, altered):
    path = altered(described.path.read_bytes()[:-100])
    data = path.read_bytes()
    with pytest.raises(SessionError, match="recover"):
        annotate(path, {"note": "x"}, "", NOW)
    assert path.read_bytes() == data
    assert [each.name for each in path.parent.iterdir() if each.name.startswith(path.name)] == [path.name]


def test_the_verb_adds_and_takes_away(described, verb):
    done = verb("annotate", described.path, "--tag", "dry", "--untag", "wet", "--operator", "", "--by", "K.", "--json")
    assert done.json["description"]["tags"] == '["new pads", "dry"]'
    assert "operator" not in done.json["description"]
    assert len(done.json["history"]) == 1
    shown = verb("info", described.path).out
    assert "new pads" in shown
    assert "Brown" in shown
    data = described.path.read_bytes()
    assert verb("annotate", described.path).out.startswith("purpose: figure 3")
    assert verb("annotate", described.path, "--purpose", "figure 3", "--operator", "").code == 0
    assert described.path.read_bytes() == data  # nothing new, nothing written


@pytest.mark.parametrize(
    ("words", "said"),
    [(["--untag", "x"], "wet, new pads"), (["--orcid", "7"], "ORCID"), (["--tag", "x" * 65], "tags")],
)
def test_what_it_cannot_take_is_named_and_nothing_changes(described, verb, words, said):
    data = described.path.read_bytes()
    done = verb("annotate", described.path, *words)
    assert (done.code, done.out) == (2, "")
    assert said in done.err
    assert described.path.read_bytes() == data


def test_the_options_of_run_fill_it_in(verb, tmp_path):
    out = tmp_path / "stop.mcap"
    words = ["--note", "a = 1", "--tag", "one", "--tag", "two", "--purpose", "p", "--operator", "o"]
    fast = ["--set", "experiment.start_speed_rad_s=10.0", "--virtual", "--quiet"]
    assert verb("run", "-o", out, *words, *fast).code == 0
    found = read_session(out).metadata["description"]
    assert found == {"note": "a = 1", "tags": '["one", "two"]', "purpose": "p", "operator": "o"}
