"""Step 5: write PWM settings with the power interface off; the board must echo them, and no wheel may move."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from inteco_abs.commissioning.consent import agree_on_first_write
from inteco_abs.commissioning.outputs import PROVES_ITSELF, outputs
from inteco_abs.commissioning.permission import outputs_permitted
from inteco_abs.commissioning.reading import open_for_reading
from inteco_abs.commissioning.step import Facts, StepContext
from inteco_abs.config import PwmMode, RigConfig
from inteco_abs.errors import CommissioningError

PHRASE: Final = "the power interface is off"
_REQUEST: Final = (
    "Switch the power interface off at its mains switch: its lamps are dark. Nothing may move in this step, so "
    "keep hands away from the wheels."
)
_DUTIES: Final = ((0.05, 0.0), (0.0, 0.2), (0.1, 0.1), (0.0, 0.0))
"""Duties of drive and brake; small, in case the interface is on after all."""
_SETTINGS: Final = (("12-bit", 2), ("8-bit", 44))
"""Modes and prescalers near 3.5 kHz (docs/facts/boards.md#pwm-and-counters)."""
_HOLD_S: Final = 0.1
_MOST_COUNTS: Final = 8
"""A wheel that rests on the edge of an encoder line may count a little."""


def echo_settings(context: StepContext) -> Facts:
    """Write modes, prescalers and widths of both channels; the profile's own settings and zero widths come last."""
    config = outputs_permitted(context, _REQUEST, PHRASE)
    context.rig.powered(on=False)
    agreed = agree_on_first_write(context, config)
    before = _settings(context)
    context.operator.say(f"  {PROVES_ITSELF}")
    tried = []
    for mode, prescaler in _modes(config):
        _echo(context, replace(config, board=replace(config.board, pwm_mode=mode, pwm_prescaler=prescaler)))
        tried.append({"mode": mode, "prescaler": prescaler, "duties": [list(pair) for pair in _DUTIES]})
        context.operator.say(f"  {mode}, prescaler {prescaler}: all widths were echoed, no wheel moved")
    after = _settings(context)
    changed = {name: [before[name], after[name]] for name in before if before[name] != after[name]}
    context.operator.say(f"  settings that differ from before: {', '.join(changed) or 'none'}")
    return {**agreed, "tried": tried, "changed": changed}


def _modes(config: RigConfig) -> Iterator[tuple[PwmMode, int]]:
    own = (config.board.pwm_mode, config.board.pwm_prescaler)
    yield from (setting for setting in _SETTINGS if setting != own)
    yield own


def _echo(context: StepContext, config: RigConfig) -> None:
    """Opening the board writes mode, prescaler and pins and compares their echo; each beat compares the widths."""
    with outputs(context, config) as out:
        for drive, brake in _DUTIES:
            for motion in out.hold(drive, brake, _HOLD_S):
                if max(abs(motion.wheel_counts), abs(motion.road_counts)) > _MOST_COUNTS:
                    raise CommissioningError(
                        "a wheel moved although the power interface should be off: check its mains switch, "
                        "let the wheels come to rest, and keep hands away"
                    )


def _settings(context: StepContext) -> dict[str, int | str]:
    """Settings as the board echoes them."""
    with open_for_reading(context) as board:
        values = board.survey().values
    return {name: value for name, value in values.items() if name.startswith(("pwm", "pin_", "encoder_reset"))}
