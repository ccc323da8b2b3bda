"""Which of the two engines a USB board is opened with, and which one is kept once exchanges were timed."""

from types import SimpleNamespace

import pytest

from inteco_abs.boards.transports import usb_async as usb_queued
from inteco_abs.boards.transports import usb_transport as usb_engines
from inteco_abs.boards.transports.links import Link
from inteco_abs.boards.transports.usb_transport import open_usb
from inteco_abs.config import UsbConfig
from inteco_abs.errors import BoardError
from inteco_abs.realtime import round_trips
from inteco_abs.signals import BoardFlags


class Stub(Link):
    """A link that was opened."""

    engines = ("queued", "one-by-one")

    def __init__(self, *_):
        self.engine = self.engines[0]

    def write(self, _data):
        """Nothing is sent."""

    def read(self, length):
        return bytes(length)

    def close(self):
        """Nothing is open."""


class Plain(Stub):
    engines = ()
    engine = "one-by-one"

    def __init__(self, *_):
        """It has one engine."""


@pytest.fixture
def stubs(monkeypatch):
    monkeypatch.setattr(usb_engines, "UsbLink", Plain)
    monkeypatch.setattr(usb_queued, "QueuedUsbLink", Stub)


@pytest.mark.parametrize(
    ("named", "engine", "engines"),
    [
        ("one-by-one", "one-by-one", ()),
        ("queued", "queued", ()),
        ("faster", "queued", ("queued", "one-by-one")),
    ],
)
@pytest.mark.usefixtures("stubs")
def test_transfers_are_queued_unless_the_configuration_says_otherwise(named, engine, engines):
    link = open_usb("", UsbConfig(engine=named))
    assert (link.engine, link.engines) == (engine, engines)


@pytest.mark.usefixtures("stubs")
def test_without_libusb1_transfers_are_synchronous_and_the_log_says_so(monkeypatch, caplog):
    monkeypatch.setattr(usb_engines, "find_spec", lambda _name: None)
    link = open_usb("", UsbConfig())
    assert (link.engine, link.engines) == ("one-by-one", ())
    assert "to queue them needs the package libusb1: pip install inteco-abs[usb]" in caplog.text
    with pytest.raises(BoardError, match=r"needs the package libusb1: pip install inteco-abs\[usb\]"):
        open_usb("", UsbConfig(engine="queued"))


class TimedBoard:
    """Answers after `answers_us[engine]` on a hand-made clock; never where that is None."""

    def __init__(self, **answers_us):
        self.engines = tuple(name.replace("_", "-") for name in answers_us)
        self.engine = self.engines[0]
        self.last_error = BoardError("it fails")
        self._answers_us = dict(zip(self.engines, answers_us.values(), strict=True))
        self._now_ns = 0
        self.begun = 0

    def exchange(self, _command):
        answer_us = self._answers_us[self.engine]
        self._now_ns += (answer_us or 1000) * 1000
        return SimpleNamespace(board_flags=BoardFlags.STALE if answer_us is None else BoardFlags.NONE)

    def begin(self):
        self.begun += 1

    def monotonic_ns(self):
        return self._now_ns


def chosen(monkeypatch, **answers_us):
    board = TimedBoard(**answers_us)
    monkeypatch.setattr(round_trips, "time", board)
    return board, round_trips.choose_engine(board)


@pytest.mark.parametrize(
    ("queued_us", "simple_us", "engine"),
    [(144, 427, "queued"), (427, 144, "one-by-one"), (100, 91, "queued"), (100, 89, "one-by-one"),
     (None, 427, "one-by-one"), (144, None, "queued")],
)  # fmt: skip
def test_the_engine_whose_whole_exchanges_are_clearly_quicker_is_kept(monkeypatch, queued_us, simple_us, engine):
    board, facts = chosen(monkeypatch, queued=queued_us, one_by_one=simple_us)
    assert board.engine == facts["engine"] == engine
    expected = "p50 inf" if queued_us is None else f"p50 {queued_us:.1f}"
    assert expected in facts["exchanges, queued"]


def test_a_board_that_answers_with_no_engine_is_refused(monkeypatch):
    with pytest.raises(BoardError, match="the board does not answer: it fails"):
        chosen(monkeypatch, queued=None, one_by_one=None)


def test_a_board_without_a_choice_keeps_its_engine_and_is_not_timed(monkeypatch):
    monkeypatch.setattr(round_trips, "time", None)
    plain = SimpleNamespace(engines=(), engine="one-by-one")
    assert round_trips.choose_engine(plain) == {"engine": "one-by-one"}
    assert round_trips.choose_engine(SimpleNamespace(engines=(), engine="")) == {}
