"""What a process asks of the machine to be punctual. Every setting may be refused, and each refusal says why.

Ranked and measured in docs/facts/real-time.md#techniques; values follow LinuxCNC's and Klipper's practice.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import struct
import sys
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

LOOP_PRIORITY: Final = 80
CONTROLLER_PRIORITY: Final = LOOP_PRIORITY - 1
"""Of a user's controller in its own process: nothing else is to delay its answer, and it never delays the loop."""
GUARDIAN_PRIORITY: Final = 90
"""Of those who end a loop that hangs: above the loop's, as it may spin on the only CPU that there is."""
WATCH_PRIORITY: Final = 85
"""Of the thread in which the supervisor watches both."""
BOARD_PRIORITY: Final = 60
"""Of the mock board's process."""

_MCL_CURRENT, _MCL_FUTURE = 1, 2
_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4
_PR_SET_PDEATHSIG, _PR_SET_TIMERSLACK = 1, 29
_CPUS: Final = Path("/sys/devices/system/cpu")
_ISOLATED: Final = _CPUS / "isolated"
_CPU_LATENCY: Final = Path("/dev/cpu_dma_latency")
_OOM: Final = Path("/proc/self/oom_score_adj")
_NEVER_KILL: Final = "-1000"
_LARGEST_SMALL: Final = 400
_ARENA_BYTES: Final = 1 << 20
_RESERVE_BYTES: Final = 8 << 20
_UNKNOWN: Final[dict[int, Any]] = {}
_KEPT: Final[list[bytes]] = []
"""Keeps the reserve from being given back."""


class Setting(NamedTuple):
    """One setting: what is in force now, or why it was refused and what to do about it."""

    name: str
    value: str
    refused: str = ""


class Tuning(NamedTuple):
    """How one thing is asked for: `ask` gives the value in force or raises OSError; `fix` goes with a refusal."""

    name: str
    ask: Callable[[], str]
    fix: str


class Core(NamedTuple):
    """What the kernel tells of one CPU."""

    speed: int = 0
    """Its highest clock in kHz, or where the kernel tells none its capacity; 0: not known."""
    siblings: frozenset[int] = frozenset()
    """CPUs that share its core: hyper-threads, itself among them."""


def loop_cpus(allowed: Collection[int], isolated: Collection[int], cores: Mapping[int, Core] = _UNKNOWN) -> set[int]:
    """CPU for the loop alone: an isolated one if there is any; none on a machine with a single CPU.

    Of several isolated ones, one whose hyper-threads are isolated as well; then the fastest, then the last. The kernel
    leaves isolated CPUs out of what a process may use by itself, and lets it move there all the same.
    """
    candidates = set(isolated) or (set(allowed) if len(allowed) > 1 else set())

    def worth(cpu: int) -> tuple[bool, int, int]:
        core = cores.get(cpu, Core())
        return not isolated or core.siblings <= {cpu, *isolated}, core.speed, cpu

    return {max(candidates, key=worth)} if candidates else set()


def other_cpus(allowed: Collection[int], isolated: Collection[int], cores: Mapping[int, Core] = _UNKNOWN) -> set[int]:
    """CPUs for everything that runs beside the loop: not the hyper-threads of its core, which would take its cycles."""
    loop = loop_cpus(allowed, isolated, cores)
    beside = {sibling for cpu in loop for sibling in cores.get(cpu, Core()).siblings}
    return set(allowed) - loop - beside or set(allowed) - loop or set(allowed)


def cores_of(folder: Path = _CPUS) -> dict[int, Core]:
    """Every CPU that the kernel tells of in its folder."""
    return {int(cpu.name[3:]): _core(cpu) for cpu in folder.glob("cpu[0-9]*")}


def _core(cpu: Path) -> Core:
    def told(*names: str) -> str:
        for name in names:
            with suppress(OSError):
                return (cpu / name).read_text(encoding="ascii").strip()
        return ""

    speed = told("cpufreq/cpuinfo_max_freq", "cpu_capacity")
    siblings = parse_cpus(told("topology/thread_siblings_list"))
    return Core(int(speed) if speed.isdecimal() else 0, frozenset(siblings))


def isolated_cpus(file: Path = _ISOLATED) -> set[int]:
    """CPUs that the kernel was told to keep free (isolcpus), from its list such as `2,4-5`."""
    try:
        text = file.read_text(encoding="ascii").strip()
    except OSError:
        return set()
    return parse_cpus(text)


def parse_cpus(text: str) -> set[int]:
    """CPU numbers of a kernel list such as `0,2-3`."""
    cpus: set[int] = set()
    for part in filter(None, text.split(",")):
        first, _, last = part.partition("-")
        cpus |= set(range(int(first), int(last or first) + 1))
    return cpus


def kernel_list(cpus: Collection[int]) -> str:
    """CPUs as the kernel's boot parameters name them, such as `2,6`."""
    return ",".join(map(str, sorted(cpus)))


def prepare(tunings: Collection[Tuning]) -> list[Setting]:
    """Ask for everything in order; what is refused is reported, never an error."""
    settings = []
    for name, ask, fix in tunings:
        try:
            settings.append(Setting(name, ask()))
        except (OSError, AttributeError, ValueError) as error:  # AttributeError: this system has no such call
            why = getattr(error, "strerror", None) or str(error)
            settings.append(Setting(name, "default", f"{why}: {fix}"))
    return settings


def loop_tuning() -> tuple[Tuning, ...]:
    """Everything for the process that runs the loop. Garbage goes last: it freezes what exists by then."""
    allowed, isolated = _allowed(), isolated_cpus()
    return (
        _affinity(loop_cpus(allowed, isolated, cores_of()), "the loop shares its CPUs; a second core would help"),
        *_common(lambda: _below_the_guardian(LOOP_PRIORITY)),
        Tuning("heap", _reserve_heap, ""),
        Tuning("C-states", _keep_awake, "deep sleep states add up to 100 us; allow writing /dev/cpu_dma_latency"),
        Tuning("garbage", _freeze_garbage, ""),
    )


def controller_tuning() -> tuple[Tuning, ...]:
    """Everything for the process of a user's controller, which shares the loop's CPU: a message is quickest there."""
    return (
        _affinity(
            loop_cpus(_allowed(), isolated_cpus(), cores_of()), "the loop shares its CPUs; a second core would help"
        ),
        *_common(lambda: _below_the_guardian(CONTROLLER_PRIORITY)),
        Tuning("garbage", _freeze_garbage, ""),
    )


def end_with_parent() -> None:
    """Have this process killed as soon as the one that started it ends, however that comes. Raises OSError."""
    _call("prctl", _PR_SET_PDEATHSIG, signal.SIGKILL)


def guardian_tuning(priority: int = GUARDIAN_PRIORITY) -> tuple[Tuning, ...]:
    """Everything for the guardian and for the mock board: beside the loop, never on its CPU."""
    return (
        _affinity(other_cpus(_allowed(), isolated_cpus(), cores_of()), "a second core would help"),
        *_common(lambda: _first_in_first_out(priority)),
        Tuning("out of memory", _survive, "the kernel may choose this process when memory runs out"),
        Tuning("garbage", _freeze_garbage, ""),
    )


def recorder_tuning() -> tuple[Tuning, ...]:
    """The recorder is an ordinary process that keeps off the loop's CPU."""
    return (
        _affinity(other_cpus(_allowed(), isolated_cpus(), cores_of()), "a second core would help"),
        Tuning("signals", _block_signals, ""),
    )


def supervisor_tuning() -> tuple[Tuning, ...]:
    """The supervisor and its screen keep off the loop's CPU."""
    return (_affinity(other_cpus(_allowed(), isolated_cpus(), cores_of()), "a second core would help"),)


def watch_tuning(priority: int = WATCH_PRIORITY) -> tuple[Tuning, ...]:
    """The thread in which a process watches others or beats: it must not wait for a loop that spins."""
    return (
        _affinity(other_cpus(_allowed(), isolated_cpus(), cores_of()), "a second core would help"),
        Tuning("signals", _block_signals, ""),
        Tuning("scheduler", lambda: _first_in_first_out(priority), "a busy program delays it"),
    )


def _common(schedule: Callable[[], str]) -> tuple[Tuning, ...]:
    return (
        Tuning("signals", _block_signals, ""),
        Tuning("malloc", _keep_heap, "the C library is not glibc"),
        Tuning(
            "memory", _lock_memory, "a page fault may cost a tick; raise memlock to unlimited in /etc/security/limits.d"
        ),
        Tuning("timer slack", _no_slack, "wake-ups may come 50 us late"),
        Tuning(
            "scheduler",
            schedule,
            "ordinary priority, so any busy program delays the loop; raise rtprio to 90 in /etc/security/limits.d",
        ),
    )


def _affinity(cpus: set[int], fix: str) -> Tuning:
    def ask() -> str:
        if not cpus:
            raise OSError(None, "there is one CPU only")
        os.sched_setaffinity(0, cpus)
        return f"CPU {kernel_list(cpus)}"

    return Tuning("affinity", ask, fix)


def _allowed() -> set[int]:
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()


def _first_in_first_out(priority: int) -> str:
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    return f"SCHED_FIFO {priority}"


def _below_the_guardian(priority: int) -> str:
    """A limit between the priorities would turn their order around: then all of them stay ordinary processes."""
    _first_in_first_out(GUARDIAN_PRIORITY)
    return _first_in_first_out(priority)


def _lock_memory() -> str:
    _call("mlockall", _MCL_CURRENT | _MCL_FUTURE)
    return "locked"


def _keep_heap() -> str:
    """Freed memory stays with the process, and large blocks come from the heap: no page is faulted in twice."""
    libc = _libc()
    if not (libc.mallopt(_M_TRIM_THRESHOLD, -1) and libc.mallopt(_M_MMAP_MAX, 0)):
        raise OSError(None, "mallopt failed")
    return "never trimmed"


def _reserve_heap() -> str:
    """Memory for Python's small objects ahead of need: fetching it costs 256 page faults at once.

    An arena goes back to the system when its last object is freed, so one object in each stays alive.
    """
    objects = [bytes(_LARGEST_SMALL) for _ in range(_RESERVE_BYTES // _LARGEST_SMALL)]
    _KEPT.extend(objects[:: _ARENA_BYTES // 4 // _LARGEST_SMALL])
    return f"{_RESERVE_BYTES >> 20} MiB in reserve"


def _no_slack() -> str:
    _call("prctl", _PR_SET_TIMERSLACK, 1)
    return "1 ns"


def _block_signals() -> str:
    """A handler would run between two bytecodes of the tick; the supervisor listens instead."""
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals() - {signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE})
    return "blocked"


def _keep_awake() -> str:
    """The setting holds as long as the file is open: until the process ends."""
    file = os.open(_CPU_LATENCY, os.O_WRONLY)
    os.write(file, struct.pack("i", 0))
    return "latency 0 us"


def _survive() -> str:
    _OOM.write_text(_NEVER_KILL, encoding="ascii")
    return "killed last"


def _freeze_garbage() -> str:
    gc.collect()
    gc.freeze()
    gc.disable()
    return "frozen and off"


def _libc() -> Any:
    if not sys.platform.startswith("linux"):
        raise OSError(None, f"{sys.platform} has no such call")
    return ctypes.CDLL(None, use_errno=True)


def _call(name: str, *arguments: int) -> None:
    if getattr(_libc(), name)(*arguments):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
