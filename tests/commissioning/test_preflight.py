"""What is found out of a board by reading alone."""

import pytest

from firmware_protocol.rtdac_usb2 import READ_REQUEST, encode_send
from inteco_abs.boards import InProcessLink
from inteco_abs.commissioning import MockRigAccess
from inteco_abs.commissioning.preflight import planned_phases, run_preflight
from inteco_abs.config import load_config
from inteco_abs.mock_board import FrontEnd


class Overheard(InProcessLink):
    """Keeps every message to the board; an answer comes after `wait`."""

    def __init__(self, front_end: FrontEnd, wait) -> None:
        super().__init__(front_end)
        self._wait = wait
        self.written = []

    def write(self, data):
        self.written.append(bytes(data))
        super().write(data)

    def read(self, length):
        self._wait()
        return super().read(length)


class WatchedRig(MockRigAccess):
    """A rig of which everything that goes to the board is kept; `read_ns` is how long each reading takes."""

    def __init__(self, *settings, read_s=0.0):
        super().__init__(load_config(settings=settings))
        self._read_s = read_s
        self.links = []

    def link(self):
        link = Overheard(self._front_end, lambda: self.pause(self._read_s))
        self.links.append(link)
        return link

    @property
    def written(self):
        return {message for link in self.links for message in link.written}


def preflight(rig, *settings):
    return run_preflight(rig, load_config(settings=settings))


def test_a_rig_at_rest_has_nothing_against_a_run():
    rig = WatchedRig()
    found = preflight(rig)
    assert (found.refused, found.cautions, found.moved) == ([], [], (0, 0))
    assert not found.identity.read_only_because


def test_only_read_requests_go_to_the_board():
    rig = WatchedRig()
    preflight(rig)
    assert rig.written == {READ_REQUEST}


@pytest.mark.parametrize("which", ["wheel", "road"])
def test_a_wheel_that_turns_stands_against_it_as_against_a_run(which):
    rig = WatchedRig()
    rig.device.turn(which, 1.0, 1.0)
    (refusal,) = preflight(rig).refused
    assert "a wheel moved before the start: wait until both stand still" in str(refusal)


def test_a_nudge_of_few_counts_does_not():
    rig = WatchedRig()
    rig.device.turn("wheel", 3.0 / 2048.0, 0.05)
    found = preflight(rig)
    assert found.refused == []
    assert 0 < abs(found.moved[0]) <= 4


def test_a_board_that_is_not_trusted_is_refused_and_still_watched():
    rig = WatchedRig()
    rig.device.turn("wheel", 1.0, 1.0)
    unsigned, moving = preflight(rig, 'board.verified_by=""').refused
    assert "reading only" in str(unsigned)
    assert "a wheel moved" in str(moving)


def test_counters_of_an_unknown_logic_are_not_mistaken_for_counters():
    found = preflight(WatchedRig(), "board.logic_version=0x0111")
    assert ("0x0103" in str(found.refused[0]), found.moved) == (True, None)


def test_outputs_that_were_left_on_are_reported():
    rig = WatchedRig("experiment.idle_s=0.01")
    rig.device.power(on=False)
    rig.link().write(encode_send({"pin_mode": 1 << 2 | 1 << 5, "pwm0_width": 255}))
    found = preflight(rig)
    assert "emergency switch" in found.cautions[0]


def test_a_board_that_hangs_up_is_a_refusal_not_an_error():
    rig = WatchedRig()
    made = rig.link
    rig.link = lambda: closed(made())
    found = preflight(rig)
    assert "closed" in str(found.refused[0])
    assert found.identity is None


def closed(link):
    link.close()
    return link


def test_readings_longer_than_a_period_are_refused_and_long_ones_noted():
    slow, doubtful, quick = (preflight(WatchedRig(read_s=read_s)) for read_s in (0.0006, 0.0004, 0.0001))
    assert "longer than" in str(slow.refused[0])
    assert ("may find" in doubtful.cautions[0], doubtful.refused) == (True, [])
    assert (quick.cautions, quick.refused) == ([], [])


def test_the_course_has_the_limits_of_experiment_and_guard():
    config = load_config(settings=["guard.drive_limit=0.5", "guard.brake_limit=0.6", "experiment.hold_s=2"])
    parts = {part.phase: part for part in planned_phases(config)}
    assert list(parts) == ["IDLE", "ARMED", "SPIN_UP", "BRAKING", "STOPPED"]
    assert "drive 0.5 until the road wheel turns at 180 rad/s" in parts["SPIN_UP"].does
    assert "brake at most 0.6" in parts["BRAKING"].does
    assert parts["STOPPED"].seconds == 2.0
    fixed = sum(part.seconds for part in parts.values())
    assert fixed == config.experiment.longest_s
