"""Which signals end a run at its next tick rather than the program with its outputs on."""

import signal
import threading

import pytest

from inteco_abs.realtime.hearing import hearing

NUMBERS = [
    signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP, signal.SIGUSR1, signal.SIGUSR2,
    signal.SIGALRM, signal.SIGXCPU,
]  # fmt: skip


@pytest.mark.parametrize("number", NUMBERS, ids=lambda number: number.name)
def test_what_would_end_or_stop_the_program_is_heard_instead_and_only_meanwhile(number):
    before, heard = signal.getsignal(number), []
    with hearing(lambda: heard.append(number)):
        handler = signal.getsignal(number)
        assert handler not in (signal.SIG_DFL, before)
        signal.raise_signal(number)
        assert heard == [number]
    assert signal.getsignal(number) == before


def test_in_another_thread_nothing_is_changed():
    before, seen = signal.getsignal(signal.SIGTERM), []

    def listen():
        with hearing(lambda: None):
            seen.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=listen)
    thread.start()
    thread.join()
    assert seen == [before]
