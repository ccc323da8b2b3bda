"""The mock board as a process of its own, for real-time runs: `python -m inteco_abs.simulator MEMORY`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from inteco_abs.config import RigConfig
from inteco_abs.mock_board import (
    Device,
    SocketServer,
    Truth,
    Usb2Face,
    UsbBoard,
    UsbHost,
    UsbIdentity,
    UsbIpServer,
    face_of,
    parse_address,
)
from inteco_abs.realtime.hearing import hearing
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.machine import BOARD_PRIORITY, guardian_wishes, prepare
from inteco_abs.realtime.memory import RunMemory, Word, alive
from inteco_abs.records import TRUTH

_LOOK_S: Final = 0.1
_LINGER_S: Final = 1.0
"""How long the board stays without supervisor and host: the guardian may be about to come."""


def main(path: str) -> int:
    """Be the board of the run in the memory at `path`, at its socket, until the run is over."""
    memory = RunMemory.open(Path(path))
    job = Job.of(memory)
    ring = memory.truth_ring(TRUTH.pack_into)

    def observe(truth: Truth) -> None:
        with suppress(BufferError):  # nobody records: a board does not stop for that
            ring.append(truth)

    face = face_of(Device(job.config, time.monotonic_ns, job.seed, observe))
    server = SocketServer(face, str(memory.socket))
    prepare(guardian_wishes(BOARD_PRIORITY))
    _serve(server, memory)
    server.close()
    return 0


def serve_usbip(config: RigConfig, address: str, serial: int, seed: int, say: Callable[[str], None]) -> None:
    """Be the board for any Linux that attaches it over USB/IP, until interrupted; says how to attach it.

    Raises ConfigError for an address or serial number that cannot be, BoardError if the address is taken.
    """
    place = parse_address(address)
    face = Usb2Face(Device(config, time.monotonic_ns, seed))
    server = UsbIpServer(UsbHost(UsbBoard(face, UsbIdentity(serial=serial))), place)
    facts = server.bind()
    with hearing(server.close):  # as an unplugged cable would end it
        ids = f"{facts.vendor_id:04x}:{facts.product_id:04x}"
        say(f"mock RT-DAC/USB2 {ids}, serial number {facts.serial}, at {facts.address}; Ctrl-C unplugs it")
        for what, lines in (("attach it", facts.attach), ("detach it", facts.detach)):
            if lines:
                say(f"to {what}, as root: {' && '.join(lines)}")
        server.serve()


def _serve(server: SocketServer, memory: RunMemory) -> None:
    words = memory.words
    looked = alone_since = time.monotonic()
    while not words[Word.OVER]:
        server.step()
        now = time.monotonic()
        if now - looked < _LOOK_S:
            continue
        looked = now
        if server.busy or alive(words[Word.SUPERVISOR_PID]):
            alone_since = now
        elif now - alone_since > _LINGER_S:
            return


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
