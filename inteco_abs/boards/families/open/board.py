"""Driver of the open board: one COMMAND and one REPORT a tick, by the computer's clock or by the board's."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Final

from firmware_protocol import ProtocolError, Status, signed32
from firmware_protocol.fields import Value
from firmware_protocol.open_board import (
    ARM,
    CHALLENGE_MASK,
    CLEAR,
    CLOCK_HZ,
    COMMAND,
    CONFIGURE,
    COUNTERS,
    CRC_BYTES,
    DISARM,
    HEAD_BYTES,
    HELLO,
    IDENTITY,
    MOST_PAYLOAD_BYTES,
    OVERHEAD_BYTES,
    PWMS,
    QUERY,
    REFUSAL,
    REPORT,
    REPORTED_COUNTERS,
    STATUS,
    WATCHDOG_MS,
    Message,
    Refused,
    State,
    Trip,
    crc16,
    decode,
    sealed,
)
from firmware_protocol.pwm import PWM_FULL_WIDTH, PWM_MODES
from inteco_abs.boards.authorization import read_only_reason
from inteco_abs.boards.board import STILL_ON, Board, BoardReading, Identity, Reading
from inteco_abs.boards.board_clock import BoardClock
from inteco_abs.boards.channels import channel_mistakes
from inteco_abs.boards.first_write import PlannedWord
from inteco_abs.boards.frame_board import widths
from inteco_abs.boards.transports.links import Link
from inteco_abs.config import BoardConfig
from inteco_abs.errors import BoardError, ConfigError, ConfigIssue, LinkError
from inteco_abs.signals import BoardFlags, Command, Sample

_MOST_BYTES: Final = MOST_PAYLOAD_BYTES + OVERHEAD_BYTES
_MOST_OLD: Final = 1000
"""A pause leaves fewer frames than this that answer nothing asked now."""
_PERIODS: Final = 2.0
"""Time-out of an exchange in the loop, periods, as of the other boards."""
_LEAST_TIMEOUT_S: Final = 0.001
_WATCHDOG_PERIODS: Final = 4
"""Periods that the watchdog lasts at least: a lost answer costs three ticks."""
_SECOND_NS: Final = 1_000_000_000
_MS: Final = 1_000_000
_CLOCK_NS: Final = _SECOND_NS // CLOCK_HZ
_DRIFT_PPM: Final = 200
"""Twice the tolerance of a crystal: how fast two clocks may drift apart."""
_OTHER_HALF: Final = 128
"""Distance between the sequence numbers of a dead process's answers and those of its rescue."""
_TRIPS: Final[Mapping[int, str]] = {
    Trip.WATCHDOG: "as no command had come for {watchdog_ms} ms",
    Trip.STOP_INPUT: "as a stop input was low",
    Trip.VENDOR_WATCHDOG: "as a program that speaks logic 0x0111 fell silent",
}
_REFUSALS: Final[Mapping[int, str]] = {
    Refused.STATE: "not in this state",
    Refused.VALUE: "a value is out of its range",
    Refused.ANSWER: "the answer does not match its challenge",
    Refused.STOP_INPUT: "a stop input is low",
    Refused.OUTPUTS: "another program has outputs on",
}
_SHOWN: Final = ("state", "trip", "trips", "late", "bad_frames", "refused")
_SETTINGS: Final = ("watchdog_ms", "stop_pins", "pwm_mode", "pwm_prescaler")


class OpenBoard(Board):
    """Driver of the open board behind `link` with this wiring; see `Board` for its guarantees.

    SAFE is DISARM, and a STATUS that shows both widths off. Entering disarms the board, clears a trip that an earlier
    run left, and sets watchdog, stop inputs and PWM. The first command with a width on arms it, after which its
    watchdog runs: it needs a command every `watchdog_ms`. A trip stays until the board is entered again: every further
    exchange fails with its reason, so that the guard ends the run.

    The board dates its samples. After `start_pacing` its tick starts them: `answer` sends the command that was decided
    from the newest one, `report` waits for the next. A sample's time is then the board's, and its lateness that of the
    report beyond the quickest of the last seconds, so that the time on the line is not in it.

    `link` carries whole frames. Raises ConfigError for a wiring that the board has no channels for.
    """

    def __init__(self, link: Link, wiring: BoardConfig, now_ns: Callable[[], int], period_ns: int) -> None:
        super().__init__(now_ns, period_ns)
        _require_channels(wiring)
        self._link = link
        self._wiring = wiring
        self._mode = PWM_MODES.index(wiring.pwm_mode)
        self._full = PWM_FULL_WIDTH[self._mode]
        self._settings = {
            "watchdog_ms": max(wiring.watchdog_ms, min(-(-_WATCHDOG_PERIODS * period_ns // _MS), WATCHDOG_MS[1])),
            "stop_pins": sum(1 << pin for pin in set(wiring.stop_pins)),
            "pwm_mode": self._mode,
            "pwm_prescaler": wiring.pwm_prescaler,
        }
        self._swapped = wiring.drive_pwm > wiring.brake_pwm
        self._unique_id = ""
        self._sequence = 0
        self._outputs_may_be_on = False  # whether ARM was accepted since the newest SAFE
        self._clock = BoardClock(CLOCK_HZ)
        self._newest_clock = 0
        self._taken_ns = 0  # host's time of that
        self._patient_s = self._timeout_s = link.timeout_s
        self._hurried_s = min(self._patient_s, max(_LEAST_TIMEOUT_S, _PERIODS * period_ns * 1e-9))
        self._pace = _Pace(period_ns)
        self._lost: LinkError | None = None  # why the newest command was not sent

    def identify(self) -> Identity:
        """Ask who is there; if it must not be driven, also whether its outputs are on."""
        if not self._ready:
            self._link.prepare(_MOST_BYTES)
        values = self._ask(HELLO)
        version, name = int(values["logic_version"]), str(values["name"])
        if not self._ready:  # an open board with another number was replaced
            self._unique_id = str(values["unique_id"])
        because = read_only_reason(self._wiring, version, name, ())
        if because and _widths_of(self._ask(QUERY)) != (0, 0):
            because += f". ITS PWM OUTPUTS ARE NOT ZERO and stay as they are. {STILL_ON}"
        return Identity(version, name, str(values["date"]), because)

    def survey(self, names: Collection[str] = ()) -> BoardReading:
        """Read the named fields, or all."""
        unknown = [name for name in names if name not in _FIELDS]
        if unknown:
            raise BoardError(f"the open board has no field {', '.join(unknown)}")
        identity, status = self._ask(HELLO), self._ask(QUERY)
        if str(identity["unique_id"]) != self._unique_id:
            raise LinkError(f"the board is another one now, number {identity['unique_id']}: was it replaced?")
        found = identity | status
        values = {name: found[_FIELDS[name]] for name in names or _FIELDS}
        frames = IDENTITY.encode(_without_sequence(identity)), STATUS.encode(_without_sequence(status))
        return BoardReading(values, b"".join(frame[HEAD_BYTES:-CRC_BYTES] for frame in frames))

    def readings(self) -> list[Reading]:
        """Return the board's state and what it has counted since its reset. Raises LinkError."""
        status = self._ask(QUERY)
        fields = STATUS.table.fields
        return [
            Reading(name, float(status[name]), fields[name][0].unit, Status.CONFIRMED, fields[name][0].meaning)
            for name in _SHOWN
        ]

    def first_write(self) -> list[PlannedWord]:
        """Return the settings that entering changes; reads only."""
        status = self._ask(QUERY)
        planned = {"width0": 0, "width1": 0, **self._settings, "tick_hz": 0}
        return [
            PlannedWord(f"b{STATUS.table.bytes_of(name)[0].word}", (name,), int(status[name]), value)
            for name, value in planned.items()
            if status[name] != value
        ]

    def _prepare_image(self) -> None:
        """Read only: the image is always the same."""

    @property
    def safe_image(self) -> bytes:
        """A DISARM frame, with the newest sequence number."""
        return DISARM.encode(sequence=self._sequence)

    def _load_safe_image(self, image: bytes) -> None:
        self._sequence = (image[HEAD_BYTES - 1] + _OTHER_HALF) % 256

    def _start(self) -> tuple[int, int]:
        self._write_safe()
        if self._ask(QUERY)["state"] == State.TRIPPED:
            self._ask(CLEAR)
        self._configure(tick_hz=0)
        self._start_ns = self._now_ns()
        return self._polled(0, 0)

    def _configure(self, tick_hz: int) -> None:
        wanted = self._settings | {"tick_hz": tick_hz}
        status = self._ask(CONFIGURE, wanted)
        wrong = [f"{name} = {status[name]}, not {value}" for name, value in wanted.items() if status[name] != value]
        if wrong:
            raise BoardError(f"the board did not take its settings: {'; '.join(wrong)}")

    def _transfer(self, command: Command) -> tuple[int, int]:
        drive, brake = widths(command, self._full)
        self._wait_for(self._hurried_s if self.hurried else self._patient_s)
        if not self._outputs_may_be_on and (drive or brake):
            self._arm()
        return self._polled(drive, brake)

    def _polled(self, drive: int, brake: int) -> tuple[int, int]:
        """Send a command, and take the report that answers it."""
        sequence = self._next()
        self._send(drive, brake, sequence)
        for _ in range(_MOST_OLD):
            frame = self._frame()
            if frame[1] == REPORT.kind and frame[HEAD_BYTES - 1] == sequence:
                break
        else:
            raise LinkError("the board does not answer the newest command: is another program using it?")
        _, self._newest_clock, *values = REPORT.codec.unpack_from(frame, HEAD_BYTES)
        self._taken_ns = self._clock.instant(self._newest_clock, self._start_ns, self._now_ns())
        if self._taken_ns < 0:
            raise LinkError(self._clock.fault)
        return self._counts(values, (drive, brake))

    def _counts(self, values: list[int], commanded: tuple[int, int]) -> tuple[int, int]:
        """Return the counts of wheel and road in a report in which these widths must be in force."""
        *counts, width0, width1, state, trip, _, _ = values
        if self._outputs_may_be_on and state != State.ARMED:
            raise LinkError(self._let_go(state, trip))
        found = (width1, width0) if self._swapped else (width0, width1)
        if found != commanded:
            raise LinkError(
                f"the board has PWM widths {found}, but {commanded} were sent: does another program drive it?"
            )
        wiring = self._wiring
        return wiring.wheel_sign * counts[wiring.wheel_encoder], wiring.road_sign * counts[wiring.road_encoder]

    def _let_go(self, state: int, trip: int) -> str:
        if state == State.TRIPPED:
            why = _TRIPS.get(trip, f"for reason {trip}").format(watchdog_ms=self._settings["watchdog_ms"])
            return f"the board has switched its outputs off, {why}"
        return "the board is not armed any more: it was reset, or another program has disarmed it"

    def _arm(self) -> None:
        """Allow widths; the watchdog runs from here on."""
        status = self._ask(QUERY)
        if status["state"] == State.TRIPPED:
            raise LinkError(self._let_go(State.TRIPPED, int(status["trip"])))
        if _widths_of(status) != (0, 0):
            raise LinkError(
                f"the board has PWM widths {_widths_of(status)} before it is armed: does another program drive it?"
            )
        if status["state"] != State.ARMED:  # else the answer to an earlier ARM was lost
            self._ask(ARM, {"answer": int(status["challenge"]) ^ CHALLENGE_MASK})
        self._outputs_may_be_on = True

    def _dated(self, now: int) -> int:  # noqa: ARG002  the board's clock dates the sample
        return self._taken_ns

    def _write_safe(self) -> None:
        self._wait_for(self._patient_s)  # no tick waits, and attempts are few
        self._pace.running = self._outputs_may_be_on = False
        self._link.write(DISARM.encode(sequence=self._next()))
        status = self._ask(QUERY)
        if _widths_of(status) != (0, 0) or status["state"] == State.ARMED:
            found = f"state {status['state']}, PWM widths {_widths_of(status)}"
            raise LinkError(f"the board is not safe after DISARM: {found}")

    def start_pacing(self) -> None:
        """Arm the board, both outputs off; its tick starts the samples from now on. Raises BoardError."""
        self._write_safe()
        self._configure(tick_hz=_SECOND_NS // self._period_ns)
        self._arm()
        self._pace.start(self._newest_clock, self._taken_ns)
        self._wait_for(self._hurried_s)

    def answer(self, command: Command) -> None:
        """Send `command`, decided from the newest sample; it acts from the board's next tick on."""
        if not self._ready:
            raise self._refusal()
        drive, brake = widths(command, self._full)
        pace = self._pace
        if not pace.running or pace.tick < 0:
            return  # there is no report to answer yet
        try:
            self._send(drive, brake, pace.tick & 0xFF)
        except LinkError as error:
            self._lost = error
            return
        pace.answered, pace.sent = pace.tick, (drive, brake)

    def report(self) -> Sample:
        """Wait for the board's next tick, and return its sample; `late_ns` and `skipped` describe it.

        A failed one repeats the last counts, with the flag STALE, as `exchange` does. A sample that came more than a
        period late, or before which the newest command was not in force in time, has the flag SLOW.
        """
        if not self._ready:
            raise self._refusal()
        pace = self._pace
        before = pace.tick
        try:
            wheel, road = self._await_tick()
        except LinkError as error:
            self.link_errors += 1
            self.last_error, self._lost = error, None
            if pace.tick == before:
                pace.miss()
            self.late_ns, self.skipped = 0, 0
            return self._sample(pace.time_ns, BoardFlags.STALE)
        wheel_before, road_before = self._raw
        self._raw = wheel, road
        self._wheel_count += signed32(wheel - wheel_before)
        self._road_count += signed32(road - road_before)
        self.late_ns, self.skipped = pace.late_ns, pace.tick - before - 1
        return self._sample(pace.time_ns, BoardFlags.SLOW if pace.slow else BoardFlags.NONE)

    def _await_tick(self) -> tuple[int, int]:
        """Return the counts of the newest report of a tick."""
        pace = self._pace
        if not pace.running:
            raise LinkError("the board's tick does not run")
        for _ in range(_MOST_OLD):
            frame = self._frame()
            if frame[1] != REPORT.kind:
                continue
            tick, clock, *values = REPORT.codec.unpack_from(frame, HEAD_BYTES)
            if tick > pace.tick and pace.takes(tick, clock, self._now_ns()):
                break
        else:
            raise LinkError("the board's reports come more than a period late: choose a lower loop.rate_hz")
        if self._lost is not None:
            raise self._lost
        *_, width0, width1, _, _, applied, _ = values
        in_force = (width1, width0) if self._swapped else (width0, width1)
        if pace.answered >= 0:
            on_time = applied == pace.answered & 0xFF
            pace.slow = pace.slow or not on_time
            in_force = pace.sent if on_time else in_force
        return self._counts(values, in_force)

    def _send(self, drive: int, brake: int, sequence: int) -> None:
        pair = (brake, drive) if self._swapped else (drive, brake)
        frame = bytearray(_COMMAND_HEAD + COMMAND.codec.pack(*pair) + bytes(CRC_BYTES))
        frame[HEAD_BYTES - 1] = sequence
        self._link.write(sealed(frame))

    def _ask(self, message: Message, values: Mapping[str, Value] | None = None) -> dict[str, Value]:
        """Send a message; return the fields of its answer. Raises LinkError, also for a refusal."""
        sequence = self._next()
        self._link.write(message.encode(values, sequence=sequence))
        wanted = IDENTITY if message is HELLO else STATUS
        for _ in range(_MOST_OLD):
            frame = self._frame()
            if frame[HEAD_BYTES - 1] != sequence or frame[1] not in {wanted.kind, REFUSAL.kind}:
                continue  # the answer to an earlier question, or a report
            answer, found = decode(frame)
            if answer is REFUSAL:
                if found["refused"] != message.kind:
                    continue
                reason = int(found["reason"])
                raise LinkError(f"the board refuses {message.name}: {_REFUSALS.get(reason, f'reason {reason}')}")
            return found
        raise LinkError(f"the board does not answer {message.name}: is another program using it?")

    def _frame(self) -> bytes:
        """Read one undamaged frame."""
        frame = self._link.read(_MOST_BYTES)
        if len(frame) < OVERHEAD_BYTES or crc16(frame[1:-CRC_BYTES]) != int.from_bytes(frame[-CRC_BYTES:], "little"):
            raise LinkError(f"the board's answer of {len(frame)} bytes is damaged: check the cable")
        try:
            if frame[1] != REPORT.kind or len(frame) != REPORT.table.size:
                decode(frame)
        except ProtocolError as error:
            raise LinkError(f"the board's answer is not one of its frames: {error}") from error
        return frame

    def _next(self) -> int:
        self._sequence = (self._sequence + 1) % 256
        return self._sequence

    def _wait_for(self, timeout_s: float) -> None:
        if timeout_s != self._timeout_s:
            self._timeout_s = self._link.timeout_s = timeout_s

    def _close(self) -> None:
        self._link.close()


class _Pace:
    """The board's tick, as the host sees it.

    The board's clock dates the samples. Its drift against the host's clock changes only the lateness: the least time
    from sample to arrival grows by 200 ppm until a report is quicker.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self.running = False
        self.tick = self.answered = -1
        """Numbers of the newest tick, and of the newest that was answered."""
        self.sent = 0, 0
        """Widths of drive and brake in that answer."""
        self.time_ns = self.late_ns = 0
        self.slow = False
        self._board_us = 0
        self._least_ns: int | None = None

    def start(self, board_us: int, time_ns: int) -> None:
        """Begin, with a reading of the board's clock and the host's time of it."""
        self._board_us, self.time_ns = board_us, time_ns
        self._least_ns = None
        self.tick = self.answered = -1
        self.running = True

    def takes(self, tick: int, board_us: int, now_ns: int) -> bool:
        """Take a report; False if it is so late that a newer one is due."""
        passed_us = signed32(board_us - self._board_us)
        self._board_us, self.time_ns = board_us, self.time_ns + passed_us * _CLOCK_NS
        delay_ns = now_ns - self.time_ns
        if self._least_ns is None:
            self._least_ns = delay_ns
        self._least_ns = min(self._least_ns + passed_us * _CLOCK_NS * _DRIFT_PPM // 1_000_000, delay_ns)
        self.late_ns = delay_ns - self._least_ns
        self.tick = tick
        self.slow = self.late_ns > self._period_ns
        return not self.slow

    def miss(self) -> None:
        """Go on without the report of a tick."""
        self.tick += 1
        self._board_us = self._board_us + self._period_ns // _CLOCK_NS & 0xFFFF_FFFF
        self.time_ns += self._period_ns


def _fields() -> dict[str, str]:
    """Return the fields for `survey` by the names of all boards, with those of the frames."""
    shared = {
        "application_name": "name",
        "synthesis_date": "date",
        **{f"encoder{i}_count": f"count{i}" for i in range(COUNTERS)},
        **{f"pwm{i}_width": f"width{i}" for i in range(PWMS)},
    }
    others = [field.name for message in (IDENTITY, STATUS) for field in message.payload]
    return shared | {name: name for name in others if name not in shared.values()}


_FIELDS: Final = _fields()
_COMMAND_HEAD: Final = COMMAND.encode()[:HEAD_BYTES]


def _widths_of(status: Mapping[str, Value]) -> tuple[int, int]:
    return int(status["width0"]), int(status["width1"])


def _without_sequence(values: Mapping[str, Value]) -> dict[str, Value]:
    return {name: value for name, value in values.items() if name != "sequence"}


def _require_channels(wiring: BoardConfig) -> None:
    mistakes = channel_mistakes(wiring, PWMS, REPORTED_COUNTERS, lambda count: f"the open board has {_channels(count)}")
    mistakes += [
        ConfigIssue(f"board.{key}", f"{getattr(wiring, key)}: the open board has no such settings; leave it out")
        for key in ("constants", "numbering_pins")
        if getattr(wiring, key)
    ]
    if mistakes:
        raise ConfigError(mistakes)


def _channels(count: int) -> str:
    # its frames carry numbers, its samples the time, and its watchdog is inside
    return f"channels 0..{count - 1} in its reports" if count else "its own; leave it out"
