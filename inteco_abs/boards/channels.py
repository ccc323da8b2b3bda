"""Checks the wiring's channels against what a board without a table of frames has."""

from __future__ import annotations

from collections.abc import Callable

from inteco_abs.config import BoardConfig
from inteco_abs.errors import ConfigIssue


def channel_mistakes(wiring: BoardConfig, pwms: int, encoders: int, has: Callable[[int], str]) -> list[ConfigIssue]:
    """Mistakes in the channels of `wiring`, for a board of `pwms` and `encoders` that dates and watches by itself.

    `has` describes what the board has, by the number of channels of a kind.
    """
    most = {
        **dict.fromkeys(("drive_pwm", "brake_pwm"), pwms),
        **dict.fromkeys(("wheel_encoder", "road_encoder"), encoders),
        **dict.fromkeys(("numbering_pwm", "timer", "watchdog_pin", "watchdog_contact_pin"), 0),
    }
    return [
        ConfigIssue(f"board.{key}", f"{getattr(wiring, key)}: {has(count)}")
        for key, count in most.items()
        if getattr(wiring, key) >= count
    ]
