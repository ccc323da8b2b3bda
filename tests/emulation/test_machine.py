"""What keeps a guest's process from outliving the tests that started it."""

import signal
import subprocess
import sys
import time
from pathlib import Path

from guest.machine import output_of

WAITING = "import sys; sys.path[:0] = {path!r}; from guest.machine import output_of; output_of({command!r}, 100.0)"


def sleeping(mark):
    """Whether `sleep` itself runs: by then, what started it has bound it to its parent."""
    wanted = f"sleep\0{mark}\0".encode()
    for entry in Path("/proc").iterdir():
        try:
            if (entry / "cmdline").read_bytes() == wanted:
                return True
        except OSError:
            continue
    return False


def ends(condition):
    end = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_guest_ends_with_the_tests_that_are_killed():
    mark = f"98765.{time.monotonic_ns()}"
    code = WAITING.format(path=[path for path in sys.path if path], command=["sleep", mark])
    tests = subprocess.Popen([sys.executable, "-c", code])
    ends(lambda: sleeping(mark) and tests.poll() is None)
    tests.send_signal(signal.SIGKILL)
    tests.wait()
    ends(lambda: not sleeping(mark))


def test_a_guest_that_takes_too_long_leaves_its_output():
    mark = f"98765.{time.monotonic_ns()}"
    assert output_of(["sh", "-c", f"echo begun; exec sleep {mark}"], 1.0) == "begun\n"
    ends(lambda: not sleeping(mark))


def test_errors_are_among_what_a_guest_has_said():
    assert output_of(["sh", "-c", "echo one; echo two >&2"], 20.0) == "one\ntwo\n"
