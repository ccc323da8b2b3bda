"""The panel's screen by itself: textual's own pilot at the keys, shared memory behind it, and no board."""

import asyncio
import os
import time

import pytest

from inteco_abs.commissioning.panel import Panel
from inteco_abs.config import load_config
from inteco_abs.format import TICK, TRUTH, pack_tick
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory
from inteco_abs.realtime.processes.manual import HELD_NS, ManualClient
from inteco_abs.signals import BoardFlags, Command, Phase, Reason, Tick

LOOK = {
    "problem": "",
    "values": {"pwm0_mode": 0, "pwm0_prescaler": 44, "pwm1_mode": 0, "pwm1_prescaler": 9},
    "raw": bytes(range(32)).hex(),
    "readings": [["supply", 11.9, "V", "confirmed"], ["alarm_bit0", 1, "1", "unknown"]],
}


class Stage:
    """An app, and the other side of its memory."""

    def __init__(self, memory, *settings, outputs=True, profile="sim_usb2", because=""):
        from inteco_abs.cli.panel_screen import PanelApp

        self.memory = memory
        self.words = memory.words
        self.words[Field.LOOP_PID] = os.getpid()
        memory.post(Mailbox.HEADER, {"identity": "logic 0x0103 'ABSSIM'", "read_only_because": because})
        memory.post(Mailbox.RESULT, LOOK)
        self._ring = memory.tick_ring(pack_tick)
        self.side = ManualClient(memory)
        self.panel = Panel(load_config(settings=settings, profile=profile), outputs=outputs)
        self.app = PanelApp(self.panel, self.side, "sim:")
        self.shown = []
        self._seen_s = time.monotonic()

    def tick(self, counts=(0, 0), speeds=(0.0, 0.0), duties=(0.0, 0.0), reason=Reason.NONE, flags=BoardFlags.NONE):
        self._ring.append(
            Tick(
                1, 0, 0.01, *counts, flags, Reason.NONE, *speeds, 0.0, False, Phase.UNKNOWN, 0.0, 0.0, 0.0, 0.0, 0.0,
                *duties, reason, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0,
            )
        )  # fmt: skip

    def play(self, *steps, size=(80, 24)):
        """Run the app; each step is a key, or an `async` function of textual's pilot. Return what it ended with.

        The text on the screen before each step, and in the end if it is still open, is left in `shown`.
        """

        async def run():
            async with self.app.run_test(size=size) as pilot:
                for step in steps:
                    await self.look(pilot)
                    self.shown.append(self.text())
                    await (pilot.press(step) if isinstance(step, str) else step(pilot))
                if self.app.return_value is None:
                    await self.look(pilot)
                    self.shown.append(self.text())
            return self.app.return_value

        return asyncio.run(run())

    async def space(self, pilot, times=1):
        """The space bar, seen so often and each time at one instant, however long the screen takes over it."""
        from textual.events import Key

        for _ in range(times):
            event = Key("space", " ")
            event.time = self._seen_s
            self.app.post_message(event)
        await pilot.pause()

    async def look(self, pilot):
        """Let the screen see what is new, now."""
        self.app.look()
        await pilot.pause()

    def text(self):
        """What is on the screen, in lines."""
        lines = self.app.screen._compositor.render_strips()  # textual has no public way to it
        return "\n".join("".join(segment.text for segment in line) for line in lines)


@pytest.fixture
def stage():
    made = []

    def make(*settings, **options):
        made.append(RunMemory.create(TICK.size, 100, TRUTH.size, 1))
        return Stage(made[-1], *settings, **options)

    yield make
    for memory in made:
        memory.remove()


def test_holding_space_passes_the_sliders_on_and_a_tap_does_not(stage):
    scene = stage()
    seen = []

    async def play(pilot):
        await pilot.press("pageup", "up", "right", "right")
        await scene.space(pilot)
        seen.append(scene.words[Field.KEY_SEEN_NS])
        await scene.space(pilot)
        seen.append(scene.side.request.at(scene.words[Field.KEY_SEEN_NS]))

    scene.play(play)
    assert seen == [-HELD_NS, Command(0.11, 0.02)]


@pytest.mark.parametrize("key", ["up", "x", "d", "0"])
def test_any_other_key_takes_the_power_away(stage, key):
    scene = stage()

    async def play(pilot):
        await pilot.press("pageup")
        await scene.space(pilot, 2)
        assert scene.words[Field.KEY_SEEN_NS] > 0
        await pilot.press(key)
        assert scene.words[Field.KEY_SEEN_NS] == -HELD_NS

    scene.play(play)


def test_a_look_that_comes_after_the_screen_has_gone_shows_nothing(stage):
    scene = stage()
    assert scene.play("q") == 0
    scene.tick(counts=(5, 5))
    scene.app.look()


@pytest.mark.parametrize(("key", "code"), [("q", 0), ("ctrl+q", 0), ("ctrl+c", 130)])
def test_leaving_takes_the_power_away_first(stage, key, code):
    scene = stage()

    async def play(pilot):
        await pilot.press("pageup")
        await scene.space(pilot, 2)
        assert scene.words[Field.KEY_SEEN_NS] > 0
        await pilot.press(key)

    assert scene.play(play) == code
    assert scene.words[Field.KEY_SEEN_NS] == -HELD_NS


def test_a_read_only_panel_ignores_the_space_bar(stage):
    scene = stage(outputs=False, because="the panel only watches")

    async def play(pilot):
        await pilot.press("pageup")
        await scene.space(pilot, 3)

    scene.play(play)
    assert scene.words[Field.KEY_SEEN_NS] <= 0


@pytest.mark.parametrize("size", [(80, 24), (140, 40)])
def test_wheels_outputs_and_board_are_on_the_screen(stage, size):
    scene = stage("board.pwm_prescaler=44", 'board.verified_by="a lab"')
    scene.tick((2048, -1024), (10.0, 20.0), (0.2, 0.0))
    scene.play("pageup", "pageup", size=size)
    for wanted in (
        "POWER IS ON", "only the emergency switch", "2048", "-1024", "1.000", "-0.500", "10.0", "20.0", "191", "20 %",
        "logic 0x0103", "signed by a lab", "unknown: drive_pwm", "drive: PWM 0, 8-bit, prescaler 44",
        "prescaler 9, not the profile's 8-bit, 44", "supply 11.9 V", "alarm_bit0 1 (unknown)", "leave",
    ):  # fmt: skip
        assert wanted in scene.shown[-1]


def test_outputs_that_an_earlier_program_left_on_are_reported(stage):
    scene = stage(outputs=False, because="it only watches. ITS PWM OUTPUTS ARE NOT ZERO. MOTOR POWER MAY STILL BE ON")
    scene.play()
    assert "OUTPUTS ARE NOT ZERO" in scene.shown[0]
    assert "WATCHING" in scene.shown[0]


def test_a_trip_of_the_guard_is_reported_and_is_a_safety_stop(stage):
    scene = stage()
    scene.tick(reason=Reason.OVER_SPEED)
    assert scene.play("q") == 5
    assert "SWITCHED OFF: a wheel turned faster" in scene.shown[0]
    assert "r: arm again" in scene.shown[0]


def test_r_and_then_y_end_it_to_begin_again(stage):
    from inteco_abs.cli.panel_screen import ARM_AGAIN

    scene = stage()
    scene.tick(reason=Reason.OVER_SPEED)
    assert scene.play("r", "y") == ARM_AGAIN
    assert scene.words[Field.KEY_SEEN_NS] == -HELD_NS
    for wanted in ("arm again?", "a wheel turned faster", "identified", "press y"):
        assert wanted in scene.shown[1]


@pytest.mark.parametrize("key", ["space", "enter", "r", "escape", "q"])
def test_any_other_answer_changes_nothing(stage, key):
    scene = stage()
    scene.tick(reason=Reason.OVER_SPEED)
    assert scene.play("r", key, "q") == 5
    assert "SWITCHED OFF" in scene.shown[2]
    assert "arm again?" not in scene.shown[2]


@pytest.mark.parametrize("outputs", [True, False])
def test_while_nothing_was_taken_away_there_is_nothing_to_arm_again(stage, outputs):
    assert stage(outputs=outputs).play("r", "y", "q") == 0


def test_it_leaves_an_open_question_when_no_process_holds_the_board_any_more(stage):
    scene = stage()
    scene.tick(reason=Reason.OVER_SPEED)

    async def gone(_pilot):
        scene.words[Field.LOOP_PID] = 0

    assert scene.play("r", gone) == 5


@pytest.mark.parametrize(
    ("word", "reason", "code"),
    [
        (Field.STOP, Reason.OPERATOR_STOP, 130),
        (Field.GUARDIAN_STOP, Reason.GUARDIAN_LOST, 5),
        (Field.STOP, Reason.NONE, 5),
    ],
)
def test_it_leaves_when_no_process_holds_the_board_any_more(stage, word, reason, code):
    scene = stage()

    async def gone(_pilot):
        scene.words[word] = reason
        scene.words[Field.LOOP_PID] = 0

    assert scene.play(gone) == code


def test_a_dump_is_shown_once_the_board_has_answered_and_any_key_closes_it(stage):
    scene = stage()

    async def answered(_pilot):
        scene.words[Field.LOOKS] = scene.words[Field.LOOKS_ASKED]

    scene.play("d", answered, "pagedown", "x")
    _, before, dump, _, after = scene.shown
    assert "00 01 02 03" in dump
    assert "pwm1_prescaler = 9" in dump
    assert "space" in before
    assert "space" in after


def test_from_z_on_counts_begin_at_zero(stage):
    scene = stage()
    scene.tick((777, 888))
    scene.play("z")
    assert "777" in scene.shown[0]
    assert "777" not in scene.shown[1]


def test_the_pci_board_is_asked_for_its_alarms_all_the_time(stage):
    scene = stage(profile="sim_pci")

    async def play(_pilot):
        for _ in range(20):
            scene.app.look()

    scene.play(play)
    assert scene.words[Field.LOOKS_ASKED] >= 2
