"""Fits the parameters to the counts of all segments by least squares, with their covariance."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.optimize import least_squares

from inteco_abs.identification.parameters import ASSUMED, Priors, torque_name
from inteco_abs.identification.segments import Floats, Segment
from inteco_abs.identification.simulation import angles

Wheel = Literal["wheel", "road"]

_ROUNDS: Final = ((300.0, 20), (30.0, 20), (5.0, 20), (1.0, 60))
"""Standard deviation of a residual in counts, and most evaluations, of each round: the first rounds, far from the
solution, weigh the counts less, and only the last must converge."""
_TOLERANCE: Final = 1e-4
_SPEED_SD_RAD_S: Final = 5.0
"""Standard deviation of a segment's start speeds around those of its first counts."""
_STEP: Final = 1e-5
"""Step of the differences, for all parameters."""
_EVERYWHERE: Final = ("J1", "Mg", "d1", "M10", "d", "M0", "a")
_DEPENDS: Final[Mapping[str, tuple[str, ...]]] = {
    "run-up": (*_EVERYWHERE, "stall", "no_load"),
    "coast-down": _EVERYWHERE,
    "braking": (*_EVERYWHERE, "w4", "w1/w4", "w2/w4", "w3/w4", "p", "lag", "dead_time"),
}
"""Parameters that affect each kind of segment, besides the brake's torques; the scale affects none."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One wheel's counts in one segment.

    While the wheels roll, only the road's: the creep of the wheel depends on radii and contact more finely than they
    are known.
    """

    segment: Segment
    wheel: Wheel
    counts: Floats
    basis: Floats
    """Orthonormal: a constant, as the encoder's start angle is unknown, and the error of an eccentric disc."""

    def free(self, rows: Floats) -> Floats:
        """`rows` in counts, without the constant and the eccentricity."""
        residual: Floats = rows - (rows @ self.basis) @ self.basis.T
        return residual


def channels(segment: Segment) -> list[Channel]:
    """The channels of a segment that are compared with the model."""
    found = []
    wheels: tuple[Wheel, ...] = ("wheel", "road") if segment.kind == "braking" else ("road",)
    for wheel in wheels:
        counts = (segment.wheel_count if wheel == "wheel" else segment.road_count)[segment.compared]
        angle = counts * (2.0 * math.pi / segment.counts_per_turn)
        basis, _ = np.linalg.qr(np.column_stack([np.ones_like(angle), np.cos(angle), np.sin(angle)]))
        found.append(Channel(segment, wheel, counts, basis))
    return found


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of the fit, in the coordinates of the search."""

    priors: Priors
    found: Floats
    covariance: Floats
    before: Floats
    """Covariance of the priors."""
    residuals: tuple[tuple[Channel, Floats], ...]
    """Measured minus simulated counts."""
    converged: bool

    def values(self) -> dict[str, float]:
        """Fit parameters by name."""
        return self.priors.values(self.found.tolist())


def fit(segments: Sequence[Segment], priors: Priors) -> Fit:
    """Least squares of count residuals and deviations from the priors, each over its standard deviation.

    All counts have the same weight: weights by the residuals would fit what the model explains badly still worse. The
    covariance is computed from the actual, correlated residuals (Huber and White's covariance for wrong weights).

    Assumed parameters stay fixed; their uncertainty is added to the covariance of the others: with H = jacobian' *
    jacobian, a change of the assumed (a) changes the fitted (f) by S = -H_ff^-1 * H_fa.
    """
    rolling = _Problem([each for each in segments if each.kind != "braking"], priors)
    begun, _ = _searched(rolling, rolling.start)
    problem = _Problem(segments, priors)
    start, looked_for = problem.start, len(priors.fit_parameters) - len(ASSUMED)
    start[:looked_for] = begun[:looked_for]
    found, converged = _searched(problem, start)
    jacobian, count = problem.slopes(found, assumed=True), len(priors.fit_parameters)
    free = problem.free
    information = jacobian.T @ jacobian
    inverse = np.linalg.inv(information[np.ix_(free, free)])
    before = np.asarray(np.linalg.inv(priors.weights.T @ priors.weights), np.float64)
    moved = np.eye(len(information))[:, : len(ASSUMED)]
    moved[free] = -inverse @ information[np.ix_(free, ~free)]
    covariance = np.asarray(moved @ before[: len(ASSUMED), : len(ASSUMED)] @ moved.T, np.float64)
    whole = problem.whole(found)
    residuals = tuple(problem.count_residuals(found))
    real = [np.full(len(each), _effective_deviation(each) / problem.noise) for _, each in residuals]
    scattered = jacobian[:, free] * np.concatenate([*real, np.ones(len(whole))])[:, None]
    pulls = _pulls(residuals, jacobian[:, free], problem.noise)
    covariance[np.ix_(free, free)] += inverse @ (scattered.T @ scattered + pulls.T @ pulls) @ inverse
    return Fit(priors, whole[:count], covariance[:count, :count], before, residuals, converged)


def _searched(problem: _Problem, start: Floats) -> tuple[Floats, bool]:
    """The best parameters from `start`, and whether the search converged."""
    found, converged = start, False
    for problem.noise, evaluations in _ROUNDS:
        outcome = least_squares(
            problem.residuals,
            found,
            problem.jacobian,
            method="lm",
            x_scale="jac",
            ftol=_TOLERANCE,
            xtol=1e-12,
            max_nfev=evaluations,
        )
        found, converged = outcome.x, bool(outcome.success)
    return found, converged


class _Problem:
    """Normalised residuals and their slopes; the last parameters are the start speeds of the segments."""

    def __init__(self, segments: Sequence[Segment], priors: Priors) -> None:
        self._priors = priors
        self.noise = _ROUNDS[0][0]
        """Standard deviation of a residual in counts."""
        self._segments = [(each, channels(each)) for each in segments]
        started = [each.start_speeds() for each, _ in self._segments if each.kind != "run-up"]
        speeds = [speed for pair in started for speed in pair]
        self._places = {each.name: place for place, each in enumerate(priors.fit_parameters)}
        self._prior = np.array([each.start for each in priors.fit_parameters] + speeds)
        self.free = np.arange(len(self._prior)) >= len(ASSUMED)
        """Mask of the parameters that are not assumed."""
        self.start = self._prior[self.free]
        count = len(priors.fit_parameters)
        self._weights = np.eye(len(self._prior)) / _SPEED_SD_RAD_S
        self._weights[:count, :count] = priors.weights

    def whole(self, found: Floats) -> Floats:
        """All parameters: the assumed ones, then `found`."""
        return np.concatenate([self._prior[~self.free], found])

    def residuals(self, found: Floats) -> Floats:
        """Normalised residuals of counts and priors."""
        parts = [residual / self.noise for _, residual in self.count_residuals(found)]
        return np.concatenate([*parts, self._weights @ (self.whole(found) - self._prior)])

    def count_residuals(self, found: Floats) -> list[tuple[Channel, Floats]]:
        """Measured minus simulated counts by channel."""
        x = self.whole(found)
        parts = []
        for segment, its_channels, own in self._each():
            simulated = self._simulated(segment, x[None, :], own)
            parts += [(each, each.free(each.counts - simulated[each.wheel])[0]) for each in its_channels]
        return parts

    def jacobian(self, found: Floats) -> Floats:
        """Slopes of `residuals`."""
        return self.slopes(found, assumed=False)[:, self.free]

    def slopes(self, found: Floats, *, assumed: bool) -> Floats:
        """Slopes by forward differences, in one batch for each segment; by assumed parameters only if `assumed`."""
        x = self.whole(found)
        blocks = []
        for segment, its_channels, own in self._each():
            names = [*_DEPENDS[segment.kind], *map(torque_name, segment.levels)]
            places = [self._places[name] for name in names if assumed or name not in ASSUMED] + list(own)
            rows = np.repeat(x[None, :], len(places) + 1, axis=0)
            rows[np.arange(1, len(rows)), places] += _STEP
            simulated = self._simulated(segment, rows, own)
            for channel in its_channels:
                counts = simulated[channel.wheel]
                block = np.zeros((counts.shape[1], len(x)))
                block[:, places] = channel.free(counts[0] - counts[1:]).T / (_STEP * self.noise)
                blocks.append(block)
        return np.concatenate([*blocks, self._weights])

    def _each(self) -> Iterator[tuple[Segment, list[Channel], tuple[int, ...]]]:
        """Segments, their channels, and the places of their start speeds, if any."""
        place = len(self._priors.fit_parameters)
        for segment, its_channels in self._segments:
            own = () if segment.kind == "run-up" else (place, place + 1)
            place += len(own)
            yield segment, its_channels, own

    def _simulated(self, segment: Segment, rows: Floats, own: tuple[int, ...]) -> dict[Wheel, Floats]:
        """Counts, a row for each of `rows`."""
        listed = rows.tolist()
        speeds = [(row[own[0]], row[own[1]]) if own else (0.0, 0.0) for row in listed]
        wheel, road = angles(segment, self._priors, [self._priors.values(row) for row in listed], speeds)
        per_rad = segment.counts_per_turn / (2.0 * math.pi)
        return {"wheel": wheel * per_rad, "road": road * per_rad}


def _pulls(residuals: Sequence[tuple[Channel, Floats]], jacobian: Floats, noise: float) -> Floats:
    """Gradient of each segment's residuals, a row for each segment; the sum is zero at the solution.

    Errors of the model pull segments apart: their covariance treats segments, not samples, as independent.
    """
    rows: dict[int, Floats] = {}
    place = 0
    for channel, residual in residuals:
        part = jacobian[place : place + len(residual)].T @ (residual / noise)
        place += len(residual)
        rows[id(channel.segment)] = rows.get(id(channel.segment), np.zeros_like(part)) + part
    count = len(rows)
    return np.array(list(rows.values())) * math.sqrt(count / max(count - 1, 1))


def _effective_deviation(residual: Floats) -> float:
    """Standard deviation of independent samples with the same information as these correlated ones.

    sigma*sqrt(tau), tau = 1 + 2*(sum of the autocorrelation up to its first negative value).
    """
    variance, count = float(np.mean(residual * residual)), len(residual)
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(residual, size)
    correlation = np.fft.irfft(spectrum * np.conj(spectrum), size)[:count] / (count * variance)
    negative = np.flatnonzero(correlation < 0.0)
    tau = 2.0 * float(correlation[: negative[0] if len(negative) else count].sum()) - 1.0
    return math.sqrt(variance * max(tau, 1.0))
