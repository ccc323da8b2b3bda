"""A dry run on a terminal: the plan, what it needs, and whether it would begin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text


def render_preflight(report: Mapping[str, Any]) -> RenderableType:
    """Report of a dry run; what speaks against a run comes last, where it is seen."""
    facts = _grid()
    for name, text in _facts(report):
        facts.add_row(name, text)
    runs = [*_run(report["runs"][0])] if len(report["runs"]) == 1 else [_runs(report)]
    against = _grid()
    for text in report["cautions"]:
        against.add_row(Text("note", "yellow"), text)
    for one in report["refused"]:
        where = f"{one['where']}: " if one["where"] else ""
        against.add_row(Text("refused", "bold red"), where + one["problem"])
    return Group(*(*runs, Text()) if report["runs"] else (), facts, Text(), against, _verdict(report))


def _verdict(report: Mapping[str, Any]) -> Text:
    count = len(report["refused"])
    if not count:
        return Text(
            "It would begin. This was a dry run: no output or setting was written, and nothing to a disk.", "green"
        )
    reasons = "for this reason" if count == 1 else f"for these {count} reasons"
    return Text(f"It would not begin, {reasons}. This was a dry run: nothing was started.", "bold red")


def _run(run: Mapping[str, Any]) -> Iterator[RenderableType]:
    """Phases, if all runs are alike."""
    times = f"{run['times']} runs of " if run["times"] > 1 else ""
    stops = f"{run['stops']} stops, each" if run["stops"] > 1 else "one stop"
    yield Text(f"{times}{stops}, at {run['rate_hz']:g} Hz:")
    table = _grid()
    for part in run["phases"]:
        length = f"{part['seconds']:g} s" if part["fixed"] else f"at most {part['seconds']:g} s"
        table.add_row(part["phase"], f"{length}: {part['does']}")
    yield table


def _runs(report: Mapping[str, Any]) -> Table:
    """One line for each of several runs."""
    table = _grid()
    for run in report["runs"]:
        drive = f"drive {run['drive']:g} to {run['start_speed_rad_s']:g} rad/s"
        text = f"{run['shows']}; {drive}; at most {run['longest_s']:g} s, {run['rate_hz']:g} Hz"
        table.add_row(run["session"], text)
    return table


def _facts(report: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    guard = report["guard"]
    if report["runs"]:
        time = "virtual time" if report["virtual"] else "real time"
        pauses = f", pauses of {report['pause_s']:g} s between runs included" if report["pause_s"] else ""
        yield "lasts", f"at most {report['longest_s']:g} s in {time}{pauses}"
    limits = (
        f"brake at most {guard['brake_limit']:g}, drive at most {guard['drive_limit']:g}, "
        f"stops above {guard['over_speed_rad_s']:g} rad/s, after {guard['missed_in_a_row']} missed exchanges in a row "
        f"and after {guard['silence_s']:g} s of silence"
    )
    yield "guard", limits
    yield from _board(report["board"])
    if len(report["runs"]) == 1:
        yield "session", report["runs"][0]["session"]
    for need in report["needs"]:
        free = "" if need["free_bytes"] is None else f"; {size(need['free_bytes'])} are free"
        yield need["what"], f"at most {size(need['bytes'])} in {need['where']}{free}"
    computer = report["computer"]
    if computer is not None:
        counts = ", ".join(f"{computer[verdict]} {verdict}" for verdict in ("green", "amber", "red"))
        yield "computer", f"{computer['verdict']} ({counts}); inteco-abs doctor has the details"
        for finding in computer["not_fit"]:
            yield "", f"{finding['name']}: {finding['found']} -> {finding['fix']}"


def _board(board: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    if board["says"] is None:
        yield "board", f"{board['address']} could not be read"
        return
    outputs = "outputs may be used" if board["outputs_allowed"] else "opens for reading only"
    yield "board", f"{board['address']} {board['says']}: {outputs}"
    for number, one in enumerate(board["first_write"]):
        text = one["remark"] or f"0x{one['now']:04X} -> 0x{one['planned']:04X}"
        yield "" if number else "first write", f"{one['place']} {', '.join(one['names'])}: {text}"
    if board["moved_counts"] is not None:
        wheel, road = board["moved_counts"]
        yield "at rest", f"upper wheel {wheel:+d} counts, lower wheel {road:+d}"
    if board["read_us"] is not None:
        yield "readings", f"p50 {board['read_us']['p50']:.0f} us, max {board['read_us']['max']:.0f} us"


def _grid() -> Table:
    table = Table.grid(padding=(0, 2))
    table.add_column(overflow="fold")
    table.add_column(overflow="fold")
    return table


def size(count: int) -> str:
    """A number of bytes in MB or GB."""
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.1f} MB"
