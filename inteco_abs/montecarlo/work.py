"""Brakes the units of a sweep that are missing, here or anywhere."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from functools import lru_cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from inteco_abs.errors import AbsError, describe_error
from inteco_abs.montecarlo.plan import Unit
from inteco_abs.montecarlo.results import METRICS_ROW, StopResults
from inteco_abs.montecarlo.stops import Progress, run_all
from inteco_abs.montecarlo.store import SweepFolder

_TRIES: Final = 3


class Braked(NamedTuple):
    """Units that were braked."""

    stops: int = 0
    ticks: int = 0
    """Number of decisions."""
    failed: int = 0
    """Number of units that were given up."""


def work(
    folder: SweepFolder,
    executor: Executor,
    ahead: int = 1,
    part: tuple[int, int] = (1, 1),
    progress: Progress | None = None,
) -> Braked:
    """Brake what is missing in `folder`, or in the I-th of N parts of it, on an executor whose workers see the folder.

    It has `ahead` units at a time. One that fails three times, as by the death of its worker, is listed in the folder
    and left. Raises at once an AbsError of a unit, which would meet the others, too, and for an executor that broke.
    """
    folder.remove_stale()
    return _Work(folder, executor, part, progress).done(ahead)


class _Work:
    def __init__(
        self, folder: SweepFolder, executor: Executor, part: tuple[int, int], progress: Progress | None
    ) -> None:
        self._folder = folder
        self._executor = executor
        self._part = part
        self._progress = progress
        self._running: dict[Future[Braked], tuple[Unit, int]] = {}
        self._again: deque[tuple[Unit, int]] = deque()
        self._braked = Braked()
        self._total = sum(unit.draws for unit in self._units())
        self._counted = self._total - sum(unit.draws for unit in self._missing())

    def done(self, ahead: int) -> Braked:
        """Brake them all."""
        missing = ((unit, 1) for unit in self._missing())
        try:
            self._report(0)
            while self._submit(missing, ahead):
                for future in wait(self._running, return_when=FIRST_COMPLETED).done:
                    self._take(future, *self._running.pop(future))
        finally:
            for future in self._running:
                future.cancel()
        return self._braked

    def _units(self) -> Iterator[Unit]:
        index, count = self._part
        return (unit for number, unit in enumerate(self._folder.plan.units()) if number % count == index - 1)

    def _missing(self) -> Iterator[Unit]:
        return (unit for unit in self._units() if not self._folder.has(unit))

    def _submit(self, missing: Iterable[tuple[Unit, int]], ahead: int) -> bool:
        """Hand units over; whether any is not done."""
        while len(self._running) < ahead:
            following = self._again.popleft() if self._again else next(iter(missing), None)
            if following is None:
                break
            path, name = str(self._folder.path.absolute()), self._folder.plan.name
            try:
                future = self._executor.submit(brake_unit, path, name, following[0])
            except BrokenExecutor as error:
                raise AbsError(f"the executor takes no more units, and the same command continues: {error}") from error
            self._running[future] = following
        return bool(self._running)

    def _take(self, future: Future[Braked], unit: Unit, tries: int) -> None:
        try:
            found = future.result()
        except AbsError:
            raise
        except Exception as error:  # noqa: BLE001  a worker may fail in any way
            if tries < _TRIES:
                self._again.append((unit, tries + 1))
                return
            self._folder.fail(unit, describe_error(error))
            found = Braked(failed=1)
        self._braked = Braked(*map(sum, zip(self._braked, found, strict=True)))
        self._report(unit.draws)

    def _report(self, count: int) -> None:
        self._counted += count
        if self._progress is not None:
            self._progress(self._counted, self._total)


def brake_unit(path: str, name: str, unit: Unit) -> Braked:
    """Brake one unit of the sweep `name` in the folder at `path`, unless that was done. In any process."""
    folder = _opened(path, name)
    if folder.has(unit):
        return Braked()
    draws, experiment = folder.plan.experiment(unit)
    if experiment.rigs:
        (stops,) = run_all([experiment])
    else:
        stops = StopResults(np.empty(0, METRICS_ROW), (), 0, {})
    folder.write(unit, draws, stops)
    return Braked(len(stops), stops.ticks)


@lru_cache(1)
def _opened(path: str, name: str) -> SweepFolder:
    folder = SweepFolder.open(Path(path))
    if folder.plan.name != name:
        raise AbsError(f"{path}: has become another sweep")
    return folder
