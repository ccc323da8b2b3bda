"""How long outputs stay on after the last frame, by the board's own clock, however the host ends."""

import os
import random
import select
import signal
import termios
import time
import tty
from collections import Counter, defaultdict
from itertools import count

import pytest
from emulated import emulated_board, let_go_at_the_first_tick, punctual

from firmware_protocol import open_board, rtdac_usb
from firmware_protocol.open_board import (
    ARM,
    CHALLENGE_MASK,
    CLEAR,
    COMMAND,
    CONFIGURE,
    DISARM,
    HELLO,
    QUERY,
    REPORT,
    STATUS,
    State,
    Trip,
)

pytestmark = [pytest.mark.long, pytest.mark.xdist_group("real time")]

TRIALS = 200
PICO_TRIALS = 800
TICKS_HZ = (0, 0, 500, 1000)
TICK_US = {"logic 0x0111": 1000, "polled": 1000, "tick of 500 Hz": 2000, "tick of 1000 Hz": 1000}
PWM_PERIOD_US = 308  # 12 bits at prescaler 2
FULL = 4095
PATIENCE_S = 0.1
GIVES_UP_S = 5
SEND = rtdac_usb.logic_of(0x0111).send


class Line:
    """A serial line without a library between, so that a forked host opens it at once."""

    def __init__(self, path):
        self.file = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.file)
        termios.tcflush(self.file, termios.TCIOFLUSH)
        self._receiver = open_board.Receiver(from_host=False)
        self._frames = []

    def send(self, message, sequence=0, **values):
        os.write(self.file, message.encode(values, sequence=sequence))

    def receive(self, message, within_s=PATIENCE_S):
        """The next message of this kind; None if it does not come within a while."""
        end = time.monotonic() + within_s
        while True:
            while self._frames:
                found, fields = open_board.decode(self._frames.pop(0))
                if found is message:
                    return fields
            if not select.select([self.file], [], [], max(end - time.monotonic(), 0))[0]:
                return None
            self._frames += self._receiver.feed(os.read(self.file, 4096))

    def ask(self, message, **values):
        """The STATUS that answers a message, asked again while reports that no host has read are in its way."""
        status, sequence = None, 0
        while status is None or status["sequence"] != sequence:
            if status is None:
                sequence += 1
                self.send(message, sequence, **values)
            status = self.receive(STATUS)
        return status


def say(capsys, *words):
    with capsys.disabled():
        print(*words)  # noqa: T201  the figures of the page


def armed(line, watchdog_ms, tick_hz):
    """Arm the board; return its first REPORT."""
    line.ask(DISARM)
    line.ask(CLEAR)
    status = line.ask(CONFIGURE, watchdog_ms=watchdog_ms, tick_hz=tick_hz, pwm_mode=1, pwm_prescaler=2)
    status = line.ask(ARM, answer=status["challenge"] ^ CHALLENGE_MASK)
    assert status["state"] == State.ARMED
    if not tick_hz:
        line.send(COMMAND, width0=0, width1=0)
    return line.receive(REPORT)


def applied(line, report, width):
    """Command a width; return the REPORT that shows it, None if the board has tripped before."""
    while report is not None and report["state"] == State.ARMED:
        if report["width0"] == width:
            return report
        line.send(COMMAND, report["tick"] & 0xFF, width0=width, width1=500)
        report = line.receive(REPORT)
    return None


def command_until_killed(path, going, watchdog_ms, tick_hz):
    """A host of the open logic: each command has other widths than the one before."""
    line = Line(path)
    report = armed(line, watchdog_ms, tick_hz)
    for n in count(1):
        while newer := line.receive(REPORT, within_s=0.0):  # one that came while this host waited for the computer
            report = newer
        if report["state"] != State.ARMED:  # it waited too long
            return
        line.send(COMMAND, report["tick"] & 0xFF, width0=2001 - max(report["width0"], 1000), width1=0)
        if n >= 5 and report["width0"] > 0 and going is not None:
            os.write(going, b"!")
            going = None
        if not tick_hz:
            time.sleep(0.001)
        report = line.receive(REPORT)


def send_until_killed(path, going, *_):
    """A host of the vendor's logic."""
    line = Line(path)
    line.ask(DISARM)
    line.ask(CLEAR)  # what the open logic has tripped, its frames alone can clear
    for n in count(1):
        frame = SEND.encode({"pin_mode": 3, "pwm0_width": 100 + n % 2 if n > 1 else 0, "pwm0_mode": 0})
        os.write(line.file, frame)
        time.sleep(0.02)
        if n == 5:
            os.write(going, b"!")


def forked(act, *arguments):
    """Run a host in a process of its own; return its number once it commands, None if the board has not let it."""
    going, begun = os.pipe()
    pid = os.fork()
    if pid == 0:
        signal.alarm(GIVES_UP_S)  # were it to wait for an answer that does not come
        try:
            with punctual():
                act(arguments[0], begun, *arguments[1:])
        finally:
            os._exit(1)
    os.close(begun)
    commands = os.read(going, 1)
    os.close(going)
    if not commands:
        os.waitpid(pid, 0)
        return None
    return pid


def unplugged(board, _host):
    board.unplug()


def killed(_board, host):
    os.kill(host, signal.SIGKILL)


def asleep(_board, host):
    """To the board a computer that sleeps, hangs or is stopped is one whose programs do nothing."""
    os.kill(host, signal.SIGSTOP)


def cut(board, host):
    """Half a frame is the last that it hears."""
    os.kill(host, signal.SIGKILL)
    file = os.open(board.link, os.O_WRONLY | os.O_NOCTTY)
    os.write(file, COMMAND.encode({"width0": FULL})[:7])
    os.close(file)


ENDS = (unplugged, killed, asleep, cut)


def test_outputs_are_off_one_tick_after_the_watchdogs_time_at_the_latest(tmp_path, capsys):
    draw = random.Random(1)
    beyond_us, ends = defaultdict(list), Counter()
    with emulated_board(tmp_path) as board:
        trial = busy = 0
        while trial < TRIALS:
            vendor = trial % 5 == 0
            watchdog_ms = open_board.VENDOR_WATCHDOG_MS if vendor else draw.randint(20, 100)
            tick_hz = 0 if vendor else draw.choice(TICKS_HZ)
            before = len(board.changes())
            host = forked(send_until_killed if vendor else command_until_killed, board.link, watchdog_ms, tick_hz)
            if host is None:
                busy += 1
                assert busy < TRIALS // 4, "the board, or a computer that is far too busy"
                continue
            trial += 1
            time.sleep(draw.uniform(0.0, 0.03))
            end = draw.choice(ENDS)
            end(board, host)
            board.wait_until_off(before + 1)
            os.kill(host, signal.SIGKILL)
            os.waitpid(host, 0)
            ends[end.__name__] += 1
            last, off = board.changes()[-2:]
            assert last.widths[0] > 0, "the last command is known by its width"
            watchdog_us = 1000 * watchdog_ms
            in_time = let_go_at_the_first_tick(last, off, watchdog_us, at_ticks=tick_hz > 0)
            assert in_time, (end, tick_hz, watchdog_ms, last, off)
            kind = "logic 0x0111" if vendor else f"tick of {tick_hz} Hz" if tick_hz else "polled"
            beyond_us[kind].append(off.clock_us - last.clock_us - watchdog_us)
        status = Line(board.link).ask(QUERY)
    assert status["state"] == State.TRIPPED or status["trip"] in {Trip.WATCHDOG, Trip.VENDOR_WATCHDOG}
    assert set(ends) == {end.__name__ for end in ENDS}
    say(capsys, f"{TRIALS} trials:", *(f"{number} {name}" for name, number in sorted(ends.items())))
    for kind, found in sorted(beyond_us.items()):
        soon = sum(each <= TICK_US[kind] for each in found)
        say(capsys, f"{kind:18} {len(found):4} trials, {soon} within one period of the tick beyond the watchdog's time")


NOTHING_THAT_FEEDS = (
    lambda _line: None,
    lambda line: os.write(line.file, COMMAND.encode({"width0": FULL})[:7]),
    lambda line: os.write(line.file, bytes(COMMAND.encode({"width0": FULL})[:-1]) + b"!"),
    lambda line: [line.send(message) for message in (QUERY, HELLO, ARM, CLEAR)],
    lambda line: os.write(line.file, SEND.encode({"pin_mode": 3, "pwm0_width": 255})),
)
"""A silent host, half a frame, a damaged one, frames that ask, and a vendor's program while the board is armed."""


def test_in_the_picos_own_time_it_is_one_period_at_most(tmp_path, capsys):
    """Its emulator's clock counts the chip's cycles, so that its ticks are never late."""
    draw = random.Random(2)
    beyond_us = defaultdict(list)
    with emulated_board(tmp_path, "rp2040") as board:
        trial = busy = 0
        line = Line(board.link)
        while trial < PICO_TRIALS:
            watchdog_ms, tick_hz = draw.randint(20, 100), draw.choice(TICKS_HZ)
            before = len(board.changes())
            report = armed(line, watchdog_ms, tick_hz)
            for width in (1000, 1001, 1002):
                report = report and applied(line, report, width)
            if report is None:
                busy += 1
                assert busy < PICO_TRIALS // 4, "the board, or a computer that is far too busy"
                continue
            trial += 1
            draw.choice(NOTHING_THAT_FEEDS)(line)
            board.wait_until_off(before)
            off_us = board.changes()[-1].clock_us % (1 << 32)
            kind = f"tick of {tick_hz} Hz" if tick_hz else "polled"
            took_us = off_us - report["clock"]
            assert took_us <= 1000 * watchdog_ms + TICK_US[kind], (watchdog_ms, tick_hz, report, off_us)
            assert took_us >= 1000 * watchdog_ms - TICK_US[kind] - PWM_PERIOD_US
            beyond_us[kind].append(took_us - 1000 * watchdog_ms)
    for kind, found in sorted(beyond_us.items()):
        say(capsys, f"Pico, {kind:16} {len(found):3} trials, the last level {min(found)} to {max(found)} us beyond it")
