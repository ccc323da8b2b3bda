"""What the board on the PCI bus has of its own: accesses and their order, the map's version, foreign registers."""

import struct
from contextlib import suppress
from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.registers import Write
from firmware_protocol.rtdac_pci import ALARM_BIT0, SUPPLY
from inteco_abs.errors import BoardError, ConfigError, LinkError, ReadOnlyError, UnsafeError
from inteco_abs.signals import BoardFlags, Command

VERSION, RESET, COUNT, WINDOW = 0x00, 0x84, 0x88, 0x50
DRIVE, BRAKE = Write(0x60, 0), Write(0x60, 1)
ROAD, WHEEL = Write(0x80, 0), Write(0x80, 1)
WIDTH = 0x6C
LOOK = [VERSION, DRIVE, WIDTH, BRAKE, WIDTH, WHEEL, COUNT, ROAD, COUNT]
OFF = (0.0, 0.0)
ALL_ONES = 0xFFFFFFFF


def steps_of(bench, *duties):
    """Accesses of an exchange."""
    before = len(bench.steps)
    bench.exchange(*duties)
    return bench.steps[before:]


class TestExchange:
    def test_it_writes_both_widths_then_asks_for_version_widths_and_counters(self, new_pci_bench):
        bench = new_pci_bench()
        with bench.board:
            assert steps_of(bench, 1.0, 0.2) == [
                DRIVE, WIDTH, Write(WIDTH, 255), BRAKE, WIDTH, Write(WIDTH, 51), *LOOK,
            ]  # fmt: skip

    @pytest.mark.parametrize(
        ("before", "after", "first"),
        [
            (OFF, (1.0, 0.0), DRIVE),
            (OFF, (0.0, 1.0), DRIVE),
            ((1.0, 0.0), (0.0, 0.6), DRIVE),
            ((0.0, 0.6), (1.0, 0.0), BRAKE),
            ((0.5, 0.6), (0.5, 0.2), BRAKE),
            ((1.0, 1.0), OFF, DRIVE),
        ],
    )
    def test_what_falls_is_written_before_what_rises(self, new_pci_bench, before, after, first):
        bench = new_pci_bench()
        with bench.board:
            bench.exchange(*before)
            assert steps_of(bench, *after)[0] == first

    def test_a_failure_between_the_two_widths_leaves_the_lower_power(self, new_pci_bench):
        bench = new_pci_bench()
        with bench.board:
            bench.exchange(0.0, 0.6)
            bench.strike({bench.link.operations + 4: LinkError("no answer")})
            bench.exchange(1.0, 0.0)
            assert bench.device.duties == OFF

    @pytest.mark.parametrize("moment", range(20))
    def test_a_master_that_moves_the_pwm_index_does_not_go_unnoticed(self, new_pci_bench, moment):
        bench = new_pci_bench()
        with bench.board:
            bench.exchange(0.2, 0.4)
            operation = bench.link.operations + moment

            def interfere(number):
                if number == operation:
                    bench.front_end.front_end.write(*DRIVE)

            bench.link.before_operation = interfere
            sample = bench.exchange(0.4, 0.2)
            assert sample.board_flags is BoardFlags.STALE or bench.device.duties == (0.4, 0.2)

    @pytest.mark.parametrize("widths", [(255, 0), (0, 255), (52, 102), (0, 0)])
    def test_width_written_by_another_program_fails_the_next_exchange(self, new_pci_bench, widths):
        bench = new_pci_bench()
        with bench.board as board:
            bench.exchange(0.2, 0.4)
            for channel, width in zip((DRIVE, BRAKE), widths, strict=True):
                bench.front_end.front_end.write(*channel)
                bench.front_end.front_end.write(WIDTH, width)
            sample = bench.exchange(0.4, 0.2)
            assert sample.board_flags is BoardFlags.STALE
            assert f"the board had PWM widths {widths}, last written were (51, 102)" in str(board.last_error)
            assert bench.device.duties == (0.4, 0.2)
            assert bench.exchange(0.4, 0.2).board_flags is BoardFlags.NONE

    def test_the_writes_of_safe_are_not_blamed_on_another_program(self, new_pci_bench):
        bench = new_pci_bench()
        with bench.board as board:
            bench.exchange(0.2, 0.4)
            board.make_safe()
            assert bench.exchange().board_flags is BoardFlags.NONE

    def test_no_other_program_is_blamed_if_the_end_of_safe_is_unknown(self, new_pci_bench):
        bench = new_pci_bench()
        with bench.board as board:
            bench.exchange(0.2, 0.4)
            first = bench.link.operations
            bench.strike({number: LinkError("no answer") for number in range(first, first + 30)})
            with pytest.raises(UnsafeError):
                board.make_safe()
            bench.strike({})
            assert bench.exchange().board_flags is BoardFlags.NONE

    @pytest.mark.parametrize("widths", [(255, 0), (0, 255)])
    def test_a_width_that_another_program_wrote_after_safe_fails_the_next_exchange(self, new_pci_bench, widths):
        bench = new_pci_bench()
        with bench.board as board:
            board.make_safe()
            for channel, width in zip((DRIVE, BRAKE), widths, strict=True):
                bench.front_end.front_end.write(*channel)
                bench.front_end.front_end.write(WIDTH, width)
            assert bench.exchange().board_flags is BoardFlags.STALE

    @pytest.mark.parametrize(("raw", "text"), [(ALL_ONES, "no board answers"), (0x50E, "0x050E"), (0, "0x0000")])
    def test_a_board_that_is_gone_or_another_fails_the_exchange(self, new_pci_bench, raw, text):
        bench = new_pci_bench()
        with bench.board as board:
            good = bench.roll()
            bench.link.change_next_value = ((VERSION, None), lambda _: raw)
            sample = bench.exchange(1.0)
            assert sample.board_flags is BoardFlags.STALE
            assert sample.road_count == good.road_count
            assert text in str(board.last_error)

    @pytest.mark.parametrize("upper", [0, 1, 0xFFFE])
    def test_the_upper_half_of_the_version_register_may_be_anything(self, new_pci_bench, upper):
        bench = new_pci_bench()
        with bench.board:
            bench.link.change_next_value = ((VERSION, None), lambda value: value | upper << 16)
            assert bench.exchange(1.0).board_flags is BoardFlags.NONE


class TestOpening:
    def test_a_trusted_board_is_identified_by_a_single_read(self, new_pci_bench):
        bench = new_pci_bench()
        bench.board.identify()
        assert bench.steps == [VERSION]

    def test_the_first_settings_written_are_both_widths(self, new_pci_bench):
        bench = new_pci_bench()
        with bench.board:
            written = [step for step in bench.steps if isinstance(step, Write)]
        assert written[:4] == [DRIVE, Write(WIDTH, 0), BRAKE, Write(WIDTH, 0)]

    @pytest.mark.parametrize("version", [0x50E, 0x510, 0, 0xFFFF])
    @pytest.mark.parametrize("signed", [True, False])
    def test_to_another_logic_nothing_is_written_whoever_signs_for_it(self, new_pci_bench, version, signed):
        signature = f"board.verified_logic={version}"
        bench = new_pci_bench(f"board.logic_version={version}", signature if signed else "loop.rate_hz=2000.0")
        bench.link.change_answer = lambda answer: answer[:4] + version.to_bytes(4, "little")
        with bench.board as board:
            assert f"0x{version:04X}" in board.identity.read_only_because
            assert "0x050F" in board.identity.read_only_because
            with pytest.raises(ReadOnlyError):
                bench.exchange(1.0, 1.0)
            with pytest.raises(BoardError, match="not known"):
                board.readings()
            with pytest.raises(BoardError, match="not known"):
                board.survey()
        assert set(bench.steps) == {VERSION}

    @pytest.mark.parametrize(("on", "warned"), [("pwm0_width", True), ("pwm1_width", True), ("pwm0_prescaler", False)])
    def test_each_output_that_is_on_is_warned_of_where_nothing_may_be_written(self, new_pci_bench, on, warned):
        bench = new_pci_bench('board.verified_by=""', earlier={on: 255})
        assert ("ITS PWM OUTPUTS ARE NOT ZERO" in bench.board.identify().read_only_because) is warned

    def test_each_output_that_is_on_is_planned_to_go_off(self, new_pci_bench):
        bench = new_pci_bench(earlier={"pwm0_width": 200, "pwm1_width": 100})
        with bench.board.reading() as board:
            planned = {one.names: (one.now, one.planned) for one in board.first_write()}
        assert (planned["pwm0_width",], planned["pwm1_width",]) == ((200, 0), (100, 0))

    def test_a_survey_has_the_registers_as_they_came(self, new_pci_bench):
        with new_pci_bench(earlier={"encoder_reset": 4}).board as board:
            survey = board.survey(["logic_version", "encoder_reset", "pwm1_prescaler"])
        assert survey.raw == struct.pack("<3I", 0x50F, 4, 44)

    def test_without_an_answering_board_it_is_a_link_error_and_nothing_is_written(self, new_pci_bench):
        bench = new_pci_bench()
        bench.link.change_answer = lambda answer: answer[:4] + b"\xff" * 4
        with pytest.raises(LinkError, match="no board answers"):
            bench.board.__enter__()
        assert bench.steps == [VERSION]
        assert bench.link.closed

    @given(reset=st.integers(0, 15), road=st.integers(0, 2), wheel=st.integers(0, 2))
    def test_only_the_reset_bits_of_the_two_wheels_are_released(self, new_pci_bench, reset, road, wheel):
        if road == wheel:
            return
        wiring = (f"board.road_encoder={road}", f"board.wheel_encoder={wheel}")
        bench = new_pci_bench(*wiring, earlier={"encoder_reset": reset})
        with bench.board:
            assert bench.device.settings["encoder_reset"] == reset & ~(1 << road | 1 << wheel)

    @pytest.mark.parametrize("name", ["pwm0_mode", "pwm1_mode", "pwm0_prescaler", "pwm1_prescaler", "encoder_reset"])
    def test_a_setting_that_the_board_does_not_take_is_named(self, new_pci_bench, name):
        bench = new_pci_bench("board.pwm_mode=12-bit", earlier={"encoder_reset": 1})
        apply = bench.device.apply
        bench.device.apply = lambda settings: apply({key: value for key, value in settings.items() if key != name})
        with pytest.raises(BoardError, match=f"did not take its settings: {name.replace('0', '').replace('1', '')}"):
            bench.board.__enter__()
        assert bench.link.closed
        assert bench.device.duties == OFF

    @pytest.mark.parametrize(
        ("setting", "text"),
        [
            ("drive_pwm=2", "channels 0..1"),
            ("brake_pwm=7", "channels 0..1"),
            ("road_encoder=3", "channels 0..2"),
            ("wheel_encoder=11", "channels 0..2"),
            ("numbering_pwm=3", "no frames"),
        ],
    )
    def test_a_wiring_to_channels_that_are_not_there_is_refused(self, new_pci_bench, setting, text):
        with pytest.raises(ConfigError, match=rf"board\.{setting.partition('=')[0]}.*{text}"):
            new_pci_bench(f"board.{setting}")


class TestSafe:
    def test_the_brake_is_switched_off_even_if_the_drive_can_never_be(self, new_pci_bench):
        bench = new_pci_bench()

        def refuse_the_drive(_number):
            bench.link.refuse_step = lambda step: step == DRIVE

        bench.board.__enter__()
        bench.exchange(1.0, 0.6)
        bench.link.before_operation = refuse_the_drive
        with pytest.raises(UnsafeError, match="emergency switch"):
            bench.board.make_safe()
        assert bench.device.duties == (1.0, 0.0)

    def test_a_rescue_writes_the_prepared_image_unchanged(self, new_pci_bench):
        bench = new_pci_bench()
        left = [BRAKE, Write(WIDTH, 0), DRIVE, Write(WIDTH, 0)]
        bench.board.rescue(struct.pack("<8I", *(word for write in left for word in write)))
        assert bench.steps[:5] == [*left, VERSION]

    @pytest.mark.untraced
    def test_two_faults_at_any_two_moments_of_the_end_never_leave_an_output_on(self, new_pci_bench):
        pairs = 0
        for one, other in combinations(range(30), 2):
            bench = new_pci_bench()
            with suppress(LinkError, KeyboardInterrupt), bench.board:
                bench.exchange(1.0, 0.6)
                start = bench.link.operations
                reached = bench.strike({start + one: LinkError("no answer"), start + other: KeyboardInterrupt()})
                bench.exchange(1.0, 0.6)
            pairs += reached == [start + one, start + other]
            assert bench.device.duties == OFF, (one, other)
        assert pairs > 200


EXPECTED = {
    "supply": (24.0, "V"),
    "temperature": (21.0, "degC"),
    "velocity_window": (5000.0, "us"),
    "road_velocity": (0.0, "rpm"),
    "wheel_velocity": (0.0, "rpm"),
    "resistor1_in_series": (1, "1"),
    "resistor2_in_series": (1, "1"),
    "alarm_bit0": (1, "1"),
    "alarm_supply": (1, "1"),
    "alarm_bit2": (1, "1"),
    "maximum_road_velocity": (2344.0, "rpm"),
    "minimum_supply": (12.3, "V"),
    "maximum_temperature": (80, "degC"),
    "resistor1_low": (1641.0, "rpm"),
    "resistor1_high": (1758.0, "rpm"),
    "resistor2_low": (1641.0, "rpm"),
    "resistor2_high": (1758.0, "rpm"),
}


class TestReadings:
    def test_they_are_the_screen_values_of_the_manual_at_rest(self, new_pci_bench):
        readings = {one.name: one for one in new_pci_bench().board.readings()}
        assert readings.keys() == EXPECTED.keys()
        for name, (value, unit) in EXPECTED.items():
            assert readings[name].value == pytest.approx(value, rel=5e-4), name
            assert readings[name].unit == unit

    def test_they_say_that_the_meaning_of_the_alarm_flags_is_unknown(self, new_pci_bench):
        statuses = {one.name: one.status for one in new_pci_bench().board.readings()}
        assert {name for name, status in statuses.items() if status is ALARM_BIT0.status} == {
            "alarm_bit0",
            "alarm_supply",
            "alarm_bit2",
        }
        assert statuses["supply"] is SUPPLY.status

    def test_nothing_is_written_for_them(self, new_pci_bench):
        bench = new_pci_bench('board.verified_by=""')
        with bench.board as board:
            before = len(bench.steps)
            board.readings()
        assert all(isinstance(step, int) for step in bench.steps[before:])

    def test_velocities_are_those_of_the_wheels(self, new_pci_bench):
        bench = new_pci_bench()
        bench.device.plant.road_speed, bench.device.plant.wheel_speed = 178.0, 100.0
        readings = {one.name: one.value for one in bench.board.readings()}
        assert readings["road_velocity"] == pytest.approx(1700, abs=12)
        assert readings["wheel_velocity"] == pytest.approx(955, abs=12)

    def test_a_velocity_without_a_window_has_no_value(self, new_pci_bench):
        bench = new_pci_bench()
        bench.link.change_next_value = ((WINDOW, None), lambda _: 0)
        readings = {one.name: one.value for one in bench.board.readings()}
        assert readings["road_velocity"] is None
        assert readings["supply"] == pytest.approx(24.0, rel=1e-3)


def test_a_command_out_of_range_writes_no_register(new_pci_bench):
    bench = new_pci_bench()
    with bench.board:
        before = bench.steps
        with pytest.raises(BoardError, match=r"0\.\.1"):
            bench.board.exchange(Command(0.0, 1.1))
        assert bench.steps == before
