"""A user's controller in its own process: the same bits, and a clear error when it fails in any way."""

import math
import subprocess
import sys
import time
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import pytest

from inteco_abs.config import load_config
from inteco_abs.control import Gain, make_controller, set_gain
from inteco_abs.errors import BoardError, ConfigError, ControllerError
from inteco_abs.plugins import Controllers, Origin, load_controller
from inteco_abs.realtime.processes import controller as isolated
from inteco_abs.realtime.processes.controller import IsolatedController
from inteco_abs.signals import Estimate, Prediction
from inteco_abs.source_files import SourceFiles

LAW = """
import math, os, signal, sys, threading, time
from inteco_abs.control import Gain
from inteco_abs.signals import BrakeDemand
{}
class Law:
    gains = (Gain("duty", 0.7, 0.0, 1.0, "1", "of the brake"),)
    internals = ("calls", "road")
    calls = 0
    def __init__(self, setup, duty):
        self.setup, self.duty = setup, duty
        {}
    def update(self, estimate, dt_s):
        self.calls += 1
        {}
        at = estimate.outlook
        total = math.fsum(at) if at else 0.0
        seen = (self.calls, estimate.road_speed_rad_s, estimate.wheel_speed_rad_s, estimate.valid)
        return BrakeDemand(self.duty / 3, estimate.slip / dt_s, total, seen)
"""
NAME = "law.py:Law"
HERE = Path("of-no-run.ring")
CONFIG = load_config()
FORGE = """
for fd in range(3, 9):
    try:
        os.write(fd, bytes(64))
    except OSError:
        pass
"""
"""As many bytes as an answer has."""
OUTLOOK = Prediction(*(math.pi / n for n in range(1, 11)))
ESTIMATES = [
    Estimate(171.3, 164.2, 0.1, valid=True),
    Estimate(1 / 3, 2 / 3, 1 / 7, valid=True, outlook=OUTLOOK),
    Estimate(0.0, -0.0, math.inf, valid=False),
]


@pytest.fixture
def patient(monkeypatch):
    """Waits for seconds: this computer is shared, and a traced process writes down what was covered before it ends."""
    monkeypatch.setattr(isolated, "_LOOKS", range(1000))


@pytest.fixture
def isolate():
    """Starts the process of a controller: `LAW` with statements at its import, in its constructor, in its update."""
    started = []

    def start(asked="pass", made="pass", imported=""):
        source = LAW.format(imported, made, asked).encode()
        started.append(IsolatedController(NAME, source, HERE))
        return started[-1], {NAME: started[-1]}

    yield start
    for process in started:
        process.close()


@pytest.fixture
def law(isolate):
    """Makes that controller."""

    def make(*statements, **keywords):
        process, controllers = isolate(*statements, **keywords)
        return process, make_controller(named(), controllers)

    return make


def named():
    return replace(CONFIG, controller=replace(CONFIG.controller, name=NAME))


def here():
    """The same controller in this process."""
    kind, source = load_controller(NAME, LAW.format("", "pass", "pass").encode())
    return make_controller(named(), Controllers({NAME: (kind, Origin(source))}))


def failure(controller):
    with pytest.raises(ControllerError) as caught:
        controller.update(ESTIMATES[0], 5e-4)
    return str(caught.value)


def gone(process):
    return process._process.poll() is not None


@pytest.mark.usefixtures("patient")
def test_it_answers_with_the_same_bits_as_in_this_process(law):
    (process, far), near = law(), here()
    for estimate in ESTIMATES:
        answer, expected = far.update(estimate, 1 / 1999), near.update(estimate, 1 / 1999)
        assert answer == expected
        assert all(type(value) is float for value in (*answer[:3], *answer.internals))
    assert process.gains == (Gain("duty", 0.7, 0.0, 1.0, "1", "of the brake"),)
    assert [each.name for each in process.internals] == ["calls", "road"]


@pytest.mark.usefixtures("patient")
def test_it_gets_the_reference_of_now_and_so_does_its_copy(isolate):
    _, controllers = isolate("return BrakeDemand(self.reference)")
    following = replace(named().controller, reference_points=[0.3, 0.1], reference_at_rad_s=[20.0, 60.0])
    first = make_controller(replace(named(), controller=following), controllers)
    for _ in range(2):
        controller = deepcopy(first)
        brakes = [controller.update(Estimate(speed, speed, 0.0, True), 5e-4).brake for speed in (90.0, 40.0, 10.0)]
        assert brakes == [0.1, pytest.approx(0.2), 0.3]


@pytest.mark.usefixtures("patient")
def test_a_gain_that_it_keeps_changes_there_and_in_its_copies(law):
    _, first = law(asked="return BrakeDemand(self.duty)", made="self.reference = setup.reference_slip")
    copy = deepcopy(first)
    assert first.keeps_gain("duty", 0.7)
    assert first.keeps_gain("reference_slip", 0.2)
    set_gain(first, "duty", 0.25)
    assert [each.update(ESTIMATES[0], 5e-4).brake for each in (first, copy)] == [0.25, 0.7]
    assert deepcopy(first).update(ESTIMATES[0], 5e-4).brake == 0.25


@pytest.mark.usefixtures("patient")
def test_gain_that_the_class_converts_and_unread_reference_cannot_change(law):
    _, controller = law(made="self.duty = duty / 2")
    assert not controller.keeps_gain("duty", 0.7)
    assert not controller.keeps_gain("reference_slip", 0.2)


@pytest.mark.usefixtures("patient")
def test_the_reference_that_changes_reaches_it(law):
    _, controller = law(asked="return BrakeDemand(self.reference)", made="self.reference = setup.reference_slip")
    set_gain(controller, "reference_slip", 0.35)
    assert controller.update(ESTIMATES[0], 5e-4).brake == 0.35


@pytest.mark.usefixtures("patient")
def test_it_has_the_files_that_were_kept_with_its_source():
    source = LAW.format("from my_gains import K", "pass", "return BrakeDemand(K)").encode()
    process = IsolatedController(NAME, SourceFiles(source, {"my_gains.py": b"K = 0.25"}).packed("law.py"), HERE)
    try:
        assert make_controller(named(), {NAME: process}).update(ESTIMATES[0], 5e-4).brake == 0.25
    finally:
        process.close()


@pytest.mark.usefixtures("patient")
def test_it_names_a_file_that_it_opens_only_while_it_runs(tmp_path, monkeypatch, isolate, capfd):
    monkeypatch.chdir(tmp_path)
    for name in ("late.txt", "early.txt"):
        (tmp_path / name).write_text("0.5")
    process, controllers = isolate(asked="open('late.txt').close()", made="open('early.txt').close()")
    make_controller(named(), controllers).update(ESTIMATES[0], 5e-4)
    process.close()
    assert "the controller opened late.txt while it ran: the session does not keep that" in capfd.readouterr().err


@pytest.mark.usefixtures("patient")
def test_each_copy_is_a_controller_of_its_own_as_for_several_stops(law):
    _, first = law()
    made = deepcopy(first)
    for copies in range(3):
        stop = deepcopy(made) if copies else first
        assert [stop.update(ESTIMATES[0], 5e-4).internals[0] for _ in range(3)] == [1.0, 2.0, 3.0]


@pytest.mark.usefixtures("patient")
def test_what_is_not_a_number_reaches_the_guard_as_such(law):
    _, controller = law(asked="return BrakeDemand((float('nan'), None, True, '0.6', 1j)[self.calls - 1])")
    assert all(math.isnan(controller.update(ESTIMATES[0], 5e-4).brake) for _ in range(5))


@pytest.mark.usefixtures("patient")
@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ("raise ValueError('my own mistake')", "ValueError: my own mistake (law.py, line 15)"),
        pytest.param("raise KeyboardInterrupt", "KeyboardInterrupt:  (law.py, line 15)", marks=pytest.mark.long),
        ("return 0.6", "update() must return a BrakeDemand, not 0.6 (law.py, line "),
        ("os._exit(3)", "law.py:Law has ended its process: exit code 3"),
        pytest.param(
            "os.kill(os.getpid(), signal.SIGKILL)", "law.py:Law has ended its process: SIGKILL", marks=pytest.mark.long
        ),
        ("os.kill(os.getpid(), signal.SIGSEGV)", "law.py:Law has ended its process: SIGSEGV"),
        ("os.closerange(3, 99); time.sleep(600)", "law.py:Law has closed the pipe of its answers"),
        (f"exec({FORGE!r})", "law.py:Law has written into the pipe of its answers"),
    ],
)
def test_it_fails_with_an_explanation(law, asked, words):
    _, controller = law(asked=asked)
    assert words in failure(controller)


@pytest.mark.parametrize(
    "asked",
    [
        pytest.param("time.sleep(600)", marks=pytest.mark.long),
        "exec('while True: pass')",
        "os.kill(os.getpid(), signal.SIGSTOP)",
    ],
)
def test_one_that_does_not_answer_is_ended_after_a_bounded_wait(law, asked, until):
    process, controller = law(asked=f"self.calls > 1 and {asked}")
    controller.update(ESTIMATES[0], 5e-4)
    begun = time.monotonic()
    assert failure(controller) == "law.py:Law has not answered for 20 ms"
    assert time.monotonic() - begun < 2.0  # generous: the wait is counted in looks, and this computer is shared
    until(lambda: gone(process), "it is ended")
    assert "has ended its process: SIGKILL" in failure(controller)


@pytest.mark.usefixtures("patient")
def test_its_prints_threads_and_children_do_not_disturb_the_exchange(law, capfd):
    thread = "threading.Thread(target=time.sleep, args=(600,)).start()"
    did = {2: "print('said', flush=True)", 3: "sys.stdin.read()", 4: "os.fork()", 5: thread}
    process, controller = law(asked=f"exec({did!r}.get(self.calls, ''))")
    assert [controller.update(ESTIMATES[0], 5e-4).internals[0] for _ in range(6)] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    process.close()
    assert gone(process)
    captured = capfd.readouterr()
    assert (captured.out, captured.err) == ("", "said\n")


@pytest.mark.parametrize(
    ("statements", "kind", "words"),
    [
        ({"imported": "1 / 0"}, ConfigError, "law.py, line 5: ZeroDivisionError"),
        ({"imported": "os._exit(4)"}, ControllerError, "has ended its process: exit code 4"),
        ({"imported": "time.sleep(600)"}, ControllerError, "was not loaded within 1 s"),
        ({"made": "raise RuntimeError('no table')"}, ConfigError, "cannot be made: ControllerError: RuntimeError: no"),
        ({"made": "os._exit(5)"}, ConfigError, "has ended its process: exit code 5"),
    ],
)  # fmt: skip
def test_a_load_error_is_reported_before_the_board_opens(law, monkeypatch, statements, kind, words):
    monkeypatch.setattr(isolated, "LOADING_MOST_S", 1.0 if "sleep" in str(statements) else 60.0)
    with pytest.raises(kind) as caught:
        law(**statements)
    assert words in str(caught.value)


def test_a_process_that_cannot_be_started_is_a_refusal(monkeypatch):
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    with pytest.raises(BoardError, match="the controller process cannot be started: No such file"):
        IsolatedController(NAME, b"", HERE)


@pytest.mark.untraced
def test_it_holds_no_file_of_its_parent_and_ends_with_it_however_that_comes(tmp_path, until):
    (tmp_path / "secret").write_text("")
    open_files = "[os.path.realpath(f'/proc/self/fd/{n}') for n in os.listdir('/proc/self/fd')]"
    source = LAW.format(f"print(os.getpid(), {open_files}, file=sys.stderr, flush=True)", "pass", "pass")
    code = (
        "import sys, os, time; from pathlib import Path\n"
        "from inteco_abs.realtime.processes.controller import IsolatedController\n"
        f"kept = os.open({str(tmp_path / 'secret')!r}, 0); os.dup2(kept, 77)\n"
        f"one = IsolatedController('law.py:Law', {source.encode()!r}, Path('x')); print(flush=True); time.sleep(600)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with parent:
        line = parent.stderr.readline()
        pid = int(line.split()[0])
        assert parent.stdout.readline() == "\n"
        parent.kill()
    assert "secret" not in line
    until(lambda: not Path(f"/proc/{pid}").exists(), "it has ended, too")
