"""The verb `inteco-abs config`: init, show, explain, schema."""

from __future__ import annotations

import json
from pathlib import Path

import click

from inteco_abs.cli.completion import key_names
from inteco_abs.cli.options import FILE, RunOptions, VerbGroup, json_option, known_controllers, run_options
from inteco_abs.cli.terminal import print_json, say
from inteco_abs.errors import AbsError, describe_disk


@click.group(cls=VerbGroup)
def config() -> None:
    """Create, show and explain rig.toml."""


@config.command()
@click.argument("file", type=FILE, default="rig.toml")
def init(file: Path) -> int:
    """Write a rig.toml with every key commented out.

    Each key has its meaning and default.
    """
    from inteco_abs.config.explain import template
    from inteco_abs.control import CONTROLLERS
    from inteco_abs.sessions import atomic_write, check_output

    check_output(file, "FILE")
    try:
        with atomic_write(file) as part:
            part.write_text(template(CONTROLLERS), encoding="utf-8", newline="\n")
    except OSError as error:
        raise AbsError(f"{file} cannot be written: {describe_disk(error)}") from error
    say(f"{file}: uncomment what differs on your rig, and use it with --config {file}", err=True)
    return 0


@config.command()
@run_options("config", "settings", board="Board address; it selects the default profile.")
@click.option("--origin", is_flag=True, help="Add the origin of each value that is not a default.")
@json_option
def show(options: RunOptions, origin: bool, as_json: bool) -> int:
    """Print the configuration that a run would use, as TOML.

    --json always includes the origins.
    """
    from inteco_abs.boards import default_profile
    from inteco_abs.config import origins
    from inteco_abs.config.explain import with_origins
    from inteco_abs.control import control_check, preferred_estimator

    known = known_controllers(None)
    rig = options.load(checks=[control_check(known)], follows=preferred_estimator(known))
    profile = default_profile(options.board)
    found = origins(options.config, options.settings, profile) if origin or as_json else {}
    if as_json:
        print_json({"schema_version": 1, "config": rig.as_table(), "origins": found})
        return 0
    say(with_origins(rig, found), nl=False)
    return 0


@config.command()
@click.argument("key", shell_complete=key_names)
@click.option("--board", default="sim:", show_default=True, help="Board address; it selects the default profile.")
@json_option
def explain(key: str, board: str, as_json: bool) -> int:
    """Explain a key, or list the keys of a section.

    It prints meaning, range and default.
    """
    from inteco_abs.boards import check_address, default_profile
    from inteco_abs.config import read_profile
    from inteco_abs.config.explain import explain as explain_key
    from inteco_abs.config.explain import facts
    from inteco_abs.control import CONTROLLERS

    check_address(board)
    profile = default_profile(board)
    below = {**read_profile(profile), "profile": profile}
    if as_json:
        print_json({"schema_version": 1, "keys": facts(key, below, CONTROLLERS)})
        return 0
    say(explain_key(key, below, CONTROLLERS))
    return 0


@config.command()
def schema() -> int:
    """Print the JSON schema of rig.toml, for editors."""
    from inteco_abs.config.validation import json_schema

    say(json.dumps(json_schema(), indent=2))
    return 0
