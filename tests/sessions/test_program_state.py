"""Which program a session names: changes of its own files count, and files beside it do not."""

import shutil
import subprocess

import pytest

from inteco_abs.sessions import provenance


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """A repository with a program of one line."""
    for name in ("inteco_abs", "firmware_protocol"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("one = 1\n")
    git = [shutil.which("git"), "-c", "user.name=a", "-c", "user.email=a@example.org"]
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "first"]):
        subprocess.run([*git, *words], cwd=tmp_path, check=True)
    monkeypatch.setattr(provenance, "SOURCE_FOLDER", tmp_path / "inteco_abs")
    return tmp_path


@pytest.mark.parametrize(
    ("file", "dirty"),
    [("stop.mcap", "false"), ("inteco_abs/new.py", "true"), ("firmware_protocol/__init__.py", "true")],
)
def test_only_changes_of_the_program_make_its_tree_dirty(clone, file, dirty):
    assert provenance.software_facts()["git_dirty"] == "false"
    (clone / file).write_text("two = 2\n")
    assert provenance.software_facts()["git_dirty"] == dirty
