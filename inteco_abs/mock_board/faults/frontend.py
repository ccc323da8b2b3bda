"""A mock board's front end with faults on the wire."""

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

_MOST_BYTES: Final = 4096
_PWM_BITS: Final = 16


class FaultyFrontEnd:
    """Applies the wire faults of `schedule` to the messages between a host and `make_front_end(device)`.

    An exchange is the host's messages up to an answer. `wait` delays an exchange by that many seconds, `pause` freezes
    the host after it for that many; `on_exchange` is called when one begins. Raises LinkError while the cable is
    unplugged.
    """

    def __init__(
        self,
        make_front_end: Callable[[FaultyDevice], FrontEnd],
        device: FaultyDevice,
        wait: Callable[[float], None],
        pause: Callable[[float], None],
        on_exchange: Callable[[], None] = lambda: None,
    ) -> None:
        self.device: Device = device
        self.rejected = 0
        self._faulty = device
        self._schedule: Schedule = device.schedule
        self._make_front_end = make_front_end
        self._front_end = make_front_end(device)
        self._wait, self._pause, self._on_exchange = wait, pause, on_exchange
        family = mock_family(device.kind)
        self._identity_offset = family.identity_offset or 0
        self._is_command = family.is_command
        self._answered = True
        self._commanded = False
        """Whether the current exchange has an answer, and whether it has a command."""
        self._sent: deque[bytes] = deque()
        """Answers ready for the host."""
        self._overdue: list[bytes] = []
        """Answers that arrive with the next exchange."""
        self._held: bytes | None = None
        """An answer that arrives after the next one."""
        self._previous = b""
        self._strongest = (0.0, b"")

    @property
    def answered(self) -> bool:
        """Whether the board has answered in the current exchange."""
        return self._answered

    def bulk_out(self, data: bytes | bytearray) -> None:
        """Receive a message from the host, unless a fault loses it."""
        command = self._is_command(data)
        if self._answered or (command and self._commanded):
            self._begin()
        self._commanded = self._commanded or command
        if not self._reachable() or (command and self._schedule.acting("lose-command")):
            return
        if command and (fault := self._schedule.acting("corrupt-command")):
            data = self._flipped(data, fault)
        self._front_end.bulk_out(data)
        self._take_answers()
        if command:
            self._repeat_strongest(bytes(data))
        self.rejected = self._front_end.rejected

    def bulk_in(self, length: int) -> bytes:
        """Return the next answer that arrives; empty if there is none."""
        if not self._reachable():
            return b""
        if not self._sent:
            self._take_answers()  # of a board that sends by itself
        return self._sent.popleft()[:length] if self._sent else b""

    def _take_answers(self) -> None:
        while answer := self._front_end.bulk_in(_MOST_BYTES):
            self._answered = True
            sent, self._previous = self._damaged(answer), answer
            self._send(sent)

    def _begin(self) -> None:
        schedule = self._schedule
        self._answered = self._commanded = False
        schedule.exchange += 1
        self._sent.extend(self._overdue)
        self._overdue.clear()
        self._on_exchange()
        if fault := schedule.once("pause"):
            self._pause(fault.value * 1e-3)
        if fault := schedule.once("sleep"):
            self._faulty.sleep(fault.value * 1e-3)
        if fault := schedule.acting("late"):
            self._wait(fault.value * 1e-3)
        if fault := schedule.once("reset"):
            self._restart(fault)

    def _reachable(self) -> bool:
        """Return whether the board responds; raises LinkError if it is unplugged."""
        if self._schedule.acting("unplug"):
            self._sent.clear()
            raise LinkError("the board is gone: is its cable unplugged?")
        return self._schedule.acting("stall") is None

    def _damaged(self, answer: bytes) -> bytes:
        """Return the answer with the faults of its bytes."""
        act = self._schedule.acting
        if act("stale") and self._previous:
            return self._previous
        if (splice := act("splice")) and self._previous:
            answer = answer[: int(splice.value)] + self._previous[int(splice.value) :]
        if fault := act("corrupt"):
            answer = self._flipped(answer, fault)
        if act("identity"):
            at = self._identity_offset
            answer = answer[:at] + bytes([answer[at] ^ 0x15]) + answer[at + 1 :]
        if cut := act("cut"):
            answer = answer[: int(cut.value)]
        return answer

    def _send(self, answer: bytes) -> None:
        """Send the answer now, later, twice or not at all."""
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

    def _repeat_strongest(self, command: bytes) -> None:
        """Let another program repeat the strongest command so far."""
        strength, strongest = self._strongest
        if sum(self.device.duties) > strength:
            self._strongest = sum(self.device.duties), command
        elif strongest and self._schedule.acting("master"):
            self._front_end.bulk_out(strongest)
            self._front_end.bulk_in(_MOST_BYTES)  # an answer would be the other program's

    def _restart(self, fault: Fault) -> None:
        """Restart the board: waiting messages are lost, settings become zero, stay, or are random."""
        word, settings = fault.word, dict(self.device.settings)
        if word != "held":
            self._front_end = self._make_front_end(self._faulty)
        if word == "zero":
            settings.clear()
        elif word == "random":
            settings = {name: self._schedule.random.getrandbits(_PWM_BITS) for name in settings}
            settings.update(encoder_reset=0, timer_reset=0, **{f"pwm{i}_mode": 1 for i in range(2)})
        self._faulty.restart(settings)
        self._previous = b""
