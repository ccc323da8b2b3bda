"""In the guest: two of QEMU's PCI functions in the place of the RT-DAC4/PCI, by the kernel's own files for them.

`ivshmem-plain` has memory at base address register 2, the host's own file, and `megasas` has 256 I/O ports there, as
the board is assumed to have. Neither can be given the board's ids: the kernel's files with them are covered by files
with the board's, for the driver, udev and everybody else who asks for them by name. `python -m guest.pci`
"""

import json
import os
import subprocess
import time
import traceback
from grp import getgrnam
from pathlib import Path

from guest import bus
from guest.scenario import SCRATCH, abs_command, save

from firmware_protocol.rtdac_pci import DEVICE_ID, LOGIC, LOGIC_VERSION, VENDOR_ID
from inteco_abs.boards import open_board
from inteco_abs.boards.transports.sysfs import SysfsRegisters
from inteco_abs.config import load_config
from inteco_abs.errors import AbsError
from inteco_abs.signals import Command

FOLDERS = Path("/sys/bus/pci/devices")
STAND_INS = {("0x1af4", "0x1110"): "memory", ("0x1000", "0x0060"): "ports"}
"""By vendor and device id."""
PROFILE = "pci_abs_50f"
SIGNATURE = ('board.verified_by="the test"', "board.verified_on=2026-01-01", f"board.verified_logic={LOGIC_VERSION}")
UNSIGNED, SIGNED = load_config(profile=PROFILE), load_config(settings=SIGNATURE, profile=PROFILE)
NOBODY = 65534
MASK_OFFSET = 0x34
"""Interrupt mask of megasas: a register that keeps what is written."""
PATTERN = 0x5A


def main():
    report = {"kernel": bus.kernel()}
    subprocess.run(["mount", "-t", "securityfs", "securityfs", "/sys/kernel/security"], check=True)
    boards = disguise()
    report["off"] = {what: refusal(SysfsRegisters, address) for what, address in boards.items()}
    bus.start_udev(abs_command("doctor", "--rules")[1])
    udevadm("trigger", "--action=add", "--subsystem-match=pci")
    udevadm("settle")
    report["files"] = {what: files(FOLDERS / address) for what, address in boards.items()}
    report["which"] = refusal(SysfsRegisters, "")
    memory, ports = boards["memory"], boards["ports"]
    dialout = getgrnam("dialout").gr_gid
    report["logic"] = as_user([dialout], lambda: read(memory, LOGIC.offset))
    report["mask"] = as_user([dialout], lambda: written(ports, MASK_OFFSET, PATTERN))
    report["stranger"] = {what: as_user([], lambda a=address: read(a, 0)) for what, address in boards.items()}
    report["taken"] = second(memory)
    report["driver"] = as_user([dialout], lambda: driven(f"pci:{memory}"))
    save(report)
    Path("/sys/kernel/security/lockdown").write_text("integrity")
    report["locked"] = {
        "memory": refusal(SysfsRegisters, memory),
        "ports": refusal(lambda: written(ports, MASK_OFFSET, PATTERN)),
    }
    report["log"] = bus.kernel_log("Lockdown")
    save(report)


def disguise():
    """Addresses of the stand-ins, once they have the board's ids."""
    found = {}
    for folder in sorted(FOLDERS.iterdir()):
        what = STAND_INS.get(tuple((folder / name).read_text().strip() for name in ("vendor", "device")))
        if what is None:
            continue
        found[what] = folder.name
        for name, number in (("vendor", VENDOR_ID), ("device", DEVICE_ID)):
            cover = SCRATCH / f"{folder.name}.{name}"
            cover.write_text(f"0x{number:04x}\n")
            subprocess.run(["mount", "--bind", cover, (folder / name).resolve()], check=True)
    return found


def udevadm(*words):
    subprocess.run(["udevadm", *words], check=True, env={**os.environ, "SYSTEMD_IGNORE_CHROOT": "1"})


def files(folder):
    """What udev has made of the function's files, and what kind of range its registers are."""
    registers = folder / "resource2"
    first, last, flags = ((folder / "resource").read_text().splitlines()[2]).split()
    return {
        "enable": (folder / "enable").read_text().strip(),
        "group": registers.group(),
        "mode": f"{registers.stat().st_mode & 0o777:04o}",
        "bytes": int(last, 16) - int(first, 16) + 1,
        "flags": int(flags, 16),
    }


def refusal(work, *arguments):
    """What is said when it is refused; empty if it is not."""
    try:
        work(*arguments)
    except AbsError as error:
        return str(error)
    return ""


def as_user(groups, work):
    """What `work` gives to an ordinary user in these groups, or what it was refused with."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        os.setgroups(groups)
        os.setgid(NOBODY)
        os.setuid(NOBODY)
        try:
            found = work()
        except AbsError as error:
            found = str(error)
        except Exception:  # noqa: BLE001 - the test reports it
            found = traceback.format_exc()
        os.write(writer, json.dumps(found).encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as source:
        found = json.loads(source.read() or b"null")
    os.waitpid(child, 0)
    return found


def read(address, offset):
    registers = SysfsRegisters(address)
    try:
        return registers.read(offset)
    finally:
        registers.close()


def written(address, offset, value):
    """What the register reads after `value` was written to it."""
    registers = SysfsRegisters(address)
    try:
        registers.write(offset, value)
        return registers.read(offset)
    finally:
        registers.close()


def second(address):
    """What a second program is source."""
    registers = SysfsRegisters(address)
    try:
        return as_user([getgrnam("dialout").gr_gid], lambda: read(address, 0))
    finally:
        registers.close()


def driven(address):
    """What the driver finds and does. Memory has no channels to be selected: both widths stay zero."""
    with open_board(address, UNSIGNED, time.monotonic_ns).reading() as board:
        identity = str(board.identity)
    with open_board(address, SIGNED, time.monotonic_ns) as board:
        board.require_writable()
        flags = [int(board.exchange(Command.SAFE).board_flags) for _ in range(10)]
    return {"identity": identity, "flags": flags}


if __name__ == "__main__":
    main()
