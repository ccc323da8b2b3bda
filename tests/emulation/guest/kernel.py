"""Debian's kernels for a guest: downloaded and unpacked into the user's cache, never installed."""

import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "inteco-abs" / "kernels"
PATH = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
"""Where ordinary users find modprobe and depmod, too."""
META_PACKAGES = {"stock": "linux-image-amd64", "rt": "linux-image-rt-amd64"}
WANTED = (
    "boot/vmlinuz-*",
    "lib/modules/*/modules.*",
    *(f"lib/modules/*/kernel/{folder}/*" for folder in ("drivers/virtio", "drivers/usb", "net/9p", "fs/9p")),
    *(f"lib/modules/*/kernel/{folder}/*" for folder in ("fs/netfs", "fs/fscache")),
)
"""What a guest needs of 400 MB."""


class MissingError(Exception):
    """Something that this computer would need for a guest."""


@dataclass(frozen=True)
class Kernel:
    """A kernel and its modules, unpacked into `folder`."""

    folder: Path

    @property
    def release(self):
        return next((self.folder / "lib/modules").iterdir()).name

    @property
    def image(self):
        return self.folder / f"boot/vmlinuz-{self.release}"

    def modules(self, *names):
        """Files of these modules and of all that they need, in the order in which they must be loaded."""
        files = []
        for name in names:
            listed = output("modprobe", "-d", self.folder, "-S", self.release, "--show-depends", name)
            files += [Path(line.split()[1]) for line in listed.splitlines() if line.startswith("insmod")]
        return list(dict.fromkeys(files))


def fetch(kind):
    """The kernel that Debian's meta package stands for now, from the cache or else from the mirror."""
    package = _package(META_PACKAGES[kind])
    folder = CACHE / package
    if not folder.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=CACHE) as scratch:
            shutil.move(_unpack(package, Path(scratch)), folder)
    return Kernel(folder)


def _package(meta):
    depends = output("apt-cache", "depends", meta)
    found = re.search(r"Depends: (linux-image-\S+)", depends)
    if not found:
        raise MissingError(f"apt knows no package {meta}: run apt-get update; the guests need Debian's kernels")
    return found[1]


def _unpack(package, scratch):
    output("apt-get", "download", package, cwd=scratch)
    (deb,) = scratch.glob("*.deb")
    folder = scratch / "unpacked"
    folder.mkdir()
    archive = output("dpkg-deb", "--fsys-tarfile", deb, text=False)
    output("tar", "-x", "-C", folder, "--wildcards", *(f"./{name}" for name in WANTED), input=archive, text=False)
    (release,) = (folder / "lib/modules").iterdir()
    output("depmod", "-b", folder, release.name)
    return folder


def output(*command, text=True, **options):
    """What the command prints; raises MissingError if it is not there or fails."""
    try:
        return subprocess.run(
            list(map(str, command)),
            check=True,
            capture_output=True,
            text=text,
            env={**os.environ, "PATH": PATH},
            **options,
        ).stdout
    except FileNotFoundError as error:
        raise MissingError(f"no command {command[0]} on this computer") from error
    except subprocess.CalledProcessError as error:
        raise MissingError(f"{' '.join(map(str, command[:2]))}: {error.stderr}") from error
