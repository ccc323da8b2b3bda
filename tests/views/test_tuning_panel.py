"""Keys that change gains while a run lasts, and the line that shows them."""

import pytest

from inteco_abs.control import Gain
from inteco_abs.errors import AbsError
from inteco_abs.views.tuning_panel import TuningPanel

UP, DOWN, RIGHT, LEFT = b"\x1b[A", b"\x1b[B", b"\x1b[C", b"\x1b[D"


class Run:
    """A run whose gains a person changes; the tick is the number of the change."""

    def __init__(self):
        self.gains = (
            Gain("reference_slip", 0.2, 0.001, 0.999, "1", "slip to hold"),
            Gain("Mk", 2.0, 0.0, 1000.0, "1/s", "rate"),
            Gain("Ki", 0.0, 0.0, 100.0, "1/s2", "integral"),
        )
        self.values = {gain.name: gain.default for gain in self.gains}
        self.changes = []

    def change(self, name, value):
        if value > 1000.0:
            raise AbsError(f"{name} = {value:g}: must be in 0..1000")
        self.values[name] = value
        self.changes.append((name, value))
        return len(self.changes)


@pytest.fixture
def run():
    return Run()


@pytest.fixture
def panel(run):
    return TuningPanel(run)


def text_of(panel, width=120):
    return "".join(text for text, _ in panel.line(width))


@pytest.mark.parametrize(
    ("keys", "changes"),
    [
        (UP, [("reference_slip", 0.2 + 0.05 * 0.2)]),
        (b"\x1bOB", [("reference_slip", 0.2 - 0.05 * 0.2)]),
        (b"\t" + UP + UP, [("Mk", 2.1), ("Mk", 2.1 + 0.05 * 2.1)]),
        (RIGHT + RIGHT + UP, [("Ki", 0.1)]),
        (LEFT + UP, [("Ki", 0.1)]),
        (b"\x1b[Z\x1b[Z" + b"7\r", [("Mk", 7.0)]),
        (b"\t\t" + DOWN, [("Ki", 0.0)]),
        (b"\t3.55\x7f\n", [("Mk", 3.5)]),
        (b"\t1e2\r", [("Mk", 100.0)]),
        (b"\t12\x1b9\r", [("Mk", 9.0)]),
        (b"\t12\t5\r", [("Ki", 5.0)]),
        (b"\r" + b"xyz?" + b"\t1-\r", []),
        (b"\t5000\r", []),
        ("é½".encode() + b"\xff\x00", []),
    ],
)
def test_keys_choose_and_change_gains(run, panel, keys, changes):
    panel.press(keys)
    assert run.changes == changes


def test_the_line_shows_gain_value_range_and_what_came_of_it(panel):
    assert text_of(panel).startswith(" 1/3 reference_slip = 0.2  0.001..0.999")
    assert "Tab: next gain" in text_of(panel)
    panel.press(b"\t3.")
    assert text_of(panel).startswith(" 2/3 Mk = 2 1/s  0..1000  3._")
    panel.press(b"5\r")
    assert text_of(panel).endswith("Mk = 3.5 1/s  0..1000  from tick 1")
    panel.press(b"5000\r")
    assert text_of(panel).endswith("Mk = 5000: must be in 0..1000")
    panel.press(b"1-\r")
    assert text_of(panel).endswith("1-: not a number")
    panel.press(RIGHT)
    assert "not a number" not in text_of(panel)


def test_before_the_first_tick_there_is_nothing_to_change(run, panel):
    run.gains = ()
    panel.press(UP + b"5\r\t")
    assert text_of(panel) == " gains can change from the first tick on"
    assert run.changes == []
