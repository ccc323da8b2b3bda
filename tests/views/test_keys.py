"""Keys without Enter, and the terminal restored at any end of the program."""

import os
import signal
import subprocess
import sys
import termios

import pytest
from on_terminal import OnTerminal

from inteco_abs.views.keys import stop_keys

PROGRAM = """
import sys, time, threading
from inteco_abs.views.keys import stop_keys
pressed = threading.Event()
with stop_keys(pressed.set) as can:
    print("keys" if can else "no keys", flush=True)
    {body}
print("over", flush=True)
"""
WAIT = "print('stop' if any(pressed.wait(0.1) for _ in range(600)) else 'nothing', flush=True)"
"""In short waits, as commands do: a signal that another thread gets does not end one of the main thread's."""


@pytest.fixture
def program():
    """Starts a program with that body on a terminal."""
    started = []

    def start(body=WAIT, **options):
        started.append(OnTerminal([sys.executable, "-c", PROGRAM.format(body=body)], **options))
        return started[-1]

    yield start
    for one in started:
        one.close()


@pytest.mark.parametrize("key", [" ", "q", "Q"])
def test_space_and_q_stop_at_once(program, key):
    run = program()
    run.until("keys")
    run.press(f"x\x1b[A{key}")
    assert run.end() == 0
    assert "stop" in run.written


def test_other_keys_do_nothing_and_none_reaches_the_shell_or_the_screen(program):
    run = program("time.sleep(0.3); print('set' if pressed.is_set() else 'clear', flush=True); pressed.wait(60)")
    run.until("keys")
    run.press("rm -rf *")  # has a space
    run.press("abc\n")
    assert run.end() == 0
    assert run.unread == 0
    assert "rm" not in run.written


def test_keys_of_no_meaning_do_not_stop(program):
    run = program("print('set' if pressed.wait(0.3) else 'clear', flush=True)")
    run.until("keys")
    run.press("xyz\n\x1b[B")
    assert run.end() == 0
    assert "clear" in run.written


def test_what_was_typed_before_does_not_stop(program):
    run = program("print('set' if pressed.wait(0.3) else 'clear', flush=True)", typed="q \nq")
    assert run.end() == 0
    assert "clear" in run.written


@pytest.mark.parametrize("body", [WAIT, "raise KeyboardInterrupt", "raise SystemExit(3)", "1 / 0"])
def test_the_terminal_is_restored(program, body):
    run = program(body)
    run.until("keys")
    if body is WAIT:
        assert not run.settings[3] & (termios.ICANON | termios.ECHO)
        assert run.settings[3] & termios.ISIG  # Ctrl-C stays a signal
        run.press("qqq")
    run.end()
    assert run.settings == run.at_first
    assert run.unread == 0


def test_a_program_that_was_frozen_takes_the_terminal_again(program):
    run = program()
    run.until("keys")
    run.process.send_signal(signal.SIGSTOP)
    os.waitpid(run.process.pid, os.WUNTRACED)
    termios.tcsetattr(run._terminal, termios.TCSANOW, run.at_first)  # as a shell does
    run.process.send_signal(signal.SIGCONT)
    while run.settings[3] & termios.ICANON:
        assert run.process.poll() is None
    run.press("q")
    assert run.end() == 0
    assert "stop" in run.written
    assert run.settings == run.at_first


def test_without_a_terminal_there_are_no_keys():
    process = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(body="pass")], input="q", capture_output=True, text=True, check=True
    )
    assert process.stdout == "no keys\nover\n"


BEHIND = "import subprocess, sys; subprocess.run([sys.executable, '-c', sys.argv[1]], process_group=0)"


def test_a_program_in_the_background_leaves_the_terminal_alone():
    run = OnTerminal([sys.executable, "-c", BEHIND, PROGRAM.format(body="pass")])
    try:
        assert run.end() == 0
        assert "no keys" in run.written
        assert "over" in run.written
        assert run.settings == run.at_first
    finally:
        run.close()


@pytest.mark.parametrize("descriptor", [-1, 999])
def test_what_is_not_open_has_no_keys(descriptor):
    with stop_keys(lambda: None, descriptor) as can:
        assert not can
