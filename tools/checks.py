"""The steps of tools/check: what needs no quiet computer runs in parallel with the tests; a table of all ends it.

tools/check sets up the environment and runs this file in it: python tools/checks.py [--long].

Tests that keep real time, or wait for a process, can fail on a computer that is busy with the other tests. A few failed
tests, `Check.most_again`, run once more when nothing else does; the check passes only if they pass then, and names
them in its last lines. More failures than that are final, and so is what no busy computer causes: an
error of collection or of a teardown, a test that ends its process.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

KEPT = Path(".pytest_cache/v")
CORES = len(os.sched_getaffinity(0))
NICENESS = 19
TESTS_FAILED = 1
"""Exit code of pytest when tests ran and some of them failed."""


class Part(NamedTuple):
    """One part of the check that has ended."""

    name: str
    result: str
    wall_s: float
    cpu_s: float


class Check:
    """Runs parts and keeps how they ended.

    A quick check has one worker more than cores, as tests that wait for processes leave theirs idle. A long one has
    hundreds of runs in real time, each of which the other tests may make late, and time to try them again.
    """

    def __init__(self, *, long: bool = False) -> None:
        # coverage measures the tests, as mutation does: it takes a fifth of their time, and changes little by a day
        self.tracer = ("-m", "coverage", "run") if long else ()
        self.workers, self.most_again = (CORES, 100) if long else (CORES + 1, 5)
        self.start_s = time.monotonic()
        self.parts: list[Part] = []
        self.unsteady: list[str] = []

    def run(self, name: str, *command: str, background: bool = False) -> int:
        """Run one part; one in the `background` has low priority and prints its output at its end."""
        start_s = time.monotonic()
        with tempfile.TemporaryFile() as said:
            output = said if background else None
            if not background:
                print(f"== {name}", flush=True)
            words = ["nice", f"-n{NICENESS if background else 0}", *command]
            process = subprocess.Popen(words, stdout=output, stderr=output)
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = code = os.waitstatus_to_exitcode(status)
            if background:
                said.seek(0)
                print(f"\n== {name}\n{said.read().decode(errors='replace')}", end="", flush=True)
        wall_s = time.monotonic() - start_s
        self.parts.append(Part(name, "passed" if code == 0 else "FAILED", wall_s, usage.ru_utime + usage.ru_stime))
        return code

    def tests(self, name: str, selection: str, *, others: Future[None]) -> None:
        """Run the selected tests on all cores, and those that failed again when the `others` have ended."""
        # tests of one group stay on one worker: real-time runs would be each other's load
        parallel = ("-n", str(self.workers), "--dist", "loadgroup", "--cache-clear")
        pytest = "-m", "pytest", "-q", "-m", selection
        code = self.run(name, sys.executable, *self.tracer, *pytest, *parallel)
        others.result()  # raises what kept them from running
        failed = unsteady_tests() if code == TESTS_FAILED else []
        if not 0 < len(failed) <= self.most_again:
            return
        # without the tracer, which alone makes runs in real time late
        if self.run(f"{name}, failed ones alone", sys.executable, *pytest, "-n", "0", *failed) == 0:
            self.parts = [part._replace(result="passed") if part.name == name else part for part in self.parts]
            self.unsteady += failed

    def report(self) -> int:
        """Print the table and how it all ended."""
        print(f"\n{'part':40} {'result':8} {'wall s':>7} {'CPU s':>7}")
        for part in self.parts:
            print(f"{part.name:40} {part.result:8} {part.wall_s:7.1f} {part.cpu_s:7.1f}")
        cpu_s = sum(part.cpu_s for part in self.parts)
        print(f"{'all':40} {'':8} {time.monotonic() - self.start_s:7.1f} {cpu_s:7.1f}")
        if self.unsteady:
            print("passed alone, but failed together with other tests:", *self.unsteady, sep="\n  ")
        failed = [part.name for part in self.parts if part.result == "FAILED"]
        print(f"FAILED: {', '.join(failed)}" if failed else "all checks passed", flush=True)
        return len(failed) > 0


def unsteady_tests(kept: Path = KEPT) -> list[str]:
    """Tests that failed in the last run and may pass alone, without the groups that pytest-xdist adds to them."""
    # tests/conftest.py keeps the second list; tests elsewhere have none
    files = kept / "cache/lastfailed", kept / "check/final"
    failed, final = (json.loads(file.read_text(encoding="utf-8")) if file.exists() else [] for file in files)
    return [] if final else [re.sub(r"@[^\]]*$", "", name) for name in failed]


def main(arguments: list[str]) -> int:
    long = arguments == ["--long"]
    check = Check(long=long)

    def in_the_background() -> None:
        check.run("format", "ruff", "format", "--check", "--quiet", ".", background=True)
        check.run("lint", "ruff", "check", "--quiet", ".", background=True)
        check.run("types", "mypy", background=True)
        check.run("import order", "lint-imports", "--no-logo", background=True)
        check.run("protocol reference", "python", "-m", "firmware_protocol.reference", "--check", background=True)
        check.run("firmware tables", "python", "-m", "firmware_protocol.c_header", "--check", background=True)
        check.run("hazards", "python", "tools/write_hazards", "--check", background=True)
        check.run("faults", "python", "tools/fault_campaign", *arguments, background=True)
        check.run("fuzzing", "python", "tools/fuzz", "30" if long else "--drawn", background=True)

    if long:
        subprocess.run(["coverage", "erase"], check=True)
    pool = ThreadPoolExecutor(1)
    others = pool.submit(in_the_background)
    if long:  # more of its tests keep real time, and it has time
        others.result()
    check.tests("tests", "" if long else "not long", others=others)
    if long:
        check.run("coverage of all processes", "coverage", "combine", "--quiet")
        check.run("coverage", "coverage", "report")
        # fifteen of each module's mutants; it judges by time, too, and wants the computer alone
        check.run("mutation", "python", "tools/mutate", "--sample", "15")
    return check.report()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
