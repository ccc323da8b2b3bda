"""What a submission may try: nothing that it does changes its grade, and the truth is out of its reach."""

import sys
from dataclasses import replace

import pytest

from inteco_abs.course.grading import exercises, grade
from inteco_abs.course.submission import Submission, SubmissionError

pytestmark = [
    pytest.mark.xdist_group("compiled"),
    pytest.mark.skipif(sys.platform != "linux", reason="submissions are confined on Linux only"),
]
ALLOWED = exercises()["pi"].may_import
ATTEMPTS = """
import ctypes, os, socket, subprocess
PARENT = os.getppid()
LIBC = ctypes.CDLL(None, use_errno=True)


def called(result):
    if result < 0:
        raise OSError(ctypes.get_errno(), "refused")


def read_memory():
    pointer, size = ctypes.create_string_buffer(8), 8
    class Part(ctypes.Structure):
        _fields_ = [("base", ctypes.c_void_p), ("length", ctypes.c_size_t)]
    here, there = Part(ctypes.addressof(pointer), size), Part(id(None), size)
    called(LIBC.process_vm_readv(PARENT, ctypes.byref(here), 1, ctypes.byref(there), 1, 0))


ATTEMPTS = {
    "memory by /proc": lambda: open(f"/proc/{PARENT}/mem", "rb"),
    "command line": lambda: open(f"/proc/{PARENT}/cmdline"),
    "environment": lambda: open(f"/proc/{PARENT}/environ"),
    "memory by a call": read_memory,
    "memory by tracing": lambda: called(LIBC.ptrace(16, PARENT, 0, 0)),
    "shared memory": lambda: os.listdir("/dev/shm"),
    "solutions": lambda: open("SOLUTION"),
    "another program": lambda: subprocess.run(["cat", "SOLUTION"], check=True, capture_output=True),
    "writing": lambda: open("WRITTEN", "w"),
    "killing the grader": lambda: os.kill(PARENT, 0),
    "network": lambda: socket.create_connection(("127.0.0.1", PORT), 1.0),
    "endless memory": lambda: bytearray(8 << 30),
}
for name, attempt in ATTEMPTS.items():
    try:
        attempt()
    except (OSError, MemoryError, subprocess.CalledProcessError):
        continue
    print("WORKED:", name)
print("all tried")
"""
LAW = """
from inteco_abs.signals import BrakeDemand
class Law:
    gains = internals = ()
    def __init__(self, setup):
        {made}
    def update(self, estimate, dt_s):
        {updated}
        return BrakeDemand(0.6)
"""
GUESSING = """
from importlib import import_module
from inteco_abs.signals import BrakeDemand
rig, plant = import_module("inteco_abs.rig"), import_module("inteco_abs.rig.plant")
class Law:
    gains = internals = ()
    drawn = 0
    def __init__(self, setup):
        self.plant = rig.Plant(rig.draw("hard", Law.drawn), 181.0, 180.0)
        Law.drawn += 1
    def update(self, estimate, dt_s):
        duty = 0.75 if self.plant.slip < 0.2 else 0.45  # a law on the truth of the rig that it takes for this one
        self.plant.advance(0.0, duty, dt_s)
        return BrakeDemand(duty)
"""
PATCHING = """
import gc, json, math, sys
from importlib import import_module
submission, exercise = import_module("inteco_abs.course.submission"), import_module("inteco_abs.course.exercise")
submission.Submission.ask = submission.Submission.number = lambda *given: 0.0
exercise.exercises = lambda: {}
exercise.Limit.most = math.inf
json.load = lambda *given: {"passed": True}
for each in gc.get_objects():
    if isinstance(each, dict) and "most" in each:
        each["most"] = math.inf
frame = sys._getframe()
while frame is not None:
    frame.f_globals.update(passed=True, score=100)
    frame = frame.f_back
print('\\x1b[2J{"passed": true, "score": 100}')
"""
FORGING = """
import os
for pipe in range(3, 9):
    try:
        os.write(pipe, b'{"passed": true, "score": 100}' * 3)
    except OSError:
        pass
"""


@pytest.fixture
def graded(tmp_path):
    """Grades a source as a submission to an exercise with few cases."""

    def run(source, name="pi", cases=2):
        (tmp_path / "file.py").write_text(source)
        return grade(replace(exercises()[name], cases=cases), tmp_path / "file.py", seed=1)

    return run


def test_neither_memory_nor_files_nor_network_of_the_grader_can_be_reached(tmp_path):
    solution = __file__.replace("test_cheats.py", "solutions/pi.py")
    source = ATTEMPTS.replace("SOLUTION", solution).replace("WRITTEN", str(tmp_path / "written"))
    source = source.replace("PORT", "9") + "class Law:\n    gains = internals = ()\n"
    with Submission("file.py", source, "Law", [], 10) as submission:
        held = set(submission.confined)
    assert {"files", "memory of other processes", "network", "time and memory"} <= held
    printed = [line for line in submission.printed if "signals" in held or line != "WORKED: killing the grader"]
    assert printed == ["all tried"]
    assert not (tmp_path / "written").exists()


@pytest.mark.long
def test_a_plant_of_a_guessed_seed_is_another_rig(graded):
    found = graded(GUESSING, cases=1)
    assert not found.failure
    assert not found.passed
    assert found.score < 30


@pytest.mark.long
def test_what_it_patches_is_its_own_copy_and_what_it_prints_is_no_grade(graded):
    found = graded(PATCHING + LAW.format(made="pass", updated="pass"), cases=1)
    assert not found.failure
    assert (found.passed, found.score) == (False, 0)
    assert '\\x1b[2J{"passed": true, "score": 100}' in found.printed


@pytest.mark.parametrize(
    ("source", "problem"),
    [
        (FORGING, "has written into the pipe of its answers"),
        ("from inteco_abs.control import PI as Law", "line 1 imports inteco_abs.control.PI: this exercise may import"),
        ("class Other: pass", "it has no Law, which this exercise asks for"),
        ("class Law: pass", "Law has no method update(estimate, dt_s)"),
        ("x = (", "SyntaxError: '(' was never closed, line 1"),
        (LAW.format(made="1 / 0", updated="pass"), "ZeroDivisionError: division by zero, line 6"),
        (LAW.format(made="pass", updated="return BrakeDemand(float('nan'))"), "is nan: must be a finite number"),
        (LAW.format(made="pass", updated="return 'full'"), "is 'full': must be a number"),
    ],
)  # fmt: skip
def test_a_file_that_fails_says_why(source, problem):
    with pytest.raises(SubmissionError) as raised:
        first_demand(source)
    assert problem in str(raised.value)


def first_demand(source):
    with Submission("file.py", source, "Law", ALLOWED, 5) as submission:
        submission.ask("controller", 0.2, 5.0)
        submission.number("demand", 0.0005, 180.0, 180.0, 0.0, True, None)


def test_a_file_that_fails_is_not_passed_and_has_no_score(graded):
    found = graded("import os\nos._exit(0)", cases=1)
    assert found.missing == ("has ended its own process: exit code 0",)
    assert (found.passed, found.score, found.measured) == (False, 0, None)


@pytest.mark.long
@pytest.mark.parametrize(
    ("source", "problem"),
    [
        ("while True: pass", "was killed: it may compute for 1 s"),
        ("import os\nos.kill(os.getpid(), 9)", "was killed: it may compute for 1 s"),
        ("import time\ntime.sleep(1e6)", "was killed: it has not come to an end within 5 s"),
    ],
)
def test_endless_computing_and_sleeping_end(source, problem):
    killed = pytest.raises(SubmissionError, match=problem)
    with killed, Submission("file.py", source, "Law", [], 1):
        pass


def test_an_interval_without_end_scores_nothing(graded):
    everything = dict.fromkeys(("r1/r2", "d/J", "M0/J", "B", "lag", "dead time"), (0.0, -1e6, 1e6))
    found = graded(f"def identify(sessions, counts_per_turn, parameters): return {everything}", "identification", 1)
    assert (found.passed, found.score) == (False, 0)


def test_a_monitor_that_cries_wolf_scores_nothing(graded):
    wolf = "class Monitor:\n    def __init__(self, *given): pass\n    def update(self, *given): return 'road-stuck'"
    found = graded(wolf, "faults", 3)
    assert (found.passed, found.score) == (False, 0)
    assert "false alarms: at most 0, kept in 0 of 3" in found.missing[0]
