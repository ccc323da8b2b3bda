"""The explanations of surviving mutants, which tools/mutate believes."""

from collections import Counter

import pytest


@pytest.fixture(scope="module")
def mutate(tool):
    return tool("mutate")


def test_every_survivor_that_is_explained_is_still_a_change_of_a_line(mutate):
    explained = Counter((each["module"], each["text"], each["change"]) for each in mutate.explanations())
    made = {
        (mutant.module, mutant.text, mutant.change)
        for module in {module for module, _, _ in explained}
        for mutant in mutate.mutants_of(module)
    }
    assert set(explained) - made == set()
    assert max(explained.values()) == 1


def test_every_survivor_that_is_explained_has_a_reason(mutate):
    assert [each for each in mutate.explanations() if not each["why"].strip()] == []


def test_a_sample_fails_for_a_survivor_that_the_kept_score_has_not_counted(mutate, tmp_path, monkeypatch):
    monkeypatch.setattr(mutate, "SCORES", tmp_path / "SCORES.md")
    module = "inteco_abs.boards.board"
    known, new = (mutate.Mutant(module, 1, "a = 0", change, str) for change in ("0 -> 1", "0 -> 2"))
    verdicts = dict.fromkeys((known, new), mutate.SURVIVED)
    mutate.write([mutate.Scored(module, verdicts, [], [known], 2)])
    for line, mutant, fails in [(1, known, False), (7, known, False), (1, new, True)]:
        sampled = mutate.Scored(module, verdicts, [], [mutant._replace(line=line)], 2)
        assert bool(sampled.failure(sampled=True)) is fails
        assert "below 95%" in sampled.failure(sampled=False)


def test_the_scores_are_kept_for_every_module(mutate):
    rows = mutate.SCORES.read_text(encoding="utf-8").splitlines()
    ours = ("| inteco_abs.", "| firmware")
    assert [row.split(" | ")[0] for row in rows if row.startswith(ours)] == [f"| {module}" for module in mutate.TESTS]
