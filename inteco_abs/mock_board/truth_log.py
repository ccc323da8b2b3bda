"""Writes the rig's true state as JSON lines, for demonstrations and tests of a mock board."""

from __future__ import annotations

import json
from typing import Final, TextIO

from inteco_abs.mock_board.device import Device

_NS: Final = 1_000_000_000


class TruthLog:
    """Writes a line to `file` every 1 / `rate_hz` seconds of the device's clock, if `poll` is called often enough."""

    def __init__(self, device: Device, file: TextIO, rate_hz: float) -> None:
        self._device = device
        self._file = file
        self._period_ns = round(_NS / rate_hz)
        self._due_ns = 0

    def poll(self) -> None:
        """Write a line if one is due."""
        truth = self._device.truth()
        if truth.time_ns >= self._due_ns:
            self._due_ns = truth.time_ns + self._period_ns
            print(json.dumps(truth._asdict()), file=self._file, flush=True)
