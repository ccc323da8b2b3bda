"""What the verbs share: exit codes, parameter types, options, groups of verbs."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from inteco_abs.cli.completion import controller_names, estimator_names, fault_names, key_names, rig_names
from inteco_abs.errors import AbsError, ConfigError, describe_disk, near_match
from inteco_abs.quantities import number_hint

if TYPE_CHECKING:
    from inteco_abs.config import Check, RigConfig, Table
    from inteco_abs.experiment import Plan
    from inteco_abs.plugins import Controllers

LOSSES: Final = 3
DIFFERS: Final = 4
INTERRUPTED: Final = 130


class _File(click.Path):
    """A path; each verb checks whether it can be read, with its own message and exit code."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("'': must name a file or folder.", param, ctx)
        return super().convert(value, param, ctx)


class _SessionFile(_File):
    """A path, or an address that the extra `remote` reads."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if isinstance(value, str) and "://" in value:
            from inteco_abs.sessions import session_path

            return session_path(value)
        return super().convert(value, param, ctx)


FILE: Final = _File(path_type=Path, readable=False)
SESSION: Final = _SessionFile(path_type=Path, readable=False)
_LONGEST_LINE: Final = 60
"""Characters of a verb's help line in a list."""
_LIVE_PORT: Final = 8765
"""Default port of Lichtblick and Foxglove."""
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


class Finite(click.FloatRange):
    """A finite number in `unit` within its range, without NaN, which click accepts."""

    def __init__(self, least: float | None = None, most: float | None = None, *, unit: str = "") -> None:
        super().__init__(least, most)
        self._unit = unit

    def _describe_range(self) -> str:
        """Return the range for the help; without limits click would print x<=None."""
        return "" if self.min is None and self.max is None else super()._describe_range()

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        try:
            number, hint = float(value), ""
        except ValueError:
            number, hint = math.nan, number_hint(value, self._unit)
        if not (math.isfinite(number) and _within(number, self)):
            self.fail(f"{value!r}: must be {_wanted('a number', self, self._unit)}{hint}", param, ctx)
        return number


class Whole(click.IntRange):
    """A whole number within its range."""

    def _describe_range(self) -> str:
        """Return the range for the help, as `Finite` does."""
        return "" if self.min is None and self.max is None else super()._describe_range()

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        try:
            number = int(value)
        except ValueError:
            self.fail(f"{value!r}: must be {_wanted('a whole number', self)}{number_hint(value)}", param, ctx)
        if not _within(number, self):
            self.fail(f"{value!r}: must be {_wanted('a whole number', self)}", param, ctx)
        return number


class _Setting(click.types.StringParamType):
    """KEY=VALUE. Checks the = only, without which a value typed as a second word would be lost silently."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        text = str(value)
        if "=" not in text:
            self.fail(f"{text!r} has no =: must look like guard.brake_limit=0.7, in one word.", param, ctx)
        return text


SETTING: Final = _Setting()


def _within(number: float, limits: click.IntRange | click.FloatRange) -> bool:
    return (limits.min is None or number >= limits.min) and (limits.max is None or number <= limits.max)


def _wanted(what: str, limits: click.IntRange | click.FloatRange, unit: str = "") -> str:
    if limits.max is not None:
        return f"{what} in {limits.min}..{limits.max} {unit}".rstrip()
    if limits.min is not None:
        return f"{what} of at least {limits.min} {unit}".rstrip()
    return f"{what}, in {unit}" if unit else what


class VerbGroup(click.Group):
    """Group that suggests the nearest verb or the one of that meaning, and accepts old names without listing them."""

    def __init__(
        self,
        *arguments: Any,
        aliases: Mapping[str, str] | None = None,
        synonyms: Mapping[str, str] | None = None,
        **more: Any,
    ) -> None:
        super().__init__(*arguments, **more)
        self._aliases = aliases or {}
        self._synonyms = synonyms or {}

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return super().get_command(ctx, self._aliases.get(cmd_name, cmd_name))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        command = self.get_command(ctx, args[0]) if args else None
        if args and command is None:
            meant = self._synonyms.get(args[0].lower())
            hint = f"; did you mean {meant}?" if meant else near_match(args[0], self.list_commands(ctx))
            raise click.UsageError(f"no command {args[0]!r}{hint}", ctx)
        return super().resolve_command(ctx, [self._aliases.get(args[0], args[0]), *args[1:]] if args else args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        self.write_commands(ctx, formatter, "Commands", self.list_commands(ctx))

    def write_commands(
        self, ctx: click.Context, formatter: click.HelpFormatter, heading: str, names: Sequence[str]
    ) -> None:
        """One section of the list of verbs."""
        found = [(name, command) for name in names if (command := self.get_command(ctx, name)) is not None]
        with formatter.section(heading):
            formatter.write_dl([(name, command.get_short_help_str(_LONGEST_LINE)) for name, command in found])


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """Values of the options that verbs share with `run`; the default where a verb does not have one."""

    board: str = "sim:"
    virtual: bool = False
    seed: int = 0
    rig: str | None = None
    """Population and seed of a sampled rig, as hard:17."""
    config: Path | None = None
    settings: tuple[str, ...] = ()
    """KEY=VALUE each, over the file."""
    controller: str | None = None
    estimator: str | None = None
    changes: tuple[str, ...] = ()
    """NAME=VALUE@WHEN each, in place of `experiment.changes`."""
    tune: bool = False
    faults: tuple[str, ...] = ()
    live_port: int | None = None
    live: str | None = None
    quiet: bool = False
    purpose: str | None = None
    note: str | None = None
    tags: tuple[str, ...] = ()
    operator: str | None = None

    @property
    def chosen(self) -> tuple[str, ...]:
        """Controller, estimator and description as settings."""
        names = {"controller": self.controller, "estimator": self.estimator}
        words = {"purpose": self.purpose, "note": self.note, "tags": [*self.tags] or None, "operator": self.operator}
        return (
            *(f"{key}.name={name}" for key, name in names.items() if name),
            *(f"description.{key}={json.dumps(value)}" for key, value in words.items() if value is not None),
            *([f"experiment.changes={json.dumps(self.changes)}"] if self.changes else []),
        )

    def load(
        self,
        more: Sequence[str] = (),
        *,
        checks: Sequence[Check] = (),
        follows: Callable[[Table], Table] | None = None,
    ) -> RigConfig:
        """Configuration for this board, with `more` settings over the typed ones. Raises ConfigError."""
        from inteco_abs.api.configuration import run_config

        return run_config(self.board, self.config, self.settings, self.rig, checks, follows, more)

    def plan(self, out: Path, *, wire: Path | None = None, frames: bool = False) -> tuple[RigConfig, Plan]:
        """Configuration and plan of a stop recorded at `out`; nothing is opened or created. Raises ConfigError."""
        from inteco_abs.cli.screens import require_keyboard
        from inteco_abs.control import control_check, preferred_estimator
        from inteco_abs.experiment import Plan
        from inteco_abs.mock_board import parse_faults

        if self.tune:
            require_keyboard(self.live, virtual=self.virtual, quiet=self.quiet)
        controllers = known_controllers(self.controller)
        config = self.load(self.chosen, checks=[control_check(controllers)], follows=preferred_estimator(controllers))
        source, package = controllers.origin(config.controller.name)
        plan = Plan(
            out=out,
            board=self.board,
            virtual=self.virtual,
            seed=self.seed,
            controllers=controllers,
            controller_source=source,
            wire=wire,
            frames=frames,
            controller_package=package,
            live_port=self.live_port,
            faults=parse_faults(self.faults),
        )
        return config, plan


def _option(*names: str, **details: Any) -> tuple[tuple[str, ...], dict[str, Any]]:
    return names, details


_OPTIONS: Final = {
    "board": _option("--board", default="sim:", show_default=True, help="Board address; sim: is the mock board."),
    "virtual": _option("--virtual", is_flag=True, help="Use virtual time: fast and repeatable; sim: only."),
    "seed": _option("--seed", default=0, show_default=True, type=Whole(0),
                    help="Seed of the mock board's random state."),
    "rig": _option("--rig", metavar="POPULATION:SEED", shell_complete=rig_names,
                   help="Simulate a sampled rig, as hard:17 or my-lab.toml:17; default: the published one."),
    "config": _option("--config", type=FILE, help="Configuration file (rig.toml); every key has a default."),
    "settings": _option("--set", multiple=True, type=SETTING, shell_complete=key_names, metavar="KEY=VALUE",
                        help="Override a key of the configuration, as in guard.brake_limit=0.7."),
    "controller": _option("--controller", shell_complete=controller_names,
                          help="A controller that `inteco-abs controllers` lists, or your own as file.py:Class."),
    "estimator": _option("--estimator", shell_complete=estimator_names,
                         help="An estimator that `inteco-abs estimators` lists: moving-window, tracking, kalman, "
                         "edge-time, observer, adaptive-observer, euler (the paper's) or difference (the vendor's)."),
    "changes": _option("--change", multiple=True, metavar="NAME=VALUE@WHEN",
                       help="Change a gain, or reference_slip, during the run, as in Mk=5@brake+200ms, "
                       "reference_slip=0.3@brake2 or Mk=5@3.5s."),
    "tune": _option("--tune", is_flag=True, help="Change gains with keys during a run in real time."),
    "faults": _option("--inject", multiple=True, metavar="FAULT", shell_complete=fault_names,
                      help="Inject a fault into the mock board, as lose@brake+20ms; `inteco-abs faults` lists all."),
    "live_port": _option("--foxglove", is_flag=False, flag_value=_LIVE_PORT, type=Whole(0, 65535), metavar="[PORT]",
                         help="Serve the running stop to Lichtblick or Foxglove on this computer; default port: "
                         f"{_LIVE_PORT}, 0: any free port."),
    "live": _option("--live", type=click.Choice(("full", "line", "none")),
                    help="Display during the run; default: as much as the terminal has room for."),
    "quiet": _option("--quiet", "-q", is_flag=True, help="Print errors and warnings only."),
    "purpose": _option("--purpose", metavar="TEXT", help="Why the run is made; kept in the session."),
    "note": _option("--note", metavar="TEXT", help="Anything that a reader should know; kept in the session."),
    "tags": _option("--tag", multiple=True, metavar="WORD", help="A word by which `list` finds the session."),
    "operator": _option("--operator", metavar="NAME", help="Who runs it; kept in the session."),
}  # fmt: skip
"""Options by field of RunOptions: the names, and arguments for click."""


def shared_option(field: str, text: str = "") -> Decorator:
    """The option for one field of RunOptions, passed on under that name; `text` replaces its help."""
    names, details = _OPTIONS[field]
    return click.option(*names, field, **{**details, **({"help": text} if text else {})})


def run_options(*fields: str, **helps: str) -> Decorator:
    """Options for these fields of RunOptions, or all of them, passed on as `options`; `helps` replaces help texts."""
    chosen = (*fields, *helps) or tuple(_OPTIONS)

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def packed(*arguments: Any, **given: Any) -> Any:
            typed = {field: given.pop(field) for field in chosen}
            return function(*arguments, options=RunOptions(**typed), **given)

        for field in reversed(chosen):
            shared_option(field, helps.get(field, ""))(packed)
        return packed

    return decorate


def json_option(function: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")(function)


def write_csv(records: Iterable[Mapping[str, Any]], path: Path, columns: Sequence[str] = ()) -> None:
    """Write one line per record; a value that a record does not have, or None, is empty. Raises AbsError.

    Without `columns` they are those of all records, which are then all in memory.
    """
    import csv

    from inteco_abs.sessions import atomic_write

    if not columns:
        records = list(records)
        columns = list(dict.fromkeys(key for record in records for key in record))
    try:
        with atomic_write(path) as part, part.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            writer.writerows(records)
    except OSError as error:
        raise AbsError(f"{path}: the table cannot be written: {describe_disk(error)}") from error


def check_table(path: Path | None) -> None:
    """Raise ConfigError for a path where no new table can be written."""
    from inteco_abs.sessions import check_output

    if path is None:
        return
    check_output(path, "--csv")
    if path.suffix != ".csv":
        raise ConfigError.of("--csv", f"{path}: must end in .csv")


def require_different(files: dict[str, Path | None]) -> None:
    """Raise ConfigError if two options name the same file."""
    seen: dict[Path, str] = {}
    for option, file in files.items():
        if file is None:
            continue
        other = seen.setdefault(file.resolve(), option)
        if other != option:
            raise ConfigError.of(option, f"{file}: same file as {other}; choose another name")


def known_controllers(name: str | None) -> Controllers:
    """As `api.controllers` has them, imported when a verb asks."""
    from inteco_abs.api import controllers

    return controllers.known_controllers(name)
