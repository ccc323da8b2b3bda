"""The verb `inteco-abs faults`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import click

from inteco_abs.cli.options import json_option
from inteco_abs.cli.terminal import print_json, say

if TYPE_CHECKING:
    from inteco_abs.mock_board.faults.kinds import FaultValue


@click.command()
@json_option
def faults(as_json: bool) -> int:
    """List the faults that the mock board can inject.

    For --inject KIND[=VALUE]@[EVENT+]WHEN[/HOW LONG] of run, repeat and panel.
    """
    from inteco_abs.mock_board.faults import KINDS, FaultEvent

    if as_json:
        found = {
            name: {
                "meaning": kind.meaning,
                "value": _facts(kind.value) if kind.value else None,
                "lasting": kind.lasting,
            }
            for name, kind in KINDS.items()
        }
        print_json({"schema_version": 1, "faults": found, "events": [event.value for event in FaultEvent]})
        return 0
    usages = {name: f"{name}{kind.value.usage if kind.value else ''}" for name, kind in KINDS.items()}
    width = max(map(len, usages.values()))
    for name, kind in KINDS.items():
        say(f"{usages[name]:{width}}  {kind.meaning}{'; for good' if kind.lasting else ''}")
    say(
        "\nWHEN and HOW LONG are times, as 500us, 20ms, 1.5s, or exchanges, as #40.\n"
        "EVENT is start, drive (energised for the first time), coast (switched off) or brake.\n"
        "Without HOW LONG a fault lasts for one exchange, or for good.\n"
        "In real time the guardian's drill comes first, and counts: time from drive, coast or brake there."
    )
    return 0


def _facts(value: FaultValue) -> dict[str, Any]:
    """JSON has no infinity: a word has no limits."""
    facts = value._asdict()
    return {name: None if isinstance(fact, float) and math.isinf(fact) else fact for name, fact in facts.items()}
