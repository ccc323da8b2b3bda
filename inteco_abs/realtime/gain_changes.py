"""Changes of gains while the loop runs: planned ones, and those that a person asks for.

A request goes through shared memory, one at a time: the process that started the run writes it, the loop looks at one
word in each tick, judges the value itself, and answers with the tick in which it took effect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from threading import Lock
from typing import Final, Protocol

from inteco_abs.config import RigConfig
from inteco_abs.control import REFERENCE, ChangePlan, Gain, GainChange, Pipeline, planned_changes, value_problem
from inteco_abs.errors import AbsError
from inteco_abs.realtime.memory import MOST_CHANGES, Field, RunMemory
from inteco_abs.signals import Phase, Sample

_BRAKING: Final = Phase.BRAKING
_ANSWER_S: Final = 1.0
_ASKED, _ANSWERED, _ANSWER = int(Field.CHANGES_ASKED), int(Field.CHANGES_ANSWERED), int(Field.ANSWER_TICK)


class ChangeRequests(Protocol):
    """Where a person's changes arrive, one at a time."""

    def asked(self) -> tuple[str, float] | None:
        """The gain to change now and its new value, or None."""
        ...

    def answer(self, tick: int) -> None:
        """Say from which tick on the change holds; -1: it was refused."""
        ...


class GainChanges:
    """Changes gains of a `pipeline` between two ticks of the loop, and hands each change to `record`.

    `gains` are those that may change, with their ranges: a request for another one, or out of range, is refused, and so
    are all after `MOST_CHANGES`. A tick without a change costs a few comparisons.
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
        self._planned = not self._plan.over
        self._made = 0

    @property
    def over(self) -> bool:
        """Whether no change can follow."""
        return not self._planned and self._requests is None

    def before(self, sample: Sample) -> None:
        """Make the changes that take effect with the decision on `sample`."""
        tick = sample.tick
        if self._planned:
            for planned in self._plan.due(tick, braking=self._pipeline.phase is _BRAKING):
                self._make(tick, planned.name, planned.value)
            self._planned = not self._plan.over
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


class ChangeTable:
    """The changes of a run in its shared memory, with the names of the gains that its controller declares, in order.

    The loop uses it as `ChangeRequests`.
    """

    def __init__(self, memory: RunMemory, declared: Iterable[str]) -> None:
        self._memory, self._words = memory, memory.words
        self._names = [REFERENCE, *declared]
        self._seen = self._words[_ASKED]

    def asked(self) -> tuple[str, float] | None:
        """The gain to change now and its new value, or None."""
        number = self._words[_ASKED]
        if number == self._seen:
            return None
        self._seen = number
        gain, value = self._memory.asked_change()
        return self._names[gain] if 0 <= gain < len(self._names) else "", value

    def answer(self, tick: int) -> None:
        """Say from which tick on the change holds; -1: it was refused."""
        self._words[_ANSWER] = tick
        self._words[_ANSWERED] = self._seen

    def record(self, change: GainChange) -> None:
        """Keep a change for the recorder."""
        self._memory.add_change(change.tick, self._names.index(change.name), change.value)

    def ask(self, name: str, value: float) -> int | None:
        """Ask the loop for a change; return its tick, -1 if it was refused, None without an answer within 1 s."""
        number, words = self._memory.ask_change(self._names.index(name), value), self._words
        if not self._memory.wait(lambda: words[_ANSWERED] == number, _ANSWER_S):
            return None
        return words[_ANSWER]

    def changes(self, first: int = 0) -> list[GainChange]:
        """The changes from number `first` on."""
        return [GainChange(tick, self._names[gain], value) for tick, gain, value in self._memory.changes(first)]


class Tuner:
    """Changes gains and the reference slip of one run in real time while it lasts.

    Give it to the run, and call it from any thread of the process that started the run: a key's, a browser's.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._table: ChangeTable | None = None
        self._values: dict[str, float] = {}
        self.gains: tuple[Gain, ...] = ()
        """Gains that can change, with unit, range and value at first (`default`); known when the run starts."""

    @property
    def values(self) -> dict[str, float]:
        """Values in force now, planned changes included."""
        table = self._table
        if table is not None:
            self._values = {gain.name: gain.default for gain in self.gains}
            self._values.update((name, value) for _, name, value in table.changes())
        return dict(self._values)

    def change(self, name: str, value: float) -> int:
        """Change a gain, or `reference_slip`; return the tick from which on it holds.

        Raises AbsError, and nothing changes, for a name that cannot change, a value out of range, and a run that has
        not begun or is over.
        """
        with self._lock:
            if self._table is None:
                raise AbsError(f"{name}: no run is under way: gains change from a run's first tick to its last")
            try:
                number = float(value)
            except (TypeError, ValueError) as error:
                raise AbsError(f"{name} = {value!r}: must be a number") from error
            problem = value_problem(name, number, self.gains)
            if problem:
                raise AbsError(problem)
            tick = self._table.ask(name, number)
        if tick is None:
            raise AbsError(f"{name}: the loop does not answer: the run has just ended, or it hangs and will be stopped")
        if tick < 0:
            raise AbsError(f"{name}: refused by the loop: a run has at most {MOST_CHANGES} changes")
        return tick

    @contextmanager
    def connected(self, memory: RunMemory, gains: Sequence[Gain], declared: Iterable[str]) -> Iterator[None]:
        """Let changes reach the run in `memory` inside the context."""
        self.gains = tuple(gains)
        self._table = ChangeTable(memory, declared)
        try:
            yield
        finally:
            self.values  # noqa: B018  the last ones stay
            self._table = None
