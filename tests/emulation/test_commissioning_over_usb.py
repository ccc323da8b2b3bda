"""Commissioning's reading steps as on a real board: kernel's list, libusb, vendor requests; the mock at the far end."""

import json
import os
import subprocess
import sysconfig
from pathlib import Path

import pytest
from drill import new_host
from usbfs import UsbfsTree

from inteco_abs.boards.families.usb2.bridge import bridge_facts
from inteco_abs.errors import LinkError
from inteco_abs.mock_board import UsbSpeed
from inteco_abs.wire.capture import read_capture

COMMAND = Path(sysconfig.get_path("scripts")) / "inteco-abs"
WORDS = ("--yes-read-only", "--draft", "lab.toml", "--json")
DESCRIPTION = {
    "idVendor": "04b4",
    "idProduct": "8613",
    "manufacturer": "InTeCo",
    "product": "RT-DAC/USB2",
    "serial": "77",
}


@pytest.mark.untraced
@pytest.mark.usefixtures("preload")
@pytest.mark.xdist_group("real libusb")
@pytest.mark.long
def test_a_board_on_the_bus_is_listed_read_and_timed_and_nothing_is_written_to_it(tmp_path):
    host = new_host(UsbSpeed.HIGH, drill=False)
    tree = UsbfsTree(host)
    for name, text in DESCRIPTION.items():
        (tree.path / "sys/devices/usb1/1-1" / name).write_text(f"{text}\n")
    environment = {key: value for key, value in os.environ.items() if not key.startswith("COV")}

    def commission(step, *more):
        return subprocess.run(
            [COMMAND, "commission", "--board", "usb2:", *WORDS, "--step", step, *more],
            cwd=tmp_path,
            env=environment | tree.environment(),
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )

    try:
        first, second, third = (
            commission("list"),
            commission("header"),
            commission("reads", "--send-report", "board.jsonl"),
        )
    finally:
        tree.close()
    assert first.returncode == second.returncode == 0, first.stderr + second.stderr
    listed, header, *_ = json.loads(second.stdout)["steps"]
    assert [one["address"] for one in listed["devices"]] == ["usb2:77"]
    assert header["application_name"] == "ABSSIM"
    assert header["bridge"]["ids"] == "04b4:8613"
    assert header["bridge"]["firmware_compiled"] == "2026-01-01"
    assert header["bridge"]["firmware_released"] == "2026-01-02"
    reads = json.loads(third.stdout)["steps"][2]
    # a busy computer may be too slow for any rate, and then it says so
    assert reads["outcome"] == "done" or "too slow for any rate" in reads["problem"]
    assert host.device.front_end.device.settings == {}
    report = read_capture(tmp_path / "board.jsonl").report
    assert bytes.fromhex(report.bus.descriptors) == b"".join(
        host.device.identity.descriptor(kind, 0) for kind in (1, 2)
    )
    assert (report.bus.manufacturer, report.bus.product, report.bus.serial_form) == ("InTeCo", "RT-DAC/USB2", "99")
    assert report.identity.firmware_compiled == "2026-01-01"
    assert str(tmp_path) not in (tmp_path / "board.jsonl").read_text()


def test_a_bridge_in_trouble_is_not_a_reason_to_stop(real_board, monkeypatch):
    device, _ = real_board

    def fail(_device):
        raise LinkError("the bus failed")

    monkeypatch.setattr("inteco_abs.boards.families.usb2.bridge.firmware_dates", fail)
    assert bridge_facts(device)["firmware_compiled"] == "not reported: the bus failed"
