"""The verb `inteco-abs estimators`."""

from __future__ import annotations

import click

from inteco_abs.cli.completion import estimator_names
from inteco_abs.cli.description import Description, docstring, print_broken, print_description, print_line
from inteco_abs.cli.options import json_option
from inteco_abs.cli.terminal import print_json
from inteco_abs.errors import ConfigError, near_match


@click.command()
@click.argument("name", required=False, shell_complete=estimator_names)
@json_option
def estimators(name: str | None, as_json: bool) -> int:
    """List the estimators and their settings, or describe one."""
    from inteco_abs.control import ESTIMATORS

    if name is not None:
        _describe(name, as_json=as_json)
        return 0
    usable, broken = ESTIMATORS.usable()
    if as_json:
        found = {
            name: {"summary": kind.summary, "parameters": [each._asdict() for each in kind.parameters]}
            for name, (kind, _) in usable.items()
        }
        print_json({"schema_version": 1, "estimators": found, **({"broken": broken} if broken else {})})
        return 0
    for each, (kind, package) in usable.items():
        print_line(each, kind.summary, package, kind.parameters)
    print_broken(broken)
    return 0


def _describe(name: str, *, as_json: bool) -> None:
    from inteco_abs.control import ESTIMATORS

    if name not in ESTIMATORS:
        raise ConfigError.of("NAME", f"no estimator {name!r}{near_match(name, ESTIMATORS)}")
    kind = ESTIMATORS[name]
    one = Description(name, f"{kind.summary}.\n\n{docstring(kind.works)}", kind.parameters)
    values = {each.name: each.default for each in kind.parameters}
    print_description(one, {"estimator": {"name": name, **values}}, as_json=as_json)
