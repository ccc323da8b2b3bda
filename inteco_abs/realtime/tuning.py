"""Real-time settings of a process. The system may refuse each one; the refusal says why and what to do.

docs/facts/real-time.md#techniques ranks and measures them; values follow LinuxCNC's and Klipper's practice.
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
"""Priority of a user's controller in its own process, just below the loop's."""
GUARDIAN_PRIORITY: Final = 90
"""Above the loop's priority, as a loop that hangs may spin on the only CPU."""
WATCH_PRIORITY: Final = 85
"""Priority of the thread in which the supervisor watches both."""
BOARD_PRIORITY: Final = 60
"""Priority of the mock board's process."""

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4
_PR_SET_PDEATHSIG, _PR_SET_TIMERSLACK = 1, 29
_CPUS: Final = Path("/sys/devices/system/cpu")
_ISOLATED: Final = _CPUS / "isolated"
_CPU_LATENCY: Final = Path("/dev/cpu_dma_latency")
_OOM: Final = Path("/proc/self/oom_score_adj")
_NEVER_KILL: Final = "-1000"
_LARGEST_SMALL: Final = 400
_LIMITS: Final = "/etc/security/limits.d"
_ORDINARY: Final = "ordinary priority, so any busy program delays the loop"
_ARENA_BYTES: Final = 1 << 20
_RESERVE_BYTES: Final = 8 << 20
_UNKNOWN: Final[dict[int, Any]] = {}
_KEPT: Final[list[bytes]] = []
"""Objects that keep the reserve from being freed."""


class Setting(NamedTuple):
    """One setting: its value in force, or why it was refused and what to do."""

    name: str
    value: str
    refused: str = ""


class Tuning(NamedTuple):
    """A setting to ask for: `ask` returns the value in force or raises OSError; `fix` goes with a refusal."""

    name: str
    ask: Callable[[], str]
    fix: str


class Core(NamedTuple):
    """One CPU as the kernel describes it."""

    speed: int = 0
    """Highest clock in kHz, or else the kernel's capacity value; 0: not known."""
    siblings: frozenset[int] = frozenset()
    """CPUs of its core: hyper-threads, itself included."""


def loop_cpus(allowed: Collection[int], isolated: Collection[int], cores: Mapping[int, Core] = _UNKNOWN) -> set[int]:
    """Return the CPU for the loop alone: an isolated one if there is any; none on a machine with a single CPU.

    Prefers a CPU whose hyper-threads are isolated too, then the fastest, then the last. A process may move to an
    isolated CPU although the kernel does not list it among the allowed ones.
    """
    candidates = set(isolated) or (set(allowed) if len(allowed) > 1 else set())

    def rank(cpu: int) -> tuple[bool, int, int]:
        core = cores.get(cpu, Core())
        return not isolated or core.siblings <= {cpu, *isolated}, core.speed, cpu

    return {max(candidates, key=rank)} if candidates else set()


def other_cpus(allowed: Collection[int], isolated: Collection[int], cores: Mapping[int, Core] = _UNKNOWN) -> set[int]:
    """Return the CPUs for everything else, without the hyper-threads of the loop's core, which take its cycles."""
    loop = loop_cpus(allowed, isolated, cores)
    beside = {sibling for cpu in loop for sibling in cores.get(cpu, Core()).siblings}
    return set(allowed) - loop - beside or set(allowed) - loop or set(allowed)


def cores_of(folder: Path = _CPUS) -> dict[int, Core]:
    """Return every CPU that the kernel lists in `folder`."""
    return {int(cpu.name[3:]): _core(cpu) for cpu in folder.glob("cpu[0-9]*")}


def _core(cpu: Path) -> Core:
    def text(*names: str) -> str:
        for name in names:
            with suppress(OSError):
                return (cpu / name).read_text(encoding="ascii").strip()
        return ""

    speed = text("cpufreq/cpuinfo_max_freq", "cpu_capacity")
    siblings = parse_cpus(text("topology/thread_siblings_list"))
    return Core(int(speed) if speed.isdecimal() else 0, frozenset(siblings))


def isolated_cpus(file: Path = _ISOLATED) -> set[int]:
    """Return the CPUs of the boot parameter isolcpus, from the kernel's list such as `2,4-5`."""
    try:
        text = file.read_text(encoding="ascii").strip()
    except OSError:
        return set()
    return parse_cpus(text)


def parse_cpus(text: str) -> set[int]:
    """Return the CPU numbers of a kernel list such as `0,2-3`."""
    cpus: set[int] = set()
    for part in filter(None, text.split(",")):
        first, _, last = part.partition("-")
        cpus |= set(range(int(first), int(last or first) + 1))
    return cpus


def kernel_list(cpus: Collection[int]) -> str:
    """Format CPUs for the kernel's boot parameters, such as `2,6`."""
    return ",".join(map(str, sorted(cpus)))


def apply(tunings: Collection[Tuning]) -> list[Setting]:
    """Ask for all settings in order; report refusals, raise nothing."""
    settings = []
    for name, ask, fix in tunings:
        try:
            settings.append(Setting(name, ask()))
        except (OSError, AttributeError, ValueError) as error:  # AttributeError: this system has no such call
            why = getattr(error, "strerror", None) or str(error)
            settings.append(Setting(name, "default", f"{why}: {fix}"))
    return settings


def loop_tuning() -> tuple[Tuning, ...]:
    """Return the settings of the loop's process. Garbage comes last: it freezes what exists by then."""
    return (
        _on_the_loops_cpu(),
        *_common(lambda: _below_the_guardian(LOOP_PRIORITY)),
        Tuning("heap", _reserve_heap, ""),
        Tuning("C-states", _keep_awake, "deep sleep states add up to 100 us; allow writing /dev/cpu_dma_latency"),
        Tuning("garbage", _freeze_garbage, ""),
    )


def controller_tuning() -> tuple[Tuning, ...]:
    """Return the settings of a user's controller, which shares the loop's CPU: messages are quickest there."""
    return (
        _on_the_loops_cpu(),
        *_common(lambda: _below_the_guardian(CONTROLLER_PRIORITY)),
        Tuning("garbage", _freeze_garbage, ""),
    )


def end_with_parent() -> None:
    """Have the kernel kill this process when its parent ends. Raises OSError."""
    _call("prctl", _PR_SET_PDEATHSIG, signal.SIGKILL)


def guardian_tuning(priority: int = GUARDIAN_PRIORITY) -> tuple[Tuning, ...]:
    """Return the settings of the guardian and the mock board, which keep off the loop's CPU."""
    return (
        _beside_the_loop(),
        *_common(lambda: _first_in_first_out(priority)),
        Tuning("out of memory", _survive, "the kernel may choose this process when memory runs out"),
        Tuning("garbage", _freeze_garbage, ""),
    )


def recorder_tuning() -> tuple[Tuning, ...]:
    """Return the settings of the recorder, an ordinary process that keeps off the loop's CPU."""
    return _beside_the_loop(), Tuning("signals", _block_signals, "")


def supervisor_tuning() -> tuple[Tuning, ...]:
    """Return the settings of the supervisor and its screen, which keep off the loop's CPU."""
    return (_beside_the_loop(),)


def watch_tuning(priority: int = WATCH_PRIORITY) -> tuple[Tuning, ...]:
    """Return the settings of a watching or beating thread, which must not wait for a loop that spins."""
    return (
        _beside_the_loop(),
        Tuning("signals", _block_signals, ""),
        Tuning("scheduler", lambda: _first_in_first_out(priority), "a busy program delays it"),
    )


def _common(schedule: Callable[[], str]) -> tuple[Tuning, ...]:
    return (
        Tuning("signals", _block_signals, ""),
        Tuning("malloc", _keep_heap, "the C library is not glibc"),
        Tuning("memory", _lock_memory, f"a page fault may cost a tick; raise memlock to unlimited in {_LIMITS}"),
        Tuning("timer slack", _no_slack, "wake-ups may come 50 us late"),
        Tuning("scheduler", schedule, f"{_ORDINARY}; raise rtprio to 90 in {_LIMITS}"),
    )


def _on_the_loops_cpu() -> Tuning:
    cpus = loop_cpus(_allowed(), isolated_cpus(), cores_of())
    return _affinity(cpus, "the loop shares its CPUs; a second core would help")


def _beside_the_loop() -> Tuning:
    return _affinity(other_cpus(_allowed(), isolated_cpus(), cores_of()), "a second core would help")


def _affinity(cpus: set[int], fix: str) -> Tuning:
    def ask() -> str:
        if not cpus:
            raise OSError(None, "there is only one CPU")
        os.sched_setaffinity(0, cpus)
        return f"CPU {kernel_list(cpus)}"

    return Tuning("affinity", ask, fix)


def _allowed() -> set[int]:
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()


def _first_in_first_out(priority: int) -> str:
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    return f"SCHED_FIFO {priority}"


def _below_the_guardian(priority: int) -> str:
    """Ask for the guardian's priority first: with a limit between the two, the loop would outrank the guardian."""
    _first_in_first_out(GUARDIAN_PRIORITY)
    return _first_in_first_out(priority)


def _lock_memory() -> str:
    """Lock all pages; beside LLVM and numpy, which map 250 MB and use a quarter, those only that were ever touched.

    Else a killed loop would take 10 ms longer to leave the board.
    """
    if "llvmlite.binding" in sys.modules:
        _call("mlockall", _MCL_CURRENT | _MCL_ONFAULT)
        _call("mlockall", _MCL_FUTURE)
        return "locked where touched"
    _call("mlockall", _MCL_CURRENT | _MCL_FUTURE)
    return "locked"


def _keep_heap() -> str:
    """Keep freed memory, and allocate large blocks from the heap, so that no page faults twice."""
    libc = _libc()
    if not (libc.mallopt(_M_TRIM_THRESHOLD, -1) and libc.mallopt(_M_MMAP_MAX, 0)):
        raise OSError(None, "mallopt failed")
    return "never trimmed"


def _reserve_heap() -> str:
    """Reserve memory for Python's small objects: to fetch an arena in mid-run costs 256 page faults at once.

    Python frees an arena with its last object, so one object in each stays alive.
    """
    objects = [bytes(_LARGEST_SMALL) for _ in range(_RESERVE_BYTES // _LARGEST_SMALL)]
    _KEPT.extend(objects[:: _ARENA_BYTES // 4 // _LARGEST_SMALL])
    return f"{_RESERVE_BYTES >> 20} MiB in reserve"


def _no_slack() -> str:
    _call("prctl", _PR_SET_TIMERSLACK, 1)
    return "1 ns"


def _block_signals() -> str:
    """Block signals: a handler would run between two bytecodes of a tick; the supervisor handles them."""
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals() - {signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE})
    return "blocked"


def _keep_awake() -> str:
    """Forbid deep sleep states; holds while the file is open, until the process ends."""
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
