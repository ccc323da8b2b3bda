"""Benches of the open board's firmware, at a pseudo-terminal, with the mock's rig on its simulated pins."""

import tempfile
from collections import deque
from functools import cache
from pathlib import Path
from typing import ClassVar

import benches_open
from benches import BENCHES_OF_A_TEST, Counted, OnPty, PtyBench, Pumped, two_complement, untrusted_profiles
from benches_open import OpenBench
from host_board import HostBoard

from firmware_protocol.c_header import BOARD_DATE, BOARD_NAME, VENDOR_NAME
from firmware_protocol.rtdac_usb import encode_send
from inteco_abs.boards.families.open.line import FramedLine
from inteco_abs.boards.families.open.mock import FrameStream
from inteco_abs.mock_board import Device, PtyServer


@cache
def _boards() -> deque[HostBoard]:
    with tempfile.TemporaryDirectory() as folder:
        return deque(HostBoard(Path(folder)) for _ in range(BENCHES_OF_A_TEST + 1))


class FirmwareFrontEnd:
    """The firmware as front end of a device, whose duties are its outputs and whose encoders it counts."""

    rejected = 0

    def __init__(self, device: Device) -> None:
        self.device = device
        _boards().rotate()
        self.board = _boards()[0]
        self.board.reset()
        self._start_us = self._now_us()
        self._counts = (0, 0)
        self._answers = b""
        self.run()

    def _now_us(self) -> int:
        self.device.catch_up()
        return self.device.truth().time_ns // 1000

    def run(self) -> None:
        """Let the firmware's time come to the rig's."""
        counts = self.device.counts()
        for channel, (now, before) in enumerate(zip(counts, self._counts, strict=True)):
            self.board.turn(channel, two_complement(now - before))
        self._counts = counts
        self.board.advance((self._now_us() - self._start_us - self.board.clock_us) % 2**32)
        self._connect()

    def _connect(self) -> None:
        """Put the firmware's outputs at the rig's terminals."""
        settings = {"pin_mode": 0b11}
        for channel, (width, mode, prescaler) in enumerate(self.board.pwm):
            settings |= {f"pwm{channel}_{name}": value for name, value in (("width", width), ("mode", mode))}
            settings[f"pwm{channel}_prescaler"] = prescaler
        if any(self.device.settings.get(name) != value for name, value in settings.items()):
            self.device.write(settings)

    def bulk_out(self, data: bytes | bytearray) -> None:
        """Deliver bytes."""
        self.run()
        self.board.write(data)
        self._connect()

    def bulk_in(self, length: int) -> bytes:
        """Return what the firmware sends."""
        self._answers += self.board.read()
        answer, self._answers = self._answers[:length], self._answers[length:]
        return answer


class CountedFrames(Counted, FrameStream):
    """The firmware's bytes, counted."""


class FirmwareUsbBench(PtyBench):
    """The firmware under the driver of the vendor's board."""

    identity = (0x0111, VENDOR_NAME, "")
    wiring = (f'board.application_names=["{VENDOR_NAME}"]',)
    untrusted: ClassVar = untrusted_profiles(identity, ("board.logic_version=0x0112", "board.numbering_pwm=-1"))
    front_end_of = FirmwareFrontEnd


class PumpedLine(Pumped, FramedLine):
    """The host's end of the pseudo-terminal."""

    def __init__(self, server: PtyServer, stream: CountedFrames) -> None:
        self._server = server
        self._stream = stream
        super().__init__(server.name, 115_200, timeout_s=0.3)
        self._quiet_s, self.timeout_s = 0.0, 0.02  # nothing is ever on its way


class FirmwareOpenBench(OnPty, OpenBench):
    """The firmware under the driver of the open board."""

    identity = (0x0B01, BOARD_NAME, BOARD_DATE)
    wiring = (f'board.application_names=["{BOARD_NAME}"]',)
    untrusted: ClassVar = benches_open.untrusted_profiles(identity)
    front_end_of = FirmwareFrontEnd
    stream_of, line_of = CountedFrames, PumpedLine

    def __init__(self, *settings: str, **options) -> None:
        super().__init__(*self.wiring, *settings, **options)

    def leave(self, front_end, settings: dict[str, int]) -> None:
        """Through the vendor's logic, which needs no arming."""
        if settings:
            front_end.bulk_out(encode_send({"pin_mode": 0b11, **settings}, logic=0x0111))
