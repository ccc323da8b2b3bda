"""A step of the commissioning and its context."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import date, datetime
from typing import Any, NamedTuple

from inteco_abs.commissioning.operator import Operator
from inteco_abs.commissioning.profile_draft import ProfileDraft
from inteco_abs.commissioning.rig_access import RigAccess

Facts = Mapping[str, Any]
"""Result of a step, in JSON's types."""


@dataclass(frozen=True, slots=True)
class StepContext:
    """The rig, the draft to write, and the operator."""

    rig: RigAccess
    draft: ProfileDraft
    operator: Operator
    quiet: bool = False
    """Take defaults instead of asking."""

    @property
    def logic_version(self) -> int:
        """Logic version of the board, as the header step read it."""
        return int(self.draft.results["header"]["logic_version"], 16)


class Step(NamedTuple):
    """A step: what it does, its risk, and what its result holds for."""

    name: str
    does: str
    risk: str
    if_it_fails: str
    run: Callable[[StepContext], Facts]
    rests_on: tuple[str, ...] = ()
    """Keys of the wiring that the result holds for; if one changes, the step is outdated."""


def today() -> date:
    """Local date."""
    return datetime.now().astimezone().date()
