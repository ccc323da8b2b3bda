"""Step 5: PWM settings are written with the power interface off, and must be echoed; the wheels must not move."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from inteco_abs.commissioning.first_write import agree_on_first_write
from inteco_abs.commissioning.outputs import PROVES_ITSELF, outputs
from inteco_abs.commissioning.permission import outputs_permitted
from inteco_abs.commissioning.reading import open_for_reading
from inteco_abs.commissioning.step import Facts, StepContext
from inteco_abs.config import PwmMode, RigConfig
from inteco_abs.errors import ProbeError

PHRASE: Final = "the power interface is off"
_REQUEST: Final = (
    "Switch the power interface off at its mains switch: its lamps are dark. Nothing may move in this step, so "
    "keep hands away from the wheels."
)
_DUTIES: Final = ((0.05, 0.0), (0.0, 0.2), (0.1, 0.1), (0.0, 0.0))
"""Of drive and brake. So small that little would happen if the interface were on after all."""
_SETTINGS: Final = (("12-bit", 2), ("8-bit", 44))
"""Modes and prescalers near 3.5 kHz (docs/facts/boards.md#pwm-and-counters)."""
_HOLD_S: Final = 0.1
_MOST_COUNTS: Final = 8
"""A wheel that stands on an edge may count a little."""


def echo_settings(visit: StepContext) -> Facts:
    """Each mode, prescaler and width of both channels; the last one written are the profile's own, widths zero."""
    config = outputs_permitted(visit, _REQUEST, PHRASE)
    visit.bench.powered(on=False)
    agreed = agree_on_first_write(visit, config)
    before = _settings(visit)
    visit.person.tell(f"  {PROVES_ITSELF}")
    tried = []
    for mode, prescaler in _modes(config):
        _echo(visit, _with_pwm(config, mode, prescaler))
        tried.append({"mode": mode, "prescaler": prescaler, "duties": [list(pair) for pair in _DUTIES]})
        visit.person.tell(f"  {mode}, prescaler {prescaler}: all widths were echoed, no wheel moved")
    after = _settings(visit)
    changed = {name: [before[name], after[name]] for name in before if before[name] != after[name]}
    visit.person.tell(f"  settings that differ from before: {', '.join(changed) or 'none'}")
    return {**agreed, "tried": tried, "changed": changed}


def _modes(config: RigConfig) -> Iterator[tuple[PwmMode, int]]:
    own = (config.board.pwm_mode, config.board.pwm_prescaler)
    yield from (setting for setting in _SETTINGS if setting != own)
    yield own


def _with_pwm(config: RigConfig, mode: PwmMode, prescaler: int) -> RigConfig:
    board = replace(config.board, pwm_mode=mode, pwm_prescaler=prescaler)
    return replace(config, board=board)


def _echo(visit: StepContext, config: RigConfig) -> None:
    """Entering the board writes mode, prescaler and pins and compares them, each beat compares the widths."""
    with outputs(visit, config) as out:
        for drive, brake in _DUTIES:
            for motion in out.hold(drive, brake, _HOLD_S):
                if max(abs(motion.wheel_counts), abs(motion.road_counts)) > _MOST_COUNTS:
                    raise ProbeError(
                        "a wheel moved although the power interface should be off: check its mains switch, "
                        "let the wheels come to rest, and keep hands away"
                    )


def _settings(visit: StepContext) -> dict[str, int | str]:
    """What the board echoes of its settings."""
    with open_for_reading(visit) as board:
        values = board.survey().values
    return {name: value for name, value in values.items() if name.startswith(("pwm", "pin_", "encoder_reset"))}
