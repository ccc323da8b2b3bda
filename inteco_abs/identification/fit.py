"""Fits the parameters to the counts of all segments by least squares, with their covariance."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from inteco_abs.identification.discs import DiscError, columns, disc_error
from inteco_abs.identification.parameters import FIXED, Priors, torque_name
from inteco_abs.identification.segments import Floats, Segment
from inteco_abs.identification.simulation import angles

Wheel = Literal["wheel", "road"]
Mask = npt.NDArray[np.bool_]
Progress = Callable[[float, float], None]
"""Called at each step with the noise that the round assumes, and the present rms residual, both in counts."""

_NOISES: Final = (300.0, 30.0, 5.0, 1.0)
"""Standard deviation of a residual in counts in each round: far from the solution counts weigh less."""
_NEAR: Final = 0.05
"""Distance to the solution at which the last round ends, in standard deviations of the parameters."""
_FLAT: Final = 0.1
"""Largest distance, in standard deviations of the intervals, at which a search has converged that finds nothing lower:
there, the steps of the integration hide the slope."""
_MOST_STEPS: Final = 50
"""Steps of a round. The last one takes 5 to 15."""
_FIRST_DAMPING: Final = 1e-3
_HARDEST: Final = 1e10
"""Damping beyond which no step lowers the sum of squares: its rounding errors are reached."""
_SHARES: Final = (1.0, 0.5, 0.25)
"""Shares of Newton's step that are tried beside the damped one, which is short along a flat valley."""
_FAR: Final = 700.0
"""Distance from which on they are not: each coordinate may move by that many standard deviations of its prior, and
beyond this the exponential of a logarithm is no float."""
_SPEED_SD_RAD_S: Final = 5.0
"""Standard deviation of a segment's start speeds around those of its first counts."""
_SPEEDS: Final[Mapping[str, int]] = {"run-up": 0, "coast-down": 1, "braking": 2}
"""Free start speeds of a segment: at rest none, rolling the road's, else both. The creep of wheels that roll settles
within milliseconds, so its start is not observed."""
_STEP: Final = 1e-4
"""Step of the differences: the integration's steps are cut differently from there on, which moves counts by 1e-4."""
_WIDE: Final = {
    "d1": 1e-2,
    "M10": 1e-2,
    "blend": 1e-2,
    "creep": 1e-2,
    "dead_time": 1e-5,
    "release_delay": 1e-5,
} | dict.fromkeys(("creep_p", "w1/w4", "w2/w4", "w3/w4", "release", "fade"), 1e-3)
"""Step for parameters of little effect, of which that error would be a larger share, and of a time in s."""
_LONGEST_S: Final = 3e-3
"""Longest step of the release's delay: beyond the corner where a release acts at once, hardly a slope leads back."""
_BRAKE: Final = ("lag", "dead_time", "release", "release_delay", "fade")
_EVERYWHERE: Final = ("J1", "Mg", "d1", "M10", "r1/r2", "d", "M0")
_DEPENDS: Final[Mapping[str, tuple[str, ...]]] = {
    "run-up": (*_EVERYWHERE, "creep", "creep_p", "stall", "no_load"),
    "coast-down": (*_EVERYWHERE, "creep", "creep_p"),
    "braking": (*_EVERYWHERE, "blend", "w4", "w1/w4", "w2/w4", "w3/w4", "a", "p", *_BRAKE),
}
"""Parameters that affect each kind of segment, besides the brake's torques; the scale affects none."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One wheel's counts in one segment.

    In a coast-down only the road's: the wheel hardly pushes the road then, its own friction brakes it as much as the
    road's does both, and its creep, as the root of next to nothing, follows from no parameter that is known.
    """

    segment: Segment
    wheel: Wheel
    counts: Floats
    basis: Floats
    """Orthonormal basis of the constant and the harmonics of the disc's error."""

    def free(self, rows: Floats) -> Floats:
        """`rows` in counts, without the constant and the disc's harmonics."""
        residual: Floats = rows - (rows @ self.basis) @ self.basis.T
        return residual


def channels(segment: Segment) -> list[Channel]:
    """The channels of a segment that are compared with the model."""
    found = []
    both: tuple[tuple[Wheel, Floats], ...] = (("wheel", segment.wheel_count), ("road", segment.road_count))
    for wheel, count in both[segment.kind == "coast-down" :]:
        counts = count[segment.compared]
        basis, _ = np.linalg.qr(columns(counts, segment.counts_per_turn))
        found.append(Channel(segment, wheel, counts, basis))
    return found


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of the fit, in the coordinates of the search."""

    priors: Priors
    found: Floats
    covariance: Floats
    """Without the uncertainty of what is assumed."""
    information: Floats
    """J'*J with the slopes of the counts and of the priors, start speeds unknown, 1/counts2."""
    moved: Floats
    """Change of each parameter by one unit of each assumed one."""
    before: Floats
    """Covariance of the priors."""
    residuals: tuple[tuple[Channel, Floats], ...]
    """Measured minus simulated counts, without the start angle and the disc's error."""
    discs: tuple[tuple[Channel, DiscError], ...]
    """The disc's error in all segments with enough turns."""
    converged: bool

    @property
    def total(self) -> Floats:
        """Covariance of the parameters, with that of what is assumed."""
        count = self.moved.shape[1]
        both: Floats = self.covariance + self.moved @ self.before[:count, :count] @ self.moved.T
        return both

    def values(self) -> dict[str, float]:
        """Fit parameters by name."""
        return self.priors.values(self.found.tolist())


def fit(segments: Sequence[Segment], priors: Priors, progress: Progress | None = None) -> Fit:
    """Least squares of count residuals and deviations from the priors, each over its standard deviation.

    All counts have the same weight: weights by the residuals would fit what the model explains badly still worse. The
    covariance is computed from the actual, correlated residuals (Huber and White's covariance for wrong weights).

    Assumed parameters stay fixed; their uncertainty is added to the covariance of the others: with H = jacobian' *
    jacobian, a change of the assumed (a) changes the fitted (f) by S = -H_ff^-1 * H_fa.
    """
    rolling = [each for each in segments if each.kind != "braking"]
    problem, count = _Problem(rolling, priors), len(priors.fit_parameters)
    found = _searched(problem, problem.start, _NOISES[:-1], progress)[0] if rolling else problem.start
    if len(rolling) < len(segments):
        begun, problem = found[:count], _Problem(segments, priors)
        found = _searched(problem, np.concatenate([begun, problem.start[count:]]), _NOISES[:-1], progress)[0]
    found, converged = _searched(problem, found, _NOISES[-1:], progress)
    free = problem.free
    jacobian = problem.jacobian(found, np.ones_like(free))
    information = jacobian.T @ jacobian
    inverse = np.linalg.inv(information[np.ix_(free, free)])
    before = np.asarray(np.linalg.inv(priors.weights.T @ priors.weights), np.float64)
    moved = np.eye(len(information))[:, : len(FIXED)]
    moved[free] = -inverse @ information[np.ix_(free, ~free)]
    differences = list(problem.differences(found))
    residuals = tuple((channel, channel.free(counts)) for channel, counts in differences)
    discs = [
        (channel, disc_error(channel.counts, channel.segment.counts_per_turn, counts))
        for channel, counts in differences
    ]
    real = [np.full(len(each), _effective_deviation(each) / problem.noise) for _, each in residuals]
    scattered = jacobian[:, free] * np.concatenate([*real, np.ones(len(found))])[:, None]
    pulls = _pulls(residuals, jacobian[:, free], problem.noise)
    covariance = np.zeros_like(information)
    covariance[np.ix_(free, free)] = inverse @ (scattered.T @ scattered + pulls.T @ pulls) @ inverse
    return Fit(
        priors,
        found[:count],
        covariance[:count, :count],
        _without(information, count),
        moved[:count],
        before,
        residuals,
        tuple((channel, error) for channel, error in discs if error is not None),
        converged,
    )


def information(segment: Segment, priors: Priors, found: Floats) -> Floats:
    """Information of a segment's counts about the parameters at `found`, its start speeds unknown, 1/counts2."""
    problem, count = _Problem([segment], priors), len(found)
    problem.noise = 1.0
    x = np.concatenate([found, problem.start[count:]])
    jacobian = problem.jacobian(x, np.ones(len(x), bool))
    jacobian[-len(x) : count - len(x)] = 0.0  # the priors are no information of the counts
    return _without(jacobian.T @ jacobian, count)


def _without(information: Floats, count: int) -> Floats:
    """The information about the first `count` parameters if the others are unknown."""
    ours, theirs = information[:count, count:], information[count:, count:]
    left: Floats = information[:count, :count] - ours @ np.linalg.solve(theirs, ours.T)
    return left


def _searched(
    problem: _Problem, start: Floats, noises: Sequence[float], progress: Progress | None
) -> tuple[Floats, bool]:
    """The best values of the parameters from `start`, and whether the search converged."""
    found, converged = start, False
    for problem.noise in noises:
        found, converged = _round(problem, found, progress)
    return found, converged


def _round(problem: _Problem, found: Floats, progress: Progress | None) -> tuple[Floats, bool]:
    """Steps of Levenberg and Marquardt, until the next one of Newton is short.

    Its length is measured in the metric of the parameters' covariance, where it is the distance in standard
    deviations: no parameter, and no combination of some, would change by more. The fall of the sum of squares says
    less: it is small in a long flat valley, too. A round that is not the last ends at the noise it assumes.
    """
    free = problem.free
    residuals, damping = problem.residuals(found), _FIRST_DAMPING
    for _ in range(_MOST_STEPS):
        if progress is not None:
            progress(problem.noise, math.sqrt(residuals @ residuals / len(residuals)) * problem.noise)
        jacobian = problem.jacobian(found, free)[:, free]
        gradient, information = jacobian.T @ residuals, jacobian.T @ jacobian
        size = np.sqrt(np.diag(information))
        scaled, slope = information / np.outer(size, size), gradient / size
        variance, newton = residuals @ residuals / len(residuals), np.linalg.solve(scaled, slope)
        distance = slope @ newton
        if distance < (_NEAR * _NEAR * variance if problem.noise == _NOISES[-1] else 1.0):
            return found, True
        shares = _SHARES if distance < _FAR * _FAR else ()
        along = [_moved(problem, found, share * newton / size) for share in shares]
        while damping <= _HARDEST:
            damped = np.linalg.solve(scaled + damping * np.eye(len(size)), slope) / size
            trial, nearer = min([_moved(problem, found, damped), *along], key=lambda each: each[1] @ each[1])
            if nearer @ nearer < residuals @ residuals:
                found, residuals, damping = trial, nearer, damping / 10.0
                break
            damping *= 10.0
        else:
            return found, bool(distance < _FLAT * _FLAT * problem.scatter(found))
    return found, False


def _moved(problem: _Problem, found: Floats, step: Floats) -> tuple[Floats, Floats]:
    """The parameters less a `step`, shortened to what each bears, and their residuals."""
    trial, longest = found.copy(), problem.longest[problem.free]
    trial[problem.free] -= step * np.min(longest / np.maximum(np.abs(step), longest))
    return trial, problem.residuals(trial)


class _Problem:
    """Normalised residuals and their slopes; the last parameters are the start speeds of the segments."""

    def __init__(self, segments: Sequence[Segment], priors: Priors) -> None:
        self._priors = priors
        self.noise = _NOISES[0]
        """Standard deviation of a residual in counts."""
        self._segments = [(each, channels(each)) for each in segments]
        speeds = [speed for each, _ in self._segments for speed in each.start_speeds()[2 - _SPEEDS[each.kind] :]]
        self._places = {each.name: place for place, each in enumerate(priors.fit_parameters)}
        self.start = np.array([each.start for each in priors.fit_parameters] + speeds)
        self.free = np.arange(len(self.start)) >= len(FIXED)
        """Mask of the parameters that are not assumed."""
        count = len(priors.fit_parameters)
        self._steps = np.full(len(self.start), _STEP)
        self._steps[[self._places[name] for name in _WIDE]] = list(_WIDE.values())
        self.longest = np.full(len(self.start), np.finfo(float).max)
        """Longest step of each parameter."""
        self.longest[self._places["release_delay"]] = _LONGEST_S
        self._weights = np.eye(len(self.start)) / _SPEED_SD_RAD_S
        self._weights[:count, :count] = priors.weights

    def residuals(self, x: Floats) -> Floats:
        """Normalised residuals of counts and priors."""
        parts = [channel.free(counts) / self.noise for channel, counts in self.differences(x)]
        return np.concatenate([*parts, self._weights @ (x - self.start)])

    def scatter(self, x: Floats) -> float:
        """Mean variance of independent residuals with the same information as these correlated ones."""
        parts = [channel.free(counts) / self.noise for channel, counts in self.differences(x)]
        return sum(len(each) * _effective_deviation(each) ** 2 for each in parts) / sum(map(len, parts))

    def differences(self, x: Floats) -> Iterator[tuple[Channel, Floats]]:
        """Measured minus simulated counts by channel."""
        for segment, its_channels, own in self._each():
            simulated = self._simulated(segment, x[None, :], own)
            for channel in its_channels:
                yield channel, channel.counts - simulated[channel.wheel][0]

    def jacobian(self, x: Floats, free: Mask) -> Floats:
        """Slopes of `residuals` by the free parameters, by differences, in one batch for each segment.

        In the last round they are central, for twice the work: in a model that is not quite the rig, forward ones have
        their zero a standard deviation away from the lowest sum of squares.
        """
        central, blocks = self.noise == _NOISES[-1], []
        for segment, its_channels, own in self._each():
            names = [*_DEPENDS[segment.kind], *map(torque_name, segment.levels)]
            places = [place for place in (*(self._places[name] for name in names), *own) if free[place]]
            ahead, each = np.repeat(x[None, :], len(places), axis=0), np.arange(len(places))
            ahead[each, places] += self._steps[places]
            behind = 2.0 * x - ahead if central else x[None, :]
            simulated = self._simulated(segment, np.concatenate([ahead, behind]), own)
            for channel in its_channels:
                above, below = np.split(simulated[channel.wheel], [len(places)])
                block = np.zeros((above.shape[1], len(x)))
                apart = self._steps[places] * (1.0 + central)
                block[:, places] = channel.free(below - above).T / (apart * self.noise)
                blocks.append(block)
        return np.concatenate([*blocks, self._weights])

    def _each(self) -> Iterator[tuple[Segment, list[Channel], tuple[int, ...]]]:
        """Segments, their channels, and the places of their start speeds, if any."""
        place = len(self._priors.fit_parameters)
        for segment, its_channels in self._segments:
            following = place + _SPEEDS[segment.kind]
            yield segment, its_channels, tuple(range(place, following))
            place = following

    def _simulated(self, segment: Segment, rows: Floats, own: tuple[int, ...]) -> dict[Wheel, Floats]:
        """Counts, a row for each of `rows`."""
        listed = rows.tolist()
        sets = [self._priors.values(row) for row in listed]
        roads = [row[own[-1]] if own else 0.0 for row in listed]
        if segment.kind == "braking":
            wheels = [row[own[0]] for row in listed]
        else:
            wheels = [speed / values["r1/r2"] for speed, values in zip(roads, sets, strict=True)]
        wheel, road = angles(segment, self._priors, sets, list(zip(wheels, roads, strict=True)))
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
