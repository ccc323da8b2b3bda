"""Verbs that take something out of a session: export, get."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from inteco_abs.cli.options import (
    FILE,
    LOSSES,
    json_option,
    on_terminal,
    plain,
    print_json,
    read_whole,
    say,
    tell_of_losses,
)
from inteco_abs.errors import ConfigError, ConfigIssue

if TYPE_CHECKING:
    from inteco_abs.sessions import Session

_FORMATS: Final = ("csv", "npz", "mat", "parquet")


@click.command()
@click.argument("file", type=FILE)
@click.option(
    "--format",
    "form",
    type=click.Choice(_FORMATS),
    help="mat and parquet need an extra; default: as OUT ends.",
)
@click.option("--out", "-o", type=FILE, help="File to write; default: FILE with the format's suffix.")
@json_option
def export(file: Path, form: str | None, out: Path | None, as_json: bool) -> int:
    """Write a session's ticks, states of the simulated rig and events for other programs.

    CSV and Parquet hold one table a file: OUT has the ticks, and the others lie beside it. Every column's unit and
    meaning are in the file, or with CSV in one beside it, as stop.columns.csv beside stop.csv.
    """
    from inteco_abs.sessions import export_session

    made = export_session(file, *_form_and_out(file, form, out))
    incomplete, beyond = made.session.incomplete, made.session.beyond
    if as_json:
        files = [{"path": str(written.path), "tables": written.tables, "rows": written.rows} for written in made.files]
        told = {"schema_version": 1, "session": str(file), "incomplete": incomplete, "beyond": beyond, "files": files}
        print_json(told)
    else:
        for written in made.files:
            say(f"{written.path}: {', '.join(written.tables)}, {written.rows} rows")
    tell_of_losses(made.session)
    return LOSSES if incomplete or beyond else 0


def _form_and_out(file: Path, form: str | None, out: Path | None) -> tuple[str, Path]:
    """Each follows from the other, and both together must agree: programs open a file by its name."""
    if out is None:
        if form is None:
            raise ConfigError([ConfigIssue("--format", f"is missing: {', '.join(_FORMATS)}, or --out that ends so")])
        return form, file.with_suffix(f".{form}")
    ending = out.suffix.removeprefix(".")
    wanted = _FORMATS if form is None else (form,)
    if ending not in wanted:
        raise ConfigError([ConfigIssue("--out", f"{out}: must end in .{', .'.join(wanted)}")])
    return ending, out


@click.command()
@click.argument("file", type=FILE)
@click.argument("name", required=False)
@click.option("--out", "-o", type=FILE, help="File or folder to write it to; default: standard output.")
@json_option
def get(file: Path, name: str | None, out: Path | None, as_json: bool) -> int:
    """List the files in a session, or take out the one called NAME, such as config.toml."""
    from inteco_abs.sessions import attached, extract, read_session

    if name is None and out is not None:
        raise ConfigError([ConfigIssue("--out", f"{out}: say which file to write there: get FILE NAME --out OUT")])
    if name is not None and out is None and as_json:
        raise ConfigError([ConfigIssue("--json", "standard output has the file itself; name another place with --out")])
    session = read_whole(file, read_session)
    if name is None:
        _list(session, as_json)
    elif out is None:
        _to_stdout(attached(session, name))
    else:
        path = extract(session, name, out)
        size = len(session.attachments[name])
        if as_json:
            print_json({"schema_version": 1, "session": str(file), "name": name, "path": str(path), "bytes": size})
        else:
            say(f"{path}: {size} bytes")
    return LOSSES if session.incomplete or session.beyond else 0


def _to_stdout(data: bytes) -> None:
    """As it is into a file or a pipe; a terminal would obey what is in it."""
    if on_terminal(sys.stdout):
        say(data.decode("utf-8", "replace"), nl=False)
    else:
        click.echo(data, nl=False)  # noqa: TID251  bytes


def _list(session: Session, as_json: bool) -> None:
    sizes = {name: len(data) for name, data in session.attachments.items()}
    if as_json:
        print_json({"schema_version": 1, "session": str(session.path), "attachments": sizes})
        return
    for name, size in sizes.items():
        say(f"{plain(name)}  {size} bytes")
