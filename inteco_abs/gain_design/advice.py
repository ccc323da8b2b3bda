"""Problems of gains, each with its figures and what can be done."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import groupby
from typing import Final, NamedTuple

import numpy as np

from inteco_abs.control import BoundaryLayer
from inteco_abs.gain_design.bounds import AtSlip, Bounds, Floats, worst
from inteco_abs.gain_design.gains import Gains
from inteco_abs.gain_design.reaching import Reaching
from inteco_abs.rig import RigParameters, brake_duty, brake_torque

_LATE_PERIODS: Final = 3.0
"""By which a sampled law may reach later than (20)."""
_TO_SPARE: Final = 1.01
_HALVINGS: Final = 30
_FASTEST_V: Final = next(gain.high for gain in BoundaryLayer.gains if gain.name == "v")


class Interval(NamedTuple):
    """Range of road speeds, rad/s."""

    low: float
    high: float


class Advice(NamedTuple):
    """A problem of the gains, and what can be done."""

    about: str
    found: str
    next_step: str


class Case(NamedTuple):
    """The gains, and the rigs and limits for which they are assessed."""

    gains: Gains
    nominal: RigParameters
    reference: AtSlip
    """The box at the reference slip."""
    slips: tuple[AtSlip, ...]
    """The box at the slips for which the conditions of sliding must hold."""
    speeds: Floats
    """Rising speeds of the road, rad/s."""
    brake_limit: float
    """Largest brake duty."""
    period_s: float

    @property
    def limit_nm(self) -> float:
        """Largest torque within the duty limit, by the brake's line."""
        return brake_torque(self.brake_limit, self.nominal)

    def bounds(self, speeds: Floats) -> Bounds:
        """Bounds at the worst slip."""
        return worst(self.slips, speeds)

    def lost(self, margin: Callable[[Floats], Floats]) -> str:
        """Road speeds at which `margin` is not above 0, as text; empty without any."""
        return describe_intervals(where_lost(margin, self.speeds), self.speeds)

    def margin_25(self, speeds: Floats) -> Floats:
        """Mq minus the bound of (25), 1/s."""
        return self.gains.switching(speeds) - self.bounds(speeds).mq_25

    def margin_26(self, speeds: Floats) -> Floats:
        """Mq minus the bound of (26), 1/s."""
        return self.gains.switching(speeds) - self.bounds(speeds).mq_26

    def torque_eq(self, speeds: Floats) -> Floats:
        """Torque that holds the reference slip by the model, M1eq = -f/g, N m."""
        return -self.reference.f(speeds) / self.reference.g(speeds)

    def torque_swing(self, speeds: Floats) -> Floats:
        """Change of that torque by switching, Mq/g, N m."""
        return self.gains.switching(speeds) / self.reference.g(speeds)


def where_lost(margin: Callable[[Floats], Floats], speeds: Floats) -> list[Interval]:
    """Where `margin` is not above 0: found at rising `speeds`, the ends refined by bisection."""

    def edge(lost: float, kept: float) -> float:
        for _ in range(_HALVINGS):
            middle = 0.5 * (lost + kept)
            if margin(np.array([middle]))[0] > 0.0:
                kept = middle
            else:
                lost = middle
        return lost

    found = []
    for holds, run in groupby(enumerate(margin(speeds) > 0.0), key=lambda one: bool(one[1])):
        if not holds:
            first, *rest = (index for index, _ in run)
            last = rest[-1] if rest else first
            low = edge(speeds[first], speeds[first - 1]) if first > 0 else speeds[first]
            high = edge(speeds[last], speeds[last + 1]) if last + 1 < len(speeds) else speeds[last]
            found.append(Interval(float(low), float(high)))
    return found


def describe_intervals(intervals: list[Interval], speeds: Floats) -> str:
    """Text such as "below 71.3 rad/s"."""

    def one(interval: Interval) -> str:
        from_start, to_end = interval.low <= speeds[0], interval.high >= speeds[-1]
        if from_start and to_end:
            return "at every speed"
        if from_start:
            return f"below {interval.high:.1f} rad/s"
        if to_end:
            return f"above {interval.low:.1f} rad/s"
        return f"from {interval.low:.1f} to {interval.high:.1f} rad/s"

    return " and ".join(map(one, intervals))


def advice(case: Case, ways: list[Reaching]) -> list[Advice]:
    """All problems of the gains."""
    found = [*_existence(case), *_holding(case), *_saturation(case), *_layer(case)]
    return [*found, *(one for way in ways for one in _lateness(case, way))]


def _existence(case: Case) -> Iterator[Advice]:
    """Condition (25), and the assumptions."""
    lost = case.lost(case.margin_25)
    bounds = case.bounds(case.speeds)
    if not math.isfinite(bounds.mq_25[0]):
        found = "g may be 0 or negative in the stated set: more torque need not raise the slip, no gain is enough"
        yield Advice("existence", found, "state less uncertainty")
    elif lost:
        at = int(np.argmin(case.margin_25(case.speeds)))
        found = (
            f"sliding is not guaranteed {lost}: at {case.speeds[at]:g} rad/s (25) asks for an "
            f"Mq above {bounds.mq_25[at]:.3g} 1/s, it is {case.gains.switching(case.speeds)[at]:.3g}"
        )
        yield Advice("existence", found, _enough(case, bounds))
    if math.isfinite(bounds.mq_25[0]) and not math.isfinite(bounds.mq_26[0]):
        found = f"eps_g = {bounds.eps_g[0]:.3g} is not below 1 as (26) assumes; only (25) applies"
        yield Advice("assumption", found, "state less uncertainty")


def _enough(case: Case, bounds: Bounds) -> str:
    """The smallest gains that fulfil (25), with a margin of 1 %."""
    constant = _TO_SPARE * float(bounds.mq_25.max())
    if constant == 0.0:
        return "any Mq above 0"
    product = _TO_SPARE * float((bounds.mq_25 * case.speeds).max())
    v = product / case.gains.Mq if case.gains.Mq > 0.0 else math.inf
    Mq, v = (case.gains.Mq, v) if v <= _FASTEST_V else (product / case.speeds[-1], float(case.speeds[-1]))
    return f"Mq = {constant:.3g}, or the controller boundary-layer with Mq = {Mq:.3g} and v = {v:.3g} rad/s"


def _holding(case: Case) -> Iterator[Advice]:
    """Whether each rig's brake can hold the reference slip."""
    if not case.reference.g_positive:  # the torque has no bounds then
        return
    needed = float(case.reference.holding_torques(case.speeds)[1].max())
    lost = case.lost(lambda speeds: case.limit_nm - case.reference.holding_torques(speeds)[1])
    if lost:
        duty = brake_duty(needed, case.nominal)
        found = (
            f"the brake cannot hold the reference slip on every rig of the set {lost}: the law "
            f"must ask for up to {needed:.3g} N m, {_limit(case)}"
        )
        fix = f"guard.brake_limit above {_rounded_up(duty)}, if the brake's supply bears it" if duty < 1.0 else ""
        yield Advice("holding", found, fix or "no duty is enough: know the rig better, or choose another reference")
    spare = float(case.reference.holding_torques(case.speeds)[0].min())
    lost = case.lost(lambda speeds: case.reference.holding_torques(speeds)[0])
    if lost:
        found = f"with the brake released the slip is above its reference {lost} on some rigs: "
        yield Advice(
            "holding", f"{found}the law must ask for {spare:.3g} N m", "a higher reference, or less uncertainty"
        )


def _saturation(case: Case) -> Iterator[Advice]:
    """No saturation requires Mq <= g*M1eq and Mq <= g*(limit - M1eq)."""

    def above(speeds: Floats) -> Floats:
        return case.limit_nm - case.torque_eq(speeds) - case.torque_swing(speeds)

    def below(speeds: Floats) -> Floats:
        return case.torque_eq(speeds) - case.torque_swing(speeds)

    for margin, what, end in ((above, "M1eq + Mq/g", _limit(case)), (below, "M1eq - Mq/g", "the brake does not push")):
        lost = case.lost(margin)
        if not lost:
            continue
        at = int(np.argmin(margin(case.speeds)))
        asked = case.limit_nm - margin(case.speeds)[at] if margin is above else margin(case.speeds)[at]
        room = margin(case.speeds) + case.torque_swing(case.speeds)
        most = float((room * case.reference.g(case.speeds) / case.gains.grown(case.speeds)).min())
        found = f"switching saturates the brake {lost}: {what} is {asked:.3g} N m at {case.speeds[at]:g} rad/s, {end}"
        yield Advice(
            "saturation",
            found,
            f"Mq up to {most / _TO_SPARE:.3g}" if most > 0.0 else "first a brake that can hold the slip",
        )


def _layer(case: Case) -> Iterator[Advice]:
    """A sampled boundary layer is stable if one period changes an error by less than twice its size."""
    lost = case.lost(lambda speeds: 2.0 - layer_step(case, speeds)) if case.gains.width > 0.0 else []
    if lost:
        least = float((case.gains.switching(case.speeds) * case.period_s / 2.0).max())
        found = f"the boundary layer is too thin to keep the law from chattering {lost}"
        yield Advice("chattering", found, f"controller.gains.width = {_TO_SPARE * least:.2g}, or less Mk")


def layer_step(case: Case, speeds: Floats) -> Floats:
    """Share by which one period reduces an error within the boundary layer."""
    return (case.gains.Mk + case.gains.switching(speeds) / case.gains.width) * case.period_s


def _lateness(case: Case, way: Reaching) -> Iterator[Advice]:
    """Reaching later than by (20), because of the brake's limits."""
    late = _LATE_PERIODS * case.period_s
    if way.time_s <= way.bound_s + late:
        return
    took = f"takes {way.time_s:.3f} s" if math.isfinite(way.time_s) else "does not succeed"
    found = (
        f"reaching from slip {way.from_slip:g} {took}, by (20) it could take {way.bound_s:.3f} s: the law asks for "
        f"{way.lowest_torque_nm:.3g} to {way.peak_torque_nm:.3g} N m on the way, {_limit(case)}"
    )
    duty = brake_duty(way.peak_torque_nm, case.nominal)
    more = f"guard.brake_limit = {_rounded_up(duty)} or more, or " if case.brake_limit < duty <= 1.0 else ""
    yield Advice("reaching", found, f"{more}smaller gains")


def _rounded_up(duty: float) -> str:
    return f"{math.ceil(100.0 * duty) / 100.0:.2f}"


def _limit(case: Case) -> str:
    return f"the brake gives {case.limit_nm:.3g} N m at its duty limit {case.brake_limit:g}"
