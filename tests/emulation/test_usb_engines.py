"""Which of the two engines a USB board is opened with."""

import pytest

from inteco_abs.boards import usb_engines, usb_queued
from inteco_abs.boards.links import Link
from inteco_abs.boards.usb_engines import open_usb
from inteco_abs.config import UsbConfig
from inteco_abs.errors import BoardError, LinkError


class Stub(Link):
    """A board that answers, after `work` rounds of something to do, or fails."""

    def __init__(self, work=0, fails=False):
        self.work = work
        self.fails = fails
        self.open = True

    def write(self, _data):
        if self.fails:
            raise LinkError("it fails")

    def read(self, length):
        for _ in range(self.work):
            pass
        return bytes(length)

    def close(self):
        self.open = False


@pytest.fixture
def engines(monkeypatch):
    """Sets what each engine opens, None for an engine that cannot open the board; the links are kept by their kind."""
    made = {"one-by-one": [], "queued": []}

    def set_up(**links):
        def opener(name, key):
            def opened(*_):
                if links[key] is None:
                    raise BoardError("no use for it")
                made[name].append(Stub(**links[key]))
                return made[name][-1]

            return opened

        monkeypatch.setattr(usb_engines, "UsbLink", opener("one-by-one", "simple"))
        monkeypatch.setattr(usb_queued, "QueuedUsbLink", opener("queued", "queued"))
        return made

    return set_up


SLOW, QUICK = {"work": 20_000}, {}


@pytest.mark.parametrize(
    ("simple", "queued", "chosen"),
    [
        (SLOW, QUICK, "queued"),
        (QUICK, SLOW, "one-by-one"),
        (QUICK, None, "one-by-one"),
        (QUICK, {"fails": True}, "one-by-one"),
        ({"fails": True}, QUICK, "queued"),
    ],
    ids=["queued is quicker", "one by one is quicker", "queued cannot open", "queued fails", "one by one fails"],
)
def test_the_engine_that_reads_more_quickly_and_without_failing_is_kept(engines, simple, queued, chosen):
    made = engines(simple=simple, queued=queued)
    link = open_usb("", UsbConfig())
    assert link is made[chosen][-1]
    assert [each for links in made.values() for each in links if each.open] == [link]


@pytest.mark.parametrize("engine", ["one-by-one", "queued"])
def test_a_named_engine_is_used_without_asking_which_is_quicker(engines, engine):
    made = engines(simple=SLOW, queued=SLOW)
    assert open_usb("", UsbConfig(engine=engine)) is made[engine][0]
    assert sum(map(len, made.values())) == 1


def test_without_the_package_for_queued_transfers_there_is_one_engine(engines, monkeypatch):
    made = engines(simple=QUICK, queued=QUICK)
    monkeypatch.setattr(usb_engines, "find_spec", lambda _name: None)
    assert open_usb("", UsbConfig()) is made["one-by-one"][0]
    with pytest.raises(BoardError, match=r"needs the package libusb1: pip install inteco-abs\[usb\]"):
        open_usb("", UsbConfig(engine="queued"))
