"""The whole driver over real libusb, plain and with queued transfers; the mock board behind an emulated device file."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from usbfs import UsbfsTree

from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.config import load_config
from inteco_abs.mock_board import Device, UsbBoard, UsbHost, UsbIdentity

HERE = Path(__file__).parent

pytestmark = [pytest.mark.xdist_group("real libusb"), pytest.mark.usefixtures("preload"), pytest.mark.untraced]


@pytest.fixture
def driven():
    """Lets the driver drive a mock board from another process with one engine; what it found, and the device."""

    def drive(engine):
        device = Device(load_config(), time.monotonic_ns, 1)
        board = UsbBoard(Usb2FrontEnd(device), UsbIdentity(serial=900_000_001))
        tree = UsbfsTree(UsbHost(board))
        paths = f"{HERE.parents[1]}{os.pathsep}{HERE}"
        try:
            child = subprocess.run(
                ["timeout", "-k", "5", "60", sys.executable, HERE / "driver_client.py", engine],
                env={**os.environ, "PYTHONPATH": paths, **tree.environment()},
                capture_output=True, text=True, check=False,
            )  # fmt: skip
        finally:
            tree.close()
        assert child.returncode == 0, child.stderr
        assert board.jtag_transfers == 0
        return json.loads(child.stdout), device

    return drive


@pytest.mark.parametrize(
    ("engine", "links"),
    [("one-by-one", {"UsbLink"}), ("queued", {"QueuedUsbLink"}), ("faster", {"UsbLink", "QueuedUsbLink"})],
)
def test_the_driver_turns_the_wheel_and_leaves_it_safe(driven, engine, links):
    found, device = driven(engine)
    assert found["link"] in links
    assert found["name"] == "ABSSIM"
    assert found["counts"] > 0
    assert found["stale"] < 50  # a busy computer may be late, and the driver goes on
    assert device.duties == (0.0, 0.0)
