"""The mock board's process of a real-time run: `python -m inteco_abs.mock_board_process MEMORY`."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, TextIO

from inteco_abs.boards import family_of
from inteco_abs.config import RigConfig
from inteco_abs.errors import ConfigError
from inteco_abs.format import TRUTH
from inteco_abs.mock_board import (
    Device,
    FaultyDevice,
    FaultyFrontEnd,
    FaultyHost,
    FrontEnd,
    PtyServer,
    Schedule,
    SocketServer,
    Truth,
    TruthLog,
    UsbHost,
    UsbIdentity,
    UsbIpServer,
    front_end_of,
    mock_family,
    parse_address,
    parse_faults,
)
from inteco_abs.realtime import (
    BOARD_PRIORITY,
    Field,
    Job,
    Mailbox,
    RunMemory,
    alive,
    apply,
    guardian_tuning,
    handle_signals,
)
from inteco_abs.realtime.processes import ENTRY

if TYPE_CHECKING:
    from inteco_abs.commissioning.board_from_report import ReportedBoard

_LOOK_S: Final = 0.1
_CATCH_UP_S: Final = 0.005
_LINGER_S: Final = 1.0
"""Time that the board stays without supervisor and host: the guardian may still connect."""


def main(path: str) -> int:
    """Run the mock board of the run in the memory at `path`, at its socket, until the run is over."""
    memory = RunMemory.open(Path(path))
    job = Job.of(memory)
    ring = memory.truth_ring(TRUTH.pack_into)

    def observe(truth: Truth) -> None:
        with suppress(BufferError):  # without a recorder the board continues
            ring.append(truth)

    schedule = Schedule(parse_faults(job.faults), time.monotonic_ns, job.seed)
    standstill = _Standstill(memory)
    front_end = _front_end(job, standstill, schedule, observe)
    new = memory.socket.with_suffix(".new")
    server = SocketServer(front_end, str(new))
    new.rename(memory.socket)  # it listens: who waits for the path is not refused
    apply(guardian_tuning(BOARD_PRIORITY))
    with FaultyHost(schedule, Path(job.out), lambda name: _pid_of(name, memory)) as host:

        def between() -> None:
            host.act()
            standstill.keep(front_end)

        def awaited() -> bool:  # a frozen supervisor requests nothing; leaving lets it continue
            return not host.frozen("supervisor") and alive(memory.words[Field.SUPERVISOR_PID])

        _serve(server, memory, schedule, between if job.faults else lambda: None, awaited)
    server.close()
    return 0


def _pid_of(name: str, memory: RunMemory) -> int:
    """Return the number of a process of the run; 0 if it is missing."""
    if name == "supervisor":
        return memory.words[Field.SUPERVISOR_PID]
    ours = f"{ENTRY}\0{name}\0{memory.path}\0".encode()
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if (process / "cmdline").read_bytes().endswith(ours):
                return int(process.name)
    return 0


def _front_end(job: Job, standstill: _Standstill, schedule: Schedule, observe: Callable[[Truth], None]) -> FrontEnd:
    if not job.faults:
        return front_end_of(Device(job.config, time.monotonic_ns, job.seed, observe))
    device = FaultyDevice(job.config, time.monotonic_ns, job.seed, observe, schedule=schedule)
    return FaultyFrontEnd(front_end_of, device, time.sleep, standstill.request)


class _Standstill:
    """Suspends the process that holds the board, between two exchanges; rig and board continue."""

    def __init__(self, memory: RunMemory) -> None:
        self._words = memory.words
        self._seconds = 0.0

    def request(self, seconds: float) -> None:
        """Suspend the holder for `seconds` after the current exchange: during it, the board would look slow."""
        self._seconds = seconds

    def keep(self, front_end: FrontEnd) -> None:
        """Suspend the holder of the board if that is requested, once `front_end` has answered it."""
        if not self._seconds or not isinstance(front_end, FaultyFrontEnd) or not front_end.answered:
            return
        seconds, self._seconds = self._seconds, 0.0
        holder = self._words[Field.HOLDER_PID]
        if not alive(holder):
            return
        with suppress(ProcessLookupError):
            os.kill(holder, signal.SIGSTOP)
            try:
                end = time.monotonic() + seconds
                while (left := end - time.monotonic()) > 0.0:
                    time.sleep(min(left, _CATCH_UP_S))
                    front_end.device.catch_up()
            finally:
                os.kill(holder, signal.SIGCONT)


@dataclass(frozen=True, slots=True)
class Mock:
    """A mock board for a computer, in real time."""

    config: RigConfig
    seed: int
    truth: TextIO | None = None
    """Where the rig's true state goes, as JSON lines."""
    truth_hz: float = 20.0
    seen: ReportedBoard | None = None
    """Board of a report to imitate; None: the family's standard mock."""

    @property
    def name(self) -> str:
        """Description for the user."""
        drawn = self.config.simulation.rig
        return f"mock {family_of(self.config.board.kind).title}{f' with rig {drawn}' if drawn else ''}"

    def front_end(self) -> FrontEnd:
        """Return a new front end."""
        device = Device(self.config, time.monotonic_ns, self.seed)
        return front_end_of(device) if self.seen is None else self.seen.front_end(device)

    def identity(self, like: UsbIdentity) -> UsbIdentity:
        """Return its identity on the bus: that of the report, else `like`."""
        return like if self.seen is None else self.seen.identity(like)

    def log(self, device: Device) -> Callable[[], None]:
        """Return a function that logs the true state, if wanted; call it often."""
        return (lambda: None) if self.truth is None else TruthLog(device, self.truth, self.truth_hz).poll


def serve_usbip(mock: Mock, address: str, serial: int, say: Callable[[str], None]) -> None:
    """Serve the board over USB/IP until interrupted; print how to attach it.

    Raises ConfigError for an invalid address or serial number, BoardError if the address is taken.
    """
    place = parse_address(address)
    front_end, kind = mock.front_end(), mock.config.board.kind
    make = mock_family(kind).usb_device
    if make is None:
        raise ConfigError.of("--usbip", f"a mock {kind} board cannot be plugged into USB")
    try:
        bridge = make(front_end, mock.identity, serial)
    except ValueError as error:
        raise ConfigError.of("--serial", str(error)) from error
    server = UsbIpServer(UsbHost(bridge), place)
    facts = server.bind()
    with handle_signals(server.close):  # as an unplugged cable would end it
        ids = f"{facts.vendor_id:04x}:{facts.product_id:04x}"
        say(f"{mock.name} {ids}, serial number {facts.serial}, at {facts.address}; Ctrl-C unplugs it")
        for what, lines in (("attach it", facts.attach), ("detach it", facts.detach)):
            if lines:
                say(f"to {what}, as root: {' && '.join(lines)}")
        _be_quick()
        server.serve(mock.log(front_end.device))


def serve_pty(mock: Mock, link: str, say: Callable[[str], None]) -> None:
    """Serve the first generation's board at a serial port until interrupted; print its path.

    `link` is a path for a symbolic link to it, or empty. Raises BoardError if that cannot be made.
    """
    family = family_of(mock.config.board.kind)
    front_end, stream = mock.front_end(), mock_family(family.name).stream
    if stream is None:
        raise ConfigError.of("--pty", f"a mock {family.name} board is not at a serial port")
    server = PtyServer(stream(front_end), Path(link) if link else None)
    with handle_signals(server.close):
        say(f"{mock.name} at {link or server.name}; Ctrl-C unplugs it")
        say(
            f"to use it: inteco-abs run --board {family.name}:{Path(link or server.name).absolute()} "
            f"--set profile={family.mock_profile}"
        )
        _be_quick()
        server.serve(mock.log(front_end.device))


def _be_quick() -> None:
    """Apply the tuning of a run's mock board, except blocked signals, which would disable Ctrl-C."""
    apply([tuning for tuning in guardian_tuning(BOARD_PRIORITY) if tuning.name != "signals"])


def _serve(
    server: SocketServer,
    memory: RunMemory,
    schedule: Schedule,
    between: Callable[[], None],
    awaited: Callable[[], bool],
) -> None:
    words = memory.words
    looked = alone_since = time.monotonic()
    known: tuple[int, bool] | None = None
    while not words[Field.OVER]:
        server.step()
        between()
        now, news = time.monotonic(), (len(schedule.first_ns), server.busy)
        if now - looked < _LOOK_S and news == known:
            continue  # a fault's first act may end the run, so it is posted before the next exchange
        looked, known = now, news
        if schedule.times:
            memory.post(Mailbox.INJECTED, schedule.acted())
        if server.busy or awaited():
            alone_since = now
        elif now - alone_since > _LINGER_S:
            return


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
