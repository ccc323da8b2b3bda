"""Verbs that list what there is to choose from: controllers, estimators, profiles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import click

from inteco_abs.cli.completion import controller_names, estimator_names
from inteco_abs.cli.options import json_option, print_json, say
from inteco_abs.errors import ConfigError, ConfigIssue, near_match

if TYPE_CHECKING:
    from inteco_abs.control import Gain
    from inteco_abs.control.estimators import Parameter

_WIDTH: Final = 19
"""Of the column of names: that of the longest which ships."""


@click.command()
@click.argument("name", required=False, shell_complete=controller_names)
@json_option
def controllers(name: str | None, as_json: bool) -> int:
    """List the controllers that ship, then those of installed packages, with their gains; or tell all about NAME.

    NAME may be your own as file.py:Class, too.
    """
    from inteco_abs.plugins import installed_controllers

    if name is not None:
        _tell_controller(name, as_json=as_json)
        return 0
    usable, broken = installed_controllers().usable()
    if as_json:
        found = {
            name: {"summary": _summary(kind), "package": package, "gains": [gain._asdict() for gain in kind.gains]}
            for name, (kind, package) in usable.items()
        }
        print_json({"schema_version": 1, "controllers": found, "broken": broken})
        return 0
    for each, (kind, package) in usable.items():
        _list_part(each, _summary(kind), package, kind.gains)
    _list_broken(broken)
    return 0


@click.command()
@click.argument("name", required=False, shell_complete=estimator_names)
@json_option
def estimators(name: str | None, as_json: bool) -> int:
    """List the estimators of wheel speeds and slip, with what can be set of each; or tell all about NAME."""
    from inteco_abs.control import ESTIMATORS

    if name is not None:
        _tell_estimator(name, as_json=as_json)
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
        _list_part(each, kind.summary, package, kind.parameters)
    _list_broken(broken)
    return 0


def _tell_controller(name: str, *, as_json: bool) -> None:
    from inteco_abs.cli.options import known_controllers
    from inteco_abs.plugins import FROM_FILE

    known = known_controllers(name)
    if name not in known:
        raise ConfigError([ConfigIssue("NAME", f"no controller {name!r}{near_match(name, known)}")])
    kind = known[name]
    one = _About(name, _docstring(kind), kind.gains, kind.internals, getattr(kind, "estimator", ""))
    values = {gain.name: gain.default for gain in kind.gains}
    named = {} if FROM_FILE in name else {"name": name}  # code of the user's own runs only if the command line names it
    _tell(one, {"controller": {**named, **({"gains": values} if values else {})}}, as_json=as_json)


def _tell_estimator(name: str, *, as_json: bool) -> None:
    from inteco_abs.control import ESTIMATORS

    if name not in ESTIMATORS:
        raise ConfigError([ConfigIssue("NAME", f"no estimator {name!r}{near_match(name, ESTIMATORS)}")])
    kind = ESTIMATORS[name]
    one = _About(name, f"{kind.summary}.\n\n{_docstring(kind.works)}", kind.parameters)
    values = {each.name: each.default for each in kind.parameters}
    _tell(one, {"estimator": {"name": name, **values}}, as_json=as_json)


class _About(NamedTuple):
    """Everything about a controller or an estimator."""

    name: str
    text: str
    numbers: Sequence[Gain | Parameter]
    internals: Sequence[str] = ()
    estimator: str = ""


def _tell(one: _About, toml: Mapping[str, Any], *, as_json: bool) -> None:
    import tomli_w

    lines = tomli_w.dumps(toml)
    internals = [name for name in one.internals if name]
    if as_json:
        numbers = [each._asdict() for each in one.numbers]
        told = {"name": one.name, "text": one.text, "numbers": numbers, "internals": internals, "toml": lines}
        print_json({"schema_version": 1, **told, "estimator": one.estimator or None})
        return
    say(f"{one.name}\n\n{one.text}\n")
    if one.estimator:
        say(f"works with the estimator {one.estimator} only, and has it if none is chosen\n")
    _list(one.numbers, indent=2)
    if not one.numbers:
        say("  nothing to set")
    if internals:
        say(f"\nin a session, c0 and those after it are {', '.join(internals)}")
    say(f"\nin rig.toml, with the defaults:\n\n{lines.rstrip()}" if lines else "")


@click.command()
@click.argument("name", required=False)
@json_option
def profiles(name: str | None, as_json: bool) -> int:
    """List the shipped profiles, or print the one called NAME: the beginning of a lab's own."""
    from inteco_abs.boards import unconfirmed
    from inteco_abs.config import load_config, profile_text
    from inteco_abs.config import profiles as shipped

    if name is not None:
        if name not in shipped():
            raise ConfigError([ConfigIssue("NAME", f"{name!r} is not a shipped profile{near_match(name, shipped())}")])
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


def _list_part(name: str, summary: str, package: str, numbers: Sequence[Gain | Parameter]) -> None:
    say(f"{name:{_WIDTH}} {summary}{f' [{package}]' if package else ''}")
    _list(numbers)


def _list_broken(broken: Sequence[Mapping[str, str]]) -> None:
    for each in broken:
        say(f"{each['name']:{_WIDTH}} broken: {each['problem']}")


def _list(numbers: Sequence[Gain | Parameter], indent: int = _WIDTH + 3) -> None:
    """One line each: name, default, range, unit, meaning."""
    values = [f"{each.name} = {each.default:g}" for each in numbers]
    width = max(map(len, ["", *values]))
    for value, each in zip(values, numbers, strict=True):
        unit = "" if each.unit == "1" else f" {each.unit}"
        say(f"{'':{indent}}{value:{width}}  {each.low:g}..{each.high:g}{unit}: {each.meaning}")


def _docstring(kind: type) -> str:
    import inspect

    return inspect.getdoc(kind) or "no description"


def _summary(kind: type) -> str:
    """First sentence of a class's docstring."""
    return (kind.__doc__ or "no description").strip().partition("\n")[0].rstrip(".")
