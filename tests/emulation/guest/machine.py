"""A guest in QEMU, in virtual time: its root is the host's, read-only, and what it writes to /mnt lands in a folder.

Virtual time counts instructions, 1 ns each, and skips what the guest would sleep: timing hardly depends on the host's
load. That takes one CPU, a fixed shift, and everything that the guest waits for inside the guest. (With 2 ns each, the
simulated rig could not keep up while its wheels begin to turn.)
"""

import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from guest.kernel import PATH, output

NEEDED = {
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "cpio": "cpio",
    "modprobe": "kmod",
    "/lib/systemd/systemd-udevd": "udev",
}
MEMORY_MB = 1024
PATIENCE_S = 1200
_MODULES = "virtio_pci", "9pnet_virtio", "9p"
_ENDED = re.compile(r"^guest: the command ended with exit code (\d+)", re.MULTILINE)


def missing():
    """What to install before a guest can run; empty if nothing."""
    packages = [package for command, package in NEEDED.items() if shutil.which(command, path=PATH) is None]
    return f"apt-get install {' '.join(packages)}" if packages else ""


def run(kernel, script, results, devices=()):
    """Boot `kernel`, run the shell script in the guest's root; its exit code and all that the guest's console said.

    `devices` are more words for QEMU.
    """
    with tempfile.TemporaryDirectory() as scratch:
        initramfs = _initramfs(kernel, script, Path(scratch))
        command = [
            "qemu-system-x86_64",
            "-M", "q35", "-accel", "tcg", "-cpu", "max", "-smp", "1", "-m", str(MEMORY_MB),
            "-icount", "shift=0,sleep=off",
            "-nodefaults", "-no-user-config", "-no-reboot", "-display", "none", "-serial", "stdio", "-nic", "none",
            "-kernel", kernel.image, "-initrd", initramfs,
            "-append", "console=ttyS0 quiet panic=-1 mitigations=off tsc=reliable no_timer_check noautogroup",
            *_share("root", "/", "readonly=on,multidevs=remap"), *_share("results", results, ""),
            *devices,
        ]  # fmt: skip
        console = output_of(command, PATIENCE_S)
    found = _ENDED.search(console)
    return (int(found[1]) if found else None), console


def output_of(command, patience_s):
    """All that a command has written by its end, or in so many seconds; it never outlives this process."""
    alone = ["setpriv", "--pdeathsig", "KILL", "--", *command]  # no other process would end it if this one is killed
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    try:
        return subprocess.run(alone, **streams, timeout=patience_s, check=False).stdout.decode(errors="replace")
    except subprocess.TimeoutExpired as ended:
        return (ended.output or b"").decode(errors="replace")


def _share(tag, folder, more):
    options = f"local,id={tag},path={folder},security_model=none,{more}".rstrip(",")
    return "-fsdev", options, "-device", f"virtio-9p-pci,fsdev={tag},mount_tag={tag}"


def _initramfs(kernel, script, scratch):
    tree = scratch / "tree"
    for folder in ("bin", "modules", "proc", "sys", "dev", "host"):
        (tree / folder).mkdir(parents=True)
    shutil.copy(shutil.which("busybox"), tree / "bin/busybox")
    shutil.copy(Path(__file__).parent / "init", tree / "init")
    (tree / "init").chmod(0o755)
    (tree / "bin/sh").symlink_to("busybox")
    (tree / "command").write_text(script)
    files = kernel.modules(*_MODULES)
    for file in files:
        shutil.copy(file, tree / "modules")
    (tree / "modules/order").write_text("".join(f"{file.name}\n" for file in files))
    names = "\n".join(str(path.relative_to(tree)) for path in sorted(tree.rglob("*")))
    archive = output("cpio", "-o", "-H", "newc", "--quiet", cwd=tree, input=names.encode(), text=False)
    file = scratch / "initramfs"
    file.write_bytes(archive)
    return file
