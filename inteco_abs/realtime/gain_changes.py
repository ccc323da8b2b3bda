"""Changes of gains while the loop runs: planned ones, and those that a person asks for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from inteco_abs.config import RigConfig
from inteco_abs.control import MOST_CHANGES, ChangePlan, Gain, GainChange, Pipeline, planned_changes, value_problem
from inteco_abs.signals import Phase, Sample

_BRAKING = Phase.BRAKING


class ChangeRequests(Protocol):
    """Where a person's changes arrive, one at a time."""

    def asked(self) -> tuple[str, float] | None:
        """The gain to change now and its new value, or None; a tick without a request costs a comparison."""
        ...

    def answer(self, tick: int) -> None:
        """Say in which tick the change took effect; -1: it was refused."""
        ...


class GainChanges:
    """Changes gains of a `pipeline` between two ticks of the loop, and hands each change to `record`.

    `gains` are those that may change, with their ranges: a request for another one, or out of range, is refused, and so
    are all after `MOST_CHANGES`.
    """

    def __init__(
        self,
        config: RigConfig,
        pipeline: Pipeline,
        gains: Sequence[Gain],
        record: Callable[[GainChange], None],
        requests: ChangeRequests | None = None,
    ) -> None:
        self._pipeline, self._gains, self._record, self._requests = pipeline, gains, record, requests
        self._plan = ChangePlan(planned_changes(config.experiment.changes), config.loop.rate_hz)
        self._made = 0

    @property
    def over(self) -> bool:
        """Whether no change can follow."""
        return self._plan.over and self._requests is None

    def before(self, sample: Sample) -> None:
        """Make the changes that take effect with the decision on `sample`."""
        tick = sample.tick
        for planned in self._plan.due(tick, braking=self._pipeline.phase is _BRAKING):
            self._make(tick, planned.name, planned.value)
        if self._requests is not None and tick > 0:
            asked = self._requests.asked()
            if asked is not None:
                self._requests.answer(tick if self._make(tick, *asked) else -1)

    def _make(self, tick: int, name: str, value: float) -> bool:
        if self._made == MOST_CHANGES or value_problem(name, value, self._gains):
            return False
        self._made += 1
        self._record(GainChange(tick, name, value))  # first: what follows may end the run
        self._pipeline.change(name, value)
        return True
