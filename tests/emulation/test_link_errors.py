"""Each way in which a USB link may fail, over pyusb in process, over USB/IP and over real libusb with both engines."""

import functools
import json
import logging
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
import usb.core
from drill import new_host
from pyusb_backend import BusBackend
from trouble import SCENARIOS, SERIAL, Bench, halt_of
from usb_core import UsbCore
from usbfs import UsbfsTree
from usbip_client import UsbIpBus

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, READ_REQUEST
from inteco_abs.boards.families.usb2 import RtdacUsb2
from inteco_abs.boards.families.usb2.bridge import firmware_dates, identify_led
from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.boards.transports.usb import UsbLink
from inteco_abs.config import UsbConfig, load_config
from inteco_abs.control import build_pipeline
from inteco_abs.errors import BoardError, LinkError, UnsafeError
from inteco_abs.format import TICK, pack_tick
from inteco_abs.mock_board import Device, UsbBoard, UsbHost, UsbSpeed
from inteco_abs.realtime import Loop, StopFlag, TickRing, VirtualClock
from inteco_abs.realtime.loop import detail_of
from inteco_abs.signals import BoardFlags, Reason

HERE = Path(__file__).parent
ENGINES = ("one-by-one", "queued")
ONLY_THERE = ("interrupted_in_mid_exchange", "unplugged_while_it_is_opened")
real_libusb = pytest.mark.xdist_group("real libusb")


@pytest.fixture
def in_process(speed):
    bench = Bench(speed)
    bench.backend = BusBackend(bench.host, bench.clock.wait)
    return reached_by(bench)


@pytest.fixture
def over_usbip(speed, serve):
    bench = Bench(speed)
    with serve(bench.host) as (_, address):
        bus = UsbIpBus(address)
        bench.backend = BusBackend(bus)
        yield reached_by(bench, timeout_ms=400)  # a busy computer must not make an answer late
        bus.close()


def reached_by(bench, **timeout):
    bench.open_link = lambda: UsbLink("", bench.config.usb, bench.backend, **timeout)
    bench.find = lambda: usb.core.find(backend=bench.backend)
    return bench


@pytest.mark.parametrize("name", SCENARIOS)
def test_over_pyusb_in_process(in_process, name):
    SCENARIOS[name](in_process)
    assert in_process.board.jtag_transfers == 0


@pytest.mark.parametrize("speed", [UsbSpeed.HIGH], ids=["high"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_over_usbip(over_usbip, name):
    SCENARIOS[name](over_usbip)
    assert over_usbip.board.jtag_transfers == 0


def client(engine, task, environment, prefix=()):
    """What a process with real libusb found, by scenario, and its stderr."""
    paths = f"{HERE.parents[1]}{os.pathsep}{HERE}"
    child = subprocess.run(
        [*prefix, "timeout", "-k", "5", "100", sys.executable, HERE / "trouble_client.py", engine, task],
        env={**os.environ, "PYTHONPATH": paths, **environment}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert child.returncode == 0, child.stderr
    return json.loads(child.stdout), child.stderr


@functools.cache
def all_of(engine, task="all"):
    with tempfile.TemporaryDirectory() as empty:  # until the client has a tree of its own
        return client(engine, task, {"LD_PRELOAD": "libumockdev-preload.so.0", "UMOCKDEV_DIR": empty})


@real_libusb
@pytest.mark.usefixtures("preload")
@pytest.mark.parametrize("engine", ["queued", "one-by-one"])
@pytest.mark.parametrize("name", [*SCENARIOS, *ONLY_THERE, "jtag"])
@pytest.mark.long
def test_over_real_libusb(engine, name):
    failure = all_of(engine)[0][name]
    assert failure is None, failure


@real_libusb
@pytest.mark.usefixtures("preload")
@pytest.mark.parametrize("engine", ENGINES)
def test_over_real_libusb_a_kernel_driver_is_detached_and_the_user_is_informed(engine):
    _, stderr = all_of(engine, "bound")
    assert "a kernel driver held the board and was detached" in stderr


@real_libusb
@pytest.mark.usefixtures("preload")
@pytest.mark.parametrize("engine", ENGINES)
def test_over_real_libusb_missing_permission_is_reported_with_the_udev_rule(engine):
    # root has to give up its rights to be refused anything
    prefix = ("setpriv", "--inh-caps=-all", "--bounding-set=-all") if os.geteuid() == 0 else ()
    tree = UsbfsTree(new_host(UsbSpeed.HIGH, drill=False), mode=0)
    try:
        assert client(engine, "denied", tree.environment(), prefix)[0] == {"denied": None}
    finally:
        tree.close()


def test_missing_permission_is_reported_with_the_udev_rule(in_process):
    in_process.backend.permitted = False
    with pytest.raises(BoardError, match=r"no board that may be opened.*doctor --rules prints the udev rule"):
        in_process.open_link()


def test_a_kernel_driver_is_detached_and_the_log_says_so_once(in_process, caplog):
    in_process.backend.driver = "usbtest"
    with caplog.at_level(logging.WARNING), in_process.driving():
        assert "a kernel driver held the board and was detached" in caplog.text
    caplog.clear()
    in_process.open_link().close()
    assert not caplog.text


class TwoBoards(BusBackend):
    """A computer with two boards."""

    def __init__(self, *benches):
        super().__init__(benches[0].host)
        self._cores = [UsbCore(bench.host) for bench in benches]

    def enumerate_devices(self):
        return iter(self._cores)


class Run:
    """A stop in virtual time over a USB link."""

    def __init__(self):
        self.config = load_config(settings=["experiment.start_speed_rad_s=40.0", "guard.missed_in_a_row=4"])
        self.clock = VirtualClock(self.config.period_ns)
        self.device = Device(self.config, self.clock.now_ns)
        self.host = UsbHost(UsbBoard(Usb2FrontEnd(self.device)))
        link = UsbLink("", self.config.usb, BusBackend(self.host))
        self.board = RtdacUsb2(link, self.config.board, self.clock.now_ns, self.config.period_ns)
        self.pipeline = build_pipeline(self.config)
        self.ring = TickRing(pack_tick, TICK.size, 10_000)
        self.loop = Loop(self.board, self.pipeline, self.clock, self.ring, StopFlag())


def test_a_run_that_loses_its_board_ends_and_says_that_motor_power_may_be_on():
    run = Run()

    def lose_the_board():
        with run.board:
            assert not run.loop.run(800)
            run.host.unplug()
            assert run.loop.run(20)

    with pytest.raises(UnsafeError, match="MOTOR POWER MAY STILL BE ON"):
        lose_the_board()
    assert run.pipeline.reason is Reason.MISSED_EXCHANGES
    assert detail_of(run.pipeline, run.board) == "the board is gone: check cable and power"


def test_a_run_with_a_stall_now_and_then_goes_through():
    run = Run()
    with run.board:
        over = False
        while not over:
            run.host.submit(halt_of(ENDPOINT_IN))
            over = run.loop.run(1000)
    ticks = TICK.array(run.ring.reader().take())
    stale = ticks["tick"][ticks["board_flags"] & BoardFlags.STALE != 0].tolist()
    assert stale == list(range(0, len(ticks), 1000))
    assert len(stale) > 2
    assert run.pipeline.reason is Reason.NONE
    assert run.device.duties == (0.0, 0.0)


def test_of_two_boards_one_must_be_named(in_process):
    in_process.backend = TwoBoards(in_process, Bench(serial=SERIAL + 1))
    with pytest.raises(BoardError, match=rf"2 boards: name one, as in usb2:{SERIAL}. Seen: .*{SERIAL}.*{SERIAL + 1}"):
        in_process.open_link()
    UsbLink(str(SERIAL + 1), UsbConfig(), in_process.backend).close()


def test_without_libusb_the_error_says_what_to_install(monkeypatch):
    def find(**_):
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb.core, "find", find)
    with pytest.raises(BoardError, match=r"no libusb on this computer: install libusb-1\.0-0"):
        UsbLink("", UsbConfig())


class StubbornBackend(BusBackend):
    """A kernel that refuses to detach its drivers."""

    def detach_kernel_driver(self, *_):
        raise usb.core.USBError("Access denied", -3, 13)


def test_a_kernel_driver_that_cannot_be_detached_is_reported_with_what_to_do(in_process):
    in_process.backend = StubbornBackend(in_process.host)
    in_process.backend.driver = "usbtest"
    with pytest.raises(BoardError, match=r"cannot be detached \(no permission.*lsusb -t.*modprobe -r"):
        in_process.open_link()


class ForeignBackend(BusBackend):
    """A system whose libusb knows no kernel drivers."""

    def is_kernel_driver_active(self, *_):
        raise NotImplementedError


def test_a_system_without_kernel_drivers_needs_none_detached(in_process):
    in_process.backend = ForeignBackend(in_process.host)
    with in_process.driving():
        in_process.works()


def test_a_bridge_that_is_gone_is_an_error_and_not_a_date(in_process):
    device = in_process.find()
    in_process.host.unplug()
    with pytest.raises(LinkError, match="the board is gone: check cable and power"):
        firmware_dates(device)
    with pytest.raises(LinkError, match="the board is gone: check cable and power"):
        identify_led(device, on=True)


def test_a_board_that_may_not_be_opened_gives_no_dates(in_process):
    in_process.backend.permitted = False
    with pytest.raises(LinkError, match=r"no permission: .*udev rule"):
        firmware_dates(in_process.find())


def test_a_transfer_that_is_taken_in_part_is_an_error(in_process, monkeypatch):
    link = in_process.open_link()
    monkeypatch.setattr(in_process.backend, "bulk_write", lambda *_: 64)
    with pytest.raises(LinkError, match="the board took 64 of 504 bytes"):
        link.write(bytes(504))
    link.close()


def test_an_answer_longer_than_requested_is_an_error(in_process):
    link = in_process.open_link()
    link.write(READ_REQUEST)
    with pytest.raises(LinkError, match="sent more than requested"):
        link.read(100)
    link.close()


def test_an_error_without_a_text_of_its_own_is_reported_in_libusbs(in_process, monkeypatch):
    def fail(*_):
        raise usb.core.USBError("Other error", -99, None)

    link = in_process.open_link()
    monkeypatch.setattr(in_process.backend, "bulk_read", fail)
    with pytest.raises(LinkError, match=r"the transfer failed: .*Other error"):
        link.read(504)
    link.close()


def test_ids_of_other_boards_are_left_alone(in_process):
    in_process.backend.driver = "usbtest"
    with pytest.raises(BoardError, match="is it plugged in"):
        UsbLink("", UsbConfig(manufacturer="Somebody"), in_process.backend)
    (core,) = in_process.backend.enumerate_devices()
    assert core.driver == "usbtest"
