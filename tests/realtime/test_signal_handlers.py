"""Which signals end a run at its next tick rather than the program with its outputs on."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from inteco_abs.realtime.signal_handlers import handle_signals, handled_signals

WITH_A_REASON_NOT_TO = {
    "SIGKILL", "SIGSTOP", "SIGCHLD", "SIGCONT", "SIGURG", "SIGWINCH", "SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL",
    "SIGPIPE", "SIGXFSZ", "SIGTTIN", "SIGTTOU",
}  # fmt: skip
NUMBERS = sorted(signal.valid_signals() - {getattr(signal, name) for name in WITH_A_REASON_NOT_TO})
DEFAULT = "import signal, sys; signal.signal(int(sys.argv[1]), signal.SIG_DFL); signal.raise_signal(int(sys.argv[1]))"


def test_ending_signals_are_handled_only_inside_the_context():
    assert {signal.SIGVTALRM, signal.SIGPROF, signal.SIGIO, signal.SIGPWR, signal.SIGRTMIN} < set(NUMBERS)
    before, heard = {number: signal.getsignal(number) for number in NUMBERS}, []
    with handle_signals(lambda: heard.append(True)):
        for number in NUMBERS:
            assert signal.getsignal(number) not in (signal.SIG_DFL, before[number]), number
            signal.raise_signal(number)
    assert len(heard) == len(NUMBERS)
    assert {number: signal.getsignal(number) for number in NUMBERS} == before


@pytest.mark.parametrize("name", ["SIGCHLD", "SIGCONT", "SIGURG", "SIGWINCH"])
def test_a_harmless_signal_is_not_handled_and_ends_nothing(name):
    number = getattr(signal, name)
    assert number not in handled_signals()
    assert subprocess.run([sys.executable, "-c", DEFAULT, str(int(number))], check=False).returncode == 0


def test_a_write_into_a_closed_pipe_still_raises_and_stops_no_run():
    heard = []
    reader, writer = os.pipe()
    os.close(reader)
    with handle_signals(lambda: heard.append(True)), pytest.raises(BrokenPipeError):
        os.write(writer, b"x")
    os.close(writer)
    assert heard == []


def test_in_another_thread_nothing_is_changed():
    before, seen = signal.getsignal(signal.SIGTERM), []

    def listen():
        with handle_signals(lambda: None):
            seen.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=listen)
    thread.start()
    thread.join()
    assert seen == [before]
