"""The runs that would make the intervals of an identification narrower, before they are recorded.

The fit is linear near its solution: a run adds J'*J to its information, with the slopes J of the counts that the
identified rig would give. Noise and errors of the model add to the covariance in proportion to information, as much as
they have in the sessions so far. What is assumed is not found by any run, so intervals that rest on it hardly change.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from inteco_abs.identification.estimates import Identification, derived_slopes, half_width
from inteco_abs.identification.fit import Fit, information
from inteco_abs.identification.parameters import FIXED
from inteco_abs.identification.plan import PlannedRun, experiments, further_experiments
from inteco_abs.identification.segments import Floats, Segment, SegmentKind, segment
from inteco_abs.identification.simulation import angles

_RUNS: Final = 3
_NAMED: Final = 3
"""Numbers that are named for each run."""
_LEAST_GAIN: Final = 1.05
"""Ratio by which an interval must become narrower to be named."""
_TICK_S: Final = 0.002
_LONGEST_S: Final[dict[SegmentKind, float]] = {"braking": 20.0, "coast-down": 70.0}


def next_runs(found: Identification, brake_limit: float, start_speed_rad_s: float) -> tuple[PlannedRun, ...]:
    """The runs that help most after the sessions of `found`, each with what it would bring in `shows`.

    One after another, each run is the one that makes the intervals narrowest, by the mean of their logarithms, once
    those before it are recorded. Brake duties are at most `brake_limit`; braking begins at `start_speed_rad_s`.
    """
    duties = {run: _duties(run, brake_limit) for run in (*experiments(brake_limit), *further_experiments(brake_limit))}
    noise, per_turn = _noise(found.fit), found.segments[0].counts_per_turn
    fit = _with_levels(found.fit, {level for steps in duties.values() for level in np.unique(steps[steps > 0.0])})
    parts = {run: _simulated(fit, steps, per_turn, start_speed_rad_s) for run, steps in duties.items()}
    more = {run: information(part, fit.priors, fit.found) for run, part in parts.items() if part is not None}
    assumed = {each.name for each in found.estimates if each.status == "assumed"}
    slopes = {key: slope for key, slope in derived_slopes(fit).items() if key[0] not in assumed}
    every, recorded = np.array(list(slopes.values())), len({each.session for each in found.segments})
    planned: list[PlannedRun] = []
    while len(planned) < _RUNS:
        after = {run: _with_run(fit, each, noise) for run, each in more.items()}
        best = min(after, key=lambda run: _mean_width(after[run], every))
        brings = _brings(fit, after[best], slopes)
        if not brings:
            break
        number = recorded + len(planned) + 1
        planned.append(best._replace(name=f"{best.name}-{number}", shows=f"{best.shows}: {brings}"))
        fit = after[best]
    return tuple(planned)


def _duties(run: PlannedRun, brake_limit: float) -> Floats:
    time_s = np.arange(0.0, _LONGEST_S["braking" if run.first else "coast-down"], _TICK_S)
    steps = run.first + run.rise * np.floor(time_s / run.length_s + 1e-9)
    return np.asarray(np.round(steps.clip(0.0, brake_limit), 4), np.float64)


def _simulated(fit: Fit, duties: Floats, counts_per_turn: int, speed_rad_s: float) -> Segment | None:
    """What the identified rig would give from this road speed on; None if it stops too soon."""
    values, off = fit.values(), np.zeros(len(duties))
    kind: SegmentKind = "braking" if duties.any() else "coast-down"
    time_s = np.arange(len(duties), dtype=np.float64) * _TICK_S
    whole = Segment("", kind, counts_per_turn, time_s, off, off, off, duties, np.ones(len(duties), bool))
    turned = angles(whole, fit.priors, [values], [(speed_rad_s / values["r1/r2"], speed_rad_s)])
    wheel, road = (each[0] * (counts_per_turn / (2.0 * np.pi)) for each in turned)
    return segment("", kind, counts_per_turn, time_s, (wheel, road), (off, duties))


def _noise(fit: Fit) -> float:
    """Variance that counts as independent have had so far in the fit, counts2, with the errors of the model."""
    free = slice(len(FIXED), None)
    return float(np.mean(np.diag(fit.covariance[free, free] @ fit.information[free, free])))


def _with_levels(fit: Fit, levels: set[float]) -> Fit:
    """The fit with the torques at more duties, known as well as by their priors."""
    priors = replace(fit.priors, levels=tuple(sorted({*fit.priors.levels, *levels})))
    places = {each.name: place for place, each in enumerate(priors.fit_parameters)}
    old = [places[each.name] for each in fit.priors.fit_parameters]
    found = np.array([each.start for each in priors.fit_parameters])
    more: Floats = priors.weights.T @ priors.weights
    before: Floats = np.asarray(np.linalg.inv(more), np.float64)
    covariance, moved = before.copy(), np.zeros((len(found), fit.moved.shape[1]))
    found[old], more[np.ix_(old, old)], covariance[np.ix_(old, old)] = fit.found, fit.information, fit.covariance
    moved[old] = fit.moved
    return replace(fit, priors=priors, found=found, information=more, covariance=covariance, moved=moved, before=before)


def _with_run(fit: Fit, more: Floats, noise: float) -> Fit:
    """The fit with the information of another run; the noise is that of its counts, counts2."""
    both, free = fit.information + more, slice(len(FIXED), None)
    inverse, had = np.linalg.inv(both[free, free]), fit.information[free, free]
    covariance, moved = np.zeros_like(both), fit.moved.copy()
    scatter = had @ fit.covariance[free, free] @ had + noise * more[free, free]
    covariance[free, free] = inverse @ scatter @ inverse
    moved[free] = -inverse @ both[free, : len(FIXED)]
    return replace(fit, information=both, covariance=covariance, moved=moved)


def _mean_width(fit: Fit, slopes: Floats) -> float:
    """Mean logarithm of the standard deviations."""
    return float(np.mean(np.log(np.einsum("ij,jk,ik->i", slopes, fit.total, slopes))))


def _brings(before: Fit, after: Fit, slopes: Mapping[tuple[str, str], Floats]) -> str:
    """The intervals that become narrower by most, as text; empty if none does."""
    widths = {key: (half_width(slope, before), half_width(slope, after)) for key, slope in slopes.items()}
    gains = sorted(((had / has, key) for key, (had, has) in widths.items()), reverse=True)[:_NAMED]
    return ", ".join(
        f"{name} from ±{widths[name, unit][0]:.2g} to ±{widths[name, unit][1]:.2g} {unit}".removesuffix(" 1")
        for gain, (name, unit) in gains
        if gain > _LEAST_GAIN
    )
