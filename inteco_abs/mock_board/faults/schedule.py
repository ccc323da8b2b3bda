"""Decides when the faults of a run act, and counts how often they did."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

from inteco_abs.mock_board.faults.fault import Fault, FaultEvent


class Schedule:
    """Faults of one run, timed on the board's clock and its exchanges; `seed` makes random faults repeatable."""

    def __init__(self, faults: Sequence[Fault], now_ns: Callable[[], int], seed: int = 0) -> None:
        self.random = random.Random(seed)
        self.exchange = 0
        """Number of exchanges begun."""
        self.times = dict.fromkeys(map(str, faults), 0)
        """How often each fault has acted, by its text."""
        self.first_ns: dict[str, int] = {}
        """Time at which each first acted, ns."""
        self._numbered = tuple(enumerate(faults))
        self._began: dict[int, tuple[int, int]] = {}
        self._over: set[int] = set()
        self._now_ns = now_ns
        self._events = {FaultEvent.START: (now_ns(), 0)}

    def outputs(self, drive: float, brake: float) -> None:
        """Record the events in the board's duties."""
        now = self._now_ns(), self.exchange
        if drive > 0.0:
            self._events.setdefault(FaultEvent.DRIVE, now)
        elif FaultEvent.DRIVE in self._events:
            self._events.setdefault(FaultEvent.COAST, now)
        if brake > 0.0:
            self._events.setdefault(FaultEvent.BRAKE, now)

    def acting(self, *names: str) -> Fault | None:
        """Return the first fault of these kinds that acts now, and count it; None if there is none."""
        for i, fault in self._numbered:
            if fault.name in names and self._acts(i, fault):
                return self._counted(fault)
        return None

    def once(self, name: str) -> Fault | None:
        """Return a fault of this kind the first time that it acts, and count it; else None."""
        for i, fault in self._numbered:
            if fault.name == name and i not in self._over and self._acts(i, fault):
                self._over.add(i)
                return self._counted(fault)
        return None

    def lasting(self, name: str) -> bool:
        """Return whether a fault returned by `once` still lasts."""
        return any(fault.name == name and i in self._began and self._acts(i, fault) for i, fault in self._numbered)

    def acted(self) -> dict[str, str]:
        """Return how often each fault has acted, as text."""
        return {name: str(times) for name, times in self.times.items()}

    def _counted(self, fault: Fault) -> Fault:
        text = str(fault)
        self.times[text] += 1
        self.first_ns.setdefault(text, self._now_ns())
        return fault

    def _acts(self, i: int, fault: Fault) -> bool:
        now = self._now_ns(), self.exchange
        began = self._began.get(i)
        if began is None:
            event = self._events.get(fault.event)
            if event is None or now[0] < event[0] + fault.after.ns or now[1] < event[1] + fault.after.exchanges:
                return False
            began = self._began[i] = now
        lasts = fault.lasts
        if lasts is None:
            return True
        return now[1] < began[1] + lasts.exchanges if lasts.exchanges else now[0] < began[0] + lasts.ns
