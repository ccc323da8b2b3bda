"""Verbs that list what there is to choose from: controllers, estimators, profiles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import click

from inteco_abs.cli.shared import json_option, print_json
from inteco_abs.errors import ConfigError, Mistake, near_match

if TYPE_CHECKING:
    from inteco_abs.control import Gain
    from inteco_abs.control.estimators import Parameter

_WIDTH: Final = 19
"""Of the column of names: that of the longest which ships."""


@click.command()
@json_option
def controllers(as_json: bool) -> int:
    """List the controllers that ship, then those of installed packages, with their gains."""
    from inteco_abs.control import CONTROLLERS
    from inteco_abs.plugins import packaged_controllers

    usable, broken = [(name, kind, "") for name, kind in CONTROLLERS.items()], []
    for offer in packaged_controllers().values():
        try:
            usable.append((offer.name, offer.load(), offer.package))
        except ConfigError as error:
            broken.append({"name": offer.name, "package": offer.package, "problem": error.mistakes[0].problem})
    if as_json:
        found = {
            name: {"summary": _summary(kind), "package": package, "gains": [gain._asdict() for gain in kind.gains]}
            for name, kind, package in usable
        }
        print_json({"schema_version": 1, "controllers": found, "broken": broken})
        return 0
    for name, kind, package in usable:
        click.echo(f"{name:{_WIDTH}} {_summary(kind)}{f' [{package}]' if package else ''}")
        _list(kind.gains)
    for each in broken:
        click.echo(f"{each['name']:{_WIDTH}} broken: {each['problem']}")
    return 0


@click.command()
@json_option
def estimators(as_json: bool) -> int:
    """List the estimators of wheel speeds and slip, with what can be set of each in the section [estimator]."""
    from inteco_abs.control import ESTIMATORS

    if as_json:
        found = {
            name: {"summary": kind.summary, "parameters": [each._asdict() for each in kind.parameters]}
            for name, kind in ESTIMATORS.items()
        }
        print_json({"schema_version": 1, "estimators": found})
        return 0
    for name, kind in ESTIMATORS.items():
        click.echo(f"{name:{_WIDTH}} {kind.summary}")
        _list(kind.parameters)
    return 0


@click.command()
@click.argument("name", required=False)
@json_option
def profiles(name: str | None, as_json: bool) -> int:
    """List the shipped profiles, or print the one called NAME: the beginning of a lab's own."""
    from inteco_abs.config import load_config, profile_text
    from inteco_abs.config import profiles as shipped

    if name is not None:
        if name not in shipped():
            raise ConfigError([Mistake("NAME", f"{name!r} is not a shipped profile{near_match(name, shipped())}")])
        click.echo(profile_text(name), nl=False)
        return 0
    boards = {one: load_config(profile=one).board for one in shipped()}
    if as_json:
        found = {
            one: {
                "kind": board.kind,
                "logic_version": board.logic_version,
                "verified_by": board.verified_by,
                "read_only": board.read_only,
                "unconfirmed": board.unconfirmed(),
            }
            for one, board in boards.items()
        }
        print_json({"schema_version": 1, "profiles": found})
        return 0
    for one, board in boards.items():
        signed = f"signed by {board.verified_by}" if board.verified_by else f"{len(board.unconfirmed())} not confirmed"
        click.echo(f"{one:19} {board.kind:5} logic 0x{board.logic_version:04X}  {board.read_only or signed}")
    return 0


def _list(numbers: Sequence[Gain | Parameter]) -> None:
    """One line each: name, default, range, unit, meaning."""
    values = [f"{each.name} = {each.default:g}" for each in numbers]
    width = max(map(len, ["", *values]))
    for value, each in zip(values, numbers, strict=True):
        unit = "" if each.unit == "1" else f" {each.unit}"
        click.echo(f"{'':{_WIDTH}}   {value:{width}}  {each.low:g}..{each.high:g}{unit}: {each.meaning}")


def _summary(kind: type) -> str:
    """First sentence of a class's docstring."""
    return (kind.__doc__ or "no description").strip().partition("\n")[0].rstrip(".")
