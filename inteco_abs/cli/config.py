"""The verb `inteco-abs config`: rig.toml begun, shown with what holds in the end, and explained."""

from __future__ import annotations

import json
from pathlib import Path

import click

from inteco_abs.cli.completion import key_names
from inteco_abs.cli.options import FILE, SETTING, VerbGroup, json_option, print_json, say
from inteco_abs.errors import AbsError, describe_disk


@click.group(cls=VerbGroup)
def config() -> None:
    """Begin a rig.toml, show what holds, explain a key."""


@config.command()
@click.argument("file", type=FILE, default="rig.toml")
def init(file: Path) -> int:
    """Write a rig.toml with every key, its meaning and its default, commented out."""
    from inteco_abs.config.explain import template
    from inteco_abs.control import CONTROLLERS
    from inteco_abs.sessions import atomic_write, check_output

    check_output(file, "FILE")
    try:
        with atomic_write(file) as part:
            part.write_text(template(CONTROLLERS), encoding="utf-8")
    except OSError as error:
        raise AbsError(f"{file} cannot be written: {describe_disk(error)}") from error
    say(f"{file}: uncomment what is different on your rig, and use it with --config {file}", err=True)
    return 0


@config.command()
@click.option("--config", "file", type=FILE, help="rig.toml; every key has a default.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    type=SETTING,
    shell_complete=key_names,
    metavar="KEY=VALUE",
    help="Over the file.",
)
@click.option("--board", default="sim:", show_default=True, help="Board address: it has a profile of its own.")
@click.option("--origin", is_flag=True, help="Say of each value that is not a default where it comes from.")
@json_option
def show(file: Path | None, settings: tuple[str, ...], board: str, origin: bool, as_json: bool) -> int:
    """Print the configuration that a run would have, whole, as TOML; --json always has the origins."""
    from inteco_abs.boards import check_address, default_profile
    from inteco_abs.cli.options import known_controllers
    from inteco_abs.config import load_config, origins
    from inteco_abs.config.explain import with_origins
    from inteco_abs.control import control_check, preferred_estimator
    from inteco_abs.mock_board import rig_check

    check_address(board)
    profile = default_profile(board)
    known = known_controllers(None)
    rig = load_config(file, settings, [control_check(known), rig_check], profile, preferred_estimator(known))
    found = origins(file, settings, profile) if origin or as_json else {}
    if as_json:
        print_json({"schema_version": 1, "config": rig.as_table(), "origins": found})
        return 0
    say(with_origins(rig, found), nl=False)
    return 0


@config.command()
@click.argument("key", shell_complete=key_names)
@click.option("--board", default="sim:", show_default=True, help="Board address: it has a profile of its own.")
@json_option
def explain(key: str, board: str, as_json: bool) -> int:
    """Say what KEY means, its range and default; for a section, as guard, list its keys."""
    from inteco_abs.boards import check_address, default_profile
    from inteco_abs.config import read_profile
    from inteco_abs.config.explain import explain as in_words
    from inteco_abs.config.explain import facts
    from inteco_abs.control import CONTROLLERS

    check_address(board)
    profile = default_profile(board)
    below = {**read_profile(profile), "profile": profile}
    if as_json:
        print_json({"schema_version": 1, "keys": facts(key, below, CONTROLLERS)})
        return 0
    say(in_words(key, below, CONTROLLERS))
    return 0


@config.command()
def schema() -> int:
    """Print the JSON schema of rig.toml, for editors that check and complete."""
    from inteco_abs.config.validation import json_schema

    say(json.dumps(json_schema(), indent=2))
    return 0
