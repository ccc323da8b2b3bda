"""Takes from this process what a submission must not have: other files and processes, the network, endless time.

Linux does it by Landlock (from 5.13 on), which needs no rights, and holds for root, too. Elsewhere only limits of
time and memory hold, and on Windows nothing: `confine` returns what does.
"""

from __future__ import annotations

import ctypes
import os
import signal
import struct
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

from inteco_abs.errors import BoardError
from inteco_abs.posix import resource

FILES: Final = "files"
MEMORY: Final = "memory of other processes"
NETWORK: Final = "network"
SIGNALS: Final = "signals"
RESOURCES: Final = "time and memory"
SECRETS: Final = (FILES, MEMORY)
"""What must hold for a grade: without these the truth can be read."""

_MEMORY_BYTES: Final = 4 << 30
_OPEN_FILES: Final = 64

_PR_SET_PDEATHSIG: Final = 1
_PR_SET_NO_NEW_PRIVS: Final = 38
_CLONE_NEWUSER: Final = 0x1000_0000
_CLONE_NEWNET: Final = 0x4000_0000

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_VERSION: Final = 1
_PATH_BENEATH: Final = 1
_EXECUTE, _READ_FILE, _READ_DIR = 1 << 0, 1 << 2, 1 << 3
_FILE_RIGHTS: Final = ((1, 13), (2, 14), (3, 15), (5, 16))
"""Version of Landlock, and the number of rights over files that it knows."""
_NETWORK_SINCE: Final = 4
_SCOPES_SINCE: Final = 6
_BIND_AND_CONNECT: Final = 3
_ABSTRACT_SOCKETS_AND_SIGNALS: Final = 3
_SYSTEM: Final = ("/usr", "/lib", "/lib64", "/bin", "/etc/ld.so.cache", "/etc/localtime", "/dev/null", "/dev/urandom")

_PACKAGES: Final = ("site-packages", "dist-packages")
"""Names of folders of installed packages, which a user may have outside of Python's."""


def confine(cpu_s: int) -> list[str]:
    """Confine this process, for good, and end it after `cpu_s` of computing; return what holds.

    Call it before anything starts a thread. Modules that are imported later must be below Python's own folders.
    """
    held = []
    with suppress(OSError, ValueError, BoardError):
        _limit(cpu_s)
        held.append(RESOURCES)
    if sys.platform == "linux":
        with suppress(OSError):
            held += _landlock(_without_network())
    return held


def _limit(cpu_s: int) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 1))
    for kind, most in (
        (resource.RLIMIT_AS, _MEMORY_BYTES),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_NPROC, 0),
        (resource.RLIMIT_NOFILE, _OPEN_FILES),
    ):
        resource.setrlimit(kind, (most, most))


def _without_network() -> bool:
    """Move into a network of its own, which has none; whether the system allows that."""
    with suppress(OSError):
        _called(_libc().unshare(_CLONE_NEWUSER | _CLONE_NEWNET))
        return True
    return False


def _landlock(offline: bool) -> Iterator[str]:
    """Keep it to reading Python's own files. Raises OSError where the kernel has no Landlock."""
    _called(_libc().prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0))
    _called(_libc().prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0))
    version = _called(_libc().syscall(_CREATE_RULESET, None, 0, _VERSION))
    rights = next(count for since, count in reversed(_FILE_RIGHTS) if version >= since)
    rules = [(1 << rights) - 1]
    if version >= _NETWORK_SINCE:
        rules.append(_BIND_AND_CONNECT)
    if version >= _SCOPES_SINCE:
        rules.append(_ABSTRACT_SOCKETS_AND_SIGNALS)
    attributes = struct.pack(f"={len(rules)}Q", *rules)
    ruleset = _called(_libc().syscall(_CREATE_RULESET, attributes, len(attributes), 0))
    for path in _readable():
        place = os.open(path, os.O_PATH | os.O_CLOEXEC)
        allowed = _EXECUTE | _READ_FILE | (_READ_DIR if path.is_dir() else 0)
        _called(_libc().syscall(_ADD_RULE, ruleset, _PATH_BENEATH, struct.pack("=Qi", allowed, place), 0))
        os.close(place)
    _called(_libc().syscall(_RESTRICT_SELF, ruleset, 0))
    os.close(ruleset)
    yield FILES
    yield MEMORY  # a process can trace, and read by /proc, those in its own domain only
    if offline or version >= _NETWORK_SINCE:
        yield NETWORK
    if version >= _SCOPES_SINCE:
        yield SIGNALS


def _readable() -> Iterator[Path]:
    """What Python needs: itself, the system's libraries, and this package without what stands beside it in a tree."""
    package = Path(__file__).resolve().parents[1]
    installed = (place for place in sys.path if Path(place).name in _PACKAGES)
    for place in dict.fromkeys((*_SYSTEM, sys.prefix, sys.base_prefix, *installed, str(package))):
        if Path(place).exists():
            yield Path(place)


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _called(result: int) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result
