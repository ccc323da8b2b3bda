"""Each protection, taken out, lets the campaign find what it protects from: no row of the table passes by itself."""

import pytest

from inteco_abs.boards.board import Board
from inteco_abs.boards.families.pci.board import RtdacPci
from inteco_abs.boards.frame_board import FrameBoard
from inteco_abs.control import guard, pipeline
from inteco_abs.errors import UnsafeError
from inteco_abs.signals import Reason

pytestmark = pytest.mark.untraced


@pytest.fixture(scope="module")
def campaign(tool):
    return tool("fault_campaign")


def no_reason(*_):
    return Reason.NONE


def newest_is_any(_self, frame):
    return frame


def takes_any_echo(self, drive, brake):
    """`FrameBoard._write_widths` without the comparison of what comes back."""
    image, layout = self._image, self._layout
    self._drive_out.codec.pack_into(image, self._drive_out.offset, drive)
    self._brake_out.codec.pack_into(image, self._brake_out.offset, brake)
    return self._whole(self._link.exchange(image, layout.request, layout.read.size))


PROTECTIONS = {
    "missed exchanges are counted": (guard, "_count_misses", no_reason, 4),
    "late exchanges are counted": (guard, "_count_misses", no_reason, 5),
    "a road that stands under drive is seen": (guard, "_judge_road", no_reason, 33),
    "a wheel ahead of a slow road is judged": (guard, "_judge_slow_road", no_reason, 6),
    "the wheel's encoder is judged": (guard, "_judge_wheel", no_reason, 7),
    "answers carry a number, and echo": (FrameBoard, "_write_widths", takes_any_echo, 10),
    "a stuck brake is seen from the road": (guard, "_judge_road", no_reason, 14),
    "another master's command is seen": (FrameBoard, "_write_widths", takes_any_echo, 20),
    "the header is compared": (FrameBoard, "_newest", newest_is_any, 22),
    "leaving means SAFE": (Board, "make_safe", lambda _self: None, 28),
}


@pytest.mark.long
@pytest.mark.parametrize("name", PROTECTIONS)
def test_without_this_protection_the_campaign_finds_a_violation(campaign, monkeypatch, name):
    where, attribute, replacement, number = PROTECTIONS[name]
    monkeypatch.setattr(where, attribute, replacement)
    cases = [case for case in campaign.hazard_cases(1) if case.name.startswith(f"{number}:")]
    assert any(campaign.judged(case).problem for case in cases)


def test_without_the_comparison_on_the_bus_another_master_would_not_be_seen(campaign, monkeypatch):
    case = campaign.Case(
        "20", ("master@coast",), profile="sim_pci", ends=("MISSED_EXCHANGES", "warned"), warned_ms=40.0
    )
    assert not campaign.judged(case).problem
    monkeypatch.setattr(RtdacPci, "_written", property(lambda _: False, lambda _, __: None), raising=False)
    assert campaign.judged(case).problem


def test_the_campaign_finds_outputs_that_are_left_on(campaign, monkeypatch):
    def trips_and_admits(k, s, sample, drive, brake):
        guard.admit(k, s, sample, drive, brake)
        s.drive, s.brake = drive, brake

    case = campaign.Case("road-stuck", ("road-stuck@drive+80ms",))
    assert not campaign.judged(case).problem
    monkeypatch.setattr(Board, "make_safe", lambda _self: None)
    monkeypatch.setattr(pipeline, "admit", trips_and_admits)
    assert "left on" in campaign.judged(case).problem


@pytest.mark.parametrize("profile", ["sim_usb2", "sim_usb", "sim_pci"])
def test_the_campaign_finds_a_pulled_cable_without_a_warning(campaign, monkeypatch, profile):
    case = campaign.Case("unplug", ("unplug@brake+20ms",), profile=profile)
    assert not campaign.judged(case).problem
    monkeypatch.setattr(Board, "make_safe", lambda _self: None)
    assert "left on" in campaign.judged(case).problem


@pytest.mark.parametrize("kind", ["lose", "lose-command", "overdue", "stale", "identity", "cut=13", "stall", "unplug"])
def test_the_campaign_finds_a_link_without_one_good_exchange_that_is_noticed_late(campaign, monkeypatch, kind):
    def notices_late(_k, s, _dt_s, flags):
        s.in_a_row += bool(flags)
        return Reason.MISSED_EXCHANGES if s.in_a_row > 2 * campaign.FOR_GOOD_BOUND else Reason.NONE

    case = campaign.Case(kind, (f"{kind}@drive+#10/600s",))
    assert not campaign.judged(case).problem
    monkeypatch.setattr(guard, "_count_misses", notices_late)
    assert f"ticks of {campaign.FOR_GOOD_BOUND}" in campaign.judged(case).problem


def test_the_campaign_finds_a_board_that_is_given_up_though_it_answers(campaign, monkeypatch):
    def gives_up(_self):
        raise UnsafeError

    case = campaign.Case("lose", ("lose@drive+#10/#1",))
    assert not campaign.judged(case).problem
    monkeypatch.setattr(FrameBoard, "_write_safe", gives_up)
    assert "left on" in campaign.judged(case).problem


@pytest.mark.parametrize("profile", ["sim_usb2", "sim_pci"])
def test_the_campaign_finds_another_master_without_a_warning(campaign, monkeypatch, profile):
    case = campaign.Case("master", ("master@brake+#2/600s",), profile=profile)
    assert not campaign.judged(case).problem
    monkeypatch.setattr(Board, "make_safe", lambda _self: None)
    assert "left on without a warning" in campaign.judged(case).problem
