"""In the guest: the RT-DAC/USB2, by real pyusb on real libusb on the real kernel. `python -m guest.usb2`."""

import subprocess
import sys
import traceback

import usb.core
from check_list import CHECKS, Bench
from guest import bus
from guest.scenario import SCRATCH, braking_stop, mock_board, prepare, save

from firmware_protocol.rtdac_usb2_bridge import VENDOR_ID
from inteco_abs.mock_board import UsbSpeed

RATE_HZ = 250
"""An exchange takes 1 ms of virtual time."""


def main():
    report = {"kernel": bus.kernel(), "checks": {}, "devices": {}}
    prepare(["inteco_abs.boards.transports.usb_async"])
    for speed in UsbSpeed:
        check_list(report, speed)
        save(report)
    with mock_board() as folder:
        report["devices"]["mock"] = bus.facts(folder)
        report["stop"] = braking_stop("usb2:", "sim_usb2", RATE_HZ)
        report["log"] = bus.kernel_log("usb 1-1")
    save(report)


def check_list(report, speed):
    """The list of every level, on the drill board."""
    name = speed.name.lower()
    path = SCRATCH / name
    with subprocess.Popen([sys.executable, "-m", "guest.drill_server", path, name]) as server:
        folder = bus.attach(path)
        device = report["devices"][name] = bus.facts(folder)
        bench = Bench(find(), find, speed.packet_bytes, keeps_partial_data=False, round_trips=1000)
        results = report["checks"][name] = {}
        for check, function in CHECKS.items():
            try:
                function(bench)
            except Exception:  # noqa: BLE001 - the test reports it
                results[check] = traceback.format_exc()
            else:
                results[check] = None
        device["round_trip_us"] = bench.figures
        server.terminate()


def find():
    return usb.core.find(idVendor=VENDOR_ID)


if __name__ == "__main__":
    main()
