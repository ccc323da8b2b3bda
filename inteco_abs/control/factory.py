"""Makes the pipeline of a configuration, and checks names and gains."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import replace
from typing import Any

from inteco_abs.config import Check, RigConfig, section_of
from inteco_abs.control.controllers import CONTROLLERS, SWING_BAND, Controller, Gain, PredictiveReaching, Setup
from inteco_abs.control.estimators import ESTIMATORS, Estimator
from inteco_abs.control.gain_changes import (
    REFERENCE,
    changeable_gains,
    parse_change,
    planned_changes,
    reference_gain,
    value_problem,
)
from inteco_abs.control.pipeline import Pipeline
from inteco_abs.control.reference import check_reference, following
from inteco_abs.errors import ConfigError, ConfigIssue, near_match, place_in, shortened
from inteco_abs.quantities import number_hint
from inteco_abs.rig import RigVariation, nominal_brake_map, nominal_parameters


def build_pipeline(config: RigConfig, controllers: Mapping[str, type[Controller]] = CONTROLLERS) -> Pipeline:
    """Pipeline of a configuration that passed `control_check(controllers)`.

    Raises ConfigError if the controller's constructor fails.
    """
    controller = make_controller(config, controllers)
    if config.experiment.stops > 1:
        with _blamed_on(config):
            deepcopy(controller)  # each stop begins with a fresh one
    return Pipeline(config, make_estimator(config), controller)


def make_estimator(config: RigConfig) -> Estimator:
    """Estimator of a configuration that passed `control_check`."""
    return ESTIMATORS[config.estimator.name](config, nominal_parameters(config.model))


def make_controller(config: RigConfig, controllers: Mapping[str, type[Controller]] = CONTROLLERS) -> Controller:
    """Controller of a configuration that passed `control_check(controllers)`.

    Raises ConfigError if its constructor fails.
    """
    parameters = nominal_parameters(config.model)
    brake, reference = nominal_brake_map(config.model), config.controller.reference_slip
    setup = Setup(reference, parameters, config.controller.hold_below_rad_s, brake)
    make: Any = controllers[config.controller.name]  # each controller's constructor takes its own gains
    with _blamed_on(config):
        controller: Controller = make(setup, **gains_in_force(config, controllers))
    return following(controller, config)


@contextmanager
def _blamed_on(config: RigConfig) -> Iterator[None]:
    """Report anything that the controller's code raises as a ConfigError."""
    try:
        yield
    except (Exception, SystemExit) as error:
        name = config.controller.name
        where = place_in(error, name.rpartition(":")[0])
        problem = f"{name}{where} cannot be made: {type(error).__name__}: {error}"
        raise ConfigError.of("controller.name", problem) from error


def gains_in_force(config: RigConfig, controllers: Mapping[str, type[Controller]] = CONTROLLERS) -> dict[str, float]:
    """Every gain of the configured controller, defaults included."""
    return {
        gain.name: float(config.controller.gains.get(gain.name, gain.default))
        for gain in controllers[config.controller.name].gains
    }


def swing_band(config: RigConfig) -> float:
    """Slip error to both sides of which the slip swings when the configured law falls back; 0: it does not."""
    own = CONTROLLERS.get(config.controller.name) is PredictiveReaching
    return gains_in_force(config)[SWING_BAND] if own else 0.0


def gains_to_change(
    pipeline: Pipeline, config: RigConfig, controllers: Mapping[str, type[Controller]] = CONTROLLERS
) -> tuple[Gain, ...]:
    """Gains and reference slip that can change while `pipeline`, just made, runs; their values are the defaults."""
    values = {REFERENCE: config.controller.reference_slip, **gains_in_force(config, controllers)}
    return changeable_gains(pipeline.machine.controller, controllers[config.controller.name].gains, values)


def check_changes(config: RigConfig, gains: Sequence[Gain]) -> None:
    """Raise ConfigError unless `gains`, which can change, have all that `experiment.changes` plans, within the run."""
    problems = list[str]()
    for text, each in zip(config.experiment.changes or (), planned_changes(config.experiment.changes), strict=True):
        problems.append(value_problem(each.name, each.value, gains))
        stops, longest_s = config.experiment.stops, config.experiment.longest_s
        if each.braking > stops:
            problems.append(f"{text!r}: the run has {stops} {'stop' if stops == 1 else 'stops'}; set experiment.stops")
        if each.delay(config.loop.rate_hz) > longest_s * config.loop.rate_hz:
            problems.append(f"{text!r}: the run lasts at most {longest_s:g} s; choose an earlier time")
    mistakes = [ConfigIssue("experiment.changes", problem) for problem in dict.fromkeys(problems) if problem]
    if mistakes:
        raise ConfigError(mistakes)


def config_of_stop(config: RigConfig, rig: RigVariation) -> RigConfig:
    """`config` for one stop of a simulated rig, of a lab that knows its amplifier: the brake is limited to its cap.

    Raises ConfigError for gains that change.
    """
    guard, experiment = config.guard, config.experiment
    if experiment.changes:
        problem = "stops of many rigs keep their gains; leave it out, or use inteco-abs run"
        raise ConfigError.of("experiment.changes", problem)
    limit = min(guard.brake_limit, rig.brake_duty_cap)
    return replace(config, guard=replace(guard, brake_limit=limit), experiment=replace(experiment, stops=1))


def preferred_estimator(
    controllers: Mapping[str, type[Controller]] = CONTROLLERS,
) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """For `load_config`: the `estimator` that the controller needs, if no other was chosen."""

    def follows(table: Mapping[str, Any]) -> dict[str, Any]:
        needed = _needed_estimator(table, controllers)
        return {"estimator": {"name": needed}} if needed else {}

    return follows


def _needed_estimator(table: Mapping[str, Any], controllers: Mapping[str, type[Controller]]) -> str:
    name = section_of(table, "controller").get("name", "")
    if not isinstance(name, str) or name not in controllers:
        return ""
    try:
        needed: str = getattr(controllers[name], "estimator", "")
    except ConfigError:  # a package that cannot be imported; the check reports it
        return ""
    return needed


def _same_kind(name: str, needed: str) -> bool:
    """Whether both are of one class, tuned in different ways."""
    known = name in ESTIMATORS and needed in ESTIMATORS
    return known and ESTIMATORS[name].works is ESTIMATORS[needed].works


def control_check(
    controllers: Mapping[str, type[Controller]] = CONTROLLERS, estimators: Collection[str] = ESTIMATORS
) -> Check:
    """Check of names and gains for `load_config`: unknown ones with near matches, gains out of range."""

    def check(table: Mapping[str, Any]) -> Iterator[ConfigIssue]:
        estimator, controller = section_of(table, "estimator"), section_of(table, "controller")
        name = estimator.get("name", "moving-window")
        needed = _needed_estimator(table, controllers)
        if isinstance(name, str) and name not in estimators:
            yield ConfigIssue("estimator.name", f"no estimator {name!r}{near_match(name, estimators)}")
        elif isinstance(name, str) and needed not in {"", name} and not _same_kind(name, needed):
            problem = (
                f"{name!r}: the controller {controller['name']} needs {needed!r}; choose it, or another controller"
            )
            yield ConfigIssue("estimator.name", problem)
        yield from _check_parameters(name, estimator, section_of(table, "loop"))
        name = controller.get("name", "reaching-law")
        if isinstance(name, str) and name not in controllers and ".py:" in name:
            yield ConfigIssue("controller.name", f"{name!r} is code, which runs only if named by --controller")
        elif isinstance(name, str) and name not in controllers:
            yield ConfigIssue("controller.name", f"no controller {name!r}{near_match(name, controllers)}")
        elif isinstance(name, str):
            try:
                gains = controllers[name].gains
            except ConfigError as error:  # a package is imported only now
                yield from error.mistakes
            else:
                yield from _check_gains(name, section_of(controller, "gains"), gains)
                yield from _bare_gains(table, gains)
                yield from check_reference(name, controllers[name], controller)
                yield from _check_changes(section_of(table, "experiment").get("changes"), gains)

    return check


def _check_changes(texts: object, gains: tuple[Gain, ...]) -> Iterator[ConfigIssue]:
    """What is wrong with planned changes, as far as it shows without the controller; `check_changes` finds the rest."""
    known = [reference_gain(0.2), *gains]
    for text in texts if isinstance(texts, list) else ():
        if isinstance(text, str):
            try:
                change = parse_change(text)
                problem = value_problem(change.name, change.value, known)
            except ValueError as error:
                problem = str(error)
            if problem:
                yield ConfigIssue("experiment.changes", f"{shortened(text)}: {problem}")


def _check_parameters(name: object, estimator: Mapping[str, Any], loop: Mapping[str, Any]) -> Iterator[ConfigIssue]:
    if isinstance(name, str) and name in ESTIMATORS:
        try:
            check = ESTIMATORS[name].check
        except ConfigError as error:  # a package is imported only now
            yield from error.mistakes
        else:
            yield from check(estimator, loop)


def _bare_gains(table: Mapping[str, Any], gains: tuple[Gain, ...]) -> Iterator[ConfigIssue]:
    """Gains that stand without their section."""
    for gain in gains:
        if gain.name in table:
            yield ConfigIssue(gain.name, f"unknown key; did you mean controller.gains.{gain.name}?")


def _check_gains(controller: str, values: Mapping[str, Any], gains: tuple[Gain, ...]) -> Iterator[ConfigIssue]:
    known = {gain.name: gain for gain in gains}
    for name, value in values.items():
        path, gain = f"controller.gains.{name}", known.get(name)
        if gain is None:
            hint = near_match(name, known) if known else "; the controller has none"
            yield ConfigIssue(path, f"unknown gain of {controller}{hint}")
        elif isinstance(value, bool) or not isinstance(value, int | float) or not gain.low <= value <= gain.high:
            unit = "" if gain.unit == "1" else gain.unit
            wanted = f"must be a number in {gain.low:g}..{gain.high:g} {unit}".rstrip()
            hint = number_hint(value, unit) if isinstance(value, str) else ""
            yield ConfigIssue(path, f"{shortened(value)}: {wanted} ({gain.meaning}){hint}")
