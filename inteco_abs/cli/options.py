"""What the verbs have in common: options, exit codes, and reading a session with a word about its losses."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TextIO

import click

from inteco_abs.errors import ConfigError, ConfigIssue, near_match
from inteco_abs.quantities import number_hint

if TYPE_CHECKING:
    from inteco_abs.montecarlo import Progress
    from inteco_abs.plugins import Controllers
    from inteco_abs.sessions import Session

LOSSES: Final = 3
DIFFERS: Final = 4
INTERRUPTED: Final = 130
_LONGEST_SENTENCE: Final = 200
FILE: Final = click.Path(path_type=Path, readable=False)
"""Each verb says itself what it cannot read, in its own words and with its own exit code."""


class Finite(click.FloatRange):
    """A number in `unit` within its range: neither infinite nor NaN, which is in every range."""

    def __init__(self, least: float | None = None, most: float | None = None, *, unit: str = "") -> None:
        super().__init__(least, most)
        self._unit = unit

    def _describe_range(self) -> str:
        """For the help; without limits click would say x<=None."""
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

    def __init__(self, least: int | None = None, most: int | None = None) -> None:
        super().__init__(least, most)

    def _describe_range(self) -> str:
        """The same of whole numbers."""
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
    """KEY=VALUE. Looked at here only for its =, as a value in an argument of its own is nobody's otherwise."""

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
    """Group that suggests the nearest verb, and says of each its whole first sentence."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in self.commands:
            raise click.UsageError(f"no command {args[0]!r}{near_match(args[0], self.commands)}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Wrapped, where click would cut them off."""
        with formatter.section("Commands"):
            formatter.write_dl(
                [(name, self.commands[name].get_short_help_str(_LONGEST_SENTENCE)) for name in self.list_commands(ctx)]
            )


def on_terminal(stream: TextIO | None) -> bool:
    """Whether a person is at the other end; a stream that the shell has closed is None."""
    return stream is not None and stream.isatty()


def json_option(function: Callable[..., Any]) -> Callable[..., Any]:
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead.")(function)


def rig_option(function: Callable[..., Any]) -> Callable[..., Any]:
    return click.option(
        "--rig",
        "drawn",
        metavar="POPULATION:SEED",
        help="A drawn virtual rig inside the mock board, as hard:17; default: the published one.",
    )(function)


def drawn_setting(drawn: str | None) -> list[str]:
    """What `--rig` says, as for `--set`."""
    return [] if drawn is None else [f"simulation.rig={json.dumps(drawn)}"]


def print_json(data: Mapping[str, Any]) -> None:
    say(json.dumps(data, allow_nan=False, default=date.isoformat))


def say(text: str = "", *, err: bool = False, nl: bool = True) -> None:
    """Print lines: the only way by which text reaches a terminal, as any of it may come out of a stranger's file."""
    click.echo("\n".join(map(plain, text.split("\n"))), err=err, nl=nl)  # noqa: TID251


def plain(text: object) -> str:
    """Text out of a file as a part of a line: nothing in it moves the cursor, changes colours or begins a line."""
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in str(text))


def print_card(card: Mapping[str, Any], explanation: str, before: Mapping[str, Any] | None = None) -> None:
    """A result card; `before` is the one to compare it with."""
    from rich.console import Console

    from inteco_abs.views import render_card

    console = Console()
    shown, earlier = _in_plain(card), None if before is None else _in_plain(before)
    console.print(render_card(shown, plain(explanation), earlier, plain=console.options.ascii_only))


def _in_plain(card: Mapping[str, Any]) -> dict[str, Any]:
    return {key: plain(value) if isinstance(value, str) else value for key, value in card.items()}


def read_whole(file: Path, reader: Callable[[Path], Session]) -> Session:
    session = reader(file)
    tell_of_losses(session)
    return session


def tell_of_losses(session: Session) -> None:
    """What a session lacks, and what to do about it."""
    if session.incomplete:
        ticks = len(session.ticks)
        whole = f"{ticks} ticks are whole{', and recover makes a session of them' if ticks else ''}"
        say(f"inteco-abs: {session.path}: {session.incomplete}; {whole}", err=True)
    if session.beyond:
        say(f"inteco-abs: {session.path}: {plain(session.beyond)}", err=True)


def draw(files: Sequence[Path], out: Path, width: str = "two") -> bool:
    """Whether all of the files were whole, and all of them known here."""
    from inteco_abs.sessions import read_session
    from inteco_abs.views.figure import draw_stops

    sessions = [read_whole(file, read_session) for file in files]
    draw_stops(sessions, out, width)
    say(f"figure: {out}", err=True)
    return not any(session.incomplete or session.beyond for session in sessions)


def check_session_file(out: Path) -> None:
    """Refuse, before anything is started, a path where no new session can be, or where `list` would not see it."""
    from inteco_abs.sessions import check_output

    check_output(out)
    if out.suffix != ".mcap":
        raise ConfigError([ConfigIssue("--out", f"{out}: must end in .mcap, by which sessions are found")])


def check_table(path: Path | None) -> None:
    """Refuse, before anything is computed, a path where no new table can be."""
    from inteco_abs.sessions import check_output

    if path is None:
        return
    check_output(path, "--csv")
    if path.suffix != ".csv":
        raise ConfigError([ConfigIssue("--csv", f"{path}: must end in .csv")])


def require_different(files: dict[str, Path | None]) -> None:
    """Each output its own file: the later would replace the earlier."""
    seen: dict[Path, str] = {}
    for option, file in files.items():
        if file is None:
            continue
        other = seen.setdefault(file.resolve(), option)
        if other != option:
            raise ConfigError([ConfigIssue(option, f"{file}: is the file of {other} already; choose another name")])


def known_controllers(name: str | None) -> Controllers:
    """Controllers to choose from, with the user's own if `name` is `file.py:Class`."""
    from inteco_abs.plugins import FROM_FILE, Controllers, Origin, load_controller

    if name is None or FROM_FILE not in name:
        controllers = Controllers()
        if name is not None and name not in controllers:
            file = name if name.endswith(".py") else f"{name}.py"
            if name == file or os.path.isfile(file):  # noqa: PTH113  a name too long for a file is not an error here
                raise ConfigError([ConfigIssue("--controller", f"{name}: name the class too, as in {file}:Class")])
        return controllers
    kind, source = load_controller(name)
    return Controllers({name: (kind, Origin(source))})


@contextmanager
def stops_progress() -> Iterator[Progress | None]:
    """A bar on a terminal's stderr."""
    if not on_terminal(sys.stderr):
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("stops"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("compiling, then braking", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total, description="braking")
