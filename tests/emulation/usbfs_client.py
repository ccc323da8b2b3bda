"""The client of the emulated device file, in a process of its own: real pyusb on real libusb.

    python usbfs_client.py TASK PACKET_BYTES

Prints one JSON object: the task's results by name, null for what went well.
"""

import errno
import json
import sys
import threading
import time
import traceback

import pytest
import usb.core
import usb.util
from check_list import CHECKS, Bench, fails
from drill import Drill, eventually

from firmware_protocol.rtdac_usb2 import ENDPOINT_IN, ENDPOINT_OUT
from firmware_protocol.rtdac_usb2_bridge import VENDOR_ID


def find():
    return usb.core.find(idVendor=VENDOR_ID)


def blocked_read(device, seen):
    def read():
        try:
            seen.append(bytes(device.read(ENDPOINT_IN, 64, 20_000)))
        except usb.core.USBError as error:
            seen.append(error.errno)

    reader = threading.Thread(target=read)
    reader.start()
    time.sleep(0.2)
    assert not seen
    return reader


def read_while_another_thread_writes(bench):
    seen = []
    reader = blocked_read(bench.device, seen)
    bench.device.write(ENDPOINT_OUT, b"from another thread")
    reader.join(5)
    assert seen == [b"from another thread"]


def unplug_during_a_blocked_read(bench):
    seen = []
    reader = blocked_read(bench.device, seen)
    start = time.monotonic()
    with_error = None
    try:
        bench.drill(Drill.UNPLUG)
    except usb.core.USBError as error:
        with_error = error.errno
    reader.join(5)
    assert seen == [errno.ENODEV]
    assert with_error in {None, errno.ENODEV}
    assert time.monotonic() - start < 5, "it waited for its time-out"


def replug(bench):
    """The other side plugs the board in again as soon as it is gone."""
    before = bench.device.address
    try:
        bench.drill(Drill.UNPLUG)
    except usb.core.USBError as error:
        if error.errno != errno.ENODEV:
            raise
    usb.util.dispose_resources(bench.device)
    eventually(lambda: (found := find()) is not None and found.address == before + 1)
    bench.device = find()
    bench.device.set_configuration()
    assert bench.echo(b"back again") == b"back again"


def permission_denied(bench):
    assert fails(errno.EACCES, bench.device.set_configuration)
    with pytest.raises(ValueError, match="langid"):
        assert bench.device.product is None


def bound_driver(bench):
    device = bench.device
    assert device.is_kernel_driver_active(0)
    assert fails(errno.EBUSY, device.set_configuration)
    assert fails(errno.EBUSY, usb.util.claim_interface, device, 0)
    device.detach_kernel_driver(0)
    assert not device.is_kernel_driver_active(0)
    device.set_configuration()
    assert bench.echo(b"mine") == b"mine"
    usb.util.dispose_resources(device)
    device.attach_kernel_driver(0)
    assert device.is_kernel_driver_active(0)
    device.detach_kernel_driver(0)
    assert fails(errno.ENOENT, device.detach_kernel_driver, 0)


TASKS = {
    "check_list": CHECKS,
    **{
        task.__name__: {task.__name__: task}
        for task in (
            read_while_another_thread_writes,
            unplug_during_a_blocked_read,
            replug,
            permission_denied,
            bound_driver,
        )
    },
}


def main(task, packet_bytes, round_trips="200"):
    bench = Bench(find(), find, int(packet_bytes), round_trips=int(round_trips))
    results = {}
    for name, check in TASKS[task].items():
        try:
            check(bench)
        except Exception:  # noqa: BLE001 - the test reports it
            results[name] = traceback.format_exc()
        else:
            results[name] = None
    json.dump({"results": results, "figures": bench.figures}, sys.stdout)


main(*sys.argv[1:])
