"""The panel and what holds its board: keys, sliders, pauses, lost answers, trips and arming again, in any order."""

import tempfile
from pathlib import Path
from typing import ClassVar

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
from manual_bench import Bench

from inteco_abs.commissioning.panel import Panel
from inteco_abs.errors import UnsafeError
from inteco_abs.realtime import memory
from inteco_abs.realtime.memory import RunMemory
from inteco_abs.realtime.processes.manual import HELD_NS, RATE_HZ
from inteco_abs.rig import plant
from inteco_abs.sessions import TICK, TRUTH
from inteco_abs.signals import Reason

pytestmark = pytest.mark.untraced

FEW = settings(max_examples=max(30, settings().max_examples // 3), stateful_step_count=20)
PERIOD_NS = round(1e9 / RATE_HZ)
HELD_BEATS = HELD_NS // PERIOD_NS
OFF = (0.0, 0.0)
STEP = 1 / 255
RING_TICKS = 3000
FAST_RAD_S = 60.0
"""Soon reached, so that the guard has something to take away."""
NEVER = -(10**18)


class PanelMachine(RuleBasedStateMachine):
    """A panel, the process behind it and the rig; and what the person at the keys has done."""

    steps = beats = powered = trips = 0
    memories: ClassVar[list[RunMemory]] = []

    @initialize(profile=st.sampled_from(["sim_usb2", "sim_usb", "sim_pci"]))
    def arm(self, profile):
        limits = f"guard.over_speed_rad_s={FAST_RAD_S}", "experiment.start_speed_rad_s=40"
        self.bench = Bench(self._memory(), *limits, profile=profile)
        self.bench.clock.pass_ns(10**10)  # as computers have been on for a while
        self._take_up()

    def _memory(self):
        self.memories.append(RunMemory.create(TICK.size, RING_TICKS, TRUTH.size, 1))
        return self.memories[-1]

    def _take_up(self):
        self.bench.__enter__()
        self.panel = Panel(self.bench.config, outputs=True)
        self.over = self.tripped = False
        self.pressed_ns = self.held_ns = self.seen_ns = NEVER
        self.released_ns = NEVER
        self.requested = (0.0, 0.0)
        """Of each output, as is `earlier`, which an output may still have for two periods after a change."""
        self.earlier, self.changed_ns = (0.0, 0.0), NEVER

    @property
    def now_ns(self):
        return self.bench.clock.now_ns()

    @rule(age_ms=st.one_of(st.just(0), st.integers(0, 2000)))
    def press(self, age_ms):
        """The key is seen: now, or so long ago by a screen that stood still."""
        seen_ns = max(self.now_ns - age_ms * 10**6, self.seen_ns)
        if self.panel.press(seen_ns):
            self.bench.side.request.keep_on(self.panel.request, seen_ns)
        # what the person did, in words of the manual: the second of two events within half a second counts
        if seen_ns - self.pressed_ns < HELD_NS:
            if self.panel.request != self.requested:
                self.earlier, self.changed_ns = self.requested, self.now_ns
            self.held_ns, self.requested = seen_ns, self.panel.request
        self.pressed_ns = self.seen_ns = seen_ns

    @rule(drive=st.integers(0, 100), brake=st.integers(0, 100), repeats=st.integers(2, 25), every=st.integers(1, 6))
    def hold(self, drive, brake, repeats, every):
        """From sliders at zero on, as after arming."""
        if self.over or self.tripped:
            self.arm_again()
        self.press_another_key()
        self.panel.to_zero()
        self.panel.move("drive", drive)
        self.panel.move("brake", brake)
        for _ in range(repeats):
            self.press(0)
            self._beat(every)

    @rule()
    def press_another_key(self):
        self.panel.release()
        self.bench.side.request.take_away()
        self.pressed_ns = self.held_ns = NEVER
        self.released_ns = self.seen_ns = self.now_ns  # keys are seen in their order

    @rule(output=st.sampled_from(["drive", "brake"]), percent=st.integers(-100, 100))
    def slide(self, output, percent):
        self.press_another_key()
        self.panel.move(output, percent)

    @rule(beats=st.one_of(st.integers(1, 20), st.integers(40, 70)))
    def wait(self, beats):
        self._beat(beats)

    @precondition(lambda self: self.bench.device.duties != OFF)
    @rule(beats=st.integers(HELD_BEATS + 2, 70))
    def let_the_key_go(self, beats):
        self._beat(beats)
        assert self.bench.device.duties == OFF

    @rule(beats=st.integers(1, 6))
    def lose_answers(self, beats):
        self.bench.link.dead = True
        self._beat(beats)
        self.bench.link.dead = False

    @rule(on=st.booleans())
    def switch_the_motors_power(self, on):
        self.bench.device.power(on=on)

    @rule()
    def end_it_from_outside(self):
        self.bench.stop.request()

    @precondition(lambda self: self.over or self.tripped)
    @rule()
    def arm_again(self):
        self._let_go()
        assert self.bench.device.duties == OFF
        self.bench.device.power(on=True)
        self.bench.take(self._memory())
        self._take_up()

    def _beat(self, number):
        for _ in range(number):
            if self.over:
                return
            before = self.tripped
            try:
                self.over = not self.bench.beat()
            except UnsafeError:
                self.over = True  # the panel names the emergency switch and ends
            type(self).beats += 1
            self.panel.see(self.bench.side.ticks())
            self.tripped = self.tripped or self.panel.reason is not Reason.NONE
            type(self).trips += self.tripped and not before
            self._judge()

    def _judge(self):
        drive, brake = duties = self.bench.device.duties
        if duties == OFF:
            return
        type(self).powered += 1
        assert not self.tripped, f"power after {self.panel.reason!r}"
        assert not self.over
        key_ns = self.now_ns - max(self.held_ns, self.released_ns)
        released = self.held_ns < self.released_ns
        assert key_ns <= (2 * PERIOD_NS if released else HELD_NS + PERIOD_NS), f"{key_ns * 1e-6} ms after the key"
        guard = self.bench.config.guard
        most = self.requested
        if self.now_ns - self.changed_ns <= 2 * PERIOD_NS:
            most = max(most[0], self.earlier[0]), max(most[1], self.earlier[1])
        assert drive <= min(most[0], guard.drive_limit) + 1e-6
        assert brake <= min(most[1], guard.brake_limit) + 1e-6

    @invariant()
    def what_was_taken_away_stays_away(self):
        type(self).steps += 1
        if getattr(self, "panel", None) is not None and self.tripped:
            assert self.panel.tripped
            assert self.bench.device.duties == OFF

    def _let_go(self):
        self.bench.link.dead = False
        self.bench.__exit__(None, None, None)

    def teardown(self):
        if getattr(self, "panel", None) is not None:
            self._let_go()
            assert self.bench.device.duties == OFF
        while self.memories:
            self.memories.pop().remove()


def test_power_ends_with_the_key_and_returns_after_a_trip_only_by_arming(monkeypatch, record_property):
    with tempfile.TemporaryDirectory(prefix="abs-", dir=memory.FOLDER) as folder:
        monkeypatch.setattr(memory, "FOLDER", Path(folder))
        monkeypatch.setattr(plant, "MOST_CUTS", 1)
        run_state_machine_as_test(PanelMachine, settings=FEW)
    counts = f"{PanelMachine.steps} steps, {PanelMachine.beats} beats, {PanelMachine.powered} of them with power on"
    record_property("figures", f"panel: {counts}, {PanelMachine.trips} times taken away")
    assert PanelMachine.powered
    assert PanelMachine.trips
