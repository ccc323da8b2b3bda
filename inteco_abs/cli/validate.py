"""The verb `inteco-abs validate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from inteco_abs.cli.options import LOSSES, SESSION, json_option
from inteco_abs.cli.terminal import plain, print_json, say

if TYPE_CHECKING:
    from inteco_abs.sessions import Inspection

_CODES: Final = {"well": 0, "losses": LOSSES, "wrong": 1}
_WORST_FIRST: Final = ("wrong", "losses", "well")


@click.command()
@click.argument("files", type=SESSION, nargs=-1, required=True, metavar="FILE...")
@json_option
def validate(files: tuple[Path, ...], as_json: bool) -> int:
    """Check sessions byte by byte.

    It checks checksums, gaps, times, schema, hash, metadata and index. Ends with 0 if all is well, 3 if something is
    missing and the rest is right, 1 if something is wrong.
    """
    from inteco_abs.sessions import validate as inspect

    inspections = list(map(inspect, files))
    if as_json:
        print_json({"schema_version": 1, "sessions": list(map(_facts, inspections))})
    else:
        for inspection in inspections:
            for finding in inspection.findings:
                say(f"{inspection.path}: {plain(finding.place)}: {finding.severity}: {plain(finding.problem)}")
            say(f"{inspection.path}: {inspection.verdict}, {inspection.ticks} ticks")
    verdicts = {inspection.verdict for inspection in inspections}
    return _CODES[next(verdict for verdict in _WORST_FIRST if verdict in verdicts)]


def _facts(inspection: Inspection) -> dict[str, Any]:
    return {
        "session": str(inspection.path),
        "verdict": inspection.verdict,
        "ticks": inspection.ticks,
        "findings": [finding._asdict() for finding in inspection.findings],
    }
