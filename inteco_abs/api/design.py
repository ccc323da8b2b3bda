"""Assessment of gains for a rig that is not known exactly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from inteco_abs.api.arguments import speaks_of_arguments
from inteco_abs.api.configuration import chosen_settings, setting_lines
from inteco_abs.api.controllers import known_controllers, name_of
from inteco_abs.boards import kind_check
from inteco_abs.config import load_config
from inteco_abs.control import control_check, preferred_estimator
from inteco_abs.errors import ConfigError, ConfigIssue
from inteco_abs.rig import nominal_parameters

if TYPE_CHECKING:
    from inteco_abs.config import RigConfig
    from inteco_abs.control import Controller
    from inteco_abs.gain_design import Assessment, Brake, Certificate

_SLOWEST_RAD_S: Final = 10.0
_FASTEST_RAD_S: Final = 245.0
_LEAST_SLIP: Final = 0.01
"""Below, the model's adhesion is near zero or negative."""
_LONGEST_S: Final = 1.0


@speaks_of_arguments(set="settings", speeds="speeds_rad_s", lag="lag_s", dead_time="dead_time_s", from_slip="from_slip")
def design(
    controller: str | type[Controller] | None = None,
    *,
    gains: Mapping[str, float] | None = None,
    settings: Mapping[str, Any] | None = None,
    config: str | Path | None = None,
    uncertain: Mapping[str, str | float] | None = None,
    speeds_rad_s: tuple[float, float] | None = None,
    slip_band: tuple[float, float] | None = None,
    from_slip: float | None = None,
    lag_s: tuple[float, float] | None = None,
    dead_time_s: float | None = None,
) -> Assessment | Certificate:
    """Check gains of a law for a rig that is not known exactly.

    It computes how large Mq must be for sliding, by (25) and (26), how long reaching may take, by (20), and whether the
    brake is strong enough, for an ideal loop. With the `lag_s` and `dead_time_s` of the brake (s, both in 0..1), or a
    `config` of an identified one, it also finds limit cycles of the real loop. `uncertain` has by parameter how far it
    may be off, both ways, in its unit or as "5%"; by default the population `hard`. `speeds_rad_s` are road speeds,
    lowest and highest, in 0.1..245 rad/s; `slip_band` are slips in 0.01..1 at which sliding is checked, beside the
    reference alone, and `from_slip` one in 0..1 from which reaching is checked, too. `advice` of the result is empty if
    the gains hold for the whole set of rigs. Raises ConfigError.

    That is for `reaching-law`, `constant-rate` and `boundary-layer`. Of `predictive-reaching` it certifies the linear
    loop: how far gain, dead time and lag of the brake may be from what the observer expects, by road speed.
    """
    known = known_controllers(controller)
    chosen = chosen_settings(settings, gains, None if controller is None else name_of(controller))
    rig = load_config(
        None if config is None else Path(config),
        setting_lines(chosen),
        [kind_check, control_check(known)],
        follows=preferred_estimator(known),
    )
    stated = [f"{name}={spread}" for name, spread in (uncertain or {}).items()]
    return assessed(rig, stated, speeds_rad_s, slip_band, from_slip, lag_s, dead_time_s)


def assessed(
    rig: RigConfig,
    uncertain: Sequence[str] = (),
    speeds_rad_s: tuple[float, float] | None = None,
    slip_band: tuple[float, float] | None = None,
    from_slip: float | None = None,
    lag_s: tuple[float, float] | None = None,
    dead_time_s: float | None = None,
) -> Assessment | Certificate:
    """The assessment of a configuration; `uncertain` are NAME=SPREAD. Raises ConfigError."""
    from inteco_abs.gain_design import HARD, PREDICTED, certify, faded_share, judge_gains, stated_box

    speeds = speeds_rad_s or (_SLOWEST_RAD_S, max(rig.experiment.start_speed_rad_s, _SLOWEST_RAD_S + 1.0))
    slips = [0.0] if from_slip is None else [0.0, from_slip]
    if rig.controller.constant_slip is None:
        problem = "a design judges one slip: leave it out, and give controller.reference_slip"
        raise ConfigError.of(f"controller.{rig.controller.reference_key}", problem)
    _require_ranges(speeds, slip_band, slips, rig.controller.reference_slip)
    brake = _brake(rig, lag_s, dead_time_s)
    box = stated_box(uncertain or HARD, nominal_parameters(rig.model))
    if share := faded_share(rig):
        box = box.faded(share)
    if rig.controller.name == PREDICTED:
        for option, given in (("--slip-band", slip_band), ("--from-slip", from_slip)):
            if given is not None:
                raise ConfigError.of(option, f"belongs to laws with a switching gain: leave it out for {PREDICTED}")
        return certify(rig, box, speeds, brake)
    return judge_gains(rig, box, speeds, slip_band, slips, brake)


def _brake(rig: RigConfig, lag: tuple[float, float] | None, dead_time: float | None) -> Brake | None:
    """The brake that is stated, else the identified one."""
    from inteco_abs.gain_design import Brake, identified_brake

    for option, value in (("--lag", lag or ()), ("--dead-time", () if dead_time is None else (dead_time,))):
        if not all(0.0 <= each <= _LONGEST_S for each in value):
            raise ConfigError.of(option, f"{' '.join(map(str, value))}: must be in 0..{_LONGEST_S:g} s")
    if lag is not None and lag[0] > lag[1]:
        raise ConfigError.of("--lag", f"{lag[0]:g} {lag[1]:g}: must not fall; write --lag {lag[1]:g} {lag[0]:g}")
    found = identified_brake(rig) if lag is None else Brake(*lag, 0.0)
    if dead_time is None:
        return found
    if found is None:
        problem = "needs --lag LOW HIGH, or an identified lag; --lag 0 0 is a brake without lag"
        raise ConfigError.of("--dead-time", problem)
    return found._replace(dead_time_s=dead_time)


def _require_ranges(
    speeds: tuple[float, float], slip_band: tuple[float, float] | None, from_slips: Sequence[float], reference: float
) -> None:
    mistakes = [*_range_issues("--speeds", speeds, 0.1, _FASTEST_RAD_S, "rad/s")]
    if slip_band is not None:
        mistakes += _range_issues("--slip-band", slip_band, _LEAST_SLIP, 1.0, "of slip")
    mistakes += [
        ConfigIssue("--from-slip", f"{slip:g}: must be in 0..1") for slip in from_slips if not 0.0 <= slip <= 1.0
    ]
    if reference < _LEAST_SLIP:
        problem = (
            f"{reference:g}: must be at least {_LEAST_SLIP:g} for a design; below, the model has almost no adhesion"
        )
        mistakes.append(ConfigIssue("controller.reference_slip", problem))
    if mistakes:
        raise ConfigError(mistakes)


def _range_issues(option: str, stated: tuple[float, float], least: float, most: float, unit: str) -> list[ConfigIssue]:
    low, high = stated
    if not (least <= low <= most and least <= high <= most):
        return [ConfigIssue(option, f"{low:g} {high:g}: must both be in {least:g}..{most:g} {unit}")]
    if not low < high:
        return [ConfigIssue(option, f"{low:g} {high:g}: must rise; write {option} {high:g} {low:g}")]
    return []
