"""The verb `inteco-abs setup`."""

from __future__ import annotations

import getpass
import os
from pathlib import Path

import click

from inteco_abs.cli.options import FILE, LOSSES, json_option
from inteco_abs.cli.terminal import print_json, say
from inteco_abs.errors import ConfigError
from inteco_abs.posix import require_linux


@click.command()
@click.option("--apply", "allowed", is_flag=True, help="Make the changes; without it they are only listed.")
@click.option("--undo", is_flag=True, help="Take back what setup has made, and nothing else; with --apply.")
@click.option(
    "--user", "users", multiple=True, metavar="NAME", help="Who may use the rig; default: you, or who calls sudo."
)
@click.option(
    "--ftdi-serial", metavar="NUMBER", help="Serial number of the FTDI chip of a first-generation RT-DAC/USB."
)
@click.option(
    "--root", type=FILE, default=Path("/"), show_default=True, help="Folder in place of /, as of an image of a disk."
)
@json_option
def setup(allowed: bool, undo: bool, users: tuple[str, ...], ftdi_serial: str | None, root: Path, as_json: bool) -> int:
    """List what this lab computer lacks, and make it with --apply.

    That is: udev rules that open the boards, limits for real-time priority and locked memory, and your place in the
    group of both. It overwrites no file that it has not written. Ends with 3 if something is missing, or left to undo.
    """
    from inteco_abs.host import SET_UP, Setup, Undo, check_serial

    require_linux("setup, which makes a computer ready for a rig,", "virtual runs need none")
    if not root.is_dir():
        raise ConfigError.of("--root", f"{root}: is no folder")
    if undo and (users or ftdi_serial is not None):
        raise ConfigError.of("--undo", "takes back all that setup has made; leave --user and --ftdi-serial out")
    named = users or ([] if undo else [os.environ.get("SUDO_USER") or getpass.getuser()])
    serial = "" if ftdi_serial is None else check_serial(ftdi_serial)
    plan = Undo(root) if undo else Setup(root, named, serial)
    changes = plan.changes()
    left = plan.apply() if allowed else []
    made = [change for change in changes if not change.done]
    if as_json:
        print_json(
            {"schema_version": 1, "applied": allowed, "changes": [each._asdict() for each in changes], "left": left}
        )
    else:
        for change in changes:
            state = "done" if allowed and not change.done else "as is" if change.done else "to do"
            say(f"{state:6} {change.name:16} {change.what}")
            if change.problem:
                say(f"       {'':16} {change.problem}")
        if not changes:
            say("nothing that setup has made is left")
    if allowed and made:
        after = "" if undo else ", and plug the board in again; then inteco-abs doctor checks the rest"
        say(f"inteco-abs: log in again{after}", err=True)
    for command in left:
        say(f"inteco-abs: {command} failed here; restart the computer in its place", err=True)
    if made and not allowed:
        again = f"{SET_UP}{' --undo' if undo else ''}" if root == Path("/") else "the same command with --apply"
        say(f"inteco-abs: nothing was changed; {again} does it", err=True)
    return LOSSES if made and not allowed else 0
