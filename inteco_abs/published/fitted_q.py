"""A neural network as policy, trained by neural fitted Q iteration with continuous actions.

M. Riedmiller: Neural fitted Q iteration - first experiences with a data efficient neural reinforcement learning
method, European Conference on Machine Learning 2005, Lecture Notes in Computer Science 3720; with an actor and on this
rig in M.-B. Radac, R.-E. Precup: Data-driven model-free slip control of anti-lock braking systems using reinforcement
Q-learning, Neurocomputing 2017, doi 10.1016/j.neucom.2017.08.036.

Once in HOLD_S the network changes the duty. Its inputs are those that make a wheel behind a brake of lag and dead time
nearly a Markov process: slip error and its change, the last three duties, and the road's speed. `tools/train_fitted_q`
has trained it on drawn rigs, in the project's environment for Gymnasium; the second paper trains on the rig itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

from inteco_abs import elementary
from inteco_abs.published.base import LawConstants, PublishedLaw, PublishedState, demand, limited
from inteco_abs.published.fitted_q_weights import LAYERS
from inteco_abs.signals import BrakeDemand, Estimate

HOLD_S: Final = 0.01
"""Time for which a duty is held."""
MOST: Final = 0.2
"""Largest change of the duty."""
INPUTS: Final = ((0.0, 0.1), (0.0, 0.01), (0.5, 0.3), (0.0, 0.05), (0.0, 0.05), (90.0, 90.0))
"""Value that is 0 to the network, and that which is 1 more: of slip error, its change in HOLD_S, the last duty, its
change and the one before, and the road's speed in rad/s."""
LARGEST: Final = 5.0
"""Input to the network, at most."""

Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class NetworkConstants(LawConstants):
    """Weights of the three layers: a row for each unit, its bias last."""

    first: Rows = LAYERS[0]
    second: Rows = LAYERS[1]
    third: Rows = LAYERS[2]


@dataclass(slots=True)
class PolicyState(PublishedState):
    inputs: list[float] = field(default_factory=lambda: [0.0] * len(INPUTS))
    inner: list[float] = field(default_factory=lambda: [0.0] * len(LAYERS[0]))
    duties: list[float] = field(default_factory=lambda: [0.0] * 3)
    """The newest first."""
    since_s: float = 0.0
    error: float = 0.0
    started: bool = False


def _tanh(x: float) -> float:
    return 1.0 - 2.0 / (elementary.exp(2.0 * x) + 1.0)


def _unit(row: Any, inputs: Any, count: int) -> float:
    """Output of one unit."""
    total = row[count]
    for i in range(count):
        total += row[i] * inputs[i]
    return _tanh(total)


def _network(k: Any, s: Any) -> float:
    """Output in -1..1 for the inputs."""
    width, number = len(k.second), len(k.first[0]) - 1
    for i in range(width):
        s.inner[i] = _unit(k.first[i], s.inputs, number)
    total = k.third[0][width]
    for i in range(width):
        total += k.third[0][i] * _unit(k.second[i], s.inner, width)
    return _tanh(total)


def fitted_q(k: Any, s: Any, estimate: Estimate, dt_s: float) -> BrakeDemand:
    """Change the duty by what the network says, once in HOLD_S."""
    _, speed, slip, _, _ = estimate
    error = slip - s.reference
    s.since_s += dt_s
    if not s.started or s.since_s + 0.5 * dt_s > HOLD_S:
        if not s.started:
            s.error, s.started = error, True
        now, before, earlier = s.duties[0], s.duties[1], s.duties[2]
        found = (error, error - s.error, now, now - before, before - earlier, speed)
        for i in range(len(found)):
            s.inputs[i] = limited((found[i] - INPUTS[i][0]) / INPUTS[i][1], LARGEST)
        s.duties[2], s.duties[1] = before, now
        s.duties[0] = min(max(now + MOST * _network(k, s), 0.0), 1.0)
        s.since_s, s.error = 0.0, error
    return demand(s.duties[0], 0.0, error)


class FittedQ(PublishedLaw, PolicyState):
    """Neural fitted Q iteration (Riedmiller 2005, Radac and Precup 2017): a network trained on drawn rigs."""

    gains = ()
    constants = NetworkConstants
    function = staticmethod(fitted_q)
