"""The verb `inteco-abs publish`."""

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
@click.option("--title", default="", metavar="TEXT", help="Title; default: the folder's name.")
@click.option("--author", "authors", multiple=True, metavar="NAME", help="As 'Ada Lovelace <0000-0002-1825-0097>'.")
@click.option("--licence", default="", metavar="NAME", help="Licence by its SPDX name, as CC-BY-4.0, or its address.")
@click.option("--publisher", default="", metavar="NAME", help="Who publishes it; default: the institution.")
@click.option("--anonymous", is_flag=True, help="Leave out names of computers and folders.")
@json_option
def publish(
    out: Path,
    files: tuple[Path, ...],
    title: str,
    authors: tuple[str, ...],
    licence: str,
    publisher: str,
    anonymous: bool,
    as_json: bool,
) -> int:
    """Write sessions as a research object for a repository.

    OUT is a new folder with the sessions, their rows as CSV, README, citation, licence, metadata as RO-Crate and for
    DataCite, checksums, and scripts that read it with Python or Octave alone. FILE... are sessions, or folders of them.
    Authors, licence and publisher come from their descriptions (inteco-abs annotate) unless they are given. An
    anonymous copy keeps ticks and their hashes, people's names and your controller's source.
    """
    from inteco_abs.analysis import publish as write
    from inteco_abs.analysis import session_files

    found = [each for file in files for each in (session_files(file) if file.is_dir() else [file])]
    done = write(
        found, out, title=title, authors=authors, licence=licence, publisher=publisher, anonymous=anonymous
    )  # fmt: skip
    if as_json:
        print_json({"schema_version": 1, "publication": str(out), "sessions": done.sessions, "files": [*done.files]})
    else:
        say(f"{out}: {done.sessions} sessions, {len(done.files)} files; {out / 'README.md'} describes them")
    return 0
