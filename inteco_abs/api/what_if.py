"""A session compared with other gains, controllers or estimators, on its counts and simulated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, Final

from inteco_abs.analysis import Continuation, WhatIf, alternative, continued
from inteco_abs.analysis import what_if as open_loop
from inteco_abs.api.arguments import speaks_of_arguments
from inteco_abs.errors import ConfigError
from inteco_abs.quantities import shown
from inteco_abs.sessions import computed_card, session_config
from inteco_abs.views.shown import Shown
from inteco_abs.views.what_if import WhatIfTrace, figure_of_what_if, render_what_if

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

    from inteco_abs.config import RigConfig
    from inteco_abs.control import Controller
    from inteco_abs.sessions import Session

_MOST: Final = 100
_METRICS: Final = (
    "reaching_time_s", "stop_time_s", "stop_distance_m", "slip_rms_true", "slip_rms_estimated", "lock_fraction",
    "duty_variation_per_s",
)  # fmt: skip


@dataclass(frozen=True, slots=True, repr=False)
class Alternatives(Shown):
    """What others would have commanded in the place of a session's controller and estimator."""

    session: Session
    alternatives: Sequence[WhatIfTrace]
    """Each with its name, its commands on the logged counts, and its simulation if there is one."""
    own_error: Mapping[str, Any] | None
    """How far the simulation leaves the log with the session's own controller; None if that is not available."""

    def report(self) -> dict[str, Any]:
        """All of it for JSON: by alternative when and how far it leaves the log, and its simulated result."""
        report: dict[str, Any] = {
            "schema_version": 1,
            "session": str(self.session.path),
            "incomplete": self.session.incomplete,
            "alternatives": [
                {
                    "name": each.name,
                    "horizon_s": each.open_loop.horizon_s,
                    "open_loop": [asdict(one) for one in each.open_loop.divergences],
                    "closed_loop": _of_closed_loop(each.closed_loop),
                }
                for each in self.alternatives
            ],
        }
        first = self.alternatives[0].closed_loop
        if first is not None:
            card = computed_card(self.session)
            report["simulation"] = {
                "rig": first.rig,
                "from_tick": first.from_tick,
                "state_from": first.state_from,
                "own_error": self.own_error,
                "log": {name: card[name] for name in _METRICS},
            }
        return report

    def caution(self) -> str:
        """What the numbers rest on, in one sentence."""
        simulation = self.report().get("simulation")
        if simulation is None:
            return "open loop: the logged counts do not react; after the horizon this is not what would have happened"
        own = simulation["own_error"]
        error = (
            "not available"
            if own is None
            else ", ".join(f"{name} {shown(value, '.4g')}" for name, value in own.items())
        )
        return (
            f"closed loop: a SIMULATION of the rig {simulation['rig']} from tick {simulation['from_tick']} on, its "
            f"state from the {simulation['state_from']}; with the session's own controller it leaves the log by: "
            f"{error}"
        )

    @speaks_of_arguments(figure="alternatives")
    def plot(self) -> Figure:
        """Log and alternatives over the time since braking began. Raises ConfigError for more than seven."""
        return figure_of_what_if(self.session, self.alternatives)

    def __rich__(self) -> RenderableType:
        return render_what_if(self.report())

    def __repr__(self) -> str:
        return f"<Alternatives to {self.session.path}: {'; '.join(each.name for each in self.alternatives)}>"


def alternatives_to(
    session: Session,
    grid: Sequence[tuple[str, list[str]]],
    controllers: Mapping[str, type[Controller]],
    at_s: float | None = None,
    thresholds: tuple[float, float] = (0.01, 0.1),
    *,
    closed_loop: bool = False,
    keep: bool = True,
) -> Alternatives:
    """Each of the `grid`, by name and KEY=VALUE settings, from `at_s` after braking began.

    `thresholds` are the largest differences of duty and of torque, N m, that count as equal. `keep`
    keeps their commands, which a figure needs. Raises ConfigError, SessionError.
    """
    traces = []
    for name, settings in grid:
        other = alternative(session, settings, controllers)
        closed = _continued(session, other, controllers, at_s, keep=keep) if closed_loop else None
        switch_s = 0.0 if closed_loop and at_s is None else at_s
        found: WhatIf = open_loop(session, other, controllers, switch_s, *thresholds, keep=keep)
        traces.append(WhatIfTrace(name, found, closed))
    return Alternatives(session, traces, _own_error(session, controllers, at_s) if closed_loop else None)


def grid_of(settings: Sequence[str], sweeps: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Name and settings of each alternative: all combinations of the KEY=VALUE,VALUE sweeps.

    Raises ConfigError for none or too many.
    """
    axes = [_axis(sweep) for sweep in sweeps]
    count = 1
    for axis in axes:
        count *= len(axis)
    if count > _MOST:
        raise ConfigError.of("--sweep", f"{count} alternatives: must be at most {_MOST}; give fewer values")
    if not (settings or axes):
        problem = "nothing to compare: name other gains, as controller.gains.Mk=5, or a --controller or --estimator"
        raise ConfigError.of("--set", problem)
    for values in product(*axes):
        yield ", ".join(values or settings), [*settings, *values]


def _axis(sweep: str) -> list[str]:
    key, equals, text = sweep.partition("=")
    values = [value.strip() for value in text.split(",")]
    if not (equals and key.strip() and all(values)):
        raise ConfigError.of(f"--sweep {sweep}", "must look like controller.gains.Mk=1,2,5")
    return [f"{key.strip()}={value}" for value in dict.fromkeys(values)]


def _continued(
    session: Session,
    other: RigConfig,
    controllers: Mapping[str, type[Controller]],
    at_s: float | None,
    *,
    keep: bool,
) -> Continuation:
    return continued(session, session_config(session, ()), other, controllers, at_s or 0.0, keep=keep)


def _own_error(
    session: Session, controllers: Mapping[str, type[Controller]], at_s: float | None
) -> dict[str, Any] | None:
    own = session_config(session, ())
    if own.controller.name not in controllers:
        return None
    return _continued(session, own, controllers, at_s, keep=False).distance


def _of_closed_loop(closed: Continuation | None) -> dict[str, Any] | None:
    if closed is None:
        return None
    return {
        "reason": closed.reason.name,
        "card": {name: closed.card[name] for name in _METRICS},
        "from_the_log": closed.distance,
    }
