"""Sessions are found by conditions, over an index that is never trusted over the files."""

import operator
import os
import sqlite3

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.analysis import session_rows
from inteco_abs.analysis.conditions import parse_condition
from inteco_abs.analysis.index import indexed
from inteco_abs.errors import ConfigError
from inteco_abs.sessions import annotate

SIGNS = {"=": operator.eq, "!=": operator.ne, "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
FACTS = {"Mk": 2.0, "ticks": 100, "outcome": "completed", "lag.s": -0.5, "note": "New pads; 'worn' disc", "none": None}
NUMBERS = st.tuples(st.sampled_from(["Mk", "ticks", "lag.s"]), st.sampled_from([*SIGNS]), st.integers(-3, 120))
TEXTS = st.tuples(
    st.sampled_from(["outcome", "note"]), st.sampled_from(["=", "!="]), st.sampled_from(["completed", ""])
)


def stated(name, sign, value):
    return f"{name} {sign} {value!r}", SIGNS[sign](FACTS[name], value)


CONDITIONS = st.recursive(
    st.one_of(NUMBERS, TEXTS).map(lambda parts: stated(*parts)),
    lambda inner: st.one_of(
        st.tuples(inner, inner).map(lambda two: (f"({two[0][0]} and {two[1][0]})", two[0][1] and two[1][1])),
        st.tuples(inner, inner).map(lambda two: (f"({two[0][0]} OR {two[1][0]})", two[0][1] or two[1][1])),
        inner.map(lambda one: (f"not ({one[0]})", not one[1])),
    ),
    max_leaves=8,
)


def holds(text):
    condition = parse_condition(text)
    database = sqlite3.connect(":memory:")
    try:
        import json

        query = f"SELECT {condition.sql} FROM (SELECT ? AS facts)"  # noqa: S608  the product's own SQL
        return bool(database.execute(query, [*condition.parameters, json.dumps(FACTS)]).fetchone()[0])
    finally:
        database.close()


@given(CONDITIONS)
def test_a_condition_means_what_python_means(condition):
    text, expected = condition
    assert holds(text) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("note contains 'PADS'", True), ('note contains "\'worn\'"', True), ("none = 1", False), ("none < 1", False),
        ("not missing = 1", True), ("Mk = 2 or Mk = 3 and ticks = 0", True), ("Mk=2.0e0", True), ("Mk>-.5", True),
    ],
)  # fmt: skip
def test_parts_of_texts_missing_values_and_precedence(text, expected):
    assert holds(text) == expected


@pytest.mark.parametrize(
    "text",
    ["", "Mk", "Mk >", "> 3", "Mk > 3 and", "(Mk > 3", "Mk > 3)", "Mk > x", "Mk ~ 3", "'a' = 'a'",
     "Mk > 3; DROP TABLE files", "Mk = 'open", "(" * 100 + "Mk > 3" + ")" * 100, "Mk > 3 Mk < 4"],
)  # fmt: skip
def test_what_is_no_condition_is_refused_with_an_example(text):
    with pytest.raises(ConfigError, match="outcome"):
        parse_condition(text)


@pytest.fixture
def folder(tmp_path, quick):
    for name in "abc":
        (tmp_path / "runs").mkdir(exist_ok=True)
        (tmp_path / "runs" / f"{name}.mcap").write_bytes(quick.path.read_bytes())
    annotate(tmp_path / "runs" / "b.mcap", {"tags": '["wet", "new"]'}, "", "2026-11-23T12:00:00.000+00:00")
    return tmp_path / "runs"


def found(folder, where, index):
    return [row["session"].rpartition("/")[2][0] for row in session_rows(folder, where=where, index=index)]


@pytest.fixture
def index(tmp_path):
    return tmp_path / "cache" / "sessions.sqlite"


def test_gains_results_and_descriptions_find_a_session(folder, index, quick):
    assert found(folder, "tags contains 'wet'", index) == ["b"]
    assert found(folder, f"Mk = {quick.config.controller.gains.get('Mk', 2.0)} and lost_ticks = 0", index) == [
        "a",
        "b",
        "c",
    ]
    assert found(folder, "slip_rms_true > 1", index) == []
    with pytest.raises(ConfigError, match="did you mean tags"):
        found(folder, "tag = 'wet'", index)


def test_a_file_is_read_again_when_it_changed_and_only_then(folder, index):
    read = []

    def rows():
        read.clear()
        return indexed(sorted(folder.iterdir()), lambda path: read.append(path.name) or {"n": path.name}, None, index)

    assert [row["n"] for _, row in rows()] == ["a.mcap", "b.mcap", "c.mcap"] == read
    assert len(rows()) == 3
    assert read == []
    annotate(folder / "c.mcap", {"note": "x"}, "", "2026-11-23T12:00:00.000+00:00")
    (folder / "a.mcap").unlink()
    assert [row["n"] for _, row in rows()] == ["b.mcap", "c.mcap"]
    assert read == ["c.mcap"]


@pytest.mark.parametrize("damage", ["noise", "cut", "another", "folder", "no place"])
def test_an_index_that_cannot_be_used_costs_time_alone(folder, index, damage):
    assert found(folder, "tags contains 'wet'", index) == ["b"]
    data = index.read_bytes()
    if damage == "noise":
        index.write_bytes(data[:200] + os.urandom(len(data) - 200))
    elif damage == "cut":
        index.write_bytes(data[:1000])
    elif damage == "another":
        index.write_bytes(b"something else" * 1000)
    else:
        index.unlink()
        index.mkdir()
        if damage == "no place":
            index = index / "x" / "y.sqlite"
            index.parent.write_text("a file")
    assert found(folder, "tags contains 'wet'", index) == ["b"]


def test_sessions_are_told_apart_by_what_differs_in_them(folder, verb, run):
    (folder / "d.mcap").write_bytes(run("controller.gains.Mk=7.5").path.read_bytes())
    lines = verb("list", folder).out.splitlines()
    assert lines[0].split()[:7] == ["session", "date", "outcome", "controller", "estimator", "Mk", "tags"]
    assert [line.split()[5] for line in lines[1:]].count("7.5") == 1


def test_the_verb_lists_columns_and_writes_them(folder, verb, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    out = tmp_path / "out.csv"
    words = ["--where", "tags contains 'new'", "--columns", "session,tags,Mk", "--csv", out]
    done = verb("list", folder, *words)
    assert done.out.split() == ["session", "tags", "Mk", "b.mcap", "wet,", "new", "2"]
    assert out.read_text(encoding="utf-8").splitlines()[0] == "session,tags,Mk"
    assert len(verb("list", folder, "--json").json["sessions"]) == 3
    assert (tmp_path / "cache" / "inteco-abs" / "sessions.sqlite").is_file()
    assert "did you mean" in verb("list", folder, "--columns", "tag").err
