import json
import os
import signal
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.realtime import tuning as machine
from inteco_abs.realtime.tuning import (
    CONTROLLER_PRIORITY,
    GUARDIAN_PRIORITY,
    LOOP_PRIORITY,
    Core,
    Setting,
    Tuning,
    apply,
    controller_tuning,
    cores_of,
    isolated_cpus,
    loop_cpus,
    loop_tuning,
    other_cpus,
    parse_cpus,
)

CPUS = st.sets(st.integers(0, 40))


def kernel_list(cpus):
    """The kernel's way to write a set of CPUs."""
    parts, left = [], sorted(cpus)
    while left:
        last = next((i for i in range(len(left)) if left[i] != left[0] + i), len(left))
        parts.append(str(left[0]) if last == 1 else f"{left[0]}-{left[last - 1]}")
        left = left[last:]
    return ",".join(parts)


class TestCpus:
    @pytest.mark.parametrize(
        ("text", "cpus"),
        [
            ("", set()),
            ("0", {0}),
            ("0-3", {0, 1, 2, 3}),
            ("0,2-3", {0, 2, 3}),
            ("2,4-5,9", {2, 4, 5, 9}),
            ("7-7", {7}),
            ("11,0-1,", {0, 1, 11}),
        ],
    )
    def test_a_list_of_the_kernels_is_a_set_of_numbers(self, text, cpus):
        assert parse_cpus(text) == cpus

    @given(CPUS)
    def test_any_set_that_the_kernel_may_write_is_read(self, cpus):
        assert parse_cpus(kernel_list(cpus)) == cpus

    @pytest.mark.parametrize(("content", "cpus"), [("\n", set()), ("2,4-5\n", {2, 4, 5})])
    def test_isolated_cpus_are_those_in_the_kernels_file(self, tmp_path, content, cpus):
        (tmp_path / "isolated").write_text(content)
        assert isolated_cpus(tmp_path / "isolated") == cpus

    def test_a_kernel_without_that_file_isolates_none(self, tmp_path):
        assert isolated_cpus(tmp_path / "isolated") == set()

    @pytest.mark.parametrize(
        ("allowed", "isolated", "loop", "others"),
        [
            ({0}, set(), set(), {0}),
            ({0, 1}, set(), {1}, {0}),
            ({0, 1, 2, 3}, set(), {3}, {0, 1, 2}),
            ({2, 5}, set(), {5}, {2}),
            ({0, 1, 2}, {3}, {3}, {0, 1, 2}),
            ({0, 1}, {2, 3}, {3}, {0, 1}),
            ({0, 1, 2, 3}, {2}, {2}, {0, 1, 3}),
            ({0}, {1}, {1}, {0}),
            ({1}, {1}, {1}, {1}),
            (set(), set(), set(), set()),
        ],
    )
    def test_the_loop_gets_an_isolated_cpu_or_the_last_and_all_else_the_rest(self, allowed, isolated, loop, others):
        assert loop_cpus(allowed, isolated) == loop
        assert other_cpus(allowed, isolated) == others

    @pytest.mark.parametrize(
        ("isolated", "loop", "others"),
        [
            (set(), {1}, {0, 2, 4, 6}),
            ({2, 6}, {6}, {0, 1, 4, 5}),
            ({4, 2, 6}, {6}, {0, 1, 5}),
            ({0, 4}, {4}, {1, 2, 5, 6}),
        ],
    )
    def test_the_loops_cpu_is_fast_and_nothing_of_the_run_is_on_its_hyper_thread(self, isolated, loop, others):
        threads = {0: (0,), 1: (1, 5), 2: (2, 6), 4: (4,)}
        cores = {cpu: Core(4000 if cpu == 1 else 3000, frozenset(of)) for of in threads.values() for cpu in of}
        allowed = set(cores) - isolated
        assert loop_cpus(allowed, isolated, cores) == loop
        assert other_cpus(allowed, isolated, cores) == others

    def test_the_kernels_facts_of_a_cpu_may_be_missing(self, tmp_path):
        for name, text in (("cpu0/cpufreq/cpuinfo_max_freq", "4900000"), ("cpu1/cpu_capacity", "512")):
            (tmp_path / name).parent.mkdir(parents=True)
            (tmp_path / name).write_text(f"{text}\n")
        (tmp_path / "cpu0/topology").mkdir()
        (tmp_path / "cpu0/topology/thread_siblings_list").write_text("0,2\n")
        (tmp_path / "cpu2").mkdir()
        found = {0: Core(4_900_000, frozenset({0, 2})), 1: Core(512), 2: Core()}
        assert cores_of(tmp_path) == found

    @given(allowed=CPUS.filter(bool), isolated=CPUS)
    def test_the_loop_never_shares_its_cpu_where_there_is_another(self, allowed, isolated):
        loop, others = loop_cpus(allowed, isolated), other_cpus(allowed, isolated)
        assert others
        assert others <= allowed
        assert len(loop) <= 1
        assert loop <= allowed | isolated
        if len(allowed | isolated) > 1 and allowed != loop:
            assert not loop & others


def refuse(error):
    def ask():
        raise error

    return ask


class TestPrepare:
    @pytest.mark.parametrize(
        ("error", "reason"),
        [
            (PermissionError(1, "Operation not permitted"), "Operation not permitted"),
            (OSError(None, "there is one CPU only"), "there is one CPU only"),
            (AttributeError("no such call"), "no such call"),
            (ValueError("signal number out of range"), "signal number out of range"),
        ],
        ids=lambda value: type(value).__name__,
    )
    def test_refused_setting_is_reported_and_stops_no_other(self, error, reason):
        asked = []
        tunings = [
            Tuning("first", lambda: asked.append(1) or "one", "never needed"),
            Tuning("second", refuse(error), "raise the limit"),
            Tuning("third", lambda: asked.append(3) or "three", "never needed"),
        ]
        assert apply(tunings) == [
            Setting("first", "one"),
            Setting("second", "default", f"{reason}: raise the limit"),
            Setting("third", "three"),
        ]
        assert asked == [1, 3]

    def test_a_mistake_of_the_programs_own_is_not_mistaken_for_a_refusal(self):
        with pytest.raises(ZeroDivisionError):
            apply([Tuning("wrong", lambda: str(1 // 0), "")])


CHILD = """
import ctypes, gc, json, os, signal, sys
from pathlib import Path
from inteco_abs.realtime import tuning as machine
garbage = [[] for _ in range(100)]
settings = machine.apply(getattr(machine, sys.argv[1])())
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
descriptors = [os.readlink(f"/proc/self/fd/{name}") for name in os.listdir("/proc/self/fd") if int(name) > 2
               and os.path.exists(f"/proc/self/fd/{name}")]
print(json.dumps({
    "settings": settings,
    "policy": os.sched_getscheduler(0),
    "priority": os.sched_getparam(0).sched_priority,
    "cpus": sorted(os.sched_getaffinity(0)),
    "blocked": sorted(signal.pthread_sigmask(signal.SIG_BLOCK, [])),
    "collecting": gc.isenabled(),
    "frozen": gc.get_freeze_count(),
    "slack_ns": ctypes.CDLL(None).prctl(30, 0, 0, 0, 0),
    "locked_kb": int(status["VmLck"].split()[0]),
    "resident_kb": int(status["VmRSS"].split()[0]),
    "oom": int(Path("/proc/self/oom_score_adj").read_text()),
    "files": descriptors,
}))
"""
NAMES = {
    "loop_tuning": [
        "affinity", "signals", "malloc", "memory", "timer slack", "scheduler", "heap", "C-states", "garbage",
    ],
    "controller_tuning": ["affinity", "signals", "malloc", "memory", "timer slack", "scheduler", "garbage"],
    "guardian_tuning": [
        "affinity", "signals", "malloc", "memory", "timer slack", "scheduler", "out of memory", "garbage",
    ],
    "recorder_tuning": ["affinity", "signals"],
}  # fmt: skip


@pytest.fixture(scope="module")
def prepared():
    """What each kind of process has asked for, and what it found to be so afterwards; in a process of its own."""

    def look(tunings):
        command = [sys.executable, "-c", CHILD, tunings]
        process = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        found = json.loads(process.stdout)
        return {name: (value, refused) for name, value, refused in found.pop("settings")}, found

    if not sys.platform.startswith("linux"):
        pytest.skip("settings of Linux")
    return {tunings: look(tunings) for tunings in NAMES}


@pytest.fixture
def granted(prepared, tunings):
    """Value of a tuning and the state of the process; skips where the tuning was refused."""

    def state(name):
        settings, found = prepared[tunings]
        value, refused = settings[name]
        if refused:
            pytest.skip(f"refused here: {refused}")
        return value, found

    return state


every_process = pytest.mark.parametrize("tunings", NAMES)
real_time_processes = pytest.mark.parametrize("tunings", ["loop_tuning", "controller_tuning", "guardian_tuning"])
the_loop = pytest.mark.parametrize("tunings", ["loop_tuning"])
the_guardian = pytest.mark.parametrize("tunings", ["guardian_tuning"])


class TestProcesses:
    @pytest.mark.untraced
    @every_process
    def test_every_setting_is_reported_with_its_value_or_why_not(self, prepared, tunings):
        settings, _ = prepared[tunings]
        assert list(settings) == NAMES[tunings]
        for value, refused in settings.values():
            assert value
            assert (value == "default") == bool(refused)

    @pytest.mark.untraced
    @every_process
    def test_every_refusal_says_what_to_do(self, prepared, tunings):
        settings, _ = prepared[tunings]
        for _, refused in settings.values():
            assert not refused or (refused.partition(": ")[0] and refused.partition(": ")[2])

    @every_process
    def test_signals_are_blocked_but_those_of_a_crash(self, granted):
        _, found = granted("signals")
        never = {signal.SIGKILL, signal.SIGSTOP, signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE}
        wanted = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP, signal.SIGALRM}
        assert wanted <= set(found["blocked"])
        assert not never & set(found["blocked"])

    @real_time_processes
    def test_the_scheduler_is_the_one_for_real_time(self, granted, tunings):
        value, found = granted("scheduler")
        names = {"loop_tuning": LOOP_PRIORITY, "controller_tuning": CONTROLLER_PRIORITY}
        priority = names.get(tunings, GUARDIAN_PRIORITY)
        assert found["policy"] & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
        assert (found["priority"], value) == (priority, f"SCHED_FIFO {priority}")

    @every_process
    def test_the_process_keeps_to_its_cpus(self, granted, tunings):
        _, found = granted("affinity")
        allowed, isolated = os.sched_getaffinity(0), isolated_cpus()
        choose = loop_cpus if tunings in {"loop_tuning", "controller_tuning"} else other_cpus
        assert set(found["cpus"]) == choose(allowed, isolated)

    @real_time_processes
    def test_the_garbage_collector_is_frozen(self, granted):
        _, found = granted("garbage")
        assert not found["collecting"]
        assert found["frozen"] > 1000

    @real_time_processes
    def test_memory_is_locked(self, granted):
        _, found = granted("memory")
        assert found["locked_kb"] > 0

    @pytest.mark.untraced
    def test_beside_llvm_memory_is_locked_where_it_was_touched(self):
        command = [sys.executable, "-c", f"import llvmlite.binding\n{CHILD}", "loop_tuning"]
        found = json.loads(subprocess.run(command, capture_output=True, timeout=60, check=True).stdout)
        ((_, value, refused),) = (each for each in found["settings"] if each[0] == "memory")
        if refused:
            pytest.skip(f"refused here: {refused}")
        assert value == "locked where touched"
        assert found["resident_kb"] < found["locked_kb"] / 2  # the kernel counts what may be locked

    @real_time_processes
    def test_timers_have_no_slack(self, granted):
        _, found = granted("timer slack")
        assert found["slack_ns"] <= 1  # newer kernels show none for real-time processes

    @the_loop
    def test_the_file_that_forbids_deep_sleep_stays_open(self, granted):
        _, found = granted("C-states")
        assert "/dev/cpu_dma_latency" in found["files"]

    @the_guardian
    def test_it_is_killed_last_when_memory_runs_out(self, granted):
        _, found = granted("out of memory")
        assert found["oom"] == -1000

    def test_a_recorder_stays_an_ordinary_process(self, prepared):
        _, found = prepared["recorder_tuning"]
        assert found["policy"] == os.SCHED_OTHER
        assert found["collecting"]
        assert found["oom"] == prepared["loop_tuning"][1]["oom"]


def test_a_process_that_spins_on_the_only_cpu_can_still_be_ended():
    assert GUARDIAN_PRIORITY > LOOP_PRIORITY > CONTROLLER_PRIORITY


@pytest.mark.untraced
@pytest.mark.parametrize("allowed", [GUARDIAN_PRIORITY, GUARDIAN_PRIORITY - 1])
@pytest.mark.parametrize(
    ("tunings", "priority"), [(loop_tuning, LOOP_PRIORITY), (controller_tuning, CONTROLLER_PRIORITY)]
)
def test_a_process_without_permission_for_its_watchers_priority_stays_ordinary(tunings, priority, allowed, monkeypatch):
    asked, granted = [], os.SCHED_OTHER

    def schedule(_pid, policy, param):
        nonlocal granted
        asked.append(param.sched_priority)
        if param.sched_priority > allowed:
            raise PermissionError(1, "Operation not permitted")
        granted = policy

    monkeypatch.setattr(os, "sched_setscheduler", schedule)
    (tuning,) = (tuning for tuning in tunings() if tuning.name == "scheduler")
    (setting,) = apply([tuning])
    if allowed == GUARDIAN_PRIORITY:
        assert (setting.value, asked[-1]) == (f"SCHED_FIFO {priority}", priority)
    else:
        assert granted == os.SCHED_OTHER
        assert "raise rtprio to 90" in setting.refused


@pytest.mark.parametrize(
    "tunings",
    [machine.guardian_tuning, machine.recorder_tuning, machine.supervisor_tuning, machine.watch_tuning],
)
def test_processes_beside_the_loop_avoid_its_core_even_if_it_is_not_the_last(tunings, monkeypatch):
    cores = {cpu: machine.Core(3_000_000 if cpu < 2 else 2_000_000, frozenset({cpu, cpu ^ 1})) for cpu in range(4)}
    monkeypatch.setattr(machine, "isolated_cpus", set)
    monkeypatch.setattr(machine, "cores_of", lambda: cores)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(cores))
    asked = []
    monkeypatch.setattr(os, "sched_setaffinity", lambda _pid, cpus: asked.append(cpus))
    for made in (machine.loop_tuning, tunings):
        next(tuning for tuning in made() if tuning.name == "affinity").ask()
    assert asked == [{1}, {2, 3}]
