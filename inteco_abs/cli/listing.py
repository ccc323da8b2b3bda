"""The verb `list`: a folder of sessions as a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import click

from inteco_abs.cli.shared import FILE, LOSSES, json_option, plain, print_json
from inteco_abs.errors import ConfigError, Mistake, near_match

_HEADS: Final = {
    "session": "session",
    "started_utc": "date",
    "outcome": "outcome",
    "controller": "controller",
    "estimator": "estimator",
    "rig": "rig",
    "slip_rms_true": "rms true",
    "slip_rms_estimated": "rms est.",
    "band_entry_s": "band [s]",
    "stop_time_s": "stop [s]",
    "overruns": "overruns",
    "lost_ticks": "lost",
}
_LATEST_OF_A_DATE: Final = len("2026-01-01T12:00:00")


@click.command("list")
@click.argument("folder", type=FILE, default=Path())
@click.option("--sort", "key", default="started_utc", metavar="KEY", help="Column, named as in --json; default: date.")
@click.option("--reverse", is_flag=True, help="Largest or latest first.")
@click.option("--recursive", "-r", is_flag=True, help="Folders in FOLDER, too.")
@json_option
def list_sessions(folder: Path, key: str, reverse: bool, recursive: bool, as_json: bool) -> int:
    """List the sessions in FOLDER with what they were worth; ends with 3 if any of them is cut or broken.

    Of whole files only the summary is read; `validate` looks at every byte.
    """
    from inteco_abs.sessions import COLUMNS, session_files, session_row, sort_rows

    if key not in COLUMNS:
        raise ConfigError([Mistake("--sort", f"no column {key!r}{near_match(key, COLUMNS)}")])
    rows = sort_rows(map(session_row, session_files(folder, nested=recursive)), key, reverse=reverse)
    if as_json:
        print_json({"schema_version": 1, "folder": str(folder), "sessions": rows})
    elif rows:
        _print(folder, rows)
    else:
        click.echo(f"inteco-abs: {folder}: holds no sessions", err=True)
    return LOSSES if any(row["problem"] for row in rows) else 0


def _print(folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    """One line each, as wide as it is: terminals wrap, and files and pipes need not."""
    lines = [tuple(_HEADS.values()), *(tuple(_cell(folder, row, name) for name in _HEADS) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    problems = ["", *(row["problem"] or "" for row in rows)]
    for line, problem in zip(lines, problems, strict=True):
        cells = "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        click.echo(f"{cells}  {plain(problem)}".rstrip())


def _cell(folder: Path, row: dict[str, Any], name: str) -> str:
    value = row[name]
    if name == "session":
        return plain(Path(value).relative_to(folder))
    if name == "rig":
        return plain(value or row["board"] or "-")
    if value is None:
        return "-"
    if name == "started_utc":
        return plain(value[:_LATEST_OF_A_DATE])
    return f"{value:.4f}" if isinstance(value, float) else plain(value)
