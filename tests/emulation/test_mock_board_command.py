import re
import signal
import subprocess
import sysconfig
import time
from pathlib import Path

import pytest
from pyusb_backend import BusBackend
from usbip_client import UsbIpBus

from inteco_abs.boards import RtdacUsb2
from inteco_abs.boards.usb import UsbLink
from inteco_abs.config import load_config
from inteco_abs.signals import BoardFlags, Command

COMMAND = Path(sysconfig.get_path("scripts")) / "inteco-abs"


@pytest.fixture
def served():
    process = subprocess.Popen(
        [COMMAND, "mock-board", "--usbip", "127.0.0.1:0", "--serial", "900000007"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={"PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    told = [process.stdout.readline() for _ in range(3)]
    yield process, told
    process.kill()
    process.communicate()


def test_it_says_what_it_is_and_how_to_attach_it_and_ends_at_control_c(served):
    process, (what, attach, detach) = served
    assert re.match(r"mock RT-DAC/USB2 04b4:8613, serial number 900000007, at 127\.0\.0\.1:\d+", what)
    assert re.match(r"to attach it, as root: modprobe vhci-hcd && usbip .*attach -r 127.0.0.1 -b 1-1", attach)
    assert "usbip detach" in detach
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=10)
    assert process.returncode == 0, stderr


def test_the_driver_runs_the_rig_in_it_over_usbip(served):
    _, (what, *_) = served
    host, port = re.search(r"at (\S+):(\d+)", what).groups()
    bus = UsbIpBus((host, int(port)))
    config = load_config()
    link = UsbLink("900000007", config.usb, BusBackend(bus))
    with RtdacUsb2(link, config.board, time.monotonic_ns, config.period_ns) as board:
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            sample = board.exchange(Command(1.0, 0.0))
        assert not sample.board_flags & BoardFlags.STALE
        assert sample.road_count > 100
    bus.close()
