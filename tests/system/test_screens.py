"""Output of a run without a terminal, and its characters on one."""

import pytest

from inteco_abs.cli.screens import ascii_wanted, screen_of
from inteco_abs.cli.terminal import wrapped
from inteco_abs.config import load_config
from inteco_abs.realtime.screen import Lines, NoScreen, SafeScreen, StartCheck


@pytest.fixture
def said(capsys):
    """What goes to stderr while a run without terminal notes and warns."""

    def run(choice=None, *, virtual=False, quiet=False):
        with screen_of(load_config(), choice, virtual=virtual, quiet=quiet) as screen:
            screen.passed(StartCheck.BOARD)
            screen.note("good to know")
            screen.warn("cannot wait")
        said = capsys.readouterr()
        assert not said.out
        return said.err.splitlines()

    return run


BEGIN, NOTE, WARNING = (
    "running in real time; Ctrl-C stops safely",
    "inteco-abs: good to know",
    "inteco-abs: cannot wait",
)


@pytest.mark.parametrize(
    ("options", "lines"),
    [
        ({}, [BEGIN, NOTE, WARNING]),
        ({"choice": "full"}, [BEGIN, NOTE, WARNING]),  # there is no terminal to draw on
        ({"virtual": True}, [NOTE, WARNING]),
        ({"quiet": True}, [WARNING]),
    ],
)
def test_without_a_terminal_there_are_lines_and_no_picture(said, options, lines):
    assert said(**options) == lines


@pytest.mark.parametrize(
    ("variables", "wanted"),
    [
        ({}, False),
        ({"LANG": "C"}, True),
        ({"LANG": "C", "LC_CTYPE": "C.UTF-8"}, True),  # which Python itself has set
        ({"LANG": "C.UTF-8"}, False),
        ({"LANG": "de_DE.UTF-8", "LC_ALL": "POSIX"}, True),
        ({"LANG": "C", "LC_ALL": "en_US.UTF-8"}, False),
        ({"LANG": "C", "LC_CTYPE": "en_US.UTF-8"}, False),
    ],
)
def test_the_c_locale_gets_ascii(monkeypatch, variables, wanted):
    for name in ("LC_ALL", "LC_CTYPE", "LANG"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert ascii_wanted() == wanted


@pytest.mark.parametrize("act", ["passed", "show", "note", "warn"])
def test_a_failing_screen_does_not_fail_the_run(act):
    calls = []

    class Broken(NoScreen):
        def __getattribute__(self, name):
            if name not in {"listening", "period_s"}:
                calls.append(name)
                raise OSError("the terminal is gone")
            return super().__getattribute__(name)

    screen = SafeScreen(Broken())
    getattr(screen, act)("anything")
    getattr(screen, act)("anything")
    assert calls == [act]


def test_lines_print_remarks_and_warnings():
    texts = []
    screen = Lines(texts.append)
    screen.note("one")
    screen.warn("two")
    assert texts == ["one", "two"]


def test_long_lines_break_between_words_and_keep_their_indentation():
    text = wrapped("\nStep 5, echo: writes PWM settings.\n  Risk: low, nothing is connected to power.", 30)
    assert text.split("\n") == [
        "",
        "Step 5, echo: writes PWM",
        "settings.",
        "  Risk: low, nothing is",
        "  connected to power.",
    ]
