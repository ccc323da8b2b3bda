"""The verb `inteco-abs dataset`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from inteco_abs.cli.options import FILE, json_option
from inteco_abs.cli.terminal import print_json, say

if TYPE_CHECKING:
    from pathlib import Path


@click.command()
@click.argument("out", type=FILE)
@click.argument("files", type=FILE, nargs=-1, required=True, metavar="FILE...")
@json_option
def dataset(out: Path, files: tuple[Path, ...], as_json: bool) -> int:
    """Write many sessions as one dataset.

    OUT is a new folder with Parquet files by table and session, which DuckDB, polars and others read as one table, and
    with sessions.parquet, one row per session. FILE... are sessions, or folders of them. Each is checked, one after the
    other in little memory.
    """
    from inteco_abs.analysis import session_files, write_dataset

    found = [each for file in files for each in (session_files(file) if file.is_dir() else [file])]
    rows = write_dataset(found, out)
    if as_json:
        print_json({"schema_version": 1, "dataset": str(out), "sessions": len(found), "rows": rows})
    else:
        say(f"{out}: {len(found)} sessions, {rows} rows")
    return 0
