"""The verb `inteco-abs profiles`."""

from __future__ import annotations

import click

from inteco_abs.cli.options import json_option
from inteco_abs.cli.terminal import print_json, say
from inteco_abs.errors import ConfigError, near_match


@click.command()
@click.argument("name", required=False)
@json_option
def profiles(name: str | None, as_json: bool) -> int:
    """List the shipped profiles, or print one.

    A printed profile can be the start of your own.
    """
    from inteco_abs.boards import unconfirmed
    from inteco_abs.config import load_config, profile_text
    from inteco_abs.config import profiles as shipped

    if name is not None:
        if name not in shipped():
            raise ConfigError.of("NAME", f"{name!r} is not a shipped profile{near_match(name, shipped())}")
        say(profile_text(name), nl=False)
        return 0
    boards = {one: load_config(profile=one).board for one in shipped()}
    if as_json:
        found = {
            one: {
                "kind": board.kind,
                "logic_version": board.logic_version,
                "verified_by": board.verified_by,
                "read_only": board.read_only,
                "unconfirmed": unconfirmed(board),
            }
            for one, board in boards.items()
        }
        print_json({"schema_version": 1, "profiles": found})
        return 0
    for one, board in boards.items():
        signed = f"signed by {board.verified_by}" if board.verified_by else f"{len(unconfirmed(board))} not confirmed"
        say(f"{one:19} {board.kind:5} logic 0x{board.logic_version:04X}  {board.read_only or signed}")
    return 0
