"""What fuzzing begins with, and what it once found, goes through each target without a complaint."""

import os
from pathlib import Path

import pytest

HERE = Path(__file__).parent
SEEDS = [file for file in sorted(HERE.glob("*/*")) if file.parent.name != "__pycache__"]


@pytest.fixture(scope="module")
def fuzz(tool):
    return tool("fuzz")


@pytest.mark.parametrize("seed", SEEDS, ids=lambda file: f"{file.parent.name}-{file.name}")
def test_valid_seeds_are_accepted_and_others_refused(fuzz, seed, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "chdir", lambda _: None)
    monkeypatch.setattr(fuzz, "SCRATCH", tmp_path)
    fuzz.TARGETS[seed.parent.name]()(seed.read_bytes())


def test_every_target_has_a_seed(fuzz):
    assert {seed.parent.name for seed in SEEDS} == set(fuzz.TARGETS)


def test_a_failing_fuzz_target_is_found(fuzz, monkeypatch):
    def fails():
        def target(data):
            if data:
                raise ZeroDivisionError

        return target

    monkeypatch.setitem(fuzz.TARGETS, "injections", fails)
    with pytest.raises(ZeroDivisionError):
        fuzz.one("injections", HERE / "injections" / "late")


@pytest.mark.long
@pytest.mark.untraced
def test_fuzzing_leaves_nothing_behind(fuzz, monkeypatch, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setenv("TMPDIR", str(elsewhere))
    monkeypatch.setattr(fuzz, "MEMORY", tmp_path)
    executions, finding, said = fuzz.fuzzed("configuration", 0.1)
    assert not finding, said
    assert executions
    assert list(tmp_path.rglob("*")) == [elsewhere]
