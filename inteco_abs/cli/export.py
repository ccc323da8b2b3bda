"""The verb `inteco-abs export`."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import click

from inteco_abs.cli.options import FILE, LOSSES, SESSION, json_option
from inteco_abs.cli.session_files import report_losses
from inteco_abs.cli.terminal import print_json, say

_FORMATS: Final = ("csv", "npz", "mat", "parquet")


@click.command()
@click.argument("file", type=SESSION)
@click.option(
    "--format",
    "form",
    type=click.Choice(_FORMATS),
    help="File format; mat and parquet need an extra; default: by the suffix of OUT.",
)
@click.option("--out", "-o", type=FILE, help="File to write; default: FILE with the format's suffix.")
@json_option
def export(file: Path, form: str | None, out: Path | None, as_json: bool) -> int:
    """Write a session as CSV, NPZ, MAT or Parquet.

    It writes ticks, states of the simulated rig and events. CSV and Parquet hold one table per file: OUT has the
    ticks, and the others lie beside it. The unit and meaning of every column are in the file, or for CSV in a second
    file, as stop.columns.csv beside stop.csv.
    """
    from inteco_abs.sessions import export_session, export_target

    made = export_session(file, *export_target(file, form, out))
    incomplete, beyond = made.session.incomplete, made.session.unsupported
    if as_json:
        files = [{"path": str(written.path), "tables": written.tables, "rows": written.rows} for written in made.files]
        facts = {"schema_version": 1, "session": str(file), "incomplete": incomplete, "beyond": beyond, "files": files}
        print_json(facts)
    else:
        for written in made.files:
            say(f"{written.path}: {', '.join(written.tables)}, {written.rows} rows")
    report_losses(made.session)
    return LOSSES if incomplete or beyond else 0
