"""The verb `inteco-abs annotate`."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import click

from inteco_abs.cli.options import FILE, json_option
from inteco_abs.cli.terminal import plain, print_json, say
from inteco_abs.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path


@click.command()
@click.argument("file", type=FILE)
@click.option("--purpose", metavar="TEXT", help="Why the run was made.")
@click.option("--note", metavar="TEXT", help="Anything that a reader should know of it.")
@click.option("--tag", "tags", multiple=True, metavar="WORD", help="Add a word by which `list` finds it.")
@click.option("--untag", "untags", multiple=True, metavar="WORD", help="Take a word away.")
@click.option("--operator", metavar="NAME", help="Who ran it.")
@click.option("--orcid", metavar="ID", help="The operator's ORCID iD, as 0000-0002-1825-0097.")
@click.option("--institution", metavar="NAME", help="Name of the laboratory.")
@click.option("--licence", metavar="NAME", help="Licence of the data, best by its SPDX name, as CC-BY-4.0.")
@click.option("--by", default="", metavar="NAME", help="Who makes this change, for the history.")
@json_option
def annotate(
    file: Path, tags: tuple[str, ...], untags: tuple[str, ...], by: str, as_json: bool, **words: str | None
) -> int:
    """Describe a session afterwards.

    No tick changes, and the history keeps what stood there before. An empty text takes a value away. Without an option
    it shows description and history. The file is written again and then takes the old one's place.
    """
    from inteco_abs.sessions import DESCRIPTION, HISTORY, open_session
    from inteco_abs.sessions import annotate as write

    metadata = open_session(file).metadata
    changes = {key: value for key, value in words.items() if value is not None}
    if tags or untags:
        changes["tags"] = _tags(metadata.get(DESCRIPTION, {}).get("tags"), tags, untags)
    known = metadata.get(DESCRIPTION, {})
    changes = {key: value for key, value in changes.items() if value != known.get(key, "")}
    if changes:
        _check({key: value for key, value in changes.items() if value})
        made = write(file, changes, by, datetime.now(UTC).isoformat(timespec="milliseconds"))
        metadata = {name: {**metadata.get(name, {}), **made.get(name, {})} for name in (DESCRIPTION, HISTORY)}
    description = {key: value for key, value in metadata.get(DESCRIPTION, {}).items() if value}
    history = metadata.get(HISTORY, {})
    if as_json:
        print_json({"schema_version": 1, "session": str(file), "description": description, "history": history})
        return 0
    for key, value in description.items():
        say(f"{key}: {plain(value)}")
    for when, what in history.items():
        say(f"changed {plain(when)}: {plain(what)}")
    return 0


def _tags(known: str | None, more: tuple[str, ...], fewer: tuple[str, ...]) -> str:
    """The session's tags as JSON with `more` and without `fewer`; empty for none. Raises ConfigError."""
    try:
        before: list[Any] = json.loads(known or "[]")
    except ValueError:
        before = []
    if missing := [tag for tag in fewer if tag not in before]:
        raise ConfigError.of("--untag", f"{missing[0]!r}: the session has {', '.join(map(str, before)) or 'no tags'}")
    kept = [tag for tag in dict.fromkeys([*before, *more]) if tag not in fewer]
    return json.dumps(kept) if kept else ""


def _check(changes: dict[str, str]) -> None:
    """Raise ConfigError for values that rig.toml would not take either."""
    from inteco_abs.config import load_config

    lines = [f"description.{key}={value if key == 'tags' else json.dumps(value)}" for key, value in changes.items()]
    load_config(settings=lines)
