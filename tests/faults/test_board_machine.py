"""A board that is opened, driven, unplugged, left, rescued and opened again, in any order, by its own record."""

import itertools
from collections import deque
from contextlib import suppress

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from inteco_abs.boards import Link, board_behind
from inteco_abs.errors import BoardError, LinkError, UnsafeError
from inteco_abs.mock_board import Device, front_end_of
from inteco_abs.rig import plant
from inteco_abs.signals import BoardFlags, Command
from tests.faults.stage import configured

pytestmark = pytest.mark.untraced

FEW = settings(max_examples=max(150, settings().max_examples // 2), stateful_step_count=30)
"""Enough for each kind of end to be met."""
OFF = (0.0, 0.0)
STEP = 1 / 255
DUTIES = st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0.0, 1.0))
COMMANDS = st.lists(st.builds(Command, DUTIES, DUTIES), min_size=1, max_size=8)
TROUBLES = st.sampled_from(["pulled", "deaf", "losing", "late"])
PROFILES = ("sim_usb2", "sim_usb", "sim_pci")


class Wire:
    """The cable, with the messages on it; it outlives its users."""

    def __init__(self, front_end):
        self.plugged = True
        self.deaf = 0
        """Messages of the host's that will not arrive."""
        self.losing = 0
        """Answers that will not arrive."""
        self.late = 0
        """Answers that will arrive, but only when the next is asked for."""
        self._front_end = front_end
        self._waiting = deque()

    def out(self, data):
        self._insist()
        if self.deaf:
            self.deaf -= 1
        else:
            self._front_end.bulk_out(data)

    def back(self, length):
        self._insist()
        if self._waiting:
            return self._waiting.popleft()[:length]
        answer = self._front_end.bulk_in(length)
        if self.losing and answer:
            self.losing -= 1
            answer = b""
        elif self.late and answer:
            self.late -= 1
            self._waiting.append(answer)
            answer = b""
        if not answer:
            raise LinkError("no answer")
        return answer

    def pull(self):
        self.plugged = False
        self._waiting.clear()

    def _insist(self):
        if not self.plugged:
            raise LinkError("the board is gone: is its cable unplugged?")


class Host(Link):
    """One program's end of the cable."""

    def __init__(self, wire):
        self._wire = wire
        self._closed = False

    def write(self, data):
        assert not self._closed, "written after close"
        self._wire.out(bytes(data))

    def read(self, length):
        assert not self._closed, "read after close"
        return self._wire.back(length)

    def close(self):
        self._closed = True


class BoardMachine(RuleBasedStateMachine):
    """A device with a record of its own, its cable, and one program after the other."""

    steps = opened = warned = good = stale = 0
    profile = "sim_usb2"

    @initialize(seed=st.integers(0, 3))
    def power_up(self, seed):
        self.config = configured(profile=self.profile)
        self.time_ns = 0
        self.device = Device(self.config, lambda: self.time_ns, seed)
        self.wire = Wire(front_end_of(self.device))
        self.board = None
        self.image = None
        """What makes safe the board of a program that died."""
        self.possible = [OFF]
        """Commands that may be in force."""

    def _new_board(self):
        return board_behind(Host(self.wire), self.config, lambda: self.time_ns)

    @precondition(lambda self: self.board is None)
    @rule(repaired=st.booleans())
    def open(self, repaired):
        """Open the board, with or without a repair of the cable."""
        if repaired:
            self.repair()
        before, board = self.device.duties, self._new_board()
        try:
            board.__enter__()
        except UnsafeError:
            self._was_reported()
        except BoardError:
            assert self.device.duties in {OFF, before}
            self._as_it_is()
        else:
            assert self.device.duties == OFF, "an old command is in force"
            self.board, self.possible = board, [OFF]
            type(self).opened += 1

    @precondition(lambda self: self.board is not None)
    @rule(commands=COMMANDS)
    def exchange(self, commands):
        """Some, with a pause of a tick or two behind each."""
        for command in commands:
            self.time_ns += 10**6
            self._exchange(command)
            self.only_the_reported_values_are_in_force()

    def _exchange(self, command):
        sample = self.board.exchange(command)
        if sample.board_flags & BoardFlags.STALE:
            self.possible.append(command)
            type(self).stale += 1
        else:
            self.possible = [command]
            type(self).good += 1

    @precondition(lambda self: self.board is not None)
    @rule(command=st.builds(Command, DUTIES, DUTIES))
    def exchange_in_good_order(self, command):
        self.repair()
        self.exchange([command] * 9)  # what was on its way has come by then
        assert self.possible == [command]

    @precondition(lambda self: self.board is not None)
    @rule()
    def make_safe(self):
        try:
            self.board.make_safe()
        except UnsafeError:
            # a message for each channel, of which one may have arrived
            drives, brakes = ({*channel, 0.0} for channel in zip(*self.possible, strict=True))
            self.possible = list(itertools.product(drives, brakes))
            type(self).warned += 1
        else:
            assert self.device.duties == OFF
            self.possible = [OFF]

    @precondition(lambda self: self.board is not None)
    @rule(whole=st.booleans())
    def look(self, whole):
        before = self.device.duties
        with suppress(LinkError):
            self.board.survey() if whole else self.board.identify()
        assert self.device.duties == before

    @precondition(lambda self: self.board is not None)
    @rule()
    def leave(self):
        board, self.board = self.board, None
        try:
            board.__exit__(None, None, None)
        except UnsafeError:
            self._was_reported()
        else:
            assert self.device.duties == OFF
            self.possible = [OFF]
        with pytest.raises(BoardError, match="not open"):
            board.exchange(Command(1.0, 0.0))

    @precondition(lambda self: self.board is not None)
    @rule()
    def die(self):
        """Without a word to the board."""
        self.board, self.image = None, self.board.safe_image

    @precondition(lambda self: self.board is None and self.image is not None)
    @rule()
    def rescue(self):
        try:
            self._new_board().rescue(self.image)
        except UnsafeError:
            self._was_reported()
        else:
            assert self.device.duties == OFF
            self.possible = [OFF]

    @precondition(lambda self: self.board is not None)
    @rule(trouble=TROUBLES, messages=st.integers(1, 8), commands=COMMANDS)
    def exchange_amid_trouble(self, trouble, messages, commands):
        self.disturb(trouble, messages)
        self.exchange(commands)

    @rule(trouble=TROUBLES, messages=st.integers(1, 8))
    def disturb(self, trouble, messages):
        if trouble == "pulled":
            self.wire.pull()
        else:
            setattr(self.wire, trouble, messages)

    @rule()
    def repair(self):
        self.wire.plugged = True
        self.wire.deaf = self.wire.losing = self.wire.late = 0

    @rule(ms=st.integers(0, 50))
    def wait(self, ms):
        self.time_ns += ms * 10**6

    @invariant()
    def only_the_reported_values_are_in_force(self):
        type(self).steps += 1
        if hasattr(self, "device"):
            assert any(self._is(command) for command in self.possible), (self.device.duties, self.possible)

    def _is(self, command):
        return all(
            wanted - STEP <= duty <= wanted + 1e-6 for duty, wanted in zip(self.device.duties, command, strict=True)
        )

    def _was_reported(self):
        """That power may still be on: then it may."""
        type(self).warned += 1
        self._as_it_is()

    def _as_it_is(self):
        self.possible.append(Command(*self.device.duties))

    def teardown(self):
        if not hasattr(self, "device"):
            return
        self.repair()
        if self.board is None:
            self.open(repaired=True)
        self.leave()
        assert self.device.duties == OFF


@pytest.mark.parametrize(
    "profile", [each if each == "sim_usb2" else pytest.param(each, marks=pytest.mark.long) for each in PROFILES]
)
def test_board_is_left_safe_or_the_user_warned_in_any_order_of_use_and_loss(monkeypatch, record_property, profile):
    monkeypatch.setattr(plant, "MOST_CUTS", 1)
    machine = type("Machine", (BoardMachine,), {"profile": profile})
    run_state_machine_as_test(machine, settings=FEW)
    exchanges = f"{machine.good} good and {machine.stale} failed exchanges"
    warned = f"{machine.warned} warnings that power may still be on"
    record_property(
        "figures", f"{profile}: {machine.steps} steps, opened {machine.opened} times, {exchanges}, {warned}"
    )
    assert min(machine.good, machine.stale, machine.warned) > 0
