"""The tests of this folder again, with the firmware built another way; static analysis."""

import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from emulated import require
from host_board import FIRMWARE, built

RUN = partial(subprocess.run, capture_output=True, text=True, check=False, timeout=600)
HERE = Path(__file__).parent
TESTS = ["test_open_logic.py", "test_vendor_logic.py", "test_time_to_off.py", "test_differential.py"]


def run_tests(library, **environment):
    """Run the tests with this library."""
    words = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-n0",
        "-p",
        "no:cacheprovider",
        *(str(HERE / name) for name in TESTS),
    ]
    done = RUN(words, env={**os.environ, "HOST_BOARD": str(library), **environment}, cwd=HERE.parents[1])
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.long
def test_with_sanitizers():
    runtime = RUN(["cc", "-print-file-name=libasan.so"]).stdout.strip()
    run_tests(built("build/host/sanitized.so"), LD_PRELOAD=runtime, ASAN_OPTIONS="detect_leaks=0")


@pytest.mark.long
def test_the_tests_take_every_branch_of_the_core_both_ways():
    library = built("build/host/covered.so")
    for counts in library.parent.glob("*.gcda"):
        counts.unlink()
    run_tests(library)
    missed, branches = [], 0
    for source in sorted((FIRMWARE / "core").glob("*.c")):
        notes = library.with_name(f"{library.name}-{source.stem}.gcda")
        report = RUN(["gcov", "--json-format", "--stdout", "--branch-probabilities", str(notes)], cwd=FIRMWARE).stdout
        for file in json.loads(report)["files"]:
            for line in file["lines"]:
                branches += len(line["branches"])
                if not line["count"] or not all(branch["count"] for branch in line["branches"]):
                    missed.append(f"{file['file']}:{line['line_number']}")
    assert missed == []
    assert branches > 200


@pytest.mark.long
def test_static_analysis():
    require("cc", "make", "cppcheck")
    done = RUN(["make", "-C", str(FIRMWARE), "check"])
    assert done.returncode == 0, done.stdout + done.stderr
