"""Each exercise can be solved, and is not by its starting file; what it draws depends on its seed alone."""

from dataclasses import replace
from pathlib import Path

import pytest

from inteco_abs.course.grading import exercises, grade, new_seed
from inteco_abs.course.measured import Draw, Measured, median

pytestmark = pytest.mark.xdist_group("compiled")
SOLUTIONS = Path(__file__).parent / "solutions"
NAMES = sorted(exercises())
FEW = {"pi": 2, "estimator": 1, "identification": 1, "faults": 4}
"""Cases of one exercise of each kind, which take less than a second."""


def with_few_cases(name):
    return replace(exercises()[name], cases=FEW[name])


@pytest.mark.parametrize("name", [pytest.param("pi", marks=pytest.mark.long), "estimator", "identification", "faults"])
def test_the_model_solution_passes_and_says_what_it_is_compared_with(name):
    found = grade(with_few_cases(name), SOLUTIONS / f"{name}.py", seed=3)
    assert found.passed, found.missing
    assert found.safe
    assert 30 < found.score <= 100
    measured = found.measured
    assert measured.hundred < measured.zero
    assert ["guard" in note for note in measured.notes] == [True] * (name == "faults")
    assert [each.limit for each in found.kept] == list(exercises()[name].limits)


@pytest.mark.parametrize("name", [pytest.param("pi", marks=pytest.mark.long), "estimator", "identification"])
def test_the_starting_file_runs_but_does_not_pass(name, tmp_path):
    (tmp_path / "start.py").write_text(exercises()[name].start)
    found = grade(with_few_cases(name), tmp_path / "start.py", seed=3)
    assert not found.passed
    assert not found.failure
    assert found.score == 0
    kept = next(each for each in found.kept if not each.passed)
    assert f"{kept.limit.what}: at most {kept.limit.most:g}" in kept.missing
    assert kept.cases[kept.worst] in kept.missing


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_all_cases_of_a_grading_for_solution_and_starting_file(name, seed, tmp_path):
    solved = grade(exercises()[name], SOLUTIONS / f"{name}.py", seed)
    assert solved.passed, solved.missing
    (tmp_path / "start.py").write_text(exercises()[name].start)
    started = grade(exercises()[name], tmp_path / "start.py", seed)
    assert not started.failure
    assert not started.passed
    assert started.score < solved.score


def test_the_same_seed_draws_the_same_and_others_draw_others():
    exercise = with_few_cases("pi")
    first, again, other = (Draw(exercise, seed).rigs() for seed in (5, 5, 6))
    assert first == again
    assert not first.keys() & other.keys()
    assert Draw(exercises()["faults"], 5).rigs().keys().isdisjoint(first)  # one exercise says nothing of another's rigs
    assert new_seed() != new_seed()


@pytest.mark.parametrize(
    ("own", "score"), [(0.2, 0.0), (0.1, 0.0), (0.01, 50.0), (0.001, 100.0), (0.0, 100.0), (float("inf"), 0.0)]
)
def test_the_score_is_logarithmic_between_what_it_is_compared_with(own, score):
    assert Measured((), {}, own, zero=0.1, hundred=0.001).score == pytest.approx(score)


def test_a_missing_value_counts_as_infinite():
    assert median([1.0, float("nan"), 2.0]) == 2.0
    assert median([float("nan"), float("nan"), 2.0]) == float("inf")


@pytest.mark.parametrize("name", NAMES)
def test_the_page_has_the_limits_and_the_number_of_cases(name):
    exercise = exercises()[name]
    page = (Path(__file__).parents[2] / exercise.page).read_text()
    for limit in exercise.limits:
        unit = "" if limit.unit == "1" else f" {limit.unit}"
        share = "all" if limit.share == 1.0 else f"{100.0 * limit.share:g} %"
        assert f"| {limit.what} | at most {limit.most:g}{unit} | {share} |" in page
    assert page.startswith(f"# {exercise.title}\n")
    assert f" {exercise.cases} " in page.partition("## Theory")[0]
