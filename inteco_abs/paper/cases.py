"""The laws and the conditions under which they are compared.

The paper compares its law with constant-rate control, s' = -Mq*sgn(s), whose gain it does not give. Two gains are fair:
with the same Mq it chatters as much and reaches later; with Mq' = reference/t, t by (20) from slip 0 to the reference,
it reaches as soon and chatters more. A law that is better than both is better.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from inteco_abs.config import RigConfig, load_config
from inteco_abs.control import CONTROLLERS, control_check, reaching_time_bound
from inteco_abs.montecarlo import ESTIMATOR_NAMES, IDEAL, ConfiguredPolicy, Experiment, SampleSet, parse_draws
from inteco_abs.rig import RigParameters, RigVariation

REFERENCE: Final = 0.2
SIMULATION_GAINS: Final = (2.0, 1.0)
"""Mk and Mq of the paper's Fig. 2, 1/s."""
EXPERIMENT_GAINS: Final = (10.0, 4.0)
"""Mk and Mq of its Fig. 3, on the rig, 1/s."""
_EULER: Final = "euler"
_WINDOW: Final = "moving-window"
_VENDORS_DUTY: Final = 0.7
_RUN_UP_FROM_RAD_S: Final = 165.0
"""A second of driving before the start at 180 rad/s, as in a sweep: windows are full by then."""


class Law(NamedTuple):
    """A reaching law with its gains."""

    pairing: str
    """Why it is a fair rival of the paper's law; empty for that law."""
    controller: str
    Mk: float
    """1/s; 0 for constant-rate."""
    Mq: float
    """1/s."""

    def config(self, estimator: str) -> RigConfig:
        """Configuration with the estimator, a window of 10 ms, and only the rig's limit of duty."""
        settings = [
            f"controller.name={self.controller}",
            f"controller.reference_slip={REFERENCE}",
            f"controller.gains.Mq={self.Mq}",
            *([f"controller.gains.Mk={self.Mk}"] if self.Mk else []),
            f"estimator.name={estimator}",
            "guard.brake_limit=1.0",
        ]
        return load_config(settings=settings, checks=[control_check(CONTROLLERS, ESTIMATOR_NAMES)])


@dataclass(frozen=True, slots=True)
class PaperCondition:
    """Rigs, an estimator, and the laws to run on them, the paper's first."""

    name: str
    """Name in files and tables."""
    title: str
    draws: SampleSet
    estimator: str
    laws: tuple[Law, ...]
    run_up_from_rad_s: float | None = None
    """Speed from which the drive runs up, as in `Experiment`."""
    changed: RigVariation | None = None
    """Replaces the one rig that is drawn."""

    def experiment(self, law: Law) -> Experiment:
        """The Monte Carlo experiment of one of the laws."""
        config, rigs = law.config(self.estimator), (self.changed,) if self.changed else self.draws.rigs
        return Experiment(rigs, config, ConfiguredPolicy(config, CONTROLLERS), self.run_up_from_rad_s)


def paper_conditions(draws: int) -> tuple[PaperCondition, ...]:
    """All conditions; those of the experiment have `draws` rigs."""
    simulation, experiment = _laws(*SIMULATION_GAINS), _laws(*EXPERIMENT_GAINS)
    nominal, capped = parse_draws("nominal:0"), _capped(draws)
    title = "experiment (Fig. 3): lag, noise, duty of at most 0.7"
    window, euler = f"{title}; speeds over 10 ms", f"{title}; speeds over 0.5 ms (Euler)"
    return (
        PaperCondition("simulation", "simulation (Fig. 2): true slip, ideal brake", nominal, IDEAL, simulation),
        PaperCondition("experiment-window", window, capped, _WINDOW, experiment, _RUN_UP_FROM_RAD_S),
        PaperCondition("experiment-euler", euler, capped, _EULER, experiment, _RUN_UP_FROM_RAD_S),
        *_breaks(nominal, simulation[0]),
    )


def _laws(Mk: float, Mq: float) -> tuple[Law, ...]:
    as_soon = REFERENCE / reaching_time_bound(0.0, REFERENCE, Mk, Mq)
    return (
        Law("", "reaching-law", Mk, Mq),
        Law("equal Mq", "constant-rate", 0.0, Mq),
        Law("equal reaching time", "constant-rate", 0.0, as_soon),
    )


def _capped(count: int) -> SampleSet:
    """The first rigs of `capped` whose brake can hold the slip."""
    last = count
    while len((found := parse_draws(f"capped:0-{last}")).seeds) < count:
        last += count
    return parse_draws(f"capped:0-{found.seeds[count - 1]}")


def _breaks(nominal: SampleSet, law: Law) -> Iterator[PaperCondition]:
    """The simulation with one effect each that the paper's simulation leaves out."""
    (rig,) = nominal.rigs
    published = RigParameters.named("mask")
    lag = replace(rig, parameters=published)
    changed = {
        "euler": ("speeds over 0.5 ms (Euler), 2048 counts", rig, _EULER),
        "lag": (f"brake lag of {1000.0 / published.c31:.0f} ms", lag, IDEAL),
        "duty": (f"duty of at most {_VENDORS_DUTY}", replace(rig, brake_duty_cap=_VENDORS_DUTY), IDEAL),
        "less-friction": ("friction 10 % below the model's", replace(rig, adhesion_scale=0.9), IDEAL),
        "more-friction": ("friction 10 % above the model's", replace(rig, adhesion_scale=1.1), IDEAL),
    }
    for name, (title, one, estimator) in changed.items():
        yield PaperCondition(f"simulation-{name}", title, nominal, estimator, (law,), changed=one)
