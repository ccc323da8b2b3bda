"""Taking over the board of a process that is gone, with nothing but the image that it left."""

from contextlib import suppress

import pytest

from inteco_abs.errors import BoardError, LinkError, UnsafeError
from inteco_abs.signals import Command

BOTH = (1.0, 0.6)
OFF = (0.0, 0.0)


@pytest.fixture
def new_wreck(new_bench):
    """Makes a bench whose board was left driving by a process that is gone; `image` is what that had left."""

    def make(*settings, duties=BOTH):
        bench = new_bench(*settings)
        bench.board.__enter__()
        bench.image = bench.board.safe_image
        bench.exchange(*duties)
        bench.die()
        bench.plug_in()
        assert bench.device.duties == duties
        return bench

    return make


@pytest.fixture
def wreck(new_wreck):
    return new_wreck()


class TestSafeImage:
    def test_it_has_all_widths_zero_regardless_of_what_the_board_does_now(self, new_bench):
        bench, images = new_bench(), []
        with bench.board as board:
            for duties in [(0.0, 0.0), (1.0, 0.6), (0.2, 1.0)]:
                bench.exchange(*duties)
                images.append(bench.settings_in(board.safe_image))
                assert bench.device.duties == duties
        assert images[0] == images[1] == images[2]
        assert not any(images[0][f"pwm{channel}_width"] for channel in range(bench.channels))

    def test_it_is_what_the_board_itself_writes_first(self, new_bench, both_on):
        bench = new_bench(earlier={**both_on, "pin_output": 0x155, "pwm1_prescaler": 77})
        with bench.board as board:
            assert bench.settings_in(board.safe_image) == bench.unnumbered(bench.settings_sent[0])

    def test_taking_it_changes_nothing(self, new_bench):
        bench = new_bench()
        with bench.board as board:
            bench.exchange(*BOTH)
            acts = bench.acts
            assert isinstance(board.safe_image, bytes)
            assert bench.acts == acts
            bench.exchange(*BOTH)
            assert bench.device.duties == BOTH


class TestRescue:
    @pytest.mark.parametrize("mode", ["8-bit", "12-bit"])
    @pytest.mark.parametrize("duties", [(1.0, 0.0), (0.0, 0.6), (1.0, 1.0), (0.0, 0.0)])
    def test_a_board_that_was_left_driving_has_both_outputs_off(self, new_wreck, mode, duties):
        wreck = new_wreck(f"board.pwm_mode={mode}", duties=duties)
        wreck.board.rescue(wreck.image)
        assert wreck.device.duties == OFF
        assert wreck.device.settings["pwm0_width"] == wreck.device.settings["pwm1_width"] == 0

    def test_the_image_goes_out_before_anything_is_read_and_is_then_read_back(self, wreck):
        wreck.board.rescue(wreck.image)
        assert wreck.acts == [*["send"] * wreck.sends_of_safe, "read"]
        assert wreck.unnumbered(wreck.settings_sent[0]) == wreck.settings_in(wreck.image)

    def test_only_the_outputs_change(self, wreck):
        before = dict(wreck.device.settings)
        wreck.board.rescue(wreck.image)
        after = wreck.unnumbered({**before, "pwm0_width": 0, "pwm1_width": 0})
        assert wreck.unnumbered(wreck.device.settings) == after

    def test_the_outputs_are_off_even_if_every_answer_is_lost(self, wreck):
        wreck.link.change_answer = lambda _answer: b""
        with pytest.raises(UnsafeError, match=r"SAFE could not be confirmed.*emergency switch"):
            wreck.board.rescue(wreck.image)
        assert wreck.device.duties == OFF

    def test_a_board_that_does_not_answer_is_an_error_that_names_the_emergency_switch(self, wreck):
        wreck.unplug()
        with pytest.raises(UnsafeError, match=r"unplugged.*emergency switch") as refusal:
            wreck.board.rescue(wreck.image)
        assert isinstance(refusal.value.__cause__, LinkError)
        assert wreck.link.failed == 3 * wreck.messages_of_safe
        assert wreck.device.duties == BOTH

    def test_zeros_that_are_not_an_answer_of_this_board_confirm_nothing(self, wreck):
        wreck.link.change_answer = lambda answer: bytes(len(answer))
        with pytest.raises(UnsafeError, match="emergency switch"):
            wreck.board.rescue(wreck.image)

    def test_a_board_that_ignores_the_image_is_not_mistaken_for_safe(self, wreck):
        wreck.ignore_commands()
        with pytest.raises(UnsafeError, match="emergency switch"):
            wreck.board.rescue(wreck.image)
        assert wreck.front_end.ignored == 3 * wreck.sends_of_safe
        assert wreck.device.duties == BOTH

    def test_a_failure_that_passes_is_tried_again(self, wreck, way):
        wreck.fail_next(way)
        wreck.board.rescue(wreck.image)
        assert wreck.link.failed == 1
        assert wreck.device.duties == OFF

    def test_answers_to_the_dead_process_are_not_mistaken_for_those_to_this_one(self, wreck):
        for _ in range(3):
            wreck.read_along()
        wreck.board.rescue(wreck.image)
        assert wreck.device.duties == OFF
        assert wreck.acts == [*["send"] * wreck.sends_of_safe, "read"]

    @pytest.mark.parametrize("trouble", ["none", "unplugged", "deaf", "interrupted"])
    def test_the_board_is_released_in_any_case(self, wreck, trouble):
        prepare = {
            "unplugged": wreck.unplug,
            "deaf": wreck.ignore_commands,
            "interrupted": lambda: wreck.strike({0: KeyboardInterrupt()}),
        }
        prepare.get(trouble, lambda: None)()
        with suppress(UnsafeError, KeyboardInterrupt):
            wreck.board.rescue(wreck.image)
        assert wreck.link.closed

    @pytest.mark.parametrize("error", [LinkError("no answer"), KeyboardInterrupt()], ids=lambda e: type(e).__name__)
    def test_one_fault_at_any_moment_does_not_leave_an_output_on(self, new_wreck, error):
        moments = 0
        while True:
            wreck = new_wreck()
            reached = wreck.strike({moments: error})
            with suppress(type(error)):
                wreck.board.rescue(wreck.image)
            assert wreck.device.duties == OFF, moments
            assert wreck.link.closed
            if not reached:
                break
            moments += 1
        assert moments >= 3

    def test_after_it_the_board_is_not_open(self, wreck):
        wreck.board.rescue(wreck.image)
        with pytest.raises(BoardError, match="not open"):
            wreck.board.exchange(Command(*BOTH))
        assert wreck.device.duties == OFF

    def test_another_program_can_open_the_board_afterwards(self, wreck):
        wreck.board.rescue(wreck.image)
        wreck.plug_in()
        with wreck.board:
            wreck.exchange(0.4, 0.2)
            assert wreck.device.duties == (0.4, 0.2)
        assert wreck.device.duties == OFF

    def test_another_process_can_repeat_the_rescue(self, wreck):
        wreck.ignore_commands()
        with suppress(UnsafeError):
            wreck.board.rescue(wreck.image)
        wreck.front_end.deaf = False
        wreck.plug_in()
        wreck.board.rescue(wreck.image)
        assert wreck.device.duties == OFF
