"""The command's group of verbs, and the top of its process."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Collection
from contextlib import suppress
from importlib import import_module
from io import TextIOWrapper
from typing import Final, NoReturn

import click

from inteco_abs.cli.options import INTERRUPTED, VerbGroup
from inteco_abs.cli.terminal import say
from inteco_abs.errors import AbsError

_VERBS: Final = {
    "Run": ("run", "repeat", "serve", "demo"),
    "Sessions": (
        "list", "info", "play", "annotate", "report", "figure", "video", "diff", "replay", "what-if", "golden",
        "export", "dataset", "publish", "extract", "viewer-layout", "validate", "recover",
    ),
    "Compare and design": ("controllers", "estimators", "sweep", "benchmark", "design", "identify", "paper", "fmu"),
    "Course": ("grade",),
    "Boards and commissioning": ("commission", "panel", "identify-led", "mock-board", "faults", "wire"),
    "Setup": ("setup", "doctor", "config", "profiles", "completion"),
}  # fmt: skip
"""Verbs by heading of the help; the module of a verb is named as the verb."""
_OLD_NAMES: Final = {"blink": "identify-led", "get": "extract", "layout": "viewer-layout", "probe": "commission"}
_SYNONYMS: Final = {
    **dict.fromkeys(("start", "brake", "stop"), "run"),
    **dict.fromkeys(("simulate", "simulation", "sim", "virtual"), "run --virtual"),
    **dict.fromkeys(("plot", "graph", "image"), "figure"),
    **dict.fromkeys(("show", "open", "print", "summary"), "info"),
    **dict.fromkeys(("ls", "find", "search", "runs", "sessions"), "list"),
    **dict.fromkeys(("fit", "estimate"), "identify"),
    **dict.fromkeys(("csv", "convert", "save"), "export"),
    **dict.fromkeys(("install", "permissions", "udev"), "setup"),
    "batch": "repeat", "calibrate": "commission", "check": "doctor", "compare": "diff", "help": "--help",
    "montecarlo": "sweep", "repair": "recover", "test": "golden test", "tune": "run --tune or design",
    "version": "--version",
}  # fmt: skip
"""What other programs call it."""


class _Verbs(VerbGroup):
    """All verbs; a verb's module is imported when the verb is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002  click's interface
        return [name for names in _VERBS.values() for name in names]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        name = _OLD_NAMES.get(cmd_name, cmd_name)
        if name in self.list_commands(ctx) and name not in self.commands:
            module = import_module(f"inteco_abs.cli.{name.replace('-', '_')}")
            commands = [each for each in vars(module).values() if isinstance(each, click.Command)]
            self.add_command(next(each for each in commands if each.name == name))
        return super().get_command(ctx, cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for heading, names in _VERBS.items():
            self.write_commands(ctx, formatter, heading, names)


@click.group(
    cls=_Verbs,
    aliases=_OLD_NAMES,
    synonyms=_SYNONYMS,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(package_name="inteco-abs")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def cli(debug: bool) -> None:
    """Driver, controller and laboratory for the Inteco anti-lock braking rig."""


def _describe_system_error(error: OSError) -> str:
    """What the system refused; for the working folder and for standard output it gives no name."""
    if error.filename:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, FileNotFoundError):
        return "the current folder no longer exists; change to another"
    return f"the output cannot be written: {error.strerror or error}"


def _with_settings(error: click.NoSuchOption) -> click.UsageError:
    """The error with the settings of the name that was typed as an option, as --Mk for controller.gains.Mk."""
    command = error.ctx.command if error.ctx else None
    if command is None or not any("--set" in parameter.opts for parameter in command.params):
        return error
    from inteco_abs.config.explain import all_keys
    from inteco_abs.control import CONTROLLERS

    name = error.option_name.lstrip("-").replace("-", "_")
    keys = dict.fromkeys(key.path for key in all_keys(CONTROLLERS) if key.path.rpartition(".")[2] == name)
    meant = " or ".join(f"--set {key}=VALUE" for key in keys)
    return click.UsageError(f"{error.message} Did you mean {meant}?", error.ctx) if meant else error


def _replace_missing_letters() -> None:
    """Print ? for letters that the output's encoding does not have, as those of consoles of Windows."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper) and stream.errors in {"strict", "surrogateescape"}:
            stream.reconfigure(errors="replace")


def main() -> None:
    """Entry point of the command: maps every way to end to its exit code, without a traceback."""
    debug = "--debug" in sys.argv
    _replace_missing_letters()
    threads = threading.enumerate()
    try:
        code = cli.main(prog_name="inteco-abs", standalone_mode=False)
    except click.ClickException as error:
        (_with_settings(error) if isinstance(error, click.NoSuchOption) else error).show()
        code = error.exit_code
    except AbsError as error:
        if debug:
            raise
        for line in (str(error), *getattr(error, "__notes__", ())):
            say(f"inteco-abs: {line}", err=True)
        code = error.exit_code
    except (KeyboardInterrupt, click.Abort):
        say("inteco-abs: interrupted", err=True)
        code = INTERRUPTED
    except OSError as error:  # above all the output that went away: a closed pipe, a full disk
        sys.stdout = sys.stderr
        say(f"inteco-abs: {_describe_system_error(error)}", err=True)
        code = 1
    except MemoryError:
        say("inteco-abs: there is not enough memory; end other programs, or allow more (ulimit -v)", err=True)
        code = 1
    except Exception as error:  # the top of the process: a bug must not look like the user's mistake
        if debug or isinstance(error.__cause__, KeyboardInterrupt):
            raise
        say(
            f"inteco-abs: internal error, please report it: {type(error).__name__}: {error}\n"
            "  inteco-abs --debug ... shows where",
            err=True,
        )
        code = 1
    _leave(code, threads)


def _leave(code: int, threads: Collection[threading.Thread]) -> NoReturn:
    """End with the exit code, and do not wait for others than these `threads`, which a user's code has left running."""
    if any(not thread.daemon for thread in threading.enumerate() if thread not in threads):
        with suppress(OSError):
            sys.stdout.flush()
        os._exit(code)
    sys.exit(code)
