"""The verb `inteco-abs demo`: a guided tour on the mock board."""

from __future__ import annotations

import importlib.util
import shlex
import sys
from contextlib import chdir
from pathlib import Path
from textwrap import fill
from typing import Final, NamedTuple

import click

from inteco_abs.cli.options import FILE, LOSSES
from inteco_abs.cli.terminal import on_terminal, say

_WIDTH: Final = 79


class Step(NamedTuple):
    """One command of the tour, and its purpose."""

    why: str
    command: str
    needs: str = ""
    """Module without which the step is skipped."""


STEPS: Final = (
    Step(
        "A braking stop on the simulated rig, in virtual time, with the paper's sliding mode controller. It "
        "prints the result card; the session has every tick.",
        "run --virtual --seed 1 --out paper.mcap",
    ),
    Step(
        "The same rig with a controller that models the dead time and lag of the brake.",
        "run --virtual --seed 1 --controller predictive-reaching --out ours.mcap",
    ),
    Step("Both as a figure.", "figure paper.mcap ours.mcap -o both.png", "matplotlib"),
    Step("Both as a page to zoom into: open it in a browser.", "report paper.mcap ours.mcap -o both.html", "bokeh"),
    Step(
        "Every decision of a session can be repeated from the logged counts, and is the same to the last bit.",
        "replay paper.mcap",
    ),
    Step(
        "What would other gains have commanded? On the logged counts the answer holds until the two diverge; with "
        "--closed-loop the simulation continues from there.",
        "what-if paper.mcap --set controller.gains.Mk=10 --at 0.4 --closed-loop",
    ),
    Step(
        "Now in real time, as processes: a loop at 2 kHz, a recorder, and a guardian that makes the board safe when "
        "the loop dies. Ctrl-C stops a run safely at any time. A busy computer may be late at times.",
        "run --board sim: --out real-time.mcap",
    ),
    Step("All sessions of this folder with their results.", "list ."),
)


@click.command()
@click.option("-o", "--out", "folder", type=FILE, default="demo", show_default=True, help="Folder for its files.")
@click.option("--no-wait", is_flag=True, help="Do not wait for Enter before each step.")
@click.pass_context
def demo(context: click.Context, folder: Path, no_wait: bool) -> int:
    """Take a two-minute tour on the mock board.

    Each step is a command, printed as you would type it. It writes to its own folder only and touches no hardware.
    Ends with 3 if the computer was late in the real-time step.
    """
    from inteco_abs.sessions import ensured_directory

    folder = folder.absolute()
    waits = not no_wait and on_terminal(sys.stdin)
    worst = 0
    with ensured_directory(folder, new=True), chdir(folder):
        for number, step in enumerate(STEPS, 1):
            click.secho("\n" + fill(f"{number} of {len(STEPS)}: {step.why}", _WIDTH), bold=True, err=True)
            if step.needs and importlib.util.find_spec(step.needs) is None:
                say(f"skipped: it needs {step.needs}, which is not installed", err=True)
                continue
            say(f"$ inteco-abs {step.command}", err=True)
            if waits:
                _wait()
            code = context.find_root().command.main(shlex.split(step.command), "inteco-abs", standalone_mode=False)
            if code not in (0, LOSSES):
                return int(code)
            worst = max(worst, code)
    click.secho(f"\nAll files are in {folder}. `inteco-abs --help` lists the commands.", bold=True, err=True)
    return worst


def _wait() -> None:
    try:
        click.prompt("Enter", default="", show_default=False, prompt_suffix=" ", err=True)
    except click.Abort:
        say(err=True)  # the prompt's line is not over, and what comes next is not part of it
        raise
