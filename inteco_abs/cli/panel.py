"""The verb `inteco-abs panel`."""

from __future__ import annotations

import sys
from importlib.util import find_spec

import click

from inteco_abs.cli.dry_run import check_manual_start
from inteco_abs.cli.options import RunOptions, run_options
from inteco_abs.cli.terminal import Terminal, on_terminal, say
from inteco_abs.errors import AbsError, ConfigError


@click.command()
@run_options("board", "rig", "config", "settings", "faults")
@click.option("--outputs", is_flag=True, help="Allow the motors to move, after you confirm the rig is safe.")
@click.option(
    "--dry-run", is_flag=True, help="With --outputs, only check whether it could begin, and print its limits."
)
def panel(options: RunOptions, outputs: bool, dry_run: bool) -> int:
    """Watch the board, and drive its motors while a key is held.

    Without --outputs it only reads. With --outputs, drive and brake follow their sliders while you hold a key.
    """
    from inteco_abs.commissioning import CONFIRMED_OFF, PHRASE, PROVES_ITSELF, REQUEST, Panel, require_phrase
    from inteco_abs.experiment import manual_control
    from inteco_abs.mock_board import parse_faults
    from inteco_abs.signals import EXPLANATIONS, Reason

    rig, board = options.load(), options.board
    injected = parse_faults(options.faults)
    if dry_run and not outputs:
        raise ConfigError.of("--dry-run", "only with --outputs: without them the panel only reads")
    if dry_run:
        return check_manual_start(rig, board, injected, (_require_textual, _require_terminal))
    _require_textual()
    _require_terminal()
    from inteco_abs.cli.panel_screen import ARM_AGAIN, PanelApp

    if outputs:
        require_phrase(Terminal(), REQUEST, PHRASE)
    code: int | None = ARM_AGAIN
    while code == ARM_AGAIN:
        if outputs:
            say(PROVES_ITSELF, err=True)
        by_person = Panel(rig, outputs=outputs)
        with manual_control(rig, board, outputs=outputs, faults=injected) as side:
            app = PanelApp(by_person, side, board)
            code = app.run(mouse=False)
        if outputs:
            say(CONFIRMED_OFF, err=True)
        if by_person.reason is not Reason.NONE:
            say(f"inteco-abs: {EXPLANATIONS[by_person.reason]}", err=True)
    return app.return_code or 1 if code is None else code


def _require_textual() -> None:
    if find_spec("textual") is None:
        raise AbsError("the panel needs textual: pip install 'inteco-abs[panel]'; nothing was started")


def _require_terminal() -> None:
    if not (on_terminal(sys.stdin) and on_terminal(sys.stderr)):
        raise AbsError("the panel needs a terminal for keys and screen: run it in one; nothing was started")
