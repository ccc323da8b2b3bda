"""A mock made from the report of a commissioning: a board that was seen once, with the simulated rig behind it."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from inteco_abs.boards.board_report import BoardReport
from inteco_abs.boards.families.pci.board import registers_of
from inteco_abs.boards.frame_labels import protocol_of
from inteco_abs.errors import CaptureError
from inteco_abs.mock_board import (
    Device,
    FrontEnd,
    PciFrontEnd,
    ReportedFrontEnd,
    ReportedIdentity,
    Usb2FrontEnd,
    UsbFrontEnd,
    UsbIdentity,
)
from inteco_abs.wire.capture import Kind, read_capture

_CABLE: Final = ("drive_pwm", "brake_pwm", "road_encoder", "wheel_encoder", "road_sign", "wheel_sign")
_BOARDS: Final = {"usb2": "usb2", "usb": "usb1-", "pci": "pci"}
"""How a capture's board begins, by kind."""
_FACES: Final[dict[str, Callable[[Device, bytes], FrontEnd]]] = {"usb2": Usb2FrontEnd, "usb": UsbFrontEnd}
_PROFILES: Final = {"usb2": "sim_usb2", "usb": "sim_usb", "pci": "sim_pci"}


class ReportedBoard:
    """The board of the report at `path`. Raises CaptureError for a file that is not such a report, or has no image."""

    def __init__(self, path: Path) -> None:
        capture = read_capture(path)
        if capture.report is None:
            raise CaptureError(
                f"{path}: a capture, but not the report of a commissioning: probe --send-report makes one"
            )
        images = [record.data for record in capture.records if record.kind is Kind.IN]
        if not images:
            raise CaptureError(f"{path}: has no image of the board")
        self.path = path
        self.report: BoardReport = capture.report
        self._capture = capture
        self._image = images[0]
        if not capture.board.startswith(_BOARDS[self.report.kind]):
            raise CaptureError(f"{path}, line 1: board = {capture.board!r}, but report.kind = {self.report.kind!r}")

    @property
    def profile(self) -> str:
        """Shipped profile to begin with."""
        return _PROFILES[self.report.kind]

    @property
    def settings(self) -> Sequence[str]:
        """What the simulated rig's wiring is, by the report's draft, as `--set` takes it."""
        board, encoders = (self.report.profile.get(name, {}) for name in ("board", "encoders"))
        values: dict[str, object] = {f"simulation.{key}": board[key] for key in _CABLE if key in board}
        if "counts_per_turn" in encoders:
            values["simulation.counts_per_turn"] = encoders["counts_per_turn"]
        if self.report.kind == "usb":
            values["board.logic_version"] = protocol_of(self._capture.board).logic_version
        elif self.report.kind == "usb2":
            values["board.frame_map"] = self._capture.board.partition("-")[2] or "generic"
        return [f"{key}={json.dumps(value)}" for key, value in values.items()]

    def face(self, device: Device) -> FrontEnd:
        """The board's side of the wire, with `device` behind it. Raises CaptureError for an image that cannot be."""
        try:
            if self.report.kind == "pci":
                return self._registers(device)
            protocol = protocol_of(self._capture.board)
            return ReportedFrontEnd(_FACES[self.report.kind], device, protocol.read, protocol.send, self._image)
        except ValueError as error:
            raise CaptureError(f"{self._capture.name}: the image is not one of this board: {error}") from error

    def identity(self, like: UsbIdentity) -> UsbIdentity:
        """The board's descriptors, but for the serial number; `like` where the report has none. Raises CaptureError."""
        bus = self.report.bus
        if not bus.descriptors:
            return like
        strings = {"manufacturer": bus.manufacturer, "product": bus.product, "speed": bus.speed}
        try:
            return ReportedIdentity.of(like, bytes.fromhex(bus.descriptors), strings)
        except ValueError as error:
            raise CaptureError(f"{self._capture.name}, line 1: report.bus.descriptors: {error}") from error

    def _registers(self, device: Device) -> FrontEnd:
        still: dict[int, int] = {}
        settings: dict[str, int] = {}
        counts: dict[str, int] = {}
        for name, register, channel, bits in registers_of(self._image):
            if name.startswith("pwm") or name == "encoder_reset":
                settings[name] = register.decode(bits)
            elif name.endswith("_count"):
                counts[name] = register.decode(bits)
            elif channel is None:
                still[register.offset] = bits
        device.write(settings)
        cable = device.cable
        device.begin_counts(counts[f"encoder{cable.road_encoder}_count"], counts[f"encoder{cable.wheel_encoder}_count"])
        return PciFrontEnd(device, still)
