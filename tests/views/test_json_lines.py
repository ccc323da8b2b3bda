"""A run as JSON lines, and the commands of the program that started it."""

import io
import json
import math
import os
import threading

import pytest

from inteco_abs.control import Gain
from inteco_abs.errors import AbsError
from inteco_abs.realtime import Point, Snapshot, StartCheck
from inteco_abs.signals import Phase
from inteco_abs.views.json_lines import JsonLines


class OneGain:
    gains = (Gain("Mk", 2.0, 0.0, 10.0, "1/s", "rate"),)

    def __init__(self):
        self.values = {"Mk": 2.0}

    def change(self, name, value):
        if value > 10.0:
            raise AbsError(f"{name}: too large")
        self.values = {name: value}
        return 77


class Lines:
    """A screen whose commands come from a pipe, and what it has written."""

    def __init__(self, tuner=None):
        self.stream = io.StringIO()
        self.commands, self.sender = os.pipe()
        self.screen = JsonLines(self.stream, self.commands, tuner)
        self.stopped = threading.Event()

    @property
    def written(self):
        return [json.loads(line, parse_constant=pytest.fail) for line in self.stream.getvalue().splitlines()]

    def obey(self, text):
        """Send commands, and wait until they have ended."""
        with self.screen.listening(self.stopped.set):
            os.write(self.sender, text)
            os.close(self.sender)
            assert self.stopped.wait(30)
        os.close(self.commands)


def snapshot(*recent):
    return Snapshot(Phase.BRAKING, 42, 0.5, 100.0, 110.0, 1.0 / 11.0, 0.0, 0.7, 3, (1.0, 2.0, 3.0, None), recent)


@pytest.fixture
def lines():
    return Lines(OneGain())


def test_states_have_their_points_with_times_from_the_first_and_no_nan(lines):
    first = Point(5_000_000_000, 100.0, 110.0, 1.0 / 11.0, int(Phase.BRAKING), math.nan, 4.0, 0.0, 0.7)
    lines.screen.show(snapshot(first))
    lines.screen.show(snapshot(first._replace(time_ns=5_250_000_000, slip_reference=0.2)))
    (gains, values, one, two) = lines.written
    assert gains["gains"][0]["name"] == "Mk"
    assert values == {"values": {"Mk": 2.0}}
    assert one["state"]["phase"] == "BRAKING"
    assert one["state"]["late_us"] == [1.0, 2.0, 3.0, None]
    assert one["points"] == [[0.0, 100.0, 110.0, 0.0909091, 4, None, 4.0, 0.0, 0.7]]
    assert two["points"][0][0] == 0.25
    assert two["points"][0][5] == 0.2


def test_checks_remarks_and_warnings_are_lines(lines):
    lines.screen.passed(StartCheck.BOARD, "sim:")
    lines.screen.note("good to know")
    lines.screen.warn("cannot\nwait")
    assert lines.written == [
        {"check": StartCheck.BOARD.value, "detail": "sim:"},
        {"note": "good to know"},
        {"warning": "cannot\nwait"},
    ]


def test_commands_change_gains_and_wrong_ones_are_refused(lines):
    lines.obey(b"Mk=5\n\nMk=99\nMk=much\nguard\n")
    changed, large, word, nothing = lines.written
    assert changed == {"changed": {"name": "Mk", "value": 5.0, "tick": 77}}
    assert large == {"refused": "Mk: too large"}
    assert "Mk=much" in word["refused"]
    assert "NAME=VALUE" in nothing["refused"]


def test_in_virtual_time_no_gain_changes():
    lines = Lines()
    lines.obey(b"Mk=5\n")
    assert "--change" in lines.written[0]["refused"]


@pytest.mark.parametrize("text", [b"stop\n", b"", b"sto", b"x" * 100_000])
def test_the_word_stop_and_the_end_of_the_commands_stop_the_run(lines, text):
    sender = threading.Thread(target=lines.obey, args=(text,))
    sender.start()
    sender.join(30)
    assert lines.stopped.is_set()


def test_a_reader_that_is_gone_does_not_end_the_thread_that_obeys(lines):
    lines.stream.close()
    lines.obey(b"Mk=5\nMk=6\n")
    assert lines.stopped.is_set()
