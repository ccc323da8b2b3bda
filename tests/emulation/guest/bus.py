"""In the guest: devices from a USB/IP server on a Unix socket, plugged into the kernel, and what it made of them.

The steps are those of docs/facts/usb.md#attaching-over-usbip.
"""

import importlib
import os
import struct
import subprocess
import time
from pathlib import Path

from usbip_client import IMPORT, RECORD_BYTES, connect, receive

VHCI = Path("/sys/devices/platform/vhci_hcd.0")
DEVICES = Path("/sys/bus/usb/devices")
FACTS = ("idVendor", "idProduct", "manufacturer", "product", "serial", "speed", "bNumInterfaces", "bMaxPower")
_HUB = "hs"  # of low, full and high speed
_FREE = 4
_RULES = Path("/run/udev/rules.d")
_PATIENCE_S = 600.0
"""Virtual time: it passes quickly while the guest waits for files of the host, and when nothing happens at all."""


def load(*modules):
    """Load kernel modules by name, from the unpacked kernel."""
    subprocess.run(["modprobe", "-d", os.environ["KERNEL_FOLDER"], "-a", *modules], check=True)


def start_udev(rules):
    """Debian's udev with the product's rules: it sets permissions and reports plugged devices to libusb."""
    _RULES.mkdir(parents=True)
    (_RULES / "70-inteco-abs.rules").write_text(rules)
    subprocess.run(["/lib/systemd/systemd-udevd", "--daemon", "--resolve-names=early"], check=True)


def eventually(condition, what):
    """What `condition` gives as soon as it is true."""
    deadline = time.monotonic() + _PATIENCE_S
    while not (found := condition()):
        if time.monotonic() > deadline:
            raise TimeoutError(f"not within {_PATIENCE_S:g} s: {what}")
        time.sleep(0.01)
    return found


def attach(path, bus_id=b"1-1"):
    """Plug in what the server at `path` offers; the device's folder in sysfs, once it is configured."""
    eventually(path.exists, f"a server at {path}")
    before = set(DEVICES.iterdir())
    stream = connect(path)
    stream.sendall(IMPORT + bus_id.ljust(32, b"\0"))
    if receive(stream, 8)[4:] != bytes(4):
        raise ConnectionRefusedError(f"the server at {path} refused the import of {bus_id.decode()}")
    bus, device, speed = struct.unpack_from(">III", receive(stream, RECORD_BYTES), 288)
    stream.settimeout(None)
    port = _free_port()
    (VHCI / "attach").write_text(f"{port} {stream.fileno()} {bus << 16 | device} {speed}")
    stream.close()  # the kernel has its own hold of it
    interface = eventually(lambda: [new.name for new in _new(before) if ":" in new.name], "an interface in sysfs")[0]
    return DEVICES / interface.partition(":")[0]


def favour(server):
    """Let the process that serves the board, and the kernel's threads that carry it, come before ordinary programs:
    they stand for hardware, which waits for no processor. As real-time processes they would take too much: while the
    loop measures the board without a pause, no other process would run on the only CPU.
    """
    names = {path.parent.name: path.read_text().strip() for path in Path("/proc").glob("[0-9]*/comm")}
    for pid in (server.pid, *(int(pid) for pid, name in names.items() if name in {"vhci_rx", "vhci_tx"})):
        os.sched_setscheduler(pid, os.SCHED_OTHER, os.sched_param(0))
        os.setpriority(os.PRIO_PROCESS, pid, -20)


def keep_in_memory(modules):
    """Import `modules` and read every file that they map: later no process waits for the host, which would make virtual
    time jump.
    """
    for module in modules:
        importlib.import_module(module)
    mapped = {line.split(maxsplit=5)[-1].strip() for line in Path("/proc/self/maps").read_text().splitlines()}
    for file in sorted(mapped):
        if file.startswith("/") and Path(file).is_file():
            Path(file).read_bytes()


def facts(folder):
    """What `lsusb` would say of the device, from sysfs; and who may use its node once udev has been there."""
    subprocess.run(["udevadm", "settle"], check=True, env={**os.environ, "SYSTEMD_IGNORE_CHROOT": "1"})
    found = {name: (folder / name).read_text().strip() for name in FACTS}
    interface = DEVICES / f"{folder.name}:1.0"
    found["endpoints"] = sorted(path.name.removeprefix("ep_") for path in interface.glob("ep_*"))
    driver = interface / "driver"
    found["driver"] = driver.resolve().name if driver.exists() else ""
    node = Path("/dev/bus/usb") / "/".join(f"{int((folder / name).read_text()):03d}" for name in ("busnum", "devnum"))
    status = node.stat()
    found["node"] = str(node)
    found["group"], found["mode"] = node.group(), f"{status.st_mode & 0o777:04o}"
    found["power_control"] = (folder / "power/control").read_text().strip()
    return found


def kernel():
    """The kernel's name, version and build."""
    return _said("uname", "-a").strip()


def kernel_log(word):
    """Lines of the kernel's log with this word, from the first on."""
    return [line for line in _said("dmesg").splitlines() if word in line]


def _said(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def _new(before):
    return set(DEVICES.iterdir()) - before


def _free_port():
    lines = (VHCI / "status").read_text().splitlines()[1:]
    for hub, port, state, *_ in map(str.split, lines):
        if hub == _HUB and int(state) == _FREE:
            return int(port)
    raise OSError(f"no free port: {lines}")
