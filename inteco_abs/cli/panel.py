"""The verb `inteco-abs panel`: watch and move the rig by hand."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

import click

from inteco_abs.cli.commission import Terminal
from inteco_abs.cli.completion import key_names
from inteco_abs.cli.dry_run import rehearse_by_hand
from inteco_abs.cli.options import FILE, SETTING, drawn_setting, on_terminal, rig_option, say
from inteco_abs.errors import AbsError, ConfigError, ConfigIssue


@click.command()
@click.option("--board", default="sim:", show_default=True, help="Board address; sim: is the mock board.")
@click.option("--outputs", is_flag=True, help="Let the motors be moved, once you have typed what you made sure of.")
@rig_option
@click.option("--config", type=FILE, help="rig.toml; every key has a default.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    type=SETTING,
    shell_complete=key_names,
    metavar="KEY=VALUE",
    help="Over the file, as in guard.drive_limit=0.3.",
)
@click.option(
    "--inject",
    "faults",
    multiple=True,
    metavar="FAULT",
    help="Let the mock board fail, as in wheel-stuck@5s; `inteco-abs faults` lists all.",
)
@click.option("--dry-run", is_flag=True, help="With --outputs, only tell whether it would begin, and its limits.")
def panel(
    board: str,
    outputs: bool,
    drawn: str | None,
    config: Path | None,
    settings: tuple[str, ...],
    faults: tuple[str, ...],
    dry_run: bool,
) -> int:
    """Set the rig up by hand: encoders, speeds and board facts live; duties while you hold a key.

    Without --outputs it only reads.
    """
    from inteco_abs.boards import check_address, default_profile, simulated
    from inteco_abs.commissioning.operator import require_phrase
    from inteco_abs.commissioning.outputs import PROVES_ITSELF
    from inteco_abs.commissioning.panel import PHRASE, REQUEST, Panel
    from inteco_abs.config import load_config
    from inteco_abs.experiment import by_hand
    from inteco_abs.mock_board import parse_faults, rig_check
    from inteco_abs.signals import EXPLANATIONS, Reason

    check_address(board)
    if drawn is not None and not simulated(board):
        raise ConfigError(
            [ConfigIssue("--rig", f"{board} is a real board, and has a rig; only sim: has one to choose")]
        )
    rig = load_config(config, (*settings, *drawn_setting(drawn)), [rig_check], default_profile(board))
    injected = parse_faults(faults)
    if dry_run and not outputs:
        raise ConfigError([ConfigIssue("--dry-run", "is for --outputs: without them the panel only reads")])
    if dry_run:
        return rehearse_by_hand(rig, board, injected, (_insist_on_textual, _insist_on_terminal))
    _insist_on_textual()
    _insist_on_terminal()
    from inteco_abs.cli.panel_screen import ARM_AGAIN, PanelApp

    if outputs:
        require_phrase(Terminal(), REQUEST, PHRASE)
    code: int | None = ARM_AGAIN
    while code == ARM_AGAIN:
        if outputs:
            say(PROVES_ITSELF, err=True)
        by_person = Panel(rig, outputs=outputs)
        with by_hand(rig, board, outputs=outputs, faults=injected) as side:
            app = PanelApp(by_person, side, board)
            code = app.run(mouse=False)
        if outputs:
            told = "the board has confirmed that both outputs are off; wheels that turn coast for up to 48 s"
            say(told, err=True)
        if by_person.reason is not Reason.NONE:
            say(f"inteco-abs: {EXPLANATIONS[by_person.reason]}", err=True)
    return app.return_code or 1 if code is None else code


def _insist_on_textual() -> None:
    if find_spec("textual") is None:
        raise AbsError("the panel needs textual: pip install 'inteco-abs[panel]'; nothing was started")


def _insist_on_terminal() -> None:
    if not (on_terminal(sys.stdin) and on_terminal(sys.stderr)):
        raise AbsError("the panel needs a terminal for its keys and its screen: run it in one; nothing was started")
