"""The verb `inteco-abs controllers`."""

from __future__ import annotations

import click

from inteco_abs.cli.completion import controller_names
from inteco_abs.cli.description import Description, docstring, print_broken, print_description, print_line, summary
from inteco_abs.cli.options import json_option
from inteco_abs.cli.terminal import print_json
from inteco_abs.errors import ConfigError, near_match


@click.command()
@click.argument("name", required=False, shell_complete=controller_names)
@json_option
def controllers(name: str | None, as_json: bool) -> int:
    """List the controllers and their gains, or describe one.

    It lists those that ship, then those of installed packages. NAME may also be your own as file.py:Class.
    """
    from inteco_abs.plugins import installed_controllers

    if name is not None:
        _describe(name, as_json=as_json)
        return 0
    usable, broken = installed_controllers().usable()
    if as_json:
        found = {
            name: {"summary": summary(kind), "package": package, "gains": [gain._asdict() for gain in kind.gains]}
            for name, (kind, package) in usable.items()
        }
        print_json({"schema_version": 1, "controllers": found, "broken": broken})
        return 0
    for each, (kind, package) in usable.items():
        print_line(each, summary(kind), package, kind.gains)
    print_broken(broken)
    return 0


def _describe(name: str, *, as_json: bool) -> None:
    from inteco_abs.cli.options import known_controllers
    from inteco_abs.plugins import FROM_FILE
    from inteco_abs.quantities import quantities

    known = known_controllers(name)
    if name not in known:
        raise ConfigError.of("NAME", f"no controller {name!r}{near_match(name, known)}")
    kind = known[name]
    one = Description(name, docstring(kind), kind.gains, quantities(kind.internals), getattr(kind, "estimator", ""))
    values = {gain.name: gain.default for gain in kind.gains}
    named = {} if FROM_FILE in name else {"name": name}  # a config file cannot name the user's own code
    print_description(one, {"controller": {**named, **({"gains": values} if values else {})}}, as_json=as_json)
