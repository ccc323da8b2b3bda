"""A mock board made from the report of a commissioning."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from inteco_abs.boards import FAMILIES, family_of
from inteco_abs.errors import CaptureError, near_match
from inteco_abs.mock_board import Device, FrontEnd, ReportedIdentity, UsbIdentity, mock_family
from inteco_abs.wire import RecordKind, read_capture

if TYPE_CHECKING:
    from inteco_abs.boards.board_report import BoardReport  # loads pydantic

_CABLE: Final = ("drive_pwm", "brake_pwm", "road_encoder", "wheel_encoder", "road_sign", "wheel_sign")


class ReportedBoard:
    """The board of the report at `path`. Raises CaptureError if it is not such a report, or has no image."""

    def __init__(self, path: Path) -> None:
        capture = read_capture(path)
        if capture.report is None:
            raise CaptureError(
                f"{path}: a capture, but not the report of a commissioning: commission --send-report makes one"
            )
        images = [record.data for record in capture.records if record.kind is RecordKind.IN]
        if not images:
            raise CaptureError(f"{path}: has no image of the board")
        self.path = path
        self.report: BoardReport = capture.report
        self._capture = capture
        self._image = images[0]
        if self.report.kind not in FAMILIES:
            known = near_match(self.report.kind, FAMILIES)
            raise CaptureError(f"{path}, line 1: report.kind = {self.report.kind!r}: no such board family{known}")
        self._family = family_of(self.report.kind)
        self._protocol = next((one for one in self._family.protocols if one.board == capture.board), None)
        if self._protocol is None and (self._family.protocols or capture.board != self._family.name):
            raise CaptureError(f"{path}, line 1: board = {capture.board!r}, but report.kind = {self.report.kind!r}")

    @property
    def profile(self) -> str:
        """Shipped profile to begin with."""
        return self._family.mock_profile

    @property
    def settings(self) -> Sequence[str]:
        """The simulated rig's wiring by the report's profile, as settings for `--set`."""
        board, encoders = (self.report.profile.get(name, {}) for name in ("board", "encoders"))
        values: dict[str, object] = {f"simulation.{key}": board[key] for key in _CABLE if key in board}
        if "counts_per_turn" in encoders:
            values["simulation.counts_per_turn"] = encoders["counts_per_turn"]
        if self._protocol is not None:
            values |= {f"board.{key}": value for key, value in self._protocol.settings.items()}
        return [f"{key}={json.dumps(value)}" for key, value in values.items()]

    def front_end(self, device: Device) -> FrontEnd:
        """Front end of the board with `device` behind it. Raises CaptureError for an impossible image."""
        try:
            return mock_family(self._family.name).reported(device, self._protocol, self._image)
        except ValueError as error:
            raise CaptureError(f"{self._capture.name}: the image is not one of this board: {error}") from error

    def identity(self, like: UsbIdentity) -> UsbIdentity:
        """The board's descriptors without its serial number; `like` if the report has none. Raises CaptureError."""
        bus = self.report.bus
        if not bus.descriptors:
            return like
        strings = {"manufacturer": bus.manufacturer, "product": bus.product, "speed": bus.speed}
        try:
            return ReportedIdentity.of(like, bytes.fromhex(bus.descriptors), strings)
        except ValueError as error:
            raise CaptureError(f"{self._capture.name}, line 1: report.bus.descriptors: {error}") from error
