"""Checks whether this computer can run the 2 kHz loop and lists what to change; changes nothing.

Ratings follow docs/facts/real-time.md#techniques and docs/facts/real-time.md#acceptance-figures; figures of a session
are those of the loop's ring and of its file.
"""

from __future__ import annotations

import os
import shutil
import sys
import sysconfig
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

from inteco_abs.host import permissions
from inteco_abs.host.attached import plugged_in
from inteco_abs.host.checks import Check, CheckResult, Computer, Judgement, amber, green, look, red
from inteco_abs.realtime import Core, cores_of, kernel_list, loop_cpus, parse_cpus
from inteco_abs.sessions import nearest_folder

_CPUS: Final = "sys/devices/system/cpu"
_CPU_LATENCY: Final = "dev/cpu_dma_latency"
_SHARED_MEMORY: Final = "dev/shm"

_GOOD_CLOCKS: Final = frozenset({"tsc", "arch_sys_counter"})
_SLOW_CLOCKS: Final = frozenset({"hpet", "acpi_pm", "jiffies"})
"""Slow clocks, in a chip outside the CPU, or coarse ones."""
_QUICK_WAKE_UP_US: Final = 20
_MOST_SPIN_SHARE: Final = 0.4
"""Share of the time that the loop may hold a CPU; `PacedClock`'s limit."""
_COMFORTABLE_SHARE: Final = 0.9

_SESSION_BYTES_PER_S: Final = 600_000
_RING_BYTES_PER_S: Final = 500_000
_SHORTEST_RUN_S: Final = 60
_LONG_RUN_S: Final = 600
_LAB_DAY_S: Final = 3600
_TRIAL_BYTES: Final = 16 << 20
_CHUNK_BYTES: Final = 1 << 20


def examine(folder: Path, root: Path = Path("/")) -> list[CheckResult]:
    """Run all quick checks, in some milliseconds; `folder` is where sessions will be written."""
    computer = Computer(root)
    disks: dict[str, Check] = {"free space": lambda _: _free_space(folder), "shared memory": _shared_memory}
    return [
        *look(computer, {**_CHECKS, **permissions.CHECKS}),
        *plugged_in(computer),
        *look(computer, disks),
        CheckResult("Python", *judge_python(python_build())),
    ]


def write_speed(folder: Path) -> CheckResult:
    """Measure the write speed of `folder` with 16 MiB, flushed to the disk and removed."""
    data = os.urandom(_CHUNK_BYTES)  # some file systems compress
    try:
        with tempfile.TemporaryFile(dir=nearest_folder(folder), buffering=0) as file:
            start = time.perf_counter()
            for _ in range(_TRIAL_BYTES // _CHUNK_BYTES):
                file.write(data)
            os.fsync(file.fileno())
            elapsed_s = time.perf_counter() - start
    except OSError as error:
        why = f"{folder}: nothing can be written ({error.strerror})"
        return CheckResult("disk speed", *red(why, "choose another folder with --sessions"))
    return CheckResult("disk speed", *judge_write_speed(_TRIAL_BYTES / elapsed_s))


def judge_write_speed(bytes_per_s: float) -> Judgement:
    """Judge a write speed: green from ten times what a session needs."""
    times = bytes_per_s / _SESSION_BYTES_PER_S
    found = f"{bytes_per_s / 1e6:.1f} MB/s, {times:.1f} times what a session needs"
    if times >= 10:
        return green(found)
    fix = "write sessions to a disk of this computer, and nothing else to it meanwhile"
    return amber(found, fix) if times >= 2 else red(found, fix)


class PythonBuild(NamedTuple):
    """Facts of the interpreter."""

    version: str
    debug: bool = False
    """Built with --with-pydebug: several times slower."""
    development_mode: bool = False
    free_threaded: bool = False
    traced: bool = False
    """A debugger, a profiler or coverage traces every line."""


def python_build() -> PythonBuild:
    """Return the facts of this interpreter."""
    return PythonBuild(
        f"{sys.implementation.name} {sys.version.split()[0]}",
        debug=hasattr(sys, "gettotalrefcount"),
        development_mode=sys.flags.dev_mode,
        free_threaded=bool(sysconfig.get_config_var("Py_GIL_DISABLED")),
        traced=_is_traced(),
    )


def judge_python(build: PythonBuild) -> Judgement:
    """Judge an interpreter; only a debug build is red."""
    if build.debug:
        return red(f"{build.version}, a debug build: several times slower", "use a release build of Python")
    if build.traced:
        return amber(f"{build.version}, traced: every line costs extra", "run without debugger, profiler and coverage")
    if build.development_mode:
        return amber(f"{build.version} in development mode: slower", "unset PYTHONDEVMODE, and do not use -X dev")
    if build.free_threaded:
        return amber(f"{build.version}, free-threaded: not measured yet", "use the usual build of Python")
    return green(build.version)


def _is_traced() -> bool:
    monitoring = getattr(sys, "monitoring", None)  # since Python 3.12
    tools = [] if monitoring is None else [monitoring.get_tool(number) for number in range(6)]
    return sys.gettrace() is not None or sys.getprofile() is not None or any(tools)


def _kernel(computer: Computer) -> Judgement:
    release, version = computer.text("proc/sys/kernel/osrelease"), computer.text("proc/sys/kernel/version")
    if computer.text_or("sys/kernel/realtime", "0") == "1" or "PREEMPT_RT" in version:
        return green(f"{release}, PREEMPT_RT")
    kind = next((word for word in version.split() if word.startswith("PREEMPT")), "no preemption")
    return amber(
        f"{release}, {kind}: nothing bounds the longest delay",
        "install a kernel with PREEMPT_RT (Debian: linux-image-rt-amd64; Ubuntu: pro enable realtime-kernel)",
    )


def _lockdown(computer: Computer) -> Judgement:
    computer.text("proc/sys/kernel/osrelease")  # kernels without lockdown have no such file
    mode = computer.text_or("sys/kernel/security/lockdown", "[none]").partition("[")[2].partition("]")[0]
    if mode == "none":
        return green("none")
    return amber(
        f"{mode}: an RT-DAC4/PCI board cannot be reached; USB boards can",
        "for an RT-DAC4/PCI board, switch Secure Boot off in the firmware",
    )


def _real_time_share(computer: Computer) -> Judgement:
    runtime_us = int(computer.text("proc/sys/kernel/sched_rt_runtime_us"))
    if runtime_us < 0:
        return green("no limit")
    share = runtime_us / int(computer.text("proc/sys/kernel/sched_rt_period_us"))
    found = f"{100 * share:.0f} % of each period"
    if share >= _COMFORTABLE_SHARE:
        return green(found)
    fix = "sudo sysctl kernel.sched_rt_runtime_us=950000 kernel.sched_rt_period_us=1000000"
    return amber(found, fix) if share > _MOST_SPIN_SHARE else red(f"{found}: the loop is stopped in between", fix)


def _governor(computer: Computer) -> Judgement:
    governors = {computer.text(file) for file in computer.matching(f"{_CPUS}/cpu[0-9]*/cpufreq/scaling_governor")}
    if not governors:
        computer.text(f"{_CPUS}/online")
        return amber(
            "not known: a virtual machine, or the firmware decides", "choose the highest performance in the firmware"
        )
    found = ", ".join(sorted(governors))
    if governors == {"performance"}:
        return green(found)
    return amber(f"{found}: the clock follows the load", "sudo cpupower frequency-set -g performance")


def _cpus(computer: Computer) -> Judgement:
    online = parse_cpus(computer.text(f"{_CPUS}/online"))
    isolated = parse_cpus(computer.text_or(f"{_CPUS}/isolated", "")) & online
    cores = cores_of(computer.root / _CPUS)
    if len(online) == 1:
        return red("1 CPU: everything shares it with the loop", "use a computer with 2 CPUs or more, better 4")
    best = min(loop_cpus(online, (), cores))
    best_core = cores.get(best, Core()).siblings & online | {best}
    own, others = kernel_list(best_core), kernel_list(online - best_core)
    boot = f"isolcpus={own} nohz_full={own} rcu_nocbs={own} irqaffinity={others}"
    if not isolated:
        return amber(
            f"{len(online)} CPUs, none of them isolated", f"to keep all else off the loop's CPU, boot with {boot}"
        )
    problems = _disturbances(computer, min(loop_cpus(online, isolated, cores)), isolated, cores)
    found = f"{len(online)} CPUs, isolated: {kernel_list(isolated)}"
    return amber(f"{found}; {'; '.join(problems)}", f"boot with {boot}") if problems else green(found)


def _disturbances(computer: Computer, loop: int, isolated: set[int], cores: Mapping[int, Core]) -> list[str]:
    """List what still delays the loop on an isolated CPU."""
    core, fastest = cores.get(loop, Core()), max((core.speed for core in cores.values()), default=0)
    problems = []
    if core.speed < fastest:
        problems.append(f"CPU {loop} is not the fastest: {core.speed} against {fastest} (kHz or capacity)")
    if busy := core.siblings - isolated - {loop}:
        problems.append(f"CPU {kernel_list(busy)} shares a core with it and is not isolated")
    mask = int(computer.text_or("proc/irq/default_smp_affinity", "0").replace(",", ""), 16)
    if mask >> loop & 1:
        problems.append(f"interrupts may come to CPU {loop} (no irqaffinity)")
    words = computer.text_or("proc/cmdline", "rcu_nocbs=").split()
    if not any(word.startswith(("rcu_nocbs", "nohz_full=")) for word in words):
        problems.append("the kernel's deferred work runs there (no rcu_nocbs)")
    return problems


def _sleep_states(computer: Computer) -> Judgement:
    states = [
        (int(computer.text(f"{state}/latency")), computer.text(f"{state}/name"))
        for state in computer.matching(f"{_CPUS}/cpu0/cpuidle/state*")
        if computer.text_or(f"{state}/disable", "0") == "0"
    ]
    latency_us, name = max(states)  # none listed: not known
    found = f"{name} takes {latency_us} us to leave"
    if computer.may_write(_CPU_LATENCY):
        return green(f"{found}; the loop may forbid it")
    if latency_us <= _QUICK_WAKE_UP_US:
        return green(found)
    return amber(f"{found}; the loop may not forbid it", permissions.ALLOW_AWAKE)


def _clock_source(computer: Computer) -> Judgement:
    name = computer.text("sys/devices/system/clocksource/clocksource0/current_clocksource")
    if name in _GOOD_CLOCKS:
        return green(name)
    if name in _SLOW_CLOCKS:
        return red(f"{name}: slow to read", "look for tsc in `sudo dmesg`; boot with clocksource=tsc tsc=reliable")
    return amber(f"{name}: probably a virtual machine", "use a computer of its own for the rig")


def _load(computer: Computer) -> Judgement:
    load, cpus = float(computer.text("proc/loadavg").split()[0]), len(parse_cpus(computer.text(f"{_CPUS}/online")))
    found = f"{load:.2f} on {cpus} CPUs"
    return green(found) if load <= cpus / 2 else amber(found, "close other programs; `top` shows which are busy")


def _free_space(folder: Path) -> Judgement:
    free = shutil.disk_usage(nearest_folder(folder)).free
    found = f"{_size(free)} in {folder}, {_duration(free / _SESSION_BYTES_PER_S)} of recording"
    fix = "make room, or choose another folder with --sessions"
    if free >= _LAB_DAY_S * _SESSION_BYTES_PER_S:
        return green(found)
    return amber(found, fix) if free >= _SHORTEST_RUN_S * _SESSION_BYTES_PER_S else red(found, fix)


def _shared_memory(computer: Computer) -> Judgement:
    free = shutil.disk_usage(computer.root / _SHARED_MEMORY).free
    found = f"{_size(free)} in /{_SHARED_MEMORY}, {_duration(free / _RING_BYTES_PER_S)} of ticks"
    fix = f"sudo mount -o remount,size=1G /{_SHARED_MEMORY}; for a container, --shm-size=1g"
    if free >= _LONG_RUN_S * _RING_BYTES_PER_S:
        return green(found)
    return amber(found, fix) if free >= _SHORTEST_RUN_S * _RING_BYTES_PER_S else red(found, fix)


def _size(count: int) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


def _duration(seconds: float) -> str:
    hours, minutes = seconds / 3600, seconds / 60
    return f"{hours:.0f} h" if hours >= 2 else f"{minutes:.0f} min" if minutes >= 2 else f"{seconds:.0f} s"


_CHECKS: Final[dict[str, Check]] = {
    "kernel": _kernel,
    "lockdown": _lockdown,
    "CPUs": _cpus,
    "CPU governor": _governor,
    "sleep states": _sleep_states,
    "clock source": _clock_source,
    "real-time share": _real_time_share,
    "load": _load,
}
