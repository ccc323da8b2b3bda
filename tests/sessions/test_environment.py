import hashlib
import json
import os
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import inteco_abs
from inteco_abs.config import profile_text
from inteco_abs.sessions.environment import (
    Enclosure,
    Environment,
    current_environment,
    installed_packages,
    uncommitted_changes,
)
from inteco_abs.sessions.provenance import profile_source
from inteco_abs.version import SOURCE_FOLDER, source_sha256


@pytest.fixture
def tree(tmp_path):
    """A source tree of one committed file, and git."""
    folder = tmp_path / "tree"
    folder.mkdir()
    quiet = {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_SYSTEM": os.devnull}

    def git(*words):
        who = ("-c", "user.name=N", "-c", "user.email=n@localhost")
        subprocess.run(["git", "-C", folder, *who, *words], check=True, env=os.environ | quiet, capture_output=True)

    (folder / "__init__.py").write_text("gain = 1\n")
    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "first")
    return folder


def test_a_clean_tree_has_no_changes(tree):
    assert uncommitted_changes(tree) == (b"", False)


def test_changes_of_tracked_files_are_reported_line_by_line(tree):
    (tree / "__init__.py").write_text("gain = 2\n")
    diff, cut = uncommitted_changes(tree)
    assert b"-gain = 1\n+gain = 2\n" in diff
    assert not cut


def test_changes_are_cut_where_they_are_too_many_and_it_is_said(tree):
    (tree / "__init__.py").write_text("gain = 2\n" * 10_000)
    whole, _ = uncommitted_changes(tree)
    assert uncommitted_changes(tree, 1000) == (whole[:1000], True)
    assert uncommitted_changes(tree, len(whole)) == (whole, False)


def test_a_foreign_repository_around_the_package_is_ignored(tree):
    folder = tree / "site-packages"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (tree / "__init__.py").write_text("gain = 2\n")
    assert uncommitted_changes(folder) == (b"", False)


def test_packages_are_listed_as_pip_takes_them():
    lines = installed_packages().decode().splitlines()
    assert f"numpy=={version('numpy')}" in lines
    assert lines == sorted(lines, key=str.lower)


@pytest.mark.parametrize("metadata", ["", "Version: 1", "Name: half"])
def test_a_package_that_is_there_by_halves_is_left_out(tmp_path, monkeypatch, metadata):
    (tmp_path / "half-1.dist-info").mkdir()
    (tmp_path / "whole-2.dist-info").mkdir()
    (tmp_path / "half-1.dist-info" / "METADATA").write_text(metadata)
    (tmp_path / "whole-2.dist-info" / "METADATA").write_text("Name: whole\nVersion: 2\n")
    (tmp_path / "empty-1.dist-info").mkdir()
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    assert installed_packages() == b"whole==2\n"


def test_a_note_of_them_gives_the_same_again():
    files = (Enclosure("git.diff", "text/x-diff", b"\xff\0"), Enclosure("requirements.txt", "text/plain", b"a==1\n"))
    found = Environment(files, {"git_diff": "cut"})
    assert Environment.of(json.loads(json.dumps(found.as_note()))) == found


def test_a_cut_diff_is_reported_among_the_facts(monkeypatch):
    current_environment.cache_clear()
    monkeypatch.setattr("inteco_abs.sessions.environment.uncommitted_changes", lambda _folder: (b"x", True))
    found = current_environment()
    current_environment.cache_clear()
    assert found.software["git_diff"] == "cut after its first 1000000 bytes"
    assert found.files[-1].data == b"x"


def test_a_session_has_packages_and_profile(quick):
    session = quick.session
    packages = session.attachments["requirements.txt"]
    assert packages == installed_packages()
    assert session.metadata["software"]["packages_sha256"] == hashlib.sha256(packages).hexdigest()
    assert session.attachments["profile.toml"] == profile_text("sim_usb2").encode()


def test_a_session_has_the_changes_of_its_source_tree_if_there_are_any(quick):
    diff, _ = uncommitted_changes(Path(inteco_abs.__file__).parent)
    assert quick.session.attachments.get("git.diff", b"") == diff


def test_a_labs_own_profile_is_kept_verbatim(tmp_path):
    path = tmp_path / "ours.toml"
    path.write_bytes(b"# measured\n[board]\n")
    assert profile_source(str(path)) == b"# measured\n[board]\n"
    path.unlink()
    assert profile_source(str(path)) == b""


def test_limits_and_physics_of_a_run_are_among_the_facts_about_the_rig(run):
    rig = run("guard.brake_limit=0.5", "simulation.parameters=table").session.metadata["rig"]
    assert (rig["brake_limit"], rig["over_speed_rad_s"], rig["simulated_parameters"]) == ("0.5", "245.0", "table")
    drawn = run('simulation.rig="hard:3"', name="drawn.mcap").session.metadata["rig"]
    assert drawn["drawn"] == "hard:3"
    assert "simulated_parameters" not in drawn


def test_hash_of_the_sources_depends_on_content_not_on_place(tmp_path):
    assert current_environment().software["source_sha256"] == source_sha256()
    for name in ("inteco_abs", "firmware_protocol"):  # as an installation: without git, with compiled files
        shutil.copytree(SOURCE_FOLDER.parent / name, tmp_path / name)
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from inteco_abs.version import *; print(SOURCE_FOLDER, "

    def elsewhere():
        command = [sys.executable, "-c", code + "source_sha256())"]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()

    assert elsewhere() == [str(tmp_path / "inteco_abs"), source_sha256()]
    with (tmp_path / "firmware_protocol" / "__init__.py").open("a") as file:
        file.write("#")
    assert elsewhere()[1] != source_sha256()
