"""Many sessions as one dataset: every row is there, and the questions in docs/sessions.md have answers."""

import re
from pathlib import Path

import polars as pl
import pytest

from inteco_abs.analysis import write_dataset
from inteco_abs.errors import ConfigError, SessionError

PAGE = (Path(__file__).parents[2] / "docs/sessions.md").read_text(encoding="utf-8")
QUESTIONS = re.findall(r"```python\n# (\w+)\.py\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def spring(quick, tiny, tmp_path):
    out = tmp_path / "spring"
    rows = write_dataset([quick.path, tiny.path], out)
    expected = [quick.session, tiny.session]
    assert rows == sum(each.tick_count + each.truth_count + each.events for each in expected)
    return out


def test_every_row_is_there_under_its_session(spring, quick, tiny):
    for run in (quick, tiny):
        session = run.session
        folder = f"session={session.metadata['session']['session_id']}"
        ticks = pl.read_parquet(spring / "tick" / folder / "rows.parquet")
        assert ticks["slip"].to_list() == session.ticks["slip"].tolist()
        assert len(pl.read_parquet(spring / "truth" / folder / "rows.parquet")) == session.truth_count
    sessions = pl.read_parquet(spring / "sessions.parquet")
    assert sessions["file"].to_list() == [str(quick.path), str(tiny.path)]
    assert sessions["Mk"].to_list() == [2.0, 2.0]


@pytest.mark.parametrize(("name", "code"), QUESTIONS, ids=[name for name, _ in QUESTIONS])
@pytest.mark.usefixtures("spring")
def test_the_questions_of_the_page_have_answers(name, code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = {}
    exec(code, found)  # noqa: S102  the page's
    answer = found["stops"].fetchall() if name == "stops" else found["error"].rows()
    assert len(answer) == 2
    assert all(None not in row for row in answer)


def test_the_page_has_both_questions():
    assert [name for name, _ in QUESTIONS] == ["stops", "estimate"]


def test_what_cannot_be_one_dataset_leaves_nothing(quick, altered, cut_short, tmp_path):
    with pytest.raises(ConfigError, match="same session"):
        write_dataset([quick.path, quick.path], tmp_path / "out")
    broken = altered(quick.path.read_bytes()[:3000] + b"x" * 1000 + quick.path.read_bytes()[4000:])
    with pytest.raises(SessionError, match="damaged"):
        write_dataset([quick.path, broken], tmp_path / "out")
    assert not [each for each in tmp_path.iterdir() if each.name.startswith("out")]
    write_dataset([quick.path, altered(cut_short)], tmp_path / "out")
    with pytest.raises(ConfigError, match="exists"):
        write_dataset([quick.path], tmp_path / "out")


def test_the_verb_takes_folders(quick, verb, tmp_path):
    folder = tmp_path / "runs"
    folder.mkdir()
    (folder / "a.mcap").write_bytes(quick.path.read_bytes())
    assert verb("dataset", tmp_path / "out", folder).out.startswith(f"{tmp_path / 'out'}: 1 sessions, ")
    assert "exists" in verb("dataset", tmp_path / "out", folder).err
