"""The verb `inteco-abs diff`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from inteco_abs.cli.options import DIFFERS, LOSSES, SESSION, Finite, json_option
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import plain, print_json, say
from inteco_abs.errors import ConfigError, ConfigIssue, near_match

if TYPE_CHECKING:
    from inteco_abs.analysis import Change, Diff, SignalChange


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
    from inteco_abs.analysis import SECTIONS, diff_sessions
    from inteco_abs.sessions import read_session

    unknown = [name for name in only if name not in SECTIONS]
    if mistakes := [ConfigIssue("--only", f"no section {name!r}{near_match(name, SECTIONS)}") for name in unknown]:
        raise ConfigError(mistakes)
    first, second = (read_whole(file, read_session) for file in (a, b))
    found = diff_sessions(first, second, only, rel)
    if as_json:
        changes = {name: [change._asdict() for change in of_section] for name, of_section in found.changes.items()}
        print_json({"schema_version": 1, "a": str(a), "b": str(b), "equal": found.equal, "changes": changes})
    else:
        _print(a, b, found)
    if not found.equal:
        return DIFFERS
    return LOSSES if any(session.incomplete or session.unsupported for session in (first, second)) else 0


def _print(a: Path, b: Path, found: Diff) -> None:
    if found.equal:
        say(f"{a} and {b} do not differ in {', '.join(found.changes)}")
    for name, changes in found.changes.items():
        if changes:
            say(name)
        for change in changes:
            say(f"  {plain(_line(change))}")


def _line(change: Change | SignalChange) -> str:
    from inteco_abs.analysis import SignalChange

    if not isinstance(change, SignalChange):
        return f"{change.key}: {_value(change.a)} -> {_value(change.b)}"
    unit = "" if change.unit == "1" else f" {change.unit}"
    line = f"{change.key}: up to {change.max_difference:.4g}{unit} at {change.at_s:.3f} s, "
    line += f"RMS {change.rms_difference:.4g}{unit} over {change.ticks} ticks"
    return f"{line}; {change.one_sided} ticks have a number in one session only" if change.one_sided else line


def _value(value: Any) -> str:
    return "-" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
