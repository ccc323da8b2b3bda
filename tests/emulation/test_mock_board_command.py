import json
import os
import re
import signal
import subprocess
import sysconfig
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
import usb.core
from pyusb_backend import BusBackend
from usbip_client import UsbIpBus

from firmware_protocol.rtdac_usb import FRAME_BYTES, READ_REQUEST, decode_read, encode_send
from inteco_abs.boards.families.usb2 import RtdacUsb2
from inteco_abs.boards.transports.usb import UsbLink
from inteco_abs.config import load_config
from inteco_abs.signals import BoardFlags, Command

COMMAND = Path(sysconfig.get_path("scripts")) / "inteco-abs"


@contextmanager
def mock_board(*arguments):
    process = subprocess.Popen(
        [COMMAND, "mock-board", "--usbip", "127.0.0.1:0", "--serial", "900000007", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    try:
        yield process, [process.stdout.readline() for _ in range(3)]
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def served():
    with mock_board() as both:
        yield both


def test_it_says_what_it_is_and_how_to_attach_it_and_ends_at_control_c(served):
    process, (what, attach, detach) = served
    assert re.match(r"mock RT-DAC/USB2 04b4:8613, serial number 900000007, at 127\.0\.0\.1:\d+", what)
    assert re.match(r"to attach it, as root: modprobe vhci-hcd && usbip .*attach -r 127.0.0.1 -b 1-1", attach)
    assert "usbip detach" in detach
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=10)
    assert process.returncode == 0, stderr


def test_it_says_which_rig_is_drawn_for_it():
    with mock_board("--rig", "rough:3") as (_, (what, *_)):
        assert what.startswith("mock RT-DAC/USB2 with rig rough:3 04b4:8613, serial number 900000007, at ")


@pytest.mark.untraced
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


def test_first_generation_is_served_behind_its_ftdi_bridge_with_the_truth(tmp_path):
    truth = tmp_path / "truth.jsonl"
    with mock_board("--board", "usb", "--truth", truth) as (process, (what, *_)):
        assert re.match(r"mock RT-DAC/USB 0403:6001, serial number 900000007, at 127\.0\.0\.1:\d+", what)
        host, port = re.search(r"at (\S+):(\d+)", what).groups()
        bus = UsbIpBus((host, int(port)))
        device = usb.core.find(backend=BusBackend(bus))
        device.ctrl_transfer(0x40, 9, 1, 0)  # latency timer
        device.write(0x02, encode_send({"pin_mode": 0b11, "pwm0_width": 255}, logic=0x0111) + READ_REQUEST)
        data = b""
        while len(data) < FRAME_BYTES:
            data += bytes(device.read(0x81, 64))[2:]
        assert decode_read(data, logic=0x0111)["pwm0_width"] == 255
        end = time.monotonic() + 30.0
        while last_line(truth).get("road_speed_rad_s", 0.0) < 1.0:
            assert time.monotonic() < end
            time.sleep(0.05)
        bus.close()
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=10)
        assert process.returncode == 0, stderr
    assert last_line(truth)["drive"] == 1.0


def last_line(file):
    """The newest whole line of a file of JSON lines."""
    lines = file.read_text().rpartition("\n")[0].splitlines() if file.exists() else []
    return json.loads(lines[-1]) if lines else {}
