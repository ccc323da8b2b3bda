"""Controllers of the user's own that are none, or that fail during a run: their file and line are named."""

import json
import os
import signal
import time

import pytest
from wrong_inputs import Row, file, ids, session

from inteco_abs.errors import ConfigError
from inteco_abs.experiment import time_limit

RUN = "run --virtual --set experiment.start_speed_rad_s=20 --controller law.py:Law"
LAW = """\
import sys
from inteco_abs.signals import BrakeDemand
class Law:
    gains = internals = ()
    def __init__(self, setup):
        {made}
    def update(self, estimate, dt_s):
        {asked}
"""


def law(made="pass", asked="return BrakeDemand(0.6)"):
    return (file("law.py", LAW.format(made=made, asked=asked)),)


def source(text):
    return (file("law.py", text),)


NONE = [
    Row("no file", RUN, 2, ("law.py: cannot be read", "No such file"), "name a file as in law.py:Class"),
    Row("a pipe", RUN, 2, ("law.py: not a regular file",), "name a file as in law.py:Class",
        (lambda place: os.mkfifo(place.folder / "law.py"),)),
    Row("a file without its class", "run --controller law.py", 2, ("law.py",),
        "name the class too, as in law.py:Class", law()),
    Row("a file named like a controller", "run --controller law", 2, ("law",), "as in law.py:Class", law()),
    Row("nearly a shipped one", "run --controller reachin-law", 2, ("'reachin-law'",), "did you mean reaching-law?"),
    Row("no shipped one", "run --controller quantum", 2, ("'quantum'",), "known: boundary-layer, constant-rate"),
    Row("nearly its class", RUN, 2, ("no class 'Law'",), "did you mean Lab?", source("class Lab: pass\n")),
    Row("no class at all", RUN, 2, ("no class 'Law'",), "known: none", source("def Law(): pass\n")),
    Row("bad syntax", RUN, 2, ("law.py, line 2", "SyntaxError"), "invalid syntax", source("x = 1\ndef broken(:\n")),
    Row("an import that fails", RUN, 2, ("law.py, line 1", "ModuleNotFoundError"), "No module named 'nonexistent'",
        source("import nonexistent\n")),
    Row("an error while it is read", RUN, 2, ("law.py, line 3", "ZeroDivisionError"), "division by zero",
        source("import sys\n\nx = 1 / 0\n")),
    Row("an exit while it is read", RUN, 2, ("law.py, line 2", "SystemExit"), "SystemExit",
        source("import sys\nsys.exit(3)\n")),
    Row("no method", RUN, 2, ("law.py", "no method"), "update(estimate, dt_s)", source("class Law: pass\n")),
    Row("no gains", RUN, 2, ("Law.gains",), "() if it has none",
        source("class Law:\n    def update(self, e, dt): ...\n")),
    Row("a constructor without its argument", RUN, 2, ("law.py:Law cannot be made",), "takes no arguments",
        source("class Law:\n    gains = internals = ()\n    def update(self, e, dt): ...\n")),
    Row("a constructor that raises", RUN, 2, ("law.py:Law, line 6 cannot be made",), "RuntimeError: no table",
        law(made="raise RuntimeError('no table')")),
    Row("a gain that it does not have", f"{RUN} --set controller.gains.k=1", 2, ("controller.gains.k",),
        "the controller has none", law()),
    Row("one in machine code", "run --set loop.compiled=true --controller law.py:Law", 2,
        ("loop.compiled", "law.py:Law runs in a process of its own"), "set it to false", law()),
    Row("replayed without its file", "replay stop.mcap --controller law.py:Law", 2, ("law.py",), "name a file",
        (session(),)),
]  # fmt: skip

IN_A_RUN = [
    Row("raises", RUN, 5, ("law.py, line 8", "my own mistake"), "drive and brake are off after tick",
        law(asked="raise ZeroDivisionError('my own mistake')")),
    Row("returns nothing", RUN, 5, ("law.py, line 7", "not None"), "update() must return a BrakeDemand",
        law(asked="pass")),
    Row("returns a number", RUN, 5, ("law.py, line 7", "not 0.6"), "update() must return a BrakeDemand",
        law(asked="return 0.6")),
    Row("asks for no number", RUN, 5, ("is not a finite number",), "off after tick",
        law(asked="return BrakeDemand(float('nan'))")),
    Row("exits", RUN, 5, ("law.py, line 8", "SystemExit"), "off after tick", law(asked="sys.exit(3)")),
    Row("takes other arguments", RUN, 5, ("TypeError", "Law.update()"), "takes 2 positional arguments",
        source(LAW.format(made="pass", asked="pass").replace("estimate, dt_s", "estimate"))),
]  # fmt: skip


def test_a_constructor_that_does_not_end_is_ended(answers, monkeypatch):
    monkeypatch.setattr("inteco_abs.experiment.user_code.LOADING_MOST_S", 0.3)
    text = source(LAW.format(made="while True: pass", asked="pass"))
    answers.to(Row("hangs", RUN, 2, ("law.py:Law, line 6", "cannot be made"), "not finished within 0.3 s", text))


def test_one_that_catches_every_exception_is_ended_too(answers, monkeypatch):
    monkeypatch.setattr("inteco_abs.experiment.user_code.LOADING_MOST_S", 0.1)
    monkeypatch.setattr("inteco_abs.experiment.user_code._AGAIN_S", 0.1)
    text = source("while True:\n    try:\n        while True: pass\n    except Exception: pass\n")
    answers.to(Row("catches", RUN, 2, ("--controller",), "not finished within 0.1 s", text))


def never_ends():
    while True:
        pass


def test_an_alarm_while_the_limit_ends_does_not_remain_after_it(monkeypatch):
    monkeypatch.setattr("inteco_abs.experiment.user_code.LOADING_MOST_S", 1e-3)
    monkeypatch.setattr("inteco_abs.experiment.user_code._AGAIN_S", 1e-3)
    for _ in range(100):
        with pytest.raises((TimeoutError, ConfigError)), time_limit():
            never_ends()
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_an_alarm_left_on_after_the_time_limit_is_harmless(monkeypatch):
    monkeypatch.setattr("inteco_abs.experiment.user_code.LOADING_MOST_S", 0.01)

    def interrupted():
        time_limit().__enter__()

    interrupted()
    time.sleep(0.05)
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


@pytest.mark.parametrize("row", NONE, ids=ids(NONE))
def test_what_is_not_a_controller_is_reported_before_anything_is_started(answers, row):
    answers.to(row)


@pytest.mark.parametrize("row", IN_A_RUN, ids=ids(IN_A_RUN))
def test_a_controller_that_fails_ends_in_a_safety_stop(answers, main_here, row):
    answer = answers.to(row._replace(command=f"{row.command} --out stop.mcap --json", leaves=("stop.mcap",), runs=True))
    card = json.loads(answer.stdout)
    assert card["outcome"] == "fault"
    assert card["reason"] in {"CONTROLLER_ERROR", "BAD_OUTPUT"}
    main_here("info", "stop.mcap", check=0)
