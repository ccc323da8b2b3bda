"""The verb `inteco-abs list`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import click

from inteco_abs.cli.options import FILE, LOSSES, json_option
from inteco_abs.cli.terminal import on_terminal, plain, print_json, say
from inteco_abs.errors import ConfigError, near_match

_HEADS: Final = {
    "session": "session", "started_utc": "date", "outcome": "outcome", "controller": "controller",
    "estimator": "estimator", "rig": "rig", "slip_rms_true": "rms true", "slip_rms_estimated": "rms est.",
    "band_entry_s": "band [s]", "stop_time_s": "stop [s]", "overruns": "overruns", "lost_ticks": "lost",
}  # fmt: skip
_FIRST_TO_GO: Final = (
    "slip_rms_estimated", "estimator", "rig", "band_entry_s", "started_utc", "overruns", "lost_ticks", "stop_time_s",
    "outcome", "controller",
)  # fmt: skip
"""Columns that a narrow terminal leaves out, in this order."""
_GAP: Final = "  "
_LATEST_OF_A_DATE: Final = len("2026-01-01T12:00:00")


@click.command("list")
@click.argument("folder", type=FILE, default=Path())
@click.option(
    "--sort",
    "key",
    default="started_utc",
    show_default=True,
    metavar="KEY",
    help="Column to sort by, as named in --json.",
)
@click.option("--reverse", is_flag=True, help="Sort in descending order.")
@click.option("--recursive", "-r", is_flag=True, help="Also list the folders inside FOLDER.")
@json_option
def list_sessions(folder: Path, key: str, reverse: bool, recursive: bool, as_json: bool) -> int:
    """List the sessions in a folder with their results.

    Of complete files it reads the summary only; `validate` checks every byte. Ends with 3 if a session is cut or
    damaged.
    """
    from inteco_abs.analysis import COLUMNS, session_files, session_row, sort_rows

    if key not in COLUMNS:
        raise ConfigError.of("--sort", f"no column {key!r}{near_match(key, COLUMNS)}")
    rows = sort_rows(map(session_row, session_files(folder, nested=recursive)), key, reverse=reverse)
    if as_json:
        print_json({"schema_version": 1, "folder": str(folder), "sessions": rows})
    elif rows:
        _print(folder, rows)
    else:
        hint = "" if recursive else "; --recursive also searches its folders"
        say(f"inteco-abs: {folder}: no sessions found{hint}", err=True)
    return LOSSES if any(row["problem"] for row in rows) else 0


def _print(folder: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Print one line each, with all columns, or on a terminal those that fit."""
    import shutil

    columns = {name: [head, *(_cell(folder, row, name) for row in rows)] for name, head in _HEADS.items()}
    widths = {name: max(map(len, cells)) for name, cells in columns.items()}
    left_out = _left_out(widths, shutil.get_terminal_size().columns) if on_terminal(sys.stdout) else []
    remarks = ["", *map(_remark, rows)]
    for line, remark in enumerate(remarks):
        cells = (cells[line].ljust(widths[name]) for name, cells in columns.items() if name not in left_out)
        say(f"{_GAP.join(cells)}{_GAP}{plain(remark)}".rstrip())
    if left_out:
        names = ", ".join(_HEADS[name] for name in left_out)
        say(f"inteco-abs: columns left out: {names}; a wider terminal or --json shows them", err=True)


def _remark(row: dict[str, Any]) -> str:
    injected = f"injected: {row['injected']}" if row["injected"] else ""
    return "; ".join(filter(None, (row["problem"], injected)))


def _left_out(widths: Mapping[str, int], room: int) -> list[str]:
    """Columns that do not fit into a line of `room` characters."""
    left_out: list[str] = []
    for name in _FIRST_TO_GO:
        kept = [width for column, width in widths.items() if column not in left_out]
        if sum(kept) + len(_GAP) * (len(kept) - 1) <= room:
            break
        left_out.append(name)
    return left_out


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
