"""What tools/run makes, keeps and says, with a Python that only pretends to install."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
PYTHON = """#!/bin/sh
case "$*" in
    "-m venv "*)
        mkdir -p "$3/bin" && cp "$0" "$3/bin/python" && printf '#!/bin/sh\\necho ran "$@"\\n' >"$3/bin/inteco-abs"
        chmod +x "$3/bin/inteco-abs" ;;
    *"--editable"*) ;;
    "-m pip install"*)
        [ -z "$OFFLINE" ] || {
            echo "WARNING: Retrying (Retry(total=0)): NewConnectionError: Name or service not known"
            echo "ERROR: No matching distribution found for one==1.0"
            exit 1
        }
        half=${*##*-r }
        grep -q three "$half" && echo "Ignoring three: markers do not match"
        grep -q one "$half" && echo "Collecting one==1.0 (from -r $half)" || sleep 0.2 # two run at once
        grep -q two-parts "$half" && echo "Processing /somewhere/two_parts-2.0-py3-none-any.whl"
        echo "Installing collected packages" ;;
esac
"""


class Clone:
    """A folder with tools/run."""

    def __init__(self, folder):
        self.folder = folder
        (folder / "tools").mkdir(parents=True)
        for name in ("run", "environment.sh"):
            shutil.copy(TOOLS / name, folder / "tools" / name)
        (folder / "tools" / "run.lock").write_text("one==1.0\\\n    --hash=x\ntwo-parts==2.0\nthree==3.0 ; x\n")
        (folder / "pyproject.toml").write_text("")
        (folder / "python").write_text(PYTHON)
        (folder / "python").chmod(0o755)

    def run(self, **environment):
        return subprocess.run(
            [self.folder / "tools" / "run", "list"],
            env={**os.environ, "PYTHON": str(self.folder / "python"), **environment},
            capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip


@pytest.fixture
def clone(tmp_path):
    return Clone(tmp_path / "a clone")


def test_the_first_run_shows_progress_and_the_next_starts_at_once(clone):
    first = clone.run()
    assert (first.returncode, first.stdout) == (0, "ran list\n")
    assert "1 of 2 packages: one" in first.stderr
    assert ". .venv/run/bin/activate" in first.stderr
    assert clone.run().stderr == ""


def test_a_renewal_keeps_what_the_user_has_installed(clone):
    clone.run()
    mine = clone.folder / ".venv" / "run" / "mine.py"
    mine.write_text("")
    (clone.folder / "pyproject.toml").write_text("# changed")
    renewed = clone.run()
    assert "what you have installed there stays" in renewed.stderr
    assert mine.exists()
    assert clone.run().stderr == ""


@pytest.mark.parametrize("why", ["was made in another folder", "has no Python that works any more"])
def test_an_environment_that_cannot_be_renewed_is_moved_aside(clone, tmp_path, why):
    clone.run()
    (clone.folder / ".venv" / "run" / "mine.py").write_text("")
    if "folder" in why:
        clone.folder = clone.folder.rename(tmp_path / "moved")
    else:
        (clone.folder / ".venv" / "run" / "bin" / "python").unlink()
    renewed = clone.run()
    assert renewed.returncode == 0
    assert why in renewed.stderr
    (aside,) = clone.folder.glob(".venv/run.before-*")
    assert (aside / "mine.py").exists()
    assert aside.name in renewed.stderr


def test_the_container_copies_what_there_is_and_its_last_stage_is_an_ordinary_users():
    root = TOOLS.parent
    lines = (root / "Containerfile").read_text().splitlines()
    stages = [line.split()[3] for line in lines if line.startswith("FROM") and " AS " in line]
    for line in lines:
        if line.startswith("COPY"):
            assert (root / line.split()[1]).exists(), line
    last = lines[max(at for at, line in enumerate(lines) if line.startswith("FROM")) :]
    assert "USER lab" in last
    assert any("--require-hashes" in line and "tools/run.lock" in line for line in last)
    made = json.loads((root / ".devcontainer" / "devcontainer.json").read_text())
    assert made["build"]["target"] in stages
    assert (root / ".devcontainer" / made["build"]["dockerfile"]).resolve() == root / "Containerfile"


def test_without_a_network_it_says_so_and_goes_on_later(clone):
    failed = clone.run(OFFLINE="1")
    assert failed.returncode == 1
    assert "no package index answers. Is there a network" in failed.stderr
    assert "No matching distribution" in failed.stderr
    assert clone.run().returncode == 0
