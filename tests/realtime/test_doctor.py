import os
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from inteco_abs.errors import ConfigError
from inteco_abs.host import doctor
from inteco_abs.host.checks import CheckResult, Computer, Rating, as_facts, worst
from inteco_abs.host.doctor import PythonBuild, examine, judge_python, judge_write_speed, python_build, write_speed
from inteco_abs.host.permissions import UDEV_FILE, check_serial, limits, serial_group, udev_rules

CPU = "sys/devices/system/cpu"
HOST = "sys/devices/pci0000:00/0000:00:14.0"
USB = "sys/bus/usb/devices/1-2"
PCI = "sys/bus/pci/devices/0000:04:00.0"
FTDI = "sys/bus/usb-serial/devices"
NODE = "dev/bus/usb/001/005"
LOCKDOWN = "sys/kernel/security/lockdown"
RULES = UDEV_FILE.lstrip("/")
CLOCK = "sys/devices/system/clocksource/clocksource0/current_clocksource"
NOT_KNOWN = "not known on this system"
GB = 10**9


class ReadOnly(str):
    """Content of a file that this user may not write."""

    __slots__ = ()


def status(uid=1000, groups="20 1000", capabilities=0):
    ids = f"Uid:\t{uid}\t{uid}\t{uid}\t{uid}\nGid:\t1000\t1000\t1000\t1000\n"
    return f"Name:\tpython\n{ids}Groups:\t{groups} \nCapEff:\t{capabilities:016x}\n"


def limits_table(priority="90", memory="unlimited"):
    return (
        "Limit                     Soft Limit           Hard Limit           Units     \n"
        f"Max locked memory         {memory:<20} unlimited            bytes     \n"
        f"Max realtime priority     {priority:<20} 99                   \n"
    )


def stat(priority):
    return f"77 (irq/129-xhci_hcd) S {' '.join(['0'] * 36)} {priority} 1 0"


GOOD = {
    "proc/sys/kernel/osrelease": "6.12.0-rt-amd64",
    "proc/sys/kernel/version": "#1 SMP PREEMPT_RT Debian 6.12",
    "proc/sys/kernel/sched_rt_runtime_us": "950000",
    "proc/sys/kernel/sched_rt_period_us": "1000000",
    "proc/loadavg": "0.31 0.20 0.10 1/200 4242",
    "proc/self/status": status(),
    "proc/self/limits": limits_table(),
    "etc/group": "root:x:0:\ndialout:x:20:lab\nlab:x:1000:\n",
    RULES: udev_rules("dialout"),
    LOCKDOWN: "[none] integrity confidentiality",
    f"{CPU}/online": "0-3",
    f"{CPU}/isolated": "3",
    "proc/irq/default_smp_affinity": "7",
    "proc/cmdline": "quiet isolcpus=3 nohz_full=3 rcu_nocbs=3 irqaffinity=0-2",
    "proc/irq/129/effective_affinity_list": "0",
    "proc/77/comm": "irq/129-xhci_hcd",
    "proc/77/stat": stat(85),
    **{f"{CPU}/cpu{number}/cpufreq/scaling_governor": "performance" for number in range(4)},
    f"{CPU}/cpu0/cpuidle/state0/name": "POLL",
    f"{CPU}/cpu0/cpuidle/state0/latency": "0",
    f"{CPU}/cpu0/cpuidle/state1/name": "C6",
    f"{CPU}/cpu0/cpuidle/state1/latency": "133",
    f"{CPU}/cpu0/cpuidle/state1/disable": "0",
    "dev/cpu_dma_latency": "",
    CLOCK: "tsc",
    f"{USB}/manufacturer": "InTeCo",
    f"{USB}/product": "RT-DAC/USB2",
    f"{USB}/idVendor": "04b4",
    f"{USB}/speed": "480",
    f"{USB}/busnum": "1",
    f"{USB}/devnum": "5",
    f"{USB}/power/control": "on",
    NODE: "",
    "sys/bus/usb/devices/usb1/manufacturer": "Linux 6.12.0 xhci-hcd",
    f"{FTDI}/ttyUSB0/latency_timer": "1",
    f"{HOST}/msi_irqs/129": "msi",
    f"{PCI}/vendor": "0x10b5",
    f"{PCI}/device": "0x2497",
    f"{PCI}/resource2": "",
    f"{PCI}/enable": "1",
    "sys/bus/pci/devices/0000:00:00.0/vendor": "0x8086",
    "dev/shm/.keep": "",
}
NO_PCI = {path: None for path in GOOD if path.startswith(PCI)}
NO_USB = {path: None for path in GOOD if path.startswith(USB)}
SECOND_USB = {path.replace("1-2", "1-1.4"): text for path, text in GOOD.items() if path.startswith(USB)} | {
    "sys/bus/usb/devices/1-1.4/devnum": "6",
    "dev/bus/usb/001/006": "",
}
LINKS = {USB: f"{HOST}/usb1/1-2", f"{FTDI}/ttyUSB0": f"{HOST}/usb1/1-3/1-3:1.0/ttyUSB0"}
"""As sysfs has its devices: below what they hang on, and linked from their bus."""
MODEMS = {"proc/412/comm": "ModemManager", f"{HOST}/usb1/1-3/serial": "A6008isP"}
THREADS = f"{CPU}/cpu1/topology/thread_siblings_list"
STOCK = {"proc/sys/kernel/version": "#1 SMP PREEMPT_DYNAMIC Debian"}
NOT_AWAKE = {"dev/cpu_dma_latency": ReadOnly()}
NOTHING_DEEP = {f"{CPU}/cpu0/cpuidle/state1/disable": "1"}

# name of the check, what differs from the good computer, verdict, what it reports, what it advises
CASES = [
    ("kernel", {}, "green", "6.12.0-rt-amd64, PREEMPT_RT", ""),
    ("kernel", {**STOCK, "sys/kernel/realtime": "1"}, "green", "PREEMPT_RT", ""),
    ("kernel", STOCK, "amber", "PREEMPT_DYNAMIC", "linux-image-rt"),
    ("kernel", {"proc/sys/kernel/version": "#1 SMP Debian"}, "amber", "no preemption", "linux-image-rt"),
    ("kernel", {"proc/sys/kernel/osrelease": None}, "amber", NOT_KNOWN, "/proc"),
    ("lockdown", {}, "green", "none", ""),
    ("lockdown", {LOCKDOWN: None}, "green", "none", ""),
    ("lockdown", {LOCKDOWN: "none [integrity] confidentiality"}, "amber", "integrity: an RT-DAC4/PCI", "Secure Boot"),
    ("lockdown", {LOCKDOWN: "none integrity [confidentiality]"}, "amber", "confidentiality", "Secure Boot"),
    ("CPUs", {}, "green", "4 CPUs, isolated: 3", ""),
    ("CPUs", {f"{CPU}/isolated": ""}, "amber", "4 CPUs, none of them isolated", "isolcpus=3"),
    ("CPUs", {f"{CPU}/isolated": "7"}, "amber", "none of them isolated", "isolcpus=3"),
    ("CPUs", {f"{CPU}/isolated": None}, "amber", "none of them isolated", "isolcpus=3"),
    ("CPUs", {f"{CPU}/online": "0", f"{CPU}/isolated": ""}, "red", "1 CPU", "2 CPUs or more"),
    (
        "CPUs",
        {f"{CPU}/isolated": "", f"{CPU}/cpu1/cpufreq/cpuinfo_max_freq": "5000", f"{THREADS}": "1,3"},
        "amber", "none of them isolated", "isolcpus=1,3 nohz_full=1,3 rcu_nocbs=1,3 irqaffinity=0,2",
    ),
    ("CPUs", {f"{CPU}/cpu1/cpu_capacity": "1024"}, "amber", "CPU 3 is not the fastest: 0 against 1024", "isolcpus=1"),
    ("CPUs", {f"{CPU}/cpu3/topology/thread_siblings_list": "1,3"}, "amber", "CPU 1 shares a core", "isolcpus=1,3"),
    ("CPUs", {f"{CPU}/cpu3/topology/thread_siblings_list": "1,3", f"{CPU}/isolated": "1,3"}, "green", "1,3", ""),
    ("CPUs", {"proc/irq/default_smp_affinity": "ff,0000000f"}, "amber", "interrupts may come to CPU 3", "irqaffinity"),
    ("CPUs", {"proc/cmdline": "quiet isolcpus=3"}, "amber", "(no rcu_nocbs)", "rcu_nocbs=3"),
    ("CPUs", {"proc/cmdline": "isolcpus=3 nohz_full=3"}, "green", "isolated: 3", ""),
    ("CPUs", {f"{CPU}/online": "all"}, "amber", NOT_KNOWN, "/sys"),
    ("CPU governor", {}, "green", "performance", ""),
    ("CPU governor", {f"{CPU}/cpu2/cpufreq/scaling_governor": "powersave"}, "amber", ", powersave", "cpupower"),
    (
        "CPU governor",
        {f"{CPU}/cpu{number}/cpufreq/scaling_governor": None for number in range(4)},
        "amber", "not known: a virtual machine", "firmware",
    ),
    ("sleep states", {}, "green", "C6 takes 133 us to leave; the loop may forbid it", ""),
    ("sleep states", {**NOT_AWAKE, **NOTHING_DEEP}, "green", "POLL takes 0 us", ""),
    ("sleep states", {**NOT_AWAKE, f"{CPU}/cpu0/cpuidle/state1/latency": "20"}, "green", "20 us", ""),
    ("sleep states", NOT_AWAKE, "amber", "may not forbid it", UDEV_FILE),
    ("sleep states", {"dev/cpu_dma_latency": None}, "amber", "C6 takes 133 us to leave; the loop may not", UDEV_FILE),
    ("clock source", {}, "green", "tsc", ""),
    ("clock source", {CLOCK: "arch_sys_counter"}, "green", "arch_sys_counter", ""),
    ("clock source", {CLOCK: "kvm-clock"}, "amber", "kvm-clock: probably a virtual machine", "computer of its own"),
    ("clock source", {CLOCK: "hpet"}, "red", "hpet: slow", "clocksource=tsc"),
    ("clock source", {CLOCK: "acpi_pm"}, "red", "acpi_pm: slow", "clocksource=tsc"),
    ("real-time share", {}, "green", "95 %", ""),
    ("real-time share", {"proc/sys/kernel/sched_rt_runtime_us": "-1"}, "green", "no limit", ""),
    ("real-time share", {"proc/sys/kernel/sched_rt_runtime_us": "500000"}, "amber", "50 %", "sysctl"),
    ("real-time share", {"proc/sys/kernel/sched_rt_runtime_us": "900000"}, "green", "90 %", ""),
    ("real-time share", {"proc/sys/kernel/sched_rt_runtime_us": "400000"}, "red", "40 %", "sysctl"),
    ("real-time share", {"proc/sys/kernel/sched_rt_runtime_us": "0"}, "red", "0 %", "sysctl"),
    ("load", {}, "green", "0.31 on 4 CPUs", ""),
    ("load", {"proc/loadavg": "2.00 0 0"}, "green", "2.00", ""),
    ("load", {"proc/loadavg": "2.01 0 0"}, "amber", "2.01 on 4 CPUs", "close other programs"),
    ("load", {"proc/loadavg": ""}, "amber", NOT_KNOWN, "/proc"),
    ("priority limit", {}, "green", "rtprio 90", ""),
    ("priority limit", {"proc/self/limits": limits_table("unlimited")}, "green", "rtprio unlimited", ""),
    ("priority limit", {"proc/self/limits": limits_table("90")}, "green", "rtprio 90", ""),
    ("priority limit", {"proc/self/limits": limits_table("89")}, "red", "rtprio 89", "setup --apply"),
    (
        "priority limit",
        {"proc/self/limits": limits_table("0"), "proc/self/status": status(capabilities=1 << 23)},
        "green", "CAP_SYS_NICE", "",
    ),
    ("priority limit", {"proc/self/limits": "something else"}, "amber", NOT_KNOWN, "/proc"),
    ("memory limit", {}, "green", "memlock unlimited", ""),
    (
        "memory limit", {"proc/self/limits": limits_table(memory="8388608")}, "amber", "memlock 8192 KiB",
        "setup --apply",
    ),
    (
        "memory limit",
        {"proc/self/limits": limits_table(memory="0"), "proc/self/status": status(capabilities=1 << 14)},
        "green", "CAP_IPC_LOCK", "",
    ),
    ("group", {}, "green", "in group dialout", ""),
    ("group", {"proc/self/status": status(groups="1000")}, "amber", "not in group dialout", "setup --apply"),
    ("group", {"proc/self/status": status(uid=0, groups="0")}, "green", "root", ""),
    ("group", {"etc/group": "uucp:x:20:\n"}, "green", "in group uucp", ""),
    ("group", {"etc/group": "users:x:20:\n"}, "amber", NOT_KNOWN, "/proc"),
    ("udev rules", {}, "green", "installed", ""),
    ("udev rules", {RULES: udev_rules("dialout", "A6008isP")}, "green", "installed", ""),
    ("udev rules", {RULES: None}, "amber", "not installed", "setup --apply"),
    ("udev rules", {RULES: udev_rules("dialout") + "# mine\n"}, "amber", "not those of this version", "setup --apply"),
    ("board", {}, "green", "RT-DAC/USB2 at USB port 1-2, RT-DAC4/PCI at 0000:04:00.0", ""),
    ("board", NO_USB, "green", "RT-DAC4/PCI at 0000:04:00.0", ""),
    ("board", {**NO_PCI, f"{USB}/manufacturer": "INTECO Ltd."}, "green", "USB port 1-2", ""),
    ("board", {**NO_PCI, f"{USB}/idVendor": "1234"}, "green", "USB port 1-2", ""),
    ("board", {**NO_PCI, f"{USB}/manufacturer": None}, "amber", "no RT-DAC/USB2", "plug"),
    ("board", {**NO_PCI, f"{USB}/manufacturer": "Cypress"}, "amber", "no RT-DAC/USB2", "plug"),
    (
        "board",
        {**NO_PCI, f"{USB}/manufacturer": None, f"{USB}/product": None, f"{USB}/idProduct": "8613"},
        "red", "a Cypress FX2 without firmware at USB port 1-2", "docs/boards.md",
    ),
    ("board", {**NO_PCI, f"{USB}/manufacturer": "X", f"{USB}/idVendor": "0403"}, "amber", "no RT-DAC/USB2", "plug"),
    ("board", {**NO_PCI, **NO_USB}, "amber", "no RT-DAC/USB2 or RT-DAC4/PCI board plugged in", "plug"),
    ("board", {**NO_USB, f"{PCI}/device": "0x9030"}, "amber", "no RT-DAC/USB2 or RT-DAC4/PCI board plugged in", "plug"),
    ("USB speed", {}, "green", "480 Mbit/s", ""),
    ("USB speed", {f"{USB}/speed": "12"}, "red", "12 Mbit/s: one frame takes 1 ms", "hub"),
    ("USB speed", {f"{USB}/speed": "unknown"}, "amber", NOT_KNOWN, "/sys"),
    ("USB speed", {**SECOND_USB, f"{USB}/speed": "1.5"}, "red", "480 Mbit/s; 1.5 Mbit/s", "hub"),
    ("USB autosuspend", {}, "green", "off", ""),
    ("USB autosuspend", {f"{USB}/power/control": "auto"}, "amber", "on", f"echo on | sudo tee /{USB}/power/control"),
    ("USB access", {}, "green", f"/{NODE} is writable", ""),
    ("USB access", {NODE: ReadOnly()}, "red", f"/{NODE} is not writable", UDEV_FILE),
    ("USB access", {NODE: None}, "red", f"no /{NODE}", "udev"),
    ("USB interrupt", {}, "green", "interrupt 129 on CPU 0, its thread with priority 85", ""),
    ("USB interrupt", {"proc/77/comm": "irq/12-i8042"}, "green", "interrupt 129 on CPU 0", ""),
    ("USB interrupt", {"proc/77/stat": stat(50)}, "amber", "below the loop's 80", "sudo chrt -f -p 85 77"),
    (
        "USB interrupt",
        {"proc/irq/129/effective_affinity_list": "3"},
        "amber", "on CPU 3, which is the loop's", "echo 0,1,2 | sudo tee /proc/irq/129/smp_affinity_list",
    ),
    ("USB interrupt", {f"{HOST}/msi_irqs/129": None, f"{HOST}/irq": "129"}, "green", "interrupt 129 on CPU 0", ""),
    ("USB interrupt", {f"{HOST}/msi_irqs/129": None}, "amber", NOT_KNOWN, "/sys"),
    ("ModemManager", {}, "green", "not running", ""),
    ("ModemManager", MODEMS, "amber", "to ttyUSB0", "setup --apply --ftdi-serial A6008isP"),
    ("ModemManager", MODEMS | {RULES: udev_rules("dialout", "A6008isP")}, "green", "leaves ttyUSB0 alone", ""),
    ("ModemManager", MODEMS | {RULES: udev_rules("dialout", "A6008isQ")}, "amber", "to ttyUSB0", "A6008isP"),
    ("FTDI latency", {}, "green", "ttyUSB0 1 ms", ""),
    ("FTDI latency", {f"{FTDI}/ttyUSB0/latency_timer": "16"}, "amber", "16 ms", f"echo 1 | sudo tee /{FTDI}/ttyUSB0"),
    ("FTDI latency", {f"{FTDI}/ttyUSB3/latency_timer": "2"}, "amber", "ttyUSB0 1 ms; ttyUSB3 2 ms", "ttyUSB3"),
    ("PCI registers", {}, "green", "switched on", ""),
    ("PCI registers", {f"{PCI}/enable": "0"}, "red", "switched off", f"echo 1 | sudo tee /{PCI}/enable"),
    ("PCI registers", {f"{PCI}/enable": None}, "amber", NOT_KNOWN, "/sys"),
    ("PCI access", {}, "green", f"/{PCI}/resource2 is writable", ""),
    ("PCI access", {f"{PCI}/resource2": ReadOnly()}, "red", "not writable", UDEV_FILE),
    ("PCI access", {f"{PCI}/resource2": None}, "red", f"no /{PCI}/resource2", "slot"),
]  # fmt: skip


@pytest.fixture
def new_root(tmp_path, monkeypatch):
    """Maker of root folders of computers that differ from the good one; file modes count, for root as well."""
    monkeypatch.setattr(
        os, "access", lambda path, _mode: Path(path).exists() and Path(path).stat().st_mode & 0o200 != 0
    )

    def make(changes):
        root = tmp_path / "root"
        for path, target in LINKS.items():
            (root / path).parent.mkdir(parents=True)
            (root / target).mkdir(parents=True)
            (root / path).symlink_to(root / target)
        for path, text in {**GOOD, **changes}.items():
            if text is not None:
                (root / path).parent.mkdir(parents=True, exist_ok=True)
                (root / path).write_text(text + "\n")
                (root / path).chmod(0o444 if isinstance(text, ReadOnly) else 0o644)
        return root

    return make


@pytest.fixture
def disk(monkeypatch):
    """Sets how many bytes are free, by the end of the path."""
    free = {"": 500 * GB}

    def usage(path):
        return SimpleNamespace(free=next(free[end] for end in sorted(free, reverse=True) if str(path).endswith(end)))

    monkeypatch.setattr(shutil, "disk_usage", usage)
    return free


def find(findings, name):
    return next(finding for finding in findings if finding.name == name)


@pytest.mark.parametrize(
    ("name", "changes", "verdict", "found", "fix"),
    CASES,
    ids=[f"{number}: {name} {verdict}" for number, (name, _, verdict, *_) in enumerate(CASES)],
)
def test_each_check_distinguishes_good_from_bad(new_root, tmp_path, name, changes, verdict, found, fix):
    finding = find(examine(tmp_path, new_root(changes)), name)
    assert finding.verdict == verdict
    assert found in finding.found
    assert fix in finding.fix
    assert bool(finding.fix) == (verdict != "green")


@pytest.mark.usefixtures("disk")
def test_the_cases_cover_every_check_and_the_good_computer_is_green(new_root, tmp_path):
    findings = examine(tmp_path, new_root({}))
    names = [finding.name for finding in findings]
    assert len(set(names)) == len(names)
    assert set(names) - {"free space", "shared memory", "Python"} == {name for name, *_ in CASES}
    assert {finding.verdict for finding in findings if finding.name != "Python"} == {Rating.GREEN}


def test_a_system_without_proc_and_sys_is_not_known_and_no_error(tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    findings = examine(tmp_path, empty)
    of_linux = [finding for finding in findings if finding.name not in {"free space", "Python"}]
    assert {finding.verdict for finding in of_linux} == {Rating.AMBER}
    assert {finding.found for finding in of_linux} == {NOT_KNOWN}
    assert len(of_linux) >= 14


def test_absent_boards_are_not_checked(new_root, tmp_path):
    changes = {**NO_PCI, **NO_USB, f"{FTDI}/ttyUSB0/latency_timer": None}
    names = {finding.name for finding in examine(tmp_path, new_root(changes))}
    assert "board" in names
    assert not {name for name in names if name.startswith(("USB", "FTDI", "PCI"))}


def test_a_serial_port_that_is_not_ftdis_is_not_judged(new_root, tmp_path):
    changes = {f"{FTDI}/ttyUSB0/latency_timer": None, f"{FTDI}/ttyUSB0/port_number": "0"}
    assert "FTDI latency" not in {finding.name for finding in examine(tmp_path, new_root(changes))}


@pytest.mark.parametrize(
    ("free", "verdict", "found"),
    [
        (100 * GB, "green", "100.0 GB in {}, 46 h of recording"),
        (2_160_000_000, "green", "2.2 GB"),
        (2_159_000_000, "amber", "60 min of recording"),
        (36_000_000, "amber", "36 MB in {}, 60 s of recording"),
        (35_000_000, "red", "58 s of recording"),
    ],
)
def test_free_space_is_given_as_recording_time(new_root, disk, tmp_path, free, verdict, found):
    disk[str(tmp_path)] = free
    finding = find(examine(tmp_path, new_root({})), "free space")
    assert finding.verdict == verdict
    assert found.format(tmp_path) in finding.found
    assert ("--sessions" in finding.fix) == (verdict != "green")


@pytest.mark.parametrize(
    ("free", "verdict", "found"),
    [
        (300_000_000, "green", "300 MB in /dev/shm, 10 min of ticks"),
        (64 << 20, "amber", "67 MB in /dev/shm, 2 min of ticks"),
        (29_000_000, "red", "29 MB in /dev/shm, 58 s of ticks"),
    ],
)
def test_shared_memory_is_given_as_time_of_ticks(new_root, disk, tmp_path, free, verdict, found):
    disk["dev/shm"] = free
    finding = find(examine(tmp_path, new_root({})), "shared memory")
    assert (finding.verdict, finding.found) == (verdict, found)
    assert ("--shm-size" in finding.fix) == (verdict != "green")


def test_a_folder_that_does_not_exist_yet_is_judged_by_the_one_above(new_root, disk, tmp_path):
    disk[str(tmp_path)] = 35_000_000
    assert find(examine(tmp_path / "not" / "yet", new_root({})), "free space").verdict == "red"
    assert not (tmp_path / "not").exists()


@pytest.mark.parametrize(
    ("bytes_per_s", "verdict", "found"),
    [
        (6.0e6, "green", "6.0 MB/s, 10.0 times"),
        (5.9e6, "amber", "5.9 MB/s, 9.8 times"),
        (1.2e6, "amber", "1.2 MB/s, 2.0 times"),
        (1.1e6, "red", "1.1 MB/s, 1.8 times"),
    ],
)
def test_a_disk_is_judged_by_what_a_session_needs(bytes_per_s, verdict, found):
    judgement = judge_write_speed(bytes_per_s)
    assert judgement.verdict == verdict
    assert found in judgement.found
    assert bool(judgement.fix) == (verdict != "green")


def test_the_write_test_writes_16_mib_and_leaves_nothing_behind(tmp_path, monkeypatch):
    sizes = []
    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda number: (sizes.append(os.fstat(number).st_size), fsync(number)))
    finding = write_speed(tmp_path / "sessions")
    assert sizes == [16 << 20]
    assert finding.name == "disk speed"
    assert "MB/s" in finding.found
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_red(tmp_path, monkeypatch):
    def full(*_arguments, **_options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(doctor.tempfile, "TemporaryFile", full)
    finding = write_speed(tmp_path)
    assert finding.verdict == "red"
    assert f"{tmp_path}: nothing can be written (No space left on device)" in finding.found
    assert "--sessions" in finding.fix


@pytest.mark.parametrize(
    ("differs", "verdict", "found", "fix"),
    [
        ({}, "green", "cpython 3.13.1", ""),
        ({"debug": True}, "red", "debug build", "release build"),
        ({"debug": True, "traced": True}, "red", "debug build", "release build"),
        ({"traced": True}, "amber", "traced", "without debugger"),
        ({"development_mode": True}, "amber", "development mode", "PYTHONDEVMODE"),
        ({"free_threaded": True}, "amber", "free-threaded", "usual build"),
    ],
)
def test_python_is_judged_by_what_slows_it(differs, verdict, found, fix):
    judgement = judge_python(PythonBuild("cpython 3.13.1", **differs))
    assert judgement.verdict == verdict
    assert found in judgement.found
    assert fix in judgement.fix


def test_this_python_is_recognised(monkeypatch):
    build = python_build()
    assert build.version.endswith(sys.version.split()[0])
    assert build.debug == hasattr(sys, "gettotalrefcount")
    monkeypatch.setattr(sys, "gettrace", lambda: print)
    assert python_build().traced


def test_nothing_looks_at_the_lines_of_a_plain_python(monkeypatch):
    for name in ("gettrace", "getprofile"):
        monkeypatch.setattr(sys, name, lambda: None)
    monkeypatch.delattr(sys, "monitoring", raising=False)
    assert not python_build().traced


@pytest.mark.usefixtures("disk")
def test_findings_become_facts_of_a_session(new_root, tmp_path):
    findings = examine(tmp_path, new_root({CLOCK: "hpet"}))
    facts = as_facts(findings)
    assert facts["clock_source"] == "red: hpet: slow to read"
    assert facts["real_time_share"] == "green: 95 % of each period"
    assert facts["usb_speed"] == "green: 480 Mbit/s"
    assert len(facts) == len(findings)


@pytest.mark.parametrize(
    ("verdicts", "expected"),
    [
        ("", "green"),
        ("green", "green"),
        ("green amber green", "amber"),
        ("amber red green", "red"),
        ("red amber", "red"),
    ],
)
def test_the_overall_verdict_is_the_worst(verdicts, expected):
    assert worst(CheckResult("x", Rating(word), "") for word in verdicts.split()) == expected


@pytest.mark.parametrize(("groups", "name"), [("dialout:x:20:", "dialout"), ("uucp:x:14:", "uucp"), ("", "dialout")])
def test_the_files_to_install_name_the_group_of_this_system(new_root, groups, name):
    group = serial_group(Computer(new_root({"etc/group": groups})))
    assert group == name
    assert udev_rules(group).count(f'GROUP="{name}"') == 2
    assert f"@{name} - rtprio 90\n@{name} - memlock unlimited\n" in limits(group)


def test_only_the_ftdi_chip_that_is_named_is_set_beside_those_that_name_inteco():
    def set_by(*serial):
        rules = udev_rules("dialout", *serial).splitlines()
        return [line for line in rules if "latency_timer" in line or "ID_MM_DEVICE_IGNORE" in line]

    named = (
        'ATTR{manufacturer}=="*[Ii]',
        'ATTR{product}=="*[Rr]',
        'ATTRS{manufacturer}=="*[Ii]',
        'ATTRS{product}=="*[Rr]',
    )
    assert len(set_by()) == len(named)
    assert all(any(name in line for line in set_by()) for name in named)
    assert [line for line in set_by("A6008isP") if line not in set_by()] == [
        'ATTR{idVendor}=="0403", ATTR{serial}=="A6008isP", ENV{ID_MM_DEVICE_IGNORE}="1"',
        (
            'SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTRS{idVendor}=="0403", ATTRS{serial}=="A6008isP", '
            'ATTR{latency_timer}="1", ATTR{event_char}="0x13F"'
        ),
    ]


@pytest.mark.parametrize("serial", ['A" RUN+="x', "", "A 1", "A*", "ü", "A" * 33, "A\n"])
def test_what_cannot_be_a_serial_number_gets_into_no_rule(serial):
    with pytest.raises(ConfigError, match="--ftdi-serial"):
        check_serial(serial)


def test_the_udev_rules_jump_only_forward_to_labels_that_exist():
    seen, waiting = set(), set()
    for line in udev_rules("dialout").splitlines():
        for part in line.split(", "):
            key, _, value = part.partition("=")
            if key == "GOTO":
                assert value not in seen
                waiting.add(value)
            if key == "LABEL":
                seen.add(value)
    assert waiting
    assert waiting == seen


def test_every_rule_is_pairs_of_key_operator_and_quoted_value():
    rules = [line for line in udev_rules("dialout").splitlines() if line and not line.startswith("#")]
    assert len(rules) >= 8
    for rule in rules:
        for part in rule.split(", "):
            key, _, value = part.partition('"')
            assert key.rstrip("=!+").isidentifier() or key.partition("{")[0] in {"ENV", "ATTR", "ATTRS"}
            assert key.endswith("=")
            assert value.count('"') == 1
            assert value.endswith('"')
