"""The part of PROTOCOL.md about the open board."""

from __future__ import annotations

from typing import Final

from firmware_protocol import open_board as board
from firmware_protocol.fields import FrameField, ValueKind
from firmware_protocol.markdown import table

_RATES_HZ: Final = (1000, 2000)

_HEAD: Final = """\
## Open board, logic 0x{logic:04X}

A microcontroller board with this project's firmware, on a serial line or USB. It understands two sets of commands in
one byte stream: those of RT-DAC/USB, logic 0x0111, above, and the frames of this section, which have what the former
lack: length, sequence number, CRC, the board's time, a tick that the board starts, a watchdog, and arming.

### Frame

| byte | content |
|---|---|
| 0 | SYNC, 0x{sync:02X} |
| 1 | kind |
| 2 | length of the payload, one value for each kind, at most {most} |
| 3 | sequence |
| 4.. | payload |
| last 2 | CRC-16/CCITT-FALSE over kind to payload: polynomial 0x1021, initial value 0xFFFF; 0x29B1 for `123456789` |

Numbers are little-endian; text and hex digits are in reading order. An answer has the sequence of its question; a
REPORT of a tick has the low 8 bits of the tick.

### Rules of the line

* **Beginning**: outside a frame, 0x{sync:02X} begins a frame, and 0x80 to 0x83 begin a command of logic 0x0111. Inside
  a frame every byte belongs to the frame. Inside a SEND of logic 0x0111, 0x{sync:02X} ends that command, as every byte
  with bit 7 does, and begins a frame. Other bytes are ignored.
* **Damage**: a kind that the sender does not have, or a length that is not the kind's, ends the frame; that byte is
  examined again, as the first one outside a frame. A frame with a wrong CRC is dropped whole. Both count in
  `bad_frames`, and have no answer.
* **Silence**: the board drops an unfinished frame after {silence} ms without a byte, by its own clock, and counts it.
* **Detected**: the CRC finds every change of one, two or three bits behind SYNC, and every burst of at most 16 bits. A
  damaged SYNC hides its frame. Nothing in a damaged frame acts.
* **Full queue**: the board sends an answer whole or not at all.

### States

```text
                 reset
                   |
                   v
               +--------+   CONFIGURE   +--------------+
               |  idle  |-------------->|  configured  |<---+ CONFIGURE, DISARM
               +--------+               +--------------+----+
                                          |   ^      ^
                             ARM, answer  |   |      | CLEAR, no stop input low
                             right        v   |      |
                                      +---------+  +-----------+
                              DISARM  |  armed  |  |  tripped  |<---+ DISARM
                           to         +---------+  +-----------+----+
                           configured       |            ^
                                            +------------+
                                  watchdog_ms without a valid COMMAND,
                                  or an input of stop_pins low
```

| frame | idle | configured | armed | tripped |
|---|---|---|---|---|
| HELLO, QUERY | answer | answer | answer | answer |
| CONFIGURE | -> configured | -> configured | REFUSAL 1 | REFUSAL 1 |
| ARM | REFUSAL 1 | -> armed | REFUSAL 1 | REFUSAL 1 |
| COMMAND | changes nothing | changes nothing | widths | changes nothing |
| DISARM | outputs off | outputs off | -> configured | outputs off |
| CLEAR | STATUS | STATUS | REFUSAL 1 | -> configured |
| SEND of logic 0x0111 | widths | widths | ignored | changes nothing |
| READ of logic 0x0111 | answer | answer | ignored | answer |

* **CONFIGURE**: REFUSAL 2 for `watchdog_ms` outside {watchdog[0]}..{watchdog[1]}, for `tick_hz` other than 0
  and the divisors of 1000000 in {tick[0]}..{tick[1]}, for another `pwm_mode`, and for a watchdog shorter than {periods}
  periods: `watchdog_ms * tick_hz` must be at least {least}, or `tick_hz` 0. REFUSAL 5 while logic 0x0111 has a width
  on. It sets all settings of logic 0x0111 back to those after reset, so that no counter is held.
* **ARM**: `answer` is the challenge of the newest STATUS, exclusive or 0x{mask:04X}; REFUSAL 3 for another. REFUSAL 4
  while an input of `stop_pins` is low, 5 while logic 0x0111 has a width on. The state is looked at first, then answer,
  stop inputs, outputs. Each accepted ARM, each DISARM, trip and reset draws another challenge: a frame that is repeated
  later does not arm.
* **COMMAND**: valid if the board is armed, no width exceeds the steps of a period, and, with a tick, its sequence is
  the low 8 bits of the newest REPORT. Only a valid one sets widths, and only it feeds the watchdog. Others count in
  `refused`. A COMMAND with both widths 0 in another state than armed asks for a REPORT, and is not counted.
* **Watchdog**: runs from ARM on, from the arrival of the newest valid COMMAND, or from ARM; it cannot be switched
  off. The board checks it at each tick, and in polled mode at least once in each millisecond, so that outputs are off
  at the latest one tick (polled: 1 ms) after `watchdog_ms`.
* **Trip**: outputs off, `trip` is the reason, `trips` counts; latched until CLEAR and ARM. DISARM leaves it latched.
  With a tick, REPORTs go on in state tripped, until DISARM or CLEAR, and show it. CLEAR has REFUSAL 4 while an input of
  `stop_pins` is low.
* **Logic 0x0111** has no frames for arming and watchdog. While one of its widths is on, {vendor_ms} ms without a whole
  SEND switch its outputs off: reason 3, the state stays. After that, SENDs change no width until one has all widths 0,
  so that a computer that wakes up does not start the motor. Programs for that board send at 10 to 100 Hz:
  {vendor_ms} ms are two and a half periods of the slowest.

### Timing

With a tick, at instant k: latch counters and clock, check watchdog and stop inputs, put the pending COMMAND in force,
send REPORT k. Tick 0 is one period after ARM; the instants are those of one timer, so that errors do not add up.

```text
instant      k                        k+1                      k+2
board     ---|------------------------|------------------------|---
sample       counts k                 counts k+1               counts k+2
line         [REPORT k]  [COMMAND k]  [REPORT k+1] [COMMAND k+1]
host                 decide                  decide
in force     COMMAND k-1              COMMAND k                COMMAND k+1
```

* The COMMAND that answers REPORT k acts from instant k+1 on: one period of delay, constant.
* A COMMAND that arrives after k+1 is late: its sequence is not that of REPORT k+1. It counts in `refused` and feeds no
  watchdog. Each instant without a COMMAND of its own, from tick 1 on, while armed, counts in `late`; the widths in
  force stay, until the watchdog ends that.
* A second COMMAND for the same instant replaces the first.
* Polled (`tick_hz` 0): a COMMAND acts at its arrival, and REPORT has the counts of that instant and the COMMAND's
  sequence.

### Kinds
"""

_COST: Final = """\
### Cost on the line

A tick takes one REPORT of {report} bytes and one COMMAND of {command}. Between them the host decides: what the two
leave of the period is for the computer, its drivers and the bridge.

* **Serial line**: a byte takes 10 bits, and each direction has a wire of its own. REPORT's direction limits the rate:
  {report} x 10 bits x 2000 Hz = {bits} bit/s.
* **USB**: both directions share the wire, and each bulk transfer takes 13 bytes (full speed) or 55 bytes (high speed)
  beside its data. At full speed REPORT takes ({report} + 13) x 8 bits / 12 Mbit/s = {full:.1f} us. A host controller
  may wait up to a frame (1 ms) or a microframe (125 us) before it asks the board, which is not counted. Source USB20:
  [docs/facts/sources.md](../docs/facts/sources.md#usb20).
* "left" is the period minus both frames; "load" is the share of the period that the busier direction, or the shared
  wire, is in use. Where "left" is negative, no answer can be in time at that rate.
"""

_FORMS: Final = {ValueKind.TEXT: "text", ValueKind.HEX: "hex digits", ValueKind.SIGNED: "i"}


def _form(field: FrameField) -> str:
    layout = field.read or field.send or ()
    if field.kind in {ValueKind.TEXT, ValueKind.HEX}:
        return f"{_FORMS[field.kind]}, {len(layout)} bytes"
    return f"{_FORMS.get(field.kind, 'u')}{8 * len(layout)}"


def _kind(message: board.Message) -> str:
    way = "host to board" if message.from_host else "board to host"
    title = f"#### {message.name}, 0x{message.kind:02X}, {way}\n\n{message.meaning[0].upper()}{message.meaning[1:]}."
    if not message.payload:
        return f"{title} No payload, {message.table.size} bytes.\n"
    rows = (
        (f"`{field.name}`", str(min(part.word for part in message.table.fields[field.name][1])), _form(field), *about)
        for field in message.payload
        for about in [(field.unit, field.meaning)]
    )
    return f"{title} Payload {message.payload_bytes} bytes, frame {message.table.size} bytes.\n\n" + table(
        ("field", "byte", "form", "unit", "meaning"), rows
    )


def cost_us(line: board.Line) -> tuple[float, float]:
    """Return how long REPORT and COMMAND take on the wire, us."""
    return line.microseconds(board.REPORT.table.size), line.microseconds(board.COMMAND.table.size)


def _cost(line: board.Line, rate_hz: int) -> tuple[str, ...]:
    report, command = cost_us(line)
    period = 1e6 / rate_hz
    busy = report + command if line.shared else max(report, command)
    return (
        line.name,
        f"{rate_hz}",
        f"{report:.1f}",
        f"{command:.1f}",
        f"{period - report - command:.1f}",
        f"{100 * busy / period:.1f} %",
    )


def section() -> str:
    """Return the section as Markdown."""
    head = _HEAD.format(
        logic=board.LOGIC_VERSION,
        sync=board.SYNC,
        most=board.MOST_PAYLOAD_BYTES,
        silence=board.SILENCE_MS,
        watchdog=board.WATCHDOG_MS,
        tick=board.TICK_HZ,
        periods=board.WATCHDOG_PERIODS,
        least=1000 * board.WATCHDOG_PERIODS,
        mask=board.CHALLENGE_MASK,
        vendor_ms=board.VENDOR_WATCHDOG_MS,
    )
    report, command = board.REPORT.table.size, board.COMMAND.table.size
    cost = _COST.format(report=report, command=command, bits=report * 10 * 2000, full=(report + 13) * 8 / 12)
    columns = ("line", "rate, Hz", "REPORT, us", "COMMAND, us", "left, us", "load")
    costs = table(columns, (_cost(line, rate) for rate in _RATES_HZ for line in board.LINES))
    return "\n".join([head, *map(_kind, board.MESSAGES.values()), cost, costs])
