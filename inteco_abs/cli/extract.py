"""The verb `inteco-abs extract`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from inteco_abs.cli.options import FILE, LOSSES, SESSION, json_option
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import on_terminal, plain, print_json, say
from inteco_abs.errors import ConfigError

if TYPE_CHECKING:
    from inteco_abs.sessions import Session


@click.command()
@click.argument("file", type=SESSION)
@click.argument("name", required=False)
@click.option("--out", "-o", type=FILE, help="File or folder to write to; default: standard output.")
@json_option
def extract(file: Path, name: str | None, out: Path | None, as_json: bool) -> int:
    """List the files inside a session, or write out one.

    NAME is one of those listed, as config.toml.
    """
    from inteco_abs.sessions import attached, open_session
    from inteco_abs.sessions import extract as write_attachment

    if name is None and out is not None:
        raise ConfigError.of("--out", f"{out}: name the file to write there: extract FILE NAME --out OUT")
    if name is not None and out is None and as_json:
        raise ConfigError.of("--json", "standard output has the file itself; name another place with --out")
    session = read_whole(file, open_session)
    if name is None:
        _list(session, as_json)
    elif out is None:
        _to_stdout(attached(session, name))
    else:
        path = write_attachment(session, name, out)
        size = len(session.attachments[name])
        if as_json:
            print_json({"schema_version": 1, "session": str(file), "name": name, "path": str(path), "bytes": size})
        else:
            say(f"{path}: {size} bytes")
    return LOSSES if session.incomplete or session.unsupported else 0


def _to_stdout(data: bytes) -> None:
    """Write the bytes as they are into a file or a pipe; a terminal would obey what is in them."""
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
