"""The verb `inteco-abs recover`."""

from __future__ import annotations

from pathlib import Path

import click

from inteco_abs.cli.options import FILE, LOSSES, json_option
from inteco_abs.cli.terminal import plain, print_card, print_json, say


@click.command()
@click.argument("file", type=FILE)
@click.option("--out", "-o", type=FILE, required=True, help="Session file to write.")
@json_option
def recover(file: Path, out: Path, as_json: bool) -> int:
    """Rebuild a session from a damaged file or a crashed run.

    FILE is a damaged or cut session, which stays as it is, or the shared memory of a run whose processes all crashed.
    A damaged file gives every tick of every chunk with a correct checksum. Ends with 3 if something was lost.
    """
    from inteco_abs.realtime import is_ring
    from inteco_abs.sessions import check_session_file

    check_session_file(out)
    return _recover_ring(file, out, as_json) if is_ring(file) else _recover_file(file, out, as_json)


def _recover_ring(ring: Path, out: Path, as_json: bool) -> int:
    from inteco_abs.realtime.processes.recorder import recover_run

    result = recover_run(ring, out)
    if as_json:
        print_json(result.card)
    else:
        print_card(result.card, result.explanation)
    return LOSSES if result.card["lost_ticks"] else 0


def _recover_file(file: Path, out: Path, as_json: bool) -> int:
    from inteco_abs.sessions import recover_session

    recovery = recover_session(file, out)
    if as_json:
        print_json({**recovery.card, "missing_ticks": recovery.missing, "losses": recovery.losses})
    else:
        ticks = recovery.card["ticks"]
        say(f"{out}: {ticks} ticks recovered, {'with losses' if recovery.losses else 'nothing was lost'}")
        for loss in recovery.losses:
            say(f"  lost: {plain(loss)}")
    return LOSSES if recovery.losses else 0
