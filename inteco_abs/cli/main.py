"""The group of all verbs, and the top of the process."""

from __future__ import annotations

import sys
from typing import Final

import click

from inteco_abs.cli.catalogue import controllers, estimators, profiles
from inteco_abs.cli.commission import probe
from inteco_abs.cli.completion import completion
from inteco_abs.cli.config import config
from inteco_abs.cli.contents import export, get
from inteco_abs.cli.demo import demo
from inteco_abs.cli.design import design
from inteco_abs.cli.diff import diff
from inteco_abs.cli.doctor import doctor
from inteco_abs.cli.faults import faults
from inteco_abs.cli.golden import golden
from inteco_abs.cli.health import recover, validate
from inteco_abs.cli.identify import identify
from inteco_abs.cli.identify_led import blink
from inteco_abs.cli.list import list_sessions
from inteco_abs.cli.mock_board import mock_board
from inteco_abs.cli.options import INTERRUPTED, VerbGroup, say
from inteco_abs.cli.panel import panel
from inteco_abs.cli.paper import paper
from inteco_abs.cli.repeat import repeat
from inteco_abs.cli.replay import replay
from inteco_abs.cli.report import report
from inteco_abs.cli.run import run
from inteco_abs.cli.sessions import figure, info
from inteco_abs.cli.sweep import sweep
from inteco_abs.cli.viewer_layout import layout
from inteco_abs.cli.what_if import what_if
from inteco_abs.cli.wire import wire
from inteco_abs.errors import AbsError


@click.group(cls=VerbGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="inteco-abs")
@click.option("--debug", is_flag=True, help="Show the traceback of an error.")
def cli(debug: bool) -> None:
    """Driver, controller and laboratory for the Inteco anti-lock braking rig."""


_VERBS: Final = (
    run,
    repeat,
    demo,
    replay,
    what_if,
    golden,
    list_sessions,
    info,
    diff,
    report,
    figure,
    export,
    get,
    layout,
    validate,
    recover,
    design,
    sweep,
    identify,
    paper,
    doctor,
    probe,
    panel,
    blink,
    wire,
    mock_board,
    controllers,
    estimators,
    profiles,
    faults,
    config,
    completion,
)
for _verb in _VERBS:
    cli.add_command(_verb)


def _told(error: OSError) -> str:
    """What the system has refused; of the working folder and of standard output it tells no name."""
    if error.filename:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, FileNotFoundError):
        return "the folder in which this was typed does not exist any more; change to another"
    return f"the output cannot be written: {error.strerror or error}"


def main() -> None:
    """Entry point of the command: maps every way to end to its exit code, without a traceback."""
    debug = "--debug" in sys.argv
    try:
        code = cli.main(prog_name="inteco-abs", standalone_mode=False)
    except click.ClickException as error:
        error.show()
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
        say(f"inteco-abs: {_told(error)}", err=True)
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
    sys.exit(code)
