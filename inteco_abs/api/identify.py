"""Identification of a rig from sessions: which runs it needs, and the fit."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inteco_abs.api.arguments import speaks_of_arguments
from inteco_abs.api.configuration import as_list, setting_lines
from inteco_abs.boards import kind_check
from inteco_abs.config import ControllerConfig, EstimatorConfig, load_config
from inteco_abs.control import LAG, control_check
from inteco_abs.errors import ConfigError, ConfigIssue, near_match
from inteco_abs.experiment import Plan
from inteco_abs.sessions import Session, read_session, session_config

if TYPE_CHECKING:
    from inteco_abs.config import RigConfig
    from inteco_abs.control import Controller
    from inteco_abs.gain_design import Assessment
    from inteco_abs.identification import Identification, PlannedRun, Segment


@speaks_of_arguments(SESSION="sessions", plan="Rig.record_for_identification()", assume="assumed", set="settings")
def identify(
    sessions: Session | str | Path | Iterable[Session | str | Path],
    *,
    config: str | Path | None = None,
    settings: Mapping[str, Any] | None = None,
    assumed: Mapping[str, float] | None = None,
    progress: Callable[[float, float], None] | None = None,
) -> Identification:
    """Identify a rig's parameters from the sessions of `Rig.record_for_identification`, each with a 95 % interval.

    From run-ups, coast-downs and brake steps it finds frictions, drive motor, brake and friction curve. Encoder counts
    give ratios only: geometry, inertias and the lever's moment come from the model of `config` (a rig.toml) and
    `settings`; `assumed` has their uncertainty as shares, as {"J1": 0.01}, which is part of the intervals. `progress`
    is called after each step with the noise, in counts, by which residuals are weighed, and their RMS in counts.
    `missing` of the result has what was not identified, and `save` writes the parameters, for `connect(config=...)`.
    Takes some ten seconds. Raises ConfigError, SessionError, or AbsError without the extra `lab`.
    """
    checks = [kind_check, control_check()]
    rig = load_config(None if config is None else Path(config), setting_lines(settings or {}), checks)
    return identified(rig, as_list(sessions), assumed, progress)


def identified(
    rig: RigConfig,
    given: Iterable[Session | str | Path],
    assumed: Mapping[str, float] | None = None,
    progress: Callable[[float, float], None] | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Identification:
    """The fit to sessions, with the constants of the model of `rig`; `say` is called before it begins."""
    from inteco_abs.identification import chosen, segments
    from inteco_abs.identification import identify as fit

    assumed = dict(assumed or {})
    _require_shares(assumed)
    count = 0

    def found() -> Iterator[Segment]:
        nonlocal count
        for each in given:
            count += 1
            session = each if isinstance(each, Session) else read_session(Path(each))
            yield from segments(session, session_config(session, ()).encoders.counts_per_turn)

    parts = chosen(found())
    if not parts:
        problem = "no session has a run-up or a braking phase of the open-loop controller; --plan records some"
        raise ConfigError.of("SESSION", problem)
    say(f"fitting {len(parts)} phases of {count} sessions")
    return fit(parts, rig.model, assumed, progress)


def with_identified(rig: RigConfig, found: Identification, controllers: Mapping[str, type[Controller]]) -> RigConfig:
    """`rig` with the identified model; its controller inverts the identified lag if it can and no lag is stated."""
    model, gains = found.identified_model, dict(rig.controller.gains)
    c31 = model.identified.c31
    if c31 is not None and LAG in controllers[rig.controller.name].gains:
        gains.setdefault(LAG.name, round(min(1.0 / c31, LAG.high), 4))
    return replace(rig, model=model, controller=replace(rig.controller, gains=gains))


def law_sections(rig: RigConfig) -> dict[str, Any]:
    """The sections of a file that choose controller and estimator of `rig`, without values that are defaults."""
    chosen = {"estimator": (rig.estimator, EstimatorConfig()), "controller": (rig.controller, ControllerConfig())}
    return {
        section: {key: value for key, value in own.as_table().items() if key == "name" or value != getattr(usual, key)}
        for section, (own, usual) in chosen.items()
    }


def judged(rig: RigConfig, found: Identification) -> Assessment | None:
    """The assessment of the gains of `rig` for all rigs within the intervals; None for a law without a switching gain.

    Where an interval is missing, it is for the rigs of the population `hard`. Raises ConfigError as `design` does.
    """
    from inteco_abs.api.design import assessed
    from inteco_abs.gain_design import LAWS, Assessment

    if rig.controller.name not in LAWS:
        return None
    assessment = assessed(rig, found.uncertainty(rig.controller.reference_slip) or ())
    return assessment if isinstance(assessment, Assessment) else None


def _require_shares(assumed: Mapping[str, float]) -> None:
    from inteco_abs.identification import ASSUMED

    issues = []
    for name, share in assumed.items():
        if name not in ASSUMED:
            issues.append(ConfigIssue("--assume", f"{name}: not an assumed parameter{near_match(name, ASSUMED)}"))
        elif not 0.0001 <= share <= 0.9:
            issues.append(ConfigIssue("--assume", f"{name}: {share!r}: must be a share in 0.0001..0.9"))
    if issues:
        raise ConfigError(issues)


def next_planned_runs(rig: RigConfig, found: Identification | None) -> tuple[PlannedRun, ...]:
    """The runs to record within the limits of `rig`: all, or those that would help most after `found`."""
    from inteco_abs.identification import experiments, next_runs

    limit = rig.guard.brake_limit
    return experiments(limit) if found is None else next_runs(found, limit, rig.experiment.start_speed_rad_s)


def planned_run(
    run: PlannedRun, configured: Callable[..., RigConfig], folder: Path, board: str, *, virtual: bool, seed: int
) -> tuple[RigConfig, Plan]:
    """Configuration and plan of one of them; `configured` makes a configuration of checks and further settings."""
    config = configured(checks=[control_check()], more=run.settings)
    return config, Plan(out=folder / f"{run.name}.mcap", board=board, virtual=virtual, seed=seed)
