"""Verbs for sessions that may be damaged: validate, recover."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from inteco_abs.cli.options import FILE, LOSSES, check_session_file, json_option, plain, print_card, print_json, say

if TYPE_CHECKING:
    from inteco_abs.sessions import Inspection, Recovery

_CODES: Final = {"well": 0, "losses": LOSSES, "wrong": 1}
_WORST_FIRST: Final = ("wrong", "losses", "well")


@click.command()
@click.argument("files", type=FILE, nargs=-1, required=True, metavar="FILE...")
@json_option
def validate(files: tuple[Path, ...], as_json: bool) -> int:
    """Check sessions byte by byte: checksums, gaps, times, schema, hash, metadata, index.

    Ends with 0 if all is well, 3 if something is missing and the rest is right, 1 if something is wrong.
    """
    from inteco_abs.sessions import validate as inspect

    inspections = list(map(inspect, files))
    if as_json:
        print_json({"schema_version": 1, "sessions": list(map(_told, inspections))})
    else:
        for inspection in inspections:
            _print(inspection)
    verdicts = {inspection.verdict for inspection in inspections}
    return _CODES[next(verdict for verdict in _WORST_FIRST if verdict in verdicts)]


def _told(inspection: Inspection) -> dict[str, Any]:
    return {
        "session": str(inspection.path),
        "verdict": inspection.verdict,
        "ticks": inspection.ticks,
        "findings": [finding._asdict() for finding in inspection.findings],
    }


def _print(inspection: Inspection) -> None:
    for finding in inspection.findings:
        say(f"{inspection.path}: {plain(finding.place)}: {finding.severity}: {plain(finding.problem)}")
    say(f"{inspection.path}: {inspection.verdict}, {inspection.ticks} ticks")


@click.command()
@click.argument("file", type=FILE)
@click.option("--out", "-o", type=FILE, required=True, help="Session file to write.")
@json_option
def recover(file: Path, out: Path, as_json: bool) -> int:
    """Write a whole session of what is left of one in FILE.

    FILE is a damaged or cut session, or the memory that a run has left whose processes all crashed. A damaged file
    gives every tick of every chunk whose checksum is right; it stays as it is. Ends with 3 if something was lost.
    """
    from inteco_abs.realtime.memory import is_ring

    check_session_file(out)
    return _recover_ring(file, out, as_json) if is_ring(file) else _recover_file(file, out, as_json)


def _recover_ring(ring: Path, out: Path, as_json: bool) -> int:
    from inteco_abs.realtime.processes.recorder import recover_run

    account = recover_run(ring, out)
    if as_json:
        print_json(account.card)
    else:
        print_card(account.card, account.explanation)
    return LOSSES if account.card["lost_ticks"] else 0


def _recover_file(file: Path, out: Path, as_json: bool) -> int:
    from inteco_abs.sessions import recover_session

    recovery = recover_session(file, out)
    if as_json:
        print_json({**recovery.card, "missing_ticks": recovery.missing, "losses": recovery.losses})
    else:
        _print_recovery(out, recovery)
    return LOSSES if recovery.losses else 0


def _print_recovery(out: Path, recovery: Recovery) -> None:
    ticks = recovery.card["ticks"]
    say(f"{out}: {ticks} ticks recovered, {'with losses' if recovery.losses else 'nothing was lost'}")
    for loss in recovery.losses:
        say(f"  lost: {plain(loss)}")
