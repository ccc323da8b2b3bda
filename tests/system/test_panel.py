"""The panel as a person has it: on a terminal, with motors that turn; every way in which it can end leaves SAFE."""

import fcntl
import os
import pty
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from contextlib import suppress

import pytest
from live import ancestor

from inteco_abs.commissioning.panel import PHRASE
from inteco_abs.config import load_config
from inteco_abs.errors import ReadOnlyError
from inteco_abs.experiment import manual_control
from inteco_abs.format import TRUTH
from inteco_abs.realtime.memory import FOLDER, Field, RunMemory, alive
from inteco_abs.signals import Command

pytestmark = pytest.mark.xdist_group("real time")
PATIENCE_S = 30.0
PAGE_UP = b"\x1b[5~"
OFF = (0.0, 0.0)


class Terminal:
    """A panel on a terminal of its own, whose board can be looked at from outside."""

    def __init__(self, command, folder, environment, *arguments):
        self._before = set(FOLDER.glob("*.ring"))
        self.shown = b""
        self._master, slave = pty.openpty()
        fcntl.ioctl(self._master, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
        self.process = subprocess.Popen(
            ["setsid", "--ctty", command, "panel", *arguments], cwd=folder,
            env={**environment, "TERM": "xterm-256color"}, stdin=slave, stdout=slave, stderr=slave,
        )  # fmt: skip
        os.close(slave)
        self._closed = threading.Event()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        self.memory = None

    def _read(self):
        with suppress(OSError):  # reading from a terminal that is not used any more
            while not self._closed.is_set():
                if select.select([self._master], [], [], 0.02)[0]:
                    self.shown += os.read(self._master, 65536)
        os.close(self._master)

    def type(self, keys):
        os.write(self._master, keys)

    def close(self):
        """Close the window."""
        self._closed.set()
        self._reader.join()

    def until(self, condition, what):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, f"{what}: {self.shown[-2000:]!r}"
            time.sleep(0.005)

    def until_shown(self, text):
        self.until(lambda: text.encode() in self.shown, f"{text!r} is shown")

    def find_memory(self):
        for path in set(FOLDER.glob("*.ring")) - self._before:
            with suppress(Exception):  # just being made
                memory = RunMemory.open(path)
                if ancestor(memory.words[Field.SUPERVISOR_PID], self.process.pid):
                    self.memory = memory
                    return True
        return False

    @property
    def duties(self):
        """At the simulated motors, by the board's own record."""
        record = self.memory.truth_reader().newest()
        truth = TRUTH.array(record)[0]
        return float(truth["drive"]), float(truth["brake"])

    def drive(self):
        """Begin as a person would, and hold the key until the motors turn."""
        self.until_shown('emergency switch":')
        self.type(PHRASE.encode() + b"\r")
        self.until_shown("OFF")
        self.until(self.find_memory, "the memory is there")
        self.type(3 * PAGE_UP)
        self.until(self.driven, "the drive is on")
        assert self.duties[0] == pytest.approx(0.3, abs=0.01)

    def hold_until_shown(self, text):
        """Hold the key as long as that takes."""

        def held():
            self.driven()
            return text.encode() in self.shown

        self.until(held, f"{text!r} is shown")

    def driven(self):
        self.type(b" ")
        time.sleep(0.03)
        return self.duties != OFF

    def end(self):
        """Exit code, once every process is gone or has let go of the board."""
        code = self.process.wait(PATIENCE_S)
        words = self.memory.words
        self.until(lambda: not alive(words[Field.LOOP_PID]), "the board is let go of")
        return code

    def leave(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self.close()


@pytest.fixture
def terminal(command_path, tmp_path, untraced):
    opened = []

    def start(*arguments):
        opened.append(Terminal(command_path, tmp_path, untraced, *arguments))
        return opened[-1]

    yield start
    for one in opened:
        one.leave()


ENDS = {
    "q": (lambda one: one.type(b"q"), 0),
    "Ctrl-C": (lambda one: one.type(b"\x03"), 130),
    "SIGTERM": (lambda one: one.process.terminate(), 130),
    "window closed": (Terminal.close, None),
    "panel killed": (lambda one: one.process.kill(), -signal.SIGKILL),
    "board's process killed": (lambda one: os.kill(one.memory.words[Field.LOOP_PID], signal.SIGKILL), 1),
}
IN_SHORT = {"Ctrl-C"}
"""The others take the same ways: q and hang-ups that of Ctrl-C, and processes that of a killed run's."""


@pytest.mark.parametrize("how", [pytest.param(how, marks=() if how in IN_SHORT else pytest.mark.long) for how in ENDS])
def test_however_it_ends_the_outputs_are_off_and_read_back(terminal, how):
    end, code = ENDS[how]
    one = terminal("--outputs")
    one.drive()
    end(one)
    assert one.end() == code or code is None
    words = one.memory.words
    by_itself = words[Field.HOLDER_PID] == 0
    assert by_itself is (how != "board's process killed")
    assert by_itself or words[Field.RESCUED_PID] == words[Field.LOOP_PID]
    assert one.duties == OFF
    assert not one.memory.path.exists()
    if code in (0, 130):
        one.until_shown("the board has confirmed that both outputs are off")


@pytest.mark.long  # tests/faults/test_panel_machine.py has it in virtual time
def test_after_a_trip_outputs_return_only_by_arming_again(terminal):
    one = terminal("--outputs", "--set", "guard.over_speed_rad_s=20", "--set", "experiment.start_speed_rad_s=15")
    one.drive()
    tripped = one.memory
    one.hold_until_shown("SWITCHED OFF: a wheel turned faster")
    one.type(10 * PAGE_UP + b" " * 9)
    one.type(b"r")
    one.until_shown("arm again?")
    assert one.duties == OFF
    shown = len(one.shown)
    one.type(b"y")
    one.until(lambda: not tripped.path.exists(), "everything is let go of")
    assert one.duties == OFF
    one.until(one.find_memory, "the memory of the second arming is there")
    assert one.memory.path != tripped.path
    one.until(lambda: b"OFF: hold the space bar" in one.shown[shown:], "the second panel is there")
    assert one.memory.words[Field.RESCUED_PID]  # the guardian has proved itself again
    one.type(b" " * 9)
    assert one.duties == OFF  # its sliders are at zero
    one.type(PAGE_UP)
    one.until(one.driven, "the drive is on")
    one.type(b"q")
    assert one.end() == 0
    assert one.duties == OFF


@pytest.mark.long
def test_alarm_flags_and_a_low_supply_are_shown(terminal):
    pci = terminal("--set", "profile=sim_pci", "--inject", "alarm=2@start", "--inject", "supply=11.5@start")
    pci.until_shown("supply 11.5 V")
    pci.until_shown("alarm_supply 0")
    pci.type(b"q")
    assert pci.process.wait(PATIENCE_S) == 0


def test_without_the_phrase_no_process_is_started(terminal):
    one = terminal("--outputs")
    one.until_shown('emergency switch":')
    one.type(b"yes\r")
    one.until_shown("nothing was written to the board")
    assert one.process.wait(PATIENCE_S) == 1
    assert not one.find_memory()


class Trouble(Exception):  # noqa: N818  it is not ours
    """Any failure of a screen."""


def drive_until(memory, side):
    end = time.monotonic() + PATIENCE_S
    while drive_of(memory) == 0.0:
        assert time.monotonic() < end
        side.request.keep_on(Command(0.3, 0.0), time.monotonic_ns())
        time.sleep(0.01)


@pytest.fixture
def processes_in_real_time(monkeypatch):
    """What is started here is not traced.

    Near standstill the rig's steps are cut in proportion to its speed, which under the tracer takes longer than the
    10 ms for which a link waits. Until the wheels turn, SAFE would be the guardian's to confirm.
    """
    for name in [name for name in os.environ if name.startswith("COV")]:
        monkeypatch.delenv(name)


@pytest.mark.usefixtures("processes_in_real_time")
def test_a_screen_that_fails_leaves_the_outputs_off(monkeypatch):
    kept = []

    def drive_and_fail():
        with manual_control(load_config(), "sim:", outputs=True) as side:
            drive_until(side._memory, side)  # the board's own record is in there
            raise Trouble

    def keep(memory):
        kept.append(memory)

    with monkeypatch.context() as patch:
        patch.setattr(RunMemory, "remove", keep)
        with pytest.raises(Trouble):
            drive_and_fail()
    (memory,) = kept
    memory.remove()
    assert drive_of(memory) == 0.0
    assert memory.words[Field.HOLDER_PID] == 0


def drive_of(memory):
    return float(TRUTH.array(memory.truth_reader().newest())[0]["drive"])


def test_outputs_of_an_unsigned_profile_are_refused():
    unsigned = load_config(settings=['board.verified_by=""'])
    with pytest.raises(ReadOnlyError, match="was not verified"), manual_control(unsigned, "sim:", outputs=True):
        raise AssertionError("it must not come so far")


def test_without_a_terminal_nothing_is_started(main_here):
    assert "needs a terminal" in main_here("panel", check=1).stderr


def test_without_textual_it_says_how_to_get_it(main_here, monkeypatch):
    monkeypatch.setitem(sys.modules, "textual", None)
    assert "inteco-abs[panel]" in main_here("panel", check=1).stderr
