"""Faults between driver and USB board, with the required outcomes, for every link to the board.

The bench defines how its links are opened and how pyusb finds the board.
"""

import errno
import traceback
from contextlib import contextmanager

import pytest
from drill import HandClock, eventually

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, ENDPOINT_OUT
from inteco_abs.boards.families.usb2 import RtdacUsb2
from inteco_abs.boards.families.usb2.bridge import NOT_REPORTED, FirmwareDates, firmware_dates, identify_led
from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.config import load_config
from inteco_abs.errors import BoardError, UnsafeError
from inteco_abs.mock_board import Device, Urb, UsbBoard, UsbHost, UsbIdentity, UsbSpeed
from inteco_abs.mock_board.usbip.usb_device import Handshake, SetupPacket
from inteco_abs.signals import BoardFlags, Command

SERIAL = 900_000_321
PATIENT_NS = 1_000_000_000
"""A period so long that the driver waits for each answer as long as its link does."""
_SET_HALT = 0x02, 3, 0
"""Standard request SET_FEATURE(ENDPOINT_HALT)."""


class ChangingFrontEnd(Usb2FrontEnd):
    """The mock's endpoints; the next answer is what `change` makes of it and of the one before, none if nothing."""

    change = None
    _before = b""

    def bulk_in(self, length):
        answer = super().bulk_in(length)
        if not answer:
            return b""
        change, self.change = self.change, None
        before, self._before = self._before, answer
        return change(answer, before) if change else answer


class MoodyBoard(UsbBoard):
    """Refuses all vendor requests, or answers them with `reply` if it is set."""

    refuses = False
    reply = None

    def _vendor(self, setup, data):
        if self.refuses:
            return Handshake.STALL
        return super()._vendor(setup, data) if self.reply is None or not setup.reads else self.reply


class Bench:
    """A mock board on a bus of its own. `open_link()` and `find()` are set by who knows the way to it."""

    open_link = None
    find = None

    def __init__(self, speed=UsbSpeed.HIGH, serial=SERIAL):
        self.config = load_config()
        self.clock = HandClock()
        self.device = Device(self.config, self.clock.now_ns, 1)
        self.front_end = ChangingFrontEnd(self.device)
        self.board = MoodyBoard(self.front_end, UsbIdentity(serial=serial, speed=speed))
        self.host = UsbHost(self.board)
        self.driver = None

    @contextmanager
    def driving(self):
        """The wheel is being driven; at the end the outputs are off and the board is let go."""
        self.driver = RtdacUsb2(self.open_link(), self.config.board, self.clock.now_ns, PATIENT_NS)
        with self.driver:
            for _ in range(3):
                self.works()
            yield
        assert self.device.duties == (0.0, 0.0)

    def exchange(self):
        self.clock.time_ns += self.config.period_ns
        return self.driver.exchange(Command(1.0, 0.6))

    def works(self):
        sample = self.exchange()
        assert not sample.board_flags & BoardFlags.STALE, self.driver.last_error
        assert self.device.duties == (1.0, 0.6)

    def fails(self, words):
        assert self.exchange().board_flags & BoardFlags.STALE
        assert words in str(self.driver.last_error), self.driver.last_error

    def halt(self, endpoint):
        self.host.submit(halt_of(endpoint))

    def change(self, change):
        self.front_end.change = change

    def plug_in_again(self):
        eventually(lambda: self.find() is None)
        self.host.plug()
        eventually(lambda: self.find() is not None)


def halt_of(endpoint):
    """The transfer that stalls an endpoint."""
    return Urb(0, lambda _urb: None, setup=SetupPacket(*_SET_HALT, endpoint, 0))


TROUBLES = {
    "stall of the answer": (lambda bench: bench.halt(ENDPOINT_IN), "refused the transfer (stall)"),
    "stall of the command": (lambda bench: bench.halt(ENDPOINT_OUT), "refused the transfer (stall)"),
    "short frame": (lambda bench: bench.change(lambda answer, _: answer[:100]), "has 100 bytes, must be 504"),
    "frame in one packet less": (lambda bench: bench.change(lambda answer, _: answer[:448]), "has 448 bytes"),
    "damaged frame": (lambda bench: bench.change(lambda answer, _: b"\0" + answer[1:]), "the frame is damaged"),
    "older answer": (lambda bench: bench.change(lambda _, before: before), "is to an older request"),
    "no answer": (lambda bench: bench.change(lambda *_: b""), "did not answer within"),
    "babble": (lambda bench: bench.change(lambda answer, _: answer + bytes(100)), "sent more than requested"),
    "bus error in the answer": (lambda bench: bench.host.inject(ENDPOINT_IN, -errno.EPROTO), "the bus failed"),
    "bus error in the command": (lambda bench: bench.host.inject(ENDPOINT_OUT, -errno.EPROTO), "the bus failed"),
}
"""How to make it, and what the error has to say."""
SCENARIOS = {}


def scenario(function):
    SCENARIOS[function.__name__] = function
    return function


def _goes_on(cause, words):
    def goes_on(bench):
        with bench.driving():
            for _ in range(2):
                cause(bench)
                bench.fails(words)
                bench.works()

    return goes_on


def _ends_safe(cause, words):
    def ends_safe(bench):
        with bench.driving():
            cause(bench)
            bench.fails(words)
            assert bench.driver.link_errors == 1

    return ends_safe


def _fails_while_safe_is_written(cause, _words):
    def fails_while_safe_is_written(bench):
        with bench.driving():
            cause(bench)

    return fails_while_safe_is_written


for _name, _trouble in TROUBLES.items():
    SCENARIOS[f"{_name}, and the run continues"] = _goes_on(*_trouble)
    SCENARIOS[f"{_name}, and the run ends with SAFE"] = _ends_safe(*_trouble)
    SCENARIOS[f"{_name}, while SAFE is written"] = _fails_while_safe_is_written(*_trouble)


@scenario
def unplugged_in_mid_run(bench):
    def unplug():
        with bench.driving():
            bench.host.unplug()
            bench.fails("the board is gone")

    with pytest.raises(UnsafeError, match=r"the board is gone: check cable and power.*MOTOR POWER MAY STILL BE ON"):
        unplug()
    assert bench.device.duties == (1.0, 0.6)


@scenario
def stalled_and_then_unplugged(bench):
    def stall_and_unplug():
        with bench.driving():
            bench.halt(ENDPOINT_IN)
            bench.fails("refused the transfer (stall)")
            bench.host.unplug()
            bench.fails("the board is gone")

    with pytest.raises(UnsafeError, match=r"the board is gone: check cable and power.*MOTOR POWER MAY STILL BE ON"):
        stall_and_unplug()


@scenario
def not_plugged_in(bench):
    bench.host.unplug()
    eventually(lambda: bench.find() is None)
    with pytest.raises(BoardError, match="no RT-DAC/USB2 board: is it plugged in"):
        bench.open_link()


@scenario
def a_second_program(bench):
    with bench.driving():
        with pytest.raises(BoardError, match="another program has the board: end it"):
            bench.open_link()
        bench.works()
    bench.open_link().close()


@scenario
def dates_of_the_firmware(bench):
    assert firmware_dates(bench.find()) == FirmwareDates("2026-01-01", "2026-01-02")
    with bench.driving():
        assert firmware_dates(bench.find()).compiled == "2026-01-01"
        bench.works()


@scenario
def the_led_that_shows_which_board_it_is(bench):
    for on in (True, False):
        assert identify_led(bench.find(), on=on)
        assert bench.board.led is on


@scenario
def a_bridge_that_refuses_what_it_is_asked(bench):
    bench.board.refuses = True
    assert firmware_dates(bench.find()) == FirmwareDates(NOT_REPORTED, NOT_REPORTED)
    assert not identify_led(bench.find(), on=True)
    bench.board.refuses = False


@scenario
def a_bridge_that_answers_nonsense(bench):
    for reply in (b"", b"\xff" * 5, bytes(32), b"\xff" * 32):
        bench.board.reply = reply
        assert firmware_dates(bench.find()) == FirmwareDates(NOT_REPORTED, NOT_REPORTED)
    bench.board.reply = None


def run_all(bench, scenarios):
    """Every scenario on one bench; what went wrong, by name."""
    results = {}
    for name, play in scenarios.items():
        try:
            play(bench)
        except Exception:  # noqa: BLE001  reported to the test
            results[name] = traceback.format_exc()
        else:
            results[name] = None
        if not bench.host.plugged:
            bench.plug_in_again()
    return results
