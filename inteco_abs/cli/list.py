"""The verb `inteco-abs list`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import click

from inteco_abs.cli.options import FILE, LOSSES, check_table, json_option, write_csv
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
"""Columns that a narrow terminal leaves out, in this order, before those that tell sessions apart."""
_TELLING: Final = ("reference_slip", "seed", "virtual_time", "tags")
"""Columns beside the gains that are shown if sessions differ in them."""
_OF_VIRTUAL_TIME: Final = {"true": "virtual", "false": "real"}
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
@click.option(
    "--where", default="", metavar="CONDITION", help="""List only these, as 'Mk > 3 and outcome = "completed"'."""
)
@click.option("--columns", default="", metavar="KEY,KEY", help="Columns to show, as named in --json.")
@click.option("--csv", "table", type=FILE, help="Also write one line per session (.csv).")
@click.option("--html", "page", type=FILE, help="Also write a page with table, filter and curves (.html).")
@json_option
def list_sessions(
    folder: Path,
    key: str,
    reverse: bool,
    recursive: bool,
    where: str,
    columns: str,
    table: Path | None,
    page: Path | None,
    as_json: bool,
) -> int:
    """List the sessions in a folder with their results.

    Of complete files it reads the summary only; `validate` checks every byte. A condition compares results, gains,
    reference_slip, board, rig, note, tags and all else that --json names, with = != < <= > >= or contains, joined by
    and, or, not. Gains, reference slip, seed, kind of time and tags are shown where sessions differ in them. An index
    in the cache folder saves reading files that have not changed; it may be deleted. Ends with 3 if a listed session is
    cut or damaged.
    """
    from inteco_abs.analysis import COLUMNS, session_rows, sort_rows
    from inteco_abs.views.listing import check_listing, write_listing

    check_table(table)
    if page is not None:
        check_listing(page)
    rows = sort_rows(session_rows(folder, nested=recursive, where=where), key, reverse=reverse)
    chosen = [name.strip() for name in columns.split(",") if name.strip()]
    known = {*COLUMNS, *(name for row in rows for name in row)}
    if wrong := [name for name in chosen if rows and name not in known]:
        raise ConfigError.of("--columns", f"no column {wrong[0]!r}{near_match(wrong[0], known)}")
    if as_json:
        print_json({"schema_version": 1, "folder": str(folder), "sessions": rows})
    elif rows:
        _print(folder, rows, {name: name for name in chosen} or _heads(rows))
    else:
        hint = "" if recursive else "; --recursive also searches its folders"
        such = f" with {where}" if where else ""
        say(f"inteco-abs: {folder}: no sessions{such} found{hint}", err=True)
    if table is not None:
        write_csv([{name: row.get(name) for name in chosen or row} for row in rows], table)
    if page is not None:
        write_listing(rows, page, chosen)
        say(f"page: {page}", err=True)
    return LOSSES if any(row["problem"] for row in rows) else 0


def _heads(rows: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """The usual columns, and after the estimator's the gains and other settings in which sessions differ."""
    gains = dict.fromkeys(name for row in rows for name in (row.get("gains") or "").split(", ") if name)
    readable = [row for row in rows if row["controller"]]
    telling = [name for name in gains if len({row[name] for row in rows if name in row}) > 1]
    telling += [name for name in _TELLING if len({row.get(name) for row in readable}) > 1]
    place = list(_HEADS).index("rig")
    return dict([*[*_HEADS.items()][:place], *((name, name) for name in telling), *[*_HEADS.items()][place:]])


def _print(folder: Path, rows: Sequence[dict[str, Any]], heads: Mapping[str, str]) -> None:
    """Print one line each, with all columns, or on a terminal those that fit."""
    import shutil

    columns = {name: [head, *(_cell(folder, row, name) for row in rows)] for name, head in heads.items()}
    widths = {name: max(map(len, cells)) for name, cells in columns.items()}
    left_out = _left_out(widths, shutil.get_terminal_size().columns) if on_terminal(sys.stdout) else []
    remarks = ["", *map(_remark, rows)]
    for line, remark in enumerate(remarks):
        cells = (cells[line].ljust(widths[name]) for name, cells in columns.items() if name not in left_out)
        say(f"{_GAP.join(cells)}{_GAP}{plain(remark)}".rstrip())
    if left_out:
        names = ", ".join(heads[name] for name in left_out)
        say(f"inteco-abs: columns left out: {names}; a wider terminal or --json shows them", err=True)


def _remark(row: dict[str, Any]) -> str:
    injected = f"injected: {row['injected']}" if row["injected"] else ""
    return "; ".join(filter(None, (row["problem"], injected)))


def _left_out(widths: Mapping[str, int], room: int) -> list[str]:
    """Columns that do not fit into a line of `room` characters."""
    left_out: list[str] = []
    telling = [name for name in widths if name not in _HEADS]
    for name in (name for name in (*_FIRST_TO_GO, *reversed(telling)) if name in widths):
        kept = [width for column, width in widths.items() if column not in left_out]
        if sum(kept) + len(_GAP) * (len(kept) - 1) <= room:
            break
        left_out.append(name)
    return left_out


def _cell(folder: Path, row: dict[str, Any], name: str) -> str:
    value = row.get(name)
    if name == "session":
        return plain(Path(row["session"]).relative_to(folder))
    if name == "rig":
        return plain(value or row["board"] or "-")
    if value is None:
        return "-"
    if name == "started_utc":
        return plain(value[:_LATEST_OF_A_DATE])
    if name == "virtual_time":
        return _OF_VIRTUAL_TIME.get(str(value), "-")
    return f"{value:{'.4f' if name in _HEADS else 'g'}}" if isinstance(value, float) else plain(value)
