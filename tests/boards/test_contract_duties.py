import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from inteco_abs.errors import BoardError, LinkError
from inteco_abs.signals import Command

FULL = {"8-bit": 255, "12-bit": 4095}
ROUNDING = 1e-9
duties = st.floats(0.0, 1.0)
modes = pytest.mark.parametrize("mode", FULL)


class TestDuties:
    @modes
    @given(drive=duties, brake=duties)
    @example(drive=0.5, brake=math.nextafter(1.0, 0.0))
    @example(drive=math.nextafter(1 / 255, 0.0), brake=0.999 / 4095)
    def test_a_duty_becomes_the_largest_width_that_does_not_exceed_it(self, new_bench, mode, drive, brake):
        bench, full = new_bench(f"board.pwm_mode={mode}"), FULL[mode]
        bench.device.seize()
        with bench.board:
            bench.exchange(drive, brake)
            widths = [bench.device.settings[f"pwm{channel}_width"] for channel in (0, 1)]
            assert bench.device.duties == (widths[0] / full, widths[1] / full)
        for duty, width in zip((drive, brake), widths, strict=True):
            assert 0 <= width <= full
            assert width <= duty * full + ROUNDING < width + 1

    @pytest.mark.parametrize("step", [13, pytest.param(1, marks=pytest.mark.long)])
    @modes
    def test_a_duty_that_is_a_whole_number_of_widths_is_exact(self, new_bench, mode, step):
        bench, full = new_bench(f"board.pwm_mode={mode}"), FULL[mode]
        bench.device.seize()
        with bench.board:
            for width in (*range(0, full, step if mode == "12-bit" else 1), full):
                bench.exchange(width / full, (full - width) / full)
                assert bench.device.settings["pwm0_width"] == width
                assert bench.device.settings["pwm1_width"] == full - width

    @modes
    def test_no_duty_and_full_duty_are_exact(self, new_bench, mode):
        bench = new_bench(f"board.pwm_mode={mode}")
        with bench.board:
            for command in [(1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.0, 0.0)]:
                bench.exchange(*command)
                assert bench.device.duties == command

    @pytest.mark.parametrize("prescaler", [0, 44, 32767, 32768, 65535])
    @pytest.mark.parametrize(("mode", "number"), [("8-bit", 0), ("12-bit", 1)])
    def test_mode_and_prescaler_are_those_of_the_wiring(self, new_bench, mode, number, prescaler):
        bench = new_bench(f"board.pwm_mode={mode}", f"board.pwm_prescaler={prescaler}")
        with bench.board:
            bench.exchange(0.5, 0.5)
            settings = bench.device.settings
            assert [settings[f"pwm{channel}_mode"] for channel in (0, 1)] == [number, number]
            assert [settings[f"pwm{channel}_prescaler"] for channel in (0, 1)] == [prescaler, prescaler]

    def test_the_wiring_names_the_channels_of_drive_and_brake(self, new_bench):
        bench = new_bench("board.drive_pwm=1", "board.brake_pwm=0")
        with bench.board:
            bench.exchange(0.2, 0.8)
            assert bench.device.duties == (0.8, 0.2)

    @modes
    @pytest.mark.parametrize("duty", [1.01, 1.5, 257 / 255, 2.0, 1e9, -0.01, -1.0, -1e9])
    @pytest.mark.parametrize("output", ["drive", "brake"])
    def test_a_duty_out_of_range_is_refused_and_nothing_is_written(self, new_bench, mode, duty, output):
        assert_refused(new_bench(f"board.pwm_mode={mode}"), output, duty)

    @pytest.mark.parametrize("duty", [math.nan, math.inf, -math.inf, 1e308])
    @pytest.mark.parametrize("output", ["drive", "brake"])
    def test_a_duty_that_is_not_a_finite_number_is_refused_and_nothing_is_written(self, new_bench, output, duty):
        assert_refused(new_bench(), output, duty)

    @pytest.mark.parametrize("duty", [1.001, -0.001])
    @pytest.mark.parametrize("output", ["drive", "brake"])
    def test_a_duty_out_of_range_by_less_than_a_step_of_the_pwm_is_refused(self, new_bench, duty, output):
        assert_refused(new_bench(), output, duty)


def assert_refused(bench, output, duty):
    with bench.board:
        bench.exchange(0.4, 0.2)
        acts = bench.acts
        with pytest.raises(BoardError) as refusal:
            bench.board.exchange(Command(0.4, 0.2)._replace(**{output: duty}))
        assert not isinstance(refusal.value, LinkError)
        assert bench.acts == acts
        assert bench.device.duties == (0.4, 0.2)
    assert bench.device.duties == (0.0, 0.0)
