"""The rig's numbers of a run with their units, as an attachment that any program reads."""

from __future__ import annotations

import json
from math import inf
from typing import Any, Final

from inteco_abs.config import RigConfig
from inteco_abs.rig import described, nominal_brake_map, nominal_drive_motor, nominal_parameters
from inteco_abs.rig.brake_map import BrakeMap

RIG_NAME: Final = "rig.json"
"""Name of the attachment."""


def rig_numbers(config: RigConfig, *, simulated: bool) -> bytes:
    """JSON of `nominal`, the rig as controllers know it, and `simulated`, the rig in the mock board, if there is one.

    Both by name: `value`, `unit` as in UCUM, and `meaning`; defaults included. An infinite value is the text `inf`.
    """
    motor = nominal_drive_motor(config.model)
    nominal = {
        **_numbers(nominal_parameters(config.model)),
        **(_numbers(motor) if motor else {}),
        "brake_map": _points(nominal_brake_map(config.model)),
    }
    content = {"nominal": nominal}
    if simulated:
        from inteco_abs.mock_board import simulated_rig  # noqa: PLC0415  a run on a real board needs none of it
        from inteco_abs.rig import DriveMotor  # noqa: PLC0415

        rig = simulated_rig(config)
        content["simulated"] = {
            **_numbers(rig.parameters),
            **_numbers(DriveMotor()),
            **_numbers(rig),
            **_numbers(rig.wheel_encoder, "wheel_encoder."),
            **_numbers(rig.road_encoder, "road_encoder."),
        }
    return json.dumps(content, indent=0).encode()


def _numbers(record: Any, prefix: str = "") -> dict[str, dict[str, Any]]:
    return {
        prefix + name: {
            "value": "inf" if value == inf else value,
            "unit": unit,
            "meaning": meaning,
        }
        for (name, unit, meaning), _, value in described(record)
        if isinstance(value, int | float | str)
    }


def _points(brake: BrakeMap) -> dict[str, Any]:
    meaning = "static map of the brake: duty and settled torque, straight lines between"
    return {"value": [list(point) for point in brake.points], "unit": ["1", "N.m"], "meaning": meaning}
