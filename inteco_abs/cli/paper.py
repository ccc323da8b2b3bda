"""The verb `inteco-abs paper`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from inteco_abs.cli.options import Whole, json_option, write_csv
from inteco_abs.cli.terminal import items_progress, print_json, say, show
from inteco_abs.errors import AbsError, ConfigError, describe_disk

if TYPE_CHECKING:
    from inteco_abs.paper import Reproduction

_DRAWS: Final = 20
_FORMATS: Final = ("png", "pdf")


@click.command()
@click.option(
    "-o",
    "--out",
    "folder",
    type=click.Path(path_type=Path),
    default=Path("paper"),
    show_default=True,
    metavar="DIR",
    help="Folder for figures and tables; created if missing. Files of the same name are replaced.",
)
@click.option(
    "--draws",
    type=Whole(1, 1000),
    default=_DRAWS,
    show_default=True,
    help="Simulated rigs of the experiment: the first of the population capped that can hold slip 0.2.",
)
@json_option
def paper(folder: Path, draws: int, as_json: bool) -> int:
    """Reproduce the paper's simulation, experiment and claims.

    It writes figures of three panels (PNG and PDF, their data as CSV), and a table that compares the paper's reaching
    law with constant-rate sliding mode control, at equal Mq and at equal reaching time (table.csv, table.md, every stop
    in stops.csv). The same command gives the same files, byte by byte.
    """
    from inteco_abs.paper import reproduce
    from inteco_abs.views.figure import require_matplotlib

    require_matplotlib()
    _check_folder(folder)
    with items_progress() as progress:
        found = reproduce(draws, progress)
    report = found.report()
    written = [str(path) for path in _write(found, report, folder, f"inteco-abs paper --draws {draws}")]
    say(f"written: {', '.join(written)}", err=True)
    if as_json:
        print_json({**report, "files": written})
    else:
        from inteco_abs.paper.table import render_paper

        show(render_paper(report))
    return 0


def _check_folder(folder: Path) -> None:
    """Raise an error before anything is computed if `folder` cannot be written to."""
    if folder.exists() and not folder.is_dir():
        raise ConfigError.of("--out", f"{folder}: is a file; name a folder")
    if not folder.absolute().parent.is_dir():
        raise ConfigError.of("--out", f"{folder}: the folder {folder.parent} does not exist; create it first")
    changed = folder if folder.exists() else folder.absolute().parent
    if not os.access(changed, os.W_OK | os.X_OK):
        raise AbsError(f"{changed}: no permission to write to this folder; name another with -o")


def _write(found: Reproduction, report: Mapping[str, Any], folder: Path, command: str) -> Iterator[Path]:
    """Write all files; yields each path."""
    from inteco_abs.paper.table import draw_trace, paper_markdown

    try:
        folder.mkdir(exist_ok=True)
        for trace in found.traces:
            rows = zip(*(column.tolist() for column in trace.columns.values()), strict=True)
            write_csv(
                [dict(zip(trace.columns, row, strict=True)) for row in rows], path := folder / f"{trace.name}.csv"
            )
            yield path
            for suffix in _FORMATS:
                draw_trace(trace.columns, trace.title, path := folder / f"{trace.name}.{suffix}")
                yield path
        write_csv(found.records(), path := folder / "stops.csv")
        yield path
        write_csv([_flat(row) for row in report["rows"]], path := folder / "table.csv")
        yield path
        (path := folder / "table.md").write_text(paper_markdown(report, command), encoding="utf-8", newline="\n")
        yield path
    except OSError as error:
        raise AbsError(f"{error.filename or folder}: cannot be written: {describe_disk(error)}") from error


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """One line of the table."""
    flat = {key: row[key] for key in ("condition", "controller", "pairing", "Mk_per_s", "Mq_per_s", "estimator")}
    flat |= {"rigs": row["rigs"], "stops": row["stops"]}
    for of in ("median", "largest"):
        flat |= {f"{of}_{metric}": value for metric, value in row[of].items()}
    if compared := row["comparison"]:
        flat |= {f"ratio_{metric}": value for metric, value in compared["ratios"].items()}
        flat |= {key: compared[key] for key in ("better", "worse", "neither_arrived", "confirmed")}
    return flat
