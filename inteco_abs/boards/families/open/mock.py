"""The mock board as an open board: its frames, states, tick and watchdog, with the simulated rig."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Final

from firmware_protocol.fields import Value
from firmware_protocol.open_board import (
    ARM,
    CHALLENGE_MASK,
    CLEAR,
    CLOCK_HZ,
    COMMAND,
    CONFIGURE,
    COUNTERS,
    DISARM,
    HEAD_BYTES,
    HELLO,
    IDENTITY,
    PROTOCOL_VERSION,
    PWMS,
    QUERY,
    REFUSAL,
    REPORT,
    REPORTED_COUNTERS,
    SILENCE_MS,
    STATUS,
    TICK_HZ,
    WATCHDOG_MS,
    WATCHDOG_PERIODS,
    Message,
    Receiver,
    Refused,
    State,
    Trip,
    crc16,
    decode,
)
from firmware_protocol.pwm import PWM_FULL_WIDTH
from inteco_abs.boards.frame_labels import BoardProtocol
from inteco_abs.config import MOCK_NAMES
from inteco_abs.errors import ConfigError, ConfigIssue
from inteco_abs.mock_board import Device, FrontEnd, MockFamily

APPLICATION_NAME: Final = MOCK_NAMES[2]
_DATE: Final = "20260101"
_UNIQUE_ID: Final = "0000000000000B01"
_MS: Final = 1_000_000
_CLOCK_NS: Final = 1_000_000_000 // CLOCK_HZ
_MOST_WAITING: Final = 256
"""Frames in the board's queue; further ones are lost."""
_QUESTIONS: Final = frozenset({HELLO.kind, QUERY.kind})
_U16: Final = 0xFFFF


class OpenFrontEnd:
    """The board's side of its frames, as PROTOCOL.md has it, but for the commands of logic 0x0111, which it drops.

    The tick and the watchdog act at their instants of the rig's time. Raises ConfigError for a rig on a channel that
    the reports do not have.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self.rejected = 0
        _require_terminals(device)
        self._receiver = Receiver(from_host=True)
        self._heard_ns = 0  # when the newest byte came
        self._waiting: deque[bytes] = deque(maxlen=_MOST_WAITING)
        self._settings: dict[str, int] = dict.fromkeys(
            ("watchdog_ms", "tick_hz", "stop_pins", "pwm_mode", "pwm_prescaler"), 0
        )
        self._state = State.IDLE
        self._trip = Trip.NONE
        self._trips = self._late = self._refused = 0
        self._drawn = 0  # challenges so far
        self._fed_ns = 0  # when the watchdog was fed
        self._armed_ns = 0
        self._report = 0  # number of the next report
        self._pending: tuple[int, int, int] | None = None  # sequence and widths of the command for the next tick
        self._applied = 0
        self._answers: dict[int, Callable[[dict[str, Value]], None]] = {
            HELLO.kind: self._identify,
            CONFIGURE.kind: self._configure,
            ARM.kind: self._arm,
            COMMAND.kind: self._command,
            DISARM.kind: self._disarm,
            QUERY.kind: self._status,
            CLEAR.kind: self._clear,
        }

    def bulk_out(self, data: bytes | bytearray) -> None:
        """Receive bytes from the host; a frame that silence has cut is dropped."""
        device = self.device
        device.catch_up()
        if device.time_ns - self._heard_ns >= SILENCE_MS * _MS:
            self._receiver.drop()
        self._heard_ns = device.time_ns
        for frame in self._receiver.feed(data):
            message, values = decode(frame)
            with device.instant():
                self._answers[message.kind](values)
        self.rejected = self._receiver.bad_frames + self._refused

    def bulk_in(self, length: int) -> bytes:
        """Return the oldest waiting frame; empty if there is none."""
        self.device.catch_up()
        return self._waiting.popleft()[:length] if self._waiting else b""

    def _identify(self, values: dict[str, Value]) -> None:
        identity: dict[str, Value] = {
            "logic_version": self.device.logic_version,
            "protocol": PROTOCOL_VERSION,
            "name": APPLICATION_NAME,
            "date": _DATE,
            "unique_id": _UNIQUE_ID,
            "clock_hz": CLOCK_HZ,
            "counters": COUNTERS,
            "pwms": PWMS,
        }
        self._send(IDENTITY, identity, values)

    def _configure(self, values: dict[str, Value]) -> None:
        wanted = {name: int(values[name]) for name in self._settings}
        if self._state in {State.ARMED, State.TRIPPED}:
            self._refuse(CONFIGURE, Refused.STATE, values)
        elif not _possible(wanted):
            self._refuse(CONFIGURE, Refused.VALUE, values)
        elif any(self._widths):
            self._refuse(CONFIGURE, Refused.OUTPUTS, values)
        else:
            self._settings = wanted
            self._state = State.CONFIGURED
            pwm = {f"pwm{i}_{key}": wanted[f"pwm_{key}"] for i in range(PWMS) for key in ("mode", "prescaler")}
            self.device.apply({**pwm, "encoder_reset": 0})
            self._status(values)

    def _arm(self, values: dict[str, Value]) -> None:
        if self._state is not State.CONFIGURED:
            self._refuse(ARM, Refused.STATE, values)
        elif values["answer"] != self._challenge ^ CHALLENGE_MASK:
            self._refuse(ARM, Refused.ANSWER, values)
        elif self._stopped:
            self._refuse(ARM, Refused.STOP_INPUT, values)
        elif any(self._widths):
            self._refuse(ARM, Refused.OUTPUTS, values)
        else:
            self._state = State.ARMED
            self._drawn += 1
            self._armed_ns = self._fed_ns = self.device.time_ns
            self._report, self._pending, self._applied = 0, None, 0
            self._schedule()
            self._status(values)

    def _command(self, values: dict[str, Value]) -> None:
        sequence, *widths = (int(values[name]) for name in ("sequence", "width0", "width1"))
        ticking = self._ticks
        most = PWM_FULL_WIDTH[self._settings["pwm_mode"]]
        valid = self._state is State.ARMED and max(widths) <= most
        if ticking:
            valid = valid and self._report > 0 and sequence == self._report - 1 & 0xFF
        if valid:
            self._fed_ns = self.device.time_ns
            if ticking:
                self._pending = sequence, widths[0], widths[1]
            else:
                self._put_in_force(sequence, widths[0], widths[1])
                self._schedule()
        elif any(widths) or self._state is State.ARMED:
            self._refused += 1
        if not ticking:
            self._send_report(sequence)

    def _disarm(self, values: dict[str, Value]) -> None:
        self._outputs_off()
        if self._state is State.ARMED:
            self._state = State.CONFIGURED
        self._drawn += 1
        self.device.act_at(0, None)
        self._report = 0
        self._status(values)

    def _clear(self, values: dict[str, Value]) -> None:
        if self._state is State.ARMED:
            self._refuse(CLEAR, Refused.STATE, values)
        elif self._state is State.TRIPPED and self._stopped:
            self._refuse(CLEAR, Refused.STOP_INPUT, values)
        else:
            if self._state is State.TRIPPED:
                self._state = State.CONFIGURED
                self.device.act_at(0, None)
                self._report = 0
            self._status(values)

    def _status(self, values: dict[str, Value]) -> None:
        counts = self._counts()
        status: dict[str, Value] = {
            **self._settings,
            "state": self._state,
            "trip": self._trip,
            "challenge": self._challenge,
            **{f"width{i}": width for i, width in enumerate(self._widths)},
            **{f"count{i}": counts.get(i, 0) for i in range(COUNTERS)},
            "clock": self._clock,
            "trips": self._trips & _U16,
            "late": self._late & _U16,
            "bad_frames": self._receiver.bad_frames & _U16,
            "refused": self._refused & _U16,
            "pins": self.device.pins() & _U16,
        }
        self._send(STATUS, status, values)

    def _schedule(self) -> None:
        """Let the device act at the next tick, or polled when the watchdog is due."""
        device, settings = self.device, self._settings
        if settings["tick_hz"]:
            period_ns = 1_000_000_000 // settings["tick_hz"]
            device.act_at(self._armed_ns + (self._report + 1) * period_ns, self._tick)
        elif self._state is State.ARMED:
            trips_ns = self._fed_ns + settings["watchdog_ms"] * _MS
            device.act_at(min(trips_ns, device.time_ns + _MS) if settings["stop_pins"] else trips_ns, self._poll)

    def _tick(self) -> None:
        """Act at one instant of the board's tick."""
        self._look()
        if self._state is State.ARMED:
            if self._pending is not None:
                self._put_in_force(*self._pending)
                self._pending = None
            else:
                self._late += self._report > 0
                self.device.observe()
        self._send_report(self._report & 0xFF)
        self._schedule()

    def _poll(self) -> None:
        """Act at an instant without a tick."""
        self._look()
        self._schedule()

    def _look(self) -> None:
        """Check stop inputs and watchdog."""
        if self._state is not State.ARMED:
            return
        silent_ns = self.device.time_ns - self._fed_ns
        if self._stopped:
            self._let_go(Trip.STOP_INPUT)
        elif silent_ns >= self._settings["watchdog_ms"] * _MS:
            self._let_go(Trip.WATCHDOG)

    def _let_go(self, trip: Trip) -> None:
        self._outputs_off()
        self._state, self._trip = State.TRIPPED, trip
        self._trips += 1
        self._drawn += 1
        self._pending = None

    def _outputs_off(self) -> None:
        self.device.write({f"pwm{i}_width": 0 for i in range(PWMS)})

    def _put_in_force(self, sequence: int, *widths: int) -> None:
        self._applied = sequence
        self.device.write({f"pwm{i}_width": width for i, width in enumerate(widths)})

    def _send_report(self, sequence: int) -> None:
        counts, widths = self._counts(), self._widths
        report: dict[str, Value] = {
            "tick": self._report,
            "clock": self._clock,
            **{f"count{i}": counts.get(i, 0) for i in range(REPORTED_COUNTERS)},
            **{f"width{i}": width for i, width in enumerate(widths)},
            "state": self._state,
            "trip": self._trip,
            "applied": self._applied,
            "late": self._late & _U16,
        }
        self._report += 1
        self._send(REPORT, report, {"sequence": sequence})

    def _refuse(self, message: Message, reason: Refused, values: dict[str, Value]) -> None:
        refusal: dict[str, Value] = {
            "refused": message.kind,
            "reason": reason,
            "state": self._state,
            "trip": self._trip,
        }
        self._send(REFUSAL, refusal, values)

    def _send(self, message: Message, values: Mapping[str, Value], question: Mapping[str, Value]) -> None:
        numbers = {name: int(value) if isinstance(value, int) else value for name, value in values.items()}
        if len(self._waiting) < _MOST_WAITING:
            self._waiting.append(message.encode(numbers, sequence=int(question["sequence"])))

    def _counts(self) -> dict[int, int]:
        """Return the counts by channel; channels without an encoder stay at 0."""
        road, wheel = self.device.counts()
        cable = self.device.cable
        return {cable.road_encoder: road, cable.wheel_encoder: wheel}

    @property
    def _ticks(self) -> bool:
        return bool(self._settings["tick_hz"]) and self.device.due_ns >= 0

    @property
    def _widths(self) -> list[int]:
        return [self.device.settings.get(f"pwm{i}_width", 0) for i in range(PWMS)]

    @property
    def _clock(self) -> int:
        return self.device.time_ns // _CLOCK_NS & 0xFFFF_FFFF

    @property
    def _challenge(self) -> int:
        return crc16(self._drawn.to_bytes(4, "little"))

    @property
    def _stopped(self) -> bool:
        """Whether an input of `stop_pins` is low."""
        return bool(self._settings["stop_pins"] & ~self.device.pins())


def _possible(wanted: Mapping[str, int]) -> bool:
    tick_hz, watchdog_ms = wanted["tick_hz"], wanted["watchdog_ms"]
    ticks = not tick_hz or (
        TICK_HZ[0] <= tick_hz <= TICK_HZ[1]
        and CLOCK_HZ % tick_hz == 0
        and watchdog_ms * tick_hz >= 1000 * WATCHDOG_PERIODS
    )
    return ticks and WATCHDOG_MS[0] <= watchdog_ms <= WATCHDOG_MS[1] and wanted["pwm_mode"] < len(PWM_FULL_WIDTH)


def _require_terminals(device: Device) -> None:
    most = {"drive_pwm": PWMS, "brake_pwm": PWMS, "road_encoder": COUNTERS, "wheel_encoder": COUNTERS}
    mistakes = [
        ConfigIssue(f"simulation.{key}", f"{getattr(device.cable, key)}: the open board has no such channel")
        for key, count in most.items()
        if getattr(device.cable, key) >= count
    ]
    if mistakes:
        raise ConfigError(mistakes)


class FrameStream:
    """The board at a serial port: a byte stream in both directions."""

    def __init__(self, front_end: FrontEnd) -> None:
        self.front_end = front_end

    def feed(self, data: bytes | bytearray) -> bytes:
        """Receive bytes from the host, or none; return what the board sends."""
        if data:
            self.front_end.bulk_out(data)
        return b"".join(iter(lambda: self.front_end.bulk_in(STATUS.table.size), b""))


def _reported(_device: Device, _protocol: BoardProtocol | None, _image: bytes) -> FrontEnd:
    raise ValueError("an open board is not played from a report: its firmware is public")


MOCK: Final = MockFamily(
    front_end=OpenFrontEnd,
    reported=_reported,
    is_command=lambda message: len(message) >= HEAD_BYTES and message[1] not in _QUESTIONS,
    identity_offset=HEAD_BYTES,
    stream=FrameStream,
)
