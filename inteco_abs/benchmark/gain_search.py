"""One budget of tuning for every law: the same search, the same rigs, the same cost.

The rigs are draws that no figure uses, of the populations `hard`, `rough`, `slow`, `capped` and `wild`. The cost is the
mean over these populations of ln(median) + ln(90 %) of the slip RMS from 0.25 s on, where a stop that fails counts as
1, plus ten times the share of stops that fail or lock: ratios count, so that no population outweighs the others.

The search scatters points over the bounds of `Law.searched`, then evolves from the best: CMA-ES with a diagonal
covariance (R. Ros and N. Hansen: A simple modification in CMA-ES achieving linear time and space complexity, Parallel
Problem Solving from Nature 10, 2008), in logarithms, on the same rigs in every generation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from inteco_abs.benchmark.laws import Law
from inteco_abs.control import Controller
from inteco_abs.montecarlo import ConfiguredPolicy, Experiment, SampleSet, StopResults, parse_draws, run_all

_TUNED_ON: Final = ("hard", "rough", "slow", "capped", "wild")
_FIRST_SEED: Final = 3000
_BELOW_RAD_S: Final = 15.0
"""Run-up, as in a sweep."""
_SLIP: Final = "slip_rms_fixed_true"
_SIGMA: Final = 0.3
_WRONG: Final = 10.0
_HIGH: Final = 0.9

Vector = NDArray[np.float64]
Costs = Callable[[Sequence[Vector]], list[float]]


class Budget(NamedTuple):
    """What each law gets: (scatter + generations * size) candidates on `draws` rigs of each population."""

    scatter: int = 32
    generations: int = 10
    size: int = 8
    draws: int = 6

    @property
    def candidates(self) -> int:
        return 1 + self.scatter + self.generations * self.size


class Bounds(NamedTuple):
    """Of one number that is searched."""

    start: float
    low: float
    high: float


class Evolution:
    """CMA-ES with a diagonal covariance, of logarithms within bounds."""

    def __init__(self, bounds: Sequence[Bounds], size: int, sigma: float, seed: int) -> None:
        n, parents = len(bounds), size // 2
        weights = math.log(parents + 0.5) - np.log(np.arange(1, parents + 1))
        self._weights = weights / weights.sum()
        mass = 1.0 / float((self._weights * self._weights).sum())
        self._low, self._high = np.log([one.low for one in bounds]), np.log([one.high for one in bounds])
        self._mean = np.log([one.start for one in bounds])
        self._size, self._sigma, self._variances = size, sigma, np.ones(n)
        self._path, self._length = np.zeros((2, n))
        self._mass = mass
        self._by_path = 4.0 / (n + 4.0)
        self._by_length = (mass + 2.0) / (n + mass + 5.0)
        self._damping = 1.0 + self._by_length + 2.0 * max(0.0, math.sqrt((mass - 1.0) / (n + 1.0)) - 1.0)
        faster = (n + 2.0) / 3.0  # than a full covariance may be learnt
        self._by_one = min(0.5, faster * 2.0 / ((n + 1.3) ** 2 + mass))
        self._by_rank = max(0.0, min(0.5, faster * 2.0 * (mass - 2.0 + 1.0 / mass) / ((n + 2.0) ** 2 + mass)))
        self._expected = math.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n))
        self._noise = np.random.default_rng(seed)
        self._points: Vector = self._mean[None]

    def scattered(self, count: int) -> Vector:
        """Points spread evenly over the bounds, a row each."""
        return np.exp(self._noise.uniform(self._low, self._high, (count, len(self._mean))))

    def begin_at(self, point: Vector) -> None:
        self._mean = np.log(point)

    def ask(self, *, start: bool = False) -> Vector:
        """Points to try, a row each; with `start` the first is the mean itself."""
        noise = self._noise.standard_normal((self._size, len(self._mean)))
        noise[0] *= not start
        points = self._mean + self._sigma * np.sqrt(self._variances) * noise
        self._points = np.clip(points, self._low, self._high)
        return np.exp(self._points)

    def tell(self, costs: Sequence[float]) -> None:
        """The costs of the points that were asked for."""
        best = self._points[np.argsort(costs)[: len(self._weights)]]
        moves = (best - self._mean) / self._sigma
        move = self._weights @ moves
        self._mean = self._mean + self._sigma * move
        share = self._by_length
        self._length *= 1.0 - share
        self._length += math.sqrt(share * (2.0 - share) * self._mass) * move / np.sqrt(self._variances)
        share = self._by_path
        self._path = (1.0 - share) * self._path + math.sqrt(share * (2.0 - share) * self._mass) * move
        self._variances = (
            (1.0 - self._by_one - self._by_rank) * self._variances
            + self._by_one * self._path**2
            + self._by_rank * (self._weights @ moves**2)
        )
        longer = float(np.linalg.norm(self._length)) / self._expected - 1.0
        self._sigma *= math.exp(min(1.0, self._by_length / self._damping * longer))


def search(bounds: Sequence[Bounds], costs: Costs, budget: Budget, seed: int = 1) -> tuple[Vector, float, float]:
    """The best point of a search, its cost, and that of the start."""
    evolution = Evolution(bounds, budget.size, _SIGMA, seed)
    start = np.array([one.start for one in bounds])
    points = np.vstack([start, evolution.scattered(budget.scatter)])
    found = costs(list(points))
    first, best, leader = found[0], min(found), points[int(np.argmin(found))]
    evolution.begin_at(leader)
    for generation in range(budget.generations):
        points = evolution.ask(start=generation == 0)
        found = costs(list(points))
        evolution.tell(found)
        if min(found) < best:
            best, leader = min(found), points[int(np.argmin(found))]
    return leader, best, first


def tune(
    law: Law,
    controllers: Mapping[str, type[Controller]],
    budget: Budget,
    executor: Executor | None = None,
    source: bytes = b"",
) -> tuple[Law, float, float]:
    """The law with the best numbers that the budget finds, their cost, and that of its present numbers.

    `source` is that of a controller from a file. A law without any number is returned as it is.
    """
    searched = {key: Bounds(*value) for key, value in law.searched(controllers).items()}
    draws = [parse_draws(f"{name}:{_FIRST_SEED}-{_FIRST_SEED + budget.draws - 1}") for name in _TUNED_ON]

    def with_numbers(point: Vector) -> Law:
        return law.tuned({key: float(f"{value:.3g}") for key, value in zip(searched, point.tolist(), strict=True)})

    def costs(points: Sequence[Vector]) -> list[float]:
        each = [_experiments(with_numbers(point), controllers, draws, source) for point in points]
        stops = run_all([one for experiments in each for one in experiments], executor=executor)
        return [cost_of(stops[i : i + len(draws)]) for i in range(0, len(stops), len(draws))]

    if not searched:
        (only,) = costs([np.empty(0)])
        return law, only, only
    point, best, first = search(list(searched.values()), costs, budget)
    return with_numbers(point), best, first


def _experiments(
    law: Law, controllers: Mapping[str, type[Controller]], draws: Sequence[SampleSet], source: bytes
) -> list[Experiment]:
    config = law.config(controllers)
    maker: Any = ConfiguredPolicy(config, source=source)
    start = config.experiment.start_speed_rad_s - _BELOW_RAD_S
    return [Experiment(each.rigs, config, maker, start) for each in draws]


def cost_of(stops: Sequence[StopResults]) -> float:
    """Cost of the stops of one candidate on each population."""
    terms = []
    for each in stops:
        slips = np.minimum(np.nan_to_num(each[_SLIP], nan=1.0), 1.0)
        wrong = float(np.mean(~(each["lock_fraction"] <= 0.0)))
        middle, high = np.quantile(slips, (0.5, _HIGH)).tolist()
        terms.append(math.log(middle) + math.log(high) + _WRONG * wrong)
    return float(np.mean(terms))
