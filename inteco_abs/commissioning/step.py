"""One step of the commissioning, and what it works with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import date, datetime
from typing import Any, NamedTuple

from inteco_abs.commissioning.operator import Operator
from inteco_abs.commissioning.profile_draft import ProfileDraft
from inteco_abs.commissioning.rig_access import RigAccess

Facts = Mapping[str, Any]
"""What a step has found, as JSON has it."""


@dataclass(frozen=True, slots=True)
class StepContext:
    """A person at a rig, with a draft to be written."""

    bench: RigAccess
    draft: ProfileDraft
    person: Operator
    quiet: bool = False
    """Ask nothing where a suggestion or a default will do."""

    @property
    def logic_version(self) -> int:
        """Of the board, as the header step has read it."""
        return int(self.draft.results["header"]["logic_version"], 16)


class Step(NamedTuple):
    """What is done, what it may do to the rig, and what its result is good for."""

    name: str
    does: str
    risk: str
    if_it_fails: str
    run: Callable[[StepContext], Facts]
    rests_on: tuple[str, ...] = ()
    """What of the wiring the result holds for; with another it has to be done again."""


def today() -> date:
    """At the rig."""
    return datetime.now().astimezone().date()
