"""The verb `inteco-abs grade`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from inteco_abs.cli.options import DIFFERS, FILE, Whole, check_table, json_option, write_csv
from inteco_abs.cli.terminal import on_terminal, print_json, say, show
from inteco_abs.errors import AbsError, ConfigError, describe_disk, near_match

if TYPE_CHECKING:
    from inteco_abs.course.grading import Exercise, Grade


@click.command()
@click.argument("exercise", required=False)
@click.argument("files", nargs=-1, type=FILE, metavar="[FILE]...")
@click.option("--start", type=FILE, metavar="FILE", help="Write the exercise's starting file.")
@click.option("--seed", type=Whole(0), help="Draw the rigs of an earlier grading again; default: others each time.")
@click.option("--csv", "table", type=FILE, help="Also write a line per file (.csv).")
@json_option
def grade(
    exercise: str | None,
    files: tuple[Path, ...],
    start: Path | None,
    seed: int | None,
    table: Path | None,
    as_json: bool,
) -> int:
    """Grade submissions to an exercise of the course.

    Without EXERCISE it lists the exercises, without FILE the limits of one. A file runs in a process of its own, which
    gets samples or estimates and answers: the rigs, drawn from a secret seed, and the score are elsewhere. All files of
    one call get the same rigs. Ends with 0 if all pass, with 4 if one does not.
    """
    from inteco_abs.course.exercise import exercises

    known = exercises()
    if exercise is None:
        return _list(as_json=as_json)
    if exercise not in known:
        raise ConfigError.of("EXERCISE", f"no exercise {exercise!r}{near_match(exercise, known)}")
    if start is not None:
        return _write_start(known[exercise], start, files)
    if not files and (table is not None or seed is not None):
        raise ConfigError.of("FILE", "name at least one file to grade")
    if not files:
        return _show_task(known[exercise], as_json=as_json)
    check_table(table)
    return _grade(known[exercise], files, seed, table, as_json=as_json)


def _list(*, as_json: bool) -> int:
    from inteco_abs.course.exercise import exercises

    if as_json:
        facts = [{"name": each.name, "title": each.title, "page": each.page} for each in exercises().values()]
        print_json({"schema_version": 1, "exercises": facts})
        return 0
    for each in exercises().values():
        say(f"{each.name:15}{each.title}; {each.page}")
    say("\ninteco-abs grade pi --start pi.py writes a starting file, inteco-abs grade pi pi.py grades it.")
    return 0


def _show_task(exercise: Exercise, *, as_json: bool) -> int:
    if as_json:
        facts = asdict(exercise)
        print_json({"schema_version": 1, **facts, "rigs": exercise.rigs[0]})
    else:
        say(exercise.task)
    return 0


def _write_start(exercise: Exercise, path: Path, files: tuple[Path, ...]) -> int:
    from inteco_abs.sessions import check_output

    if files:
        raise ConfigError.of("--start", "writes a file, and grades none: leave out the others")
    check_output(path, "--start")
    try:
        with path.open("x", encoding="utf-8", newline="\n") as file:
            file.write(exercise.start)
    except OSError as error:
        raise AbsError(f"{path}: cannot be written: {describe_disk(error)}") from error
    say(f"{path}: now read {exercise.page}, and grade it: inteco-abs grade {exercise.name} {path}", err=True)
    return 0


def _grade(exercise: Exercise, files: tuple[Path, ...], seed: int | None, table: Path | None, *, as_json: bool) -> int:
    from inteco_abs.course.grading import grade as graded
    from inteco_abs.course.grading import new_seed

    seed = new_seed() if seed is None else seed
    grades: list[Grade] = []
    for file in files:
        with _waiting(f"grading {file}"):
            grades.append(graded(exercise, file, seed))
        if not as_json:
            show(grades[-1]) if len(files) == 1 else say(_line(grades[-1]))
    if not all(each.safe for each in grades):
        problem = "nothing kept the file from reading this computer's files and memory, and so the truth"
        say(f"inteco-abs: no grade for marks: {problem}; grade on Linux 5.13 or later", err=True)
    if as_json:
        facts = {"schema_version": 1, "exercise": exercise.name, "seed": seed}
        print_json(
            {**facts, "passed": all(each.passed for each in grades), "grades": [each.report() for each in grades]}
        )
    if table is not None:
        write_csv([each.row() for each in grades], table)
        say(f"table: {table}", err=True)
    return 0 if all(each.passed for each in grades) else DIFFERS


def _line(grade: Grade) -> str:
    verdict = "passed" if grade.passed else "not passed"
    return f"{grade.file}: {verdict}, score {grade.score}{'; ' if grade.missing else ''}{'; '.join(grade.missing[:1])}"


@contextmanager
def _waiting(what: str) -> Iterator[None]:
    """Say it on a terminal's stderr while it lasts."""
    if not on_terminal(sys.stderr):
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(f"{what}; the first time compiles for up to half a minute"):
        yield
