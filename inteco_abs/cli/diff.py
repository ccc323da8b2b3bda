"""The verb `inteco-abs diff`."""

from __future__ import annotations

from pathlib import Path

import click

from inteco_abs.cli.options import DIFFERS, LOSSES, SESSION, Finite, json_option
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import plain, print_json, say


@click.command()
@click.argument("a", type=SESSION)
@click.argument("b", type=SESSION)
@click.option("--only", multiple=True, metavar="SECTION", help="Compare this section only; may be repeated.")
@click.option(
    "--rel", type=Finite(0, 1), default=0.0, help="Relative difference of metrics and signals that counts as equal."
)
@json_option
def diff(a: Path, b: Path, only: tuple[str, ...], rel: float, as_json: bool) -> int:
    """Show what changed from session A to session B.

    Sections: outcome, result, signals (from the start of braking on), gains, configuration, software, host, rig. With
    --rel 0.05, metrics may differ by 5 % and signals by 5 % of their peak. Ends with 4 if a compared section differs.
    """
    from inteco_abs.analysis import diff_sessions, require_sections
    from inteco_abs.sessions import read_session

    require_sections(only)
    first, second = (read_whole(file, read_session) for file in (a, b))
    found = diff_sessions(first, second, only, rel)
    if as_json:
        changes = {name: [change._asdict() for change in of_section] for name, of_section in found.changes.items()}
        print_json({"schema_version": 1, "a": str(a), "b": str(b), "equal": found.equal, "changes": changes})
    else:
        for line in found.lines(str(a), str(b)):
            say(plain(line))
    if not found.equal:
        return DIFFERS
    return LOSSES if any(session.incomplete or session.unsupported for session in (first, second)) else 0
