"""The panel's own state, by a clock in the test's hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from inteco_abs.commissioning.panel import Panel
from inteco_abs.config import load_config
from inteco_abs.format import TICK
from inteco_abs.realtime.processes.manual import HELD_NS
from inteco_abs.signals import EXPLANATIONS, BoardFlags, Command, Phase, Reason, Tick

START_NS = 10**12
MS = 1_000_000


def panel(*settings, outputs=True):
    return Panel(load_config(settings=settings), outputs=outputs)


def ticks(*rows):
    """Ticks as they come out of the shared memory; each is counts, speeds, duties, flags and reason."""
    ring = bytearray()
    for (wheel, road), speeds, duties, flags, reason in rows:
        inputs = (START_NS, 0, 0.01, wheel, road, flags, Reason.NONE)
        row = Tick(
            *inputs, *speeds, 0.0, False, Phase.UNKNOWN, 0.0, 0.0, 0.0, 0.0, 0.0, *duties, reason,
            0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0,
        )  # fmt: skip
        ring += TICK.pack(row)
    return TICK.array(ring)


def still(*, duties=(0.0, 0.0), flags=BoardFlags.NONE, reason=Reason.NONE, counts=(0, 0)):
    return (counts, (0.0, 0.0), duties, flags, reason)


class TestDeadMansKey:
    def test_a_tap_does_nothing(self):
        assert not panel().press(START_NS)

    def test_a_key_that_repeats_is_held(self):
        by_person = panel()
        assert [by_person.press(START_NS + 30 * MS * number) for number in range(4)] == [False, True, True, True]

    def test_two_taps_far_apart_do_nothing(self):
        by_person = panel()
        assert not any(by_person.press(START_NS + HELD_NS * number) for number in range(4))

    def test_after_another_key_it_has_to_be_held_again(self):
        by_person = panel()
        by_person.press(START_NS)
        by_person.press(START_NS + 30 * MS)
        by_person.release()
        assert not by_person.held(START_NS + 31 * MS)
        assert not by_person.press(START_NS + 60 * MS)

    def test_without_outputs_it_is_never_held(self):
        by_person = panel(outputs=False)
        assert not any(by_person.press(START_NS + 30 * MS * number) for number in range(9))

    @given(st.lists(st.integers(0, 2000 * MS), max_size=30), st.integers(0, 2000 * MS))
    def test_it_is_held_only_within_half_a_second_of_a_repeat(self, gaps_ns, later_ns):
        by_person, now_ns, repeats = panel_for_examples(), START_NS, []
        by_person.release()
        for number, gap_ns in enumerate(gaps_ns):
            now_ns += gap_ns
            if by_person.press(now_ns):
                assert number
                assert gap_ns < HELD_NS
                repeats.append(now_ns)
        now_ns += later_ns
        assert by_person.held(now_ns) == any(now_ns - at_ns < HELD_NS for at_ns in repeats)


EXAMPLES = []


def panel_for_examples():
    if not EXAMPLES:
        EXAMPLES.append(panel())
    return EXAMPLES[0]


class TestSliders:
    def test_they_begin_at_zero_and_end_at_the_guards_limits(self):
        by_person = panel("guard.drive_limit=0.29", "guard.brake_limit=0.7")
        assert by_person.request == Command.SAFE
        for output in ("drive", "brake"):
            by_person.move(output, 1000)
        assert by_person.request == Command(0.29, 0.7)
        by_person.move("brake", -1000)
        assert by_person.request == Command(0.29, 0.0)
        by_person.to_zero()
        assert by_person.request == Command.SAFE

    @pytest.mark.parametrize("act", [lambda one: one.move("drive", 1), Panel.to_zero])
    def test_moving_a_slider_releases_the_key(self, act):
        by_person = panel()
        by_person.press(START_NS)
        by_person.press(START_NS + 1)
        act(by_person)
        assert not by_person.held(START_NS + 2)


class TestWhatIsSeen:
    def test_counts_turns_and_speeds_are_those_of_the_newest_tick(self):
        by_person = panel("encoders.counts_per_turn=2048")
        by_person.see(ticks(still(), ((2048, -1024), (10.0, 20.0), (0.0, 0.0), BoardFlags.NONE, Reason.NONE)))
        upper, lower = by_person.wheels
        assert (upper.name, upper.counts, upper.turns, upper.speed_rad_s) == ("upper", 2048, 1.0, 10.0)
        assert (lower.name, lower.counts, lower.turns, lower.speed_rad_s) == ("lower", -1024, -0.5, 20.0)
        assert lower.speed_rpm == pytest.approx(190.986, abs=0.001)

    def test_from_the_zero_on_they_are_counted_again(self):
        by_person = panel()
        by_person.see(ticks(still(counts=(500, 700))))
        by_person.zero_counts()
        by_person.see(ticks(still(counts=(510, 690))))
        assert [wheel.counts for wheel in by_person.wheels] == [10, -10]

    def test_no_news_change_nothing(self):
        by_person = panel()
        by_person.see(ticks(still(duties=(0.5, 0.0))))
        by_person.see(ticks())
        assert by_person.admitted == Command(0.5, 0.0)

    def test_flagged_exchanges_are_added_up(self):
        by_person = panel()
        by_person.see(ticks(still(flags=BoardFlags.STALE), still(flags=BoardFlags.SLOW), still()))
        by_person.see(ticks(still(flags=BoardFlags.STALE)))
        assert (by_person.failed, by_person.flags) == (3, BoardFlags.STALE)

    def test_pwm_settings_are_compared_with_the_profiles(self):
        by_person = panel("board.pwm_prescaler=44")
        values = {"pwm0_mode": 0, "pwm0_prescaler": 44, "pwm1_mode": 1, "pwm1_prescaler": 44}
        drive, brake = by_person.pwm({"values": values})
        assert (drive.output, drive.channel, drive.mode, drive.fits) == ("drive", 0, "8-bit", True)
        assert (brake.output, brake.channel, brake.mode, brake.fits) == ("brake", 1, "12-bit", False)

    def test_a_failed_reading_has_no_values(self):
        assert panel().pwm({"problem": "no answer"}) == []


class TestState:
    def test_the_state_shows_whether_power_is_on_and_why_not(self):
        by_person = panel()
        assert by_person.state(START_NS).startswith("OFF: hold the space bar")
        by_person.press(START_NS)
        by_person.press(START_NS + 1)
        assert "both sliders are at zero" in by_person.state(START_NS + 2)
        by_person.see(ticks(still(duties=(0.2, 0.0))))
        assert by_person.state(START_NS + 3).startswith("POWER IS ON")
        by_person.see(ticks(still(reason=Reason.OVER_SPEED)))
        assert EXPLANATIONS[Reason.OVER_SPEED] in by_person.state(START_NS + 4)

    def test_a_watching_panel_explains_how_to_move_the_motors(self):
        assert "--outputs" in panel(outputs=False).state(START_NS)
