"""A mock board's wire with faults on it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from inteco_abs.errors import LinkError
from inteco_abs.mock_board.device import Device
from inteco_abs.mock_board.family import mock_family
from inteco_abs.mock_board.faults.device import FaultyDevice
from inteco_abs.mock_board.faults.fault import Fault
from inteco_abs.mock_board.faults.schedule import Schedule
from inteco_abs.mock_board.frontend import FrontEnd

_LONGEST_REQUEST: Final = 4
"""Bytes: what is longer tells the board to do something."""
_MOST_BYTES: Final = 4096
_PWM_BITS: Final = 16


class FaultyFrontEnd:
    """What `schedule` lets through of what a host and the board `make_front_end(device)` say to each other.

    `wait` lets so many seconds pass in an exchange, `pause` lets the host stand still for so many after it; `begun` is
    told that one begins. An exchange is what the host sends and the answer that it then takes. Raises LinkError where
    the cable is pulled.
    """

    def __init__(
        self,
        make_front_end: Callable[[FaultyDevice], FrontEnd],
        device: FaultyDevice,
        wait: Callable[[float], None],
        pause: Callable[[float], None],
        begun: Callable[[], None] = lambda: None,
    ) -> None:
        self.device: Device = device
        self.rejected = 0
        self._faulty = device
        self._schedule: Schedule = device.schedule
        self._make_front_end = make_front_end
        self._front_end = make_front_end(device)
        self._wait, self._pause, self._begun = wait, pause, begun
        self._identity_at = mock_family(device.kind).identity_at or 0
        self._answered = True
        self._commanded = False
        """Of the exchange that goes on: whether the board has answered, whether it was told something."""
        self._sent: deque[bytes] = deque()
        """Answers on their way."""
        self._overdue: list[bytes] = []
        """Answers that come with the next exchange."""
        self._held: bytes | None = None
        """An answer that comes after the next one."""
        self._before = b""
        self._strongest = (0.0, b"")

    @property
    def answered(self) -> bool:
        """Whether the board has answered in the exchange that goes on."""
        return self._answered

    def bulk_out(self, data: bytes | bytearray) -> None:
        """What the host writes, if it arrives."""
        command = len(data) > _LONGEST_REQUEST
        if self._answered or (command and self._commanded):
            self._begin()
        self._commanded = self._commanded or command
        if not self._reachable() or (command and self._schedule.acting("lose-command")):
            return
        if command and (fault := self._schedule.acting("corrupt-command")):
            data = self._flipped(data, fault)
        self._front_end.bulk_out(data)
        answer = self._front_end.bulk_in(_MOST_BYTES)
        if command:
            self._overhear(bytes(data))
        self.rejected = self._front_end.rejected
        if answer:
            self._answered = True
            sent, self._before = self._spoilt(answer), answer
            self._send(sent)

    def bulk_in(self, length: int) -> bytes:
        """What the host gets, if anything."""
        if self._reachable() and self._sent:
            return self._sent.popleft()[:length]
        return b""

    def _begin(self) -> None:
        schedule = self._schedule
        self._answered = self._commanded = False
        schedule.exchange += 1
        self._sent.extend(self._overdue)
        self._overdue.clear()
        self._begun()
        if fault := schedule.once("pause"):
            self._pause(fault.value * 1e-3)
        if fault := schedule.once("sleep"):
            self._faulty.sleep(fault.value * 1e-3)
        if fault := schedule.acting("late"):
            self._wait(fault.value * 1e-3)
        if fault := schedule.once("reset"):
            self._restart(fault)

    def _reachable(self) -> bool:
        """Whether the board hears and answers; raises LinkError if it is not there at all."""
        if self._schedule.acting("unplug"):
            self._sent.clear()
            raise LinkError("the board is not there any more: is its cable pulled?")
        return self._schedule.acting("stall") is None

    def _spoilt(self, answer: bytes) -> bytes:
        """The answer as its bytes come through."""
        act = self._schedule.acting
        if act("stale") and self._before:
            return self._before
        if (splice := act("splice")) and self._before:
            answer = answer[: int(splice.value)] + self._before[int(splice.value) :]
        if fault := act("corrupt"):
            answer = self._flipped(answer, fault)
        if act("identity"):
            at = self._identity_at
            answer = answer[:at] + bytes([answer[at] ^ 0x15]) + answer[at + 1 :]
        if cut := act("cut"):
            answer = answer[: int(cut.value)]
        return answer

    def _send(self, answer: bytes) -> None:
        """The answer goes on its way: now, later, twice or not at all."""
        act = self._schedule.acting
        if self._held is not None:
            self._sent += answer, self._held
            self._held = None
        elif act("swap"):
            self._held = answer
        elif act("overdue"):
            self._overdue.append(answer)
        elif act("twice"):
            self._sent += answer, answer
        elif not act("lose"):
            self._sent.append(answer)

    def _flipped(self, data: bytes | bytearray, fault: Fault) -> bytes:
        bits = 8 * len(data)
        bit = int(fault.value) % bits if fault.value >= 0 else self._schedule.random.randrange(bits)
        flipped = bytearray(data)
        flipped[bit // 8] ^= 1 << bit % 8
        return bytes(flipped)

    def _overhear(self, command: bytes) -> None:
        """Another program has heard the command, and may say the strongest so far again."""
        strength, strongest = self._strongest
        if sum(self.device.duties) > strength:
            self._strongest = sum(self.device.duties), command
        elif strongest and self._schedule.acting("master"):
            self._front_end.bulk_out(strongest)
            self._front_end.bulk_in(_MOST_BYTES)  # its answer, if it asked for one, is its own

    def _restart(self, fault: Fault) -> None:
        """A brown-out: what waits is lost, and the settings are zero, as they were, or anything."""
        word, settings = fault.word, dict(self.device.settings)
        if word != "held":
            self._front_end = self._make_front_end(self._faulty)
        if word == "zero":
            settings.clear()
        elif word == "random":
            settings = {name: self._schedule.random.getrandbits(_PWM_BITS) for name in settings}
            settings.update(encoder_reset=0, timer_reset=0, **{f"pwm{i}_mode": 1 for i in range(2)})
        self._faulty.restart(settings)
        self._before = b""
