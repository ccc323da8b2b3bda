"""The open logic of the firmware, rule by rule of PROTOCOL.md."""

from itertools import pairwise

import pytest
from host_board import HostBoard
from open_host import OpenHost, decoded

from firmware_protocol.c_header import BOARD_DATE, BOARD_NAME
from firmware_protocol.open_board import ARM, CHALLENGE_MASK, CLEAR, COMMAND, HELLO, QUERY, REPORT, Refused, State, Trip
from firmware_protocol.rtdac_usb import READ_REQUEST, decode_read, encode_send

VENDOR_ON = encode_send({"pin_mode": 3, "pwm0_width": 200}, logic=0x0111)
VENDOR_SAFE = encode_send({"pin_mode": 3}, logic=0x0111)


@pytest.fixture
def host(board):
    return OpenHost(board)


def refusal(answer):
    name, values = answer
    assert name == "REFUSAL"
    return values["reason"]


def test_a_frame_written_out_by_hand(board):
    answer = board.asked(bytes.fromhex("A5 06 00 07 DB 0E"))
    assert answer[:6] == bytes.fromhex("A5 83 2E 07 00 00")
    assert len(answer) == 52


class TestIdentity:
    def test_hello(self, host):
        name, values = host.asked(HELLO, sequence=0xA5)
        assert name == "IDENTITY"
        del values["sequence"]
        assert values == {
            "protocol": 1,
            "logic_version": 0x0B01,
            "name": BOARD_NAME,
            "date": BOARD_DATE,
            "unique_id": "0123456789ABCDEF",
            "clock_hz": 1_000_000,
            "counters": 4,
            "pwms": 2,
        }

    def test_status_after_power_up(self, host):
        values = host.status()
        assert values.pop("sequence") == 7
        assert values.pop("challenge")
        assert set(values.values()) == {0}

    def test_the_first_frame_of_a_board(self, tmp_path):
        assert OpenHost(HostBoard(tmp_path)).status()["state"] == State.IDLE

    def test_a_reset_forgets_all(self, host, board):
        start = host.status()
        board.inputs = 0xFFFF
        host.armed(tick_hz=1000, watchdog_ms=50, stop_pins=0xFFFF)
        host.reports(1000)
        host.command(9, 9, sequence=0)
        host.command(9, 9, sequence=5)
        host.reports(2000)
        board.write(b"\xa5\xff" + COMMAND.encode()[:5])
        board.reset()
        assert host.status() | {"challenge": 0} == start | {"challenge": 0}
        found = host.commanded(0, 0)
        assert (found["tick"], found["applied"], board.tick_us) == (0, 0, 1000)

    def test_status_counts_late_instants(self, host, board):
        host.armed(tick_hz=1000)
        host.reports(4000)
        name, found = decoded(board.asked(QUERY.encode()))[0]
        assert (name, found["late"]) == ("STATUS", 3)

    def test_status_shows_what_is_there(self, host, board):
        board.advance(1234)
        board.inputs = 0x2ABCDEF
        for channel in range(4):
            board.turn(channel, -1 - channel)
        found = host.status()
        assert [found[f"count{i}"] for i in range(4)] == [-1, -2, -3, -4]
        assert (found["clock"], found["pins"]) == (1234, 0xCDEF)


class TestConfigure:
    def test_it_is_echoed(self, host):
        wanted = {"watchdog_ms": 100, "tick_hz": 4000, "stop_pins": 0xFEDC, "pwm_mode": 1, "pwm_prescaler": 0xABCD}
        name, values = host.configure(**wanted)
        assert (name, values["state"]) == ("STATUS", State.CONFIGURED)
        assert {each: values[each] for each in wanted} == wanted

    @pytest.mark.parametrize(
        ("watchdog_ms", "tick_hz"), [(2, 0), (100, 0), (2, 1000), (20, 100), (2, 4000), (100, 100), (4, 500), (16, 125)]
    )
    def test_valid_settings_are_accepted(self, host, watchdog_ms, tick_hz):
        assert host.configure(watchdog_ms, tick_hz)[0] == "STATUS"

    @pytest.mark.parametrize(
        ("watchdog_ms", "tick_hz"),
        [(1, 0), (101, 0), (0, 1000), (255, 4000), (3, 500), (19, 100), (100, 80), (100, 5000), (100, 1), (100, 300)],
    )
    def test_invalid_settings_are_refused(self, host, watchdog_ms, tick_hz):
        assert refusal(host.configure(watchdog_ms, tick_hz)) == Refused.VALUE
        found = host.status()
        assert (found["state"], found["watchdog_ms"], found["tick_hz"]) == (State.IDLE, 0, 0)

    @pytest.mark.parametrize("pwm_mode", [2, 255])
    def test_an_unknown_pwm_mode(self, host, pwm_mode):
        assert refusal(host.configure(pwm_mode=pwm_mode)) == Refused.VALUE

    def test_a_refusal_says_what_and_why(self, host, board):
        board.write(VENDOR_ON)
        board.advance(251_000)
        assert host.configure(watchdog_ms=1)[1] == {
            "sequence": 7,
            "refused": 2,
            "reason": Refused.VALUE,
            "state": State.IDLE,
            "trip": Trip.VENDOR_WATCHDOG,
        }
        host.armed()
        assert host.asked(CLEAR)[1] == {
            "sequence": 7,
            "refused": 7,
            "reason": Refused.STATE,
            "state": State.ARMED,
            "trip": Trip.VENDOR_WATCHDOG,
        }

    def test_not_while_armed_or_tripped(self, host, board):
        host.armed()
        assert refusal(host.configure()) == Refused.STATE
        board.advance(11_000)
        assert host.status()["state"] == State.TRIPPED
        assert refusal(host.configure()) == Refused.STATE

    def test_not_while_the_vendors_logic_has_a_width_on(self, host, board):
        board.write(VENDOR_ON)
        assert refusal(host.configure()) == Refused.OUTPUTS
        assert board.widths == (200, 0)
        board.write(VENDOR_SAFE)
        assert host.configure()[0] == "STATUS"

    def test_the_vendors_settings_are_then_those_of_power_up(self, host, board):
        start = board.asked(READ_REQUEST)
        settings = {"pin_direction": 0, "pin_output": 5, "encoder_reset": 15, "timer_mode": 3, "pin_mode": 31}
        board.write(encode_send(settings, logic=0x0111))
        host.configure(stop_pins=1)
        assert board.driven == (0, 0)
        assert board.asked(READ_REQUEST) == start
        for channel in range(4):
            board.turn(channel, 5)
        assert [host.status()[f"count{i}"] for i in range(4)] == [5] * 4

    def test_it_moves_nothing_and_sends_no_reports(self, host, board):
        host.configure(tick_hz=4000, pwm_mode=1, pwm_prescaler=44)
        assert board.pwm == ((0, 1, 44), (0, 1, 44))
        assert host.reports(5000) == []
        assert board.tick_us == 1000


class TestArm:
    def test_the_challenge_must_be_answered(self, host):
        host.configure()
        right = host.status()["challenge"] ^ CHALLENGE_MASK
        for wrong in (CHALLENGE_MASK, 1, 0x0100, 0x8000):
            assert refusal(host.asked(ARM, answer=right ^ wrong)) == Refused.ANSWER
        assert host.arm()[1]["state"] == State.ARMED

    def test_only_in_state_configured(self, host, board):
        assert refusal(host.arm()) == Refused.STATE
        host.armed()
        assert refusal(host.arm()) == Refused.STATE
        board.advance(11_000)
        assert refusal(host.arm()) == Refused.STATE

    def test_a_repeated_frame_does_not_arm_again(self, host, board):
        host.configure()
        frame = ARM.encode({"answer": host.status()["challenge"] ^ CHALLENGE_MASK})
        assert decoded(board.asked(frame))[0][0] == "STATUS"
        host.disarm()
        assert refusal(decoded(board.asked(frame))[0]) == Refused.ANSWER

    def test_arming_disarming_and_trips_draw_another_challenge(self, host, board):
        host.configure()
        seen = [host.status()["challenge"]]
        seen.append(host.arm()[1]["challenge"])
        seen.append(host.disarm()[1]["challenge"])
        seen.append(host.disarm()[1]["challenge"])
        seen.append(host.arm()[1]["challenge"])
        board.advance(11_000)
        seen.append(host.status()["challenge"])
        host.asked(CLEAR)
        board.write(VENDOR_ON)
        board.advance(300_000)
        seen.append(host.status()["challenge"])
        assert all(one != other for one, other in pairwise(seen))

    def test_not_while_a_stop_input_is_low(self, host, board):
        host.configure(stop_pins=0b1010)
        for low, levels in ((True, 0b1000), (True, 0b0010), (True, 0b0101), (False, 0b1010)):
            board.inputs = levels
            name, values = host.arm()
            assert (name == "REFUSAL" and values["reason"] == Refused.STOP_INPUT) == low

    def test_not_while_the_vendors_logic_has_a_width_on(self, host, board):
        host.configure()
        board.write(VENDOR_ON)
        assert refusal(host.arm()) == Refused.OUTPUTS

    def test_armed_the_widths_are_still_zero(self, host, board):
        host.armed()
        assert board.widths == (0, 0)


class TestPolledCommands:
    def test_it_acts_and_is_answered_at_once(self, host, board):
        host.armed()
        board.advance(321)
        board.turn(0, 3)
        board.turn(1, -2)
        found = host.commanded(4095, 1, sequence=200)
        assert board.pwm == ((4095, 1, 2), (1, 1, 2))
        assert found == {
            "sequence": 200,
            "tick": 0,
            "clock": 321,
            "count0": 3,
            "count1": -2,
            "width0": 4095,
            "width1": 1,
            "state": State.ARMED,
            "trip": Trip.NONE,
            "applied": 200,
            "late": 0,
        }
        assert host.commanded(1, 2)["tick"] == 1

    @pytest.mark.parametrize(("pwm_mode", "most"), [(0, 255), (1, 4095)])
    def test_mode_and_prescaler_are_those_configured(self, host, board, pwm_mode, most):
        host.armed(pwm_mode=pwm_mode, pwm_prescaler=0xABCD)
        host.commanded(most, most)
        assert board.pwm == ((most, pwm_mode, 0xABCD),) * 2
        assert host.commanded(most + 1, 0)["width0"] == most
        assert host.commanded(0, most + 1)["width0"] == most

    @pytest.mark.parametrize("widths", [(4096, 0), (0, 4096), (0xFFFF, 0xFFFF)])
    def test_widths_out_of_range_change_nothing(self, host, board, widths):
        host.armed()
        host.commanded(5, 6, sequence=1)
        found = host.commanded(*widths, sequence=2)
        assert (found["width0"], found["width1"], found["applied"]) == (5, 6, 1)
        assert board.widths == (5, 6)
        assert host.status()["refused"] == 1

    def test_in_another_state_widths_stay_off_and_count_as_refused(self, host, board):
        def refused():
            seen = []
            for widths in ((0, 0), (1, 0), (0, 0), (0, 1), (1, 1)):
                found = host.commanded(*widths)
                assert (found["width0"], found["applied"], board.widths) == (0, 0, (0, 0))
                seen.append(host.status()["refused"])
            return seen

        assert refused() == [0, 1, 1, 2, 3]
        host.configure()
        assert refused() == [3, 4, 4, 5, 6]
        host.armed()
        board.advance(11_000)
        assert refused() == [6, 7, 7, 8, 9]

    def test_the_numbers_of_reports_begin_at_each_arming(self, host):
        host.configure()
        assert [host.commanded(0, 0)["tick"] for _ in range(2)] == [0, 1]
        host.arm()
        assert [host.commanded(0, 0)["tick"] for _ in range(3)] == [0, 1, 2]

    def test_and_where_one_ends(self, host, board):
        host.armed()
        host.commanded(0, 0)
        host.disarm()
        assert [host.commanded(0, 0)["tick"] for _ in range(2)] == [0, 1]
        host.arm()
        board.advance(11_000)
        host.commanded(0, 0)
        host.asked(CLEAR)
        assert host.commanded(0, 0)["tick"] == 0

    def test_after_arming_no_command_is_in_force(self, host):
        host.armed()
        host.commanded(5, 5, sequence=9)
        host.disarm()
        assert host.commanded(0, 0, sequence=3)["applied"] == 9
        host.arm()
        assert host.commanded(4096, 0)["applied"] == 0


class TestTick:
    def test_a_report_at_each_instant_from_one_period_after_arming_on(self, host, board):
        board.advance(777)
        host.armed(tick_hz=2000)
        found = host.reports(2000)
        assert [(each["tick"], each["sequence"], each["clock"]) for each in found] == [
            (k, k, 777 + 500 * (k + 1)) for k in range(4)
        ]

    def test_counts_are_those_of_the_instant(self, host, board):
        host.armed(tick_hz=1000)
        board.turn(0, 10)
        board.turn(1, -10)
        (found,) = host.reports(1000)
        assert (found["count0"], found["count1"]) == (10, -10)

    def test_a_command_acts_at_the_next_instant(self, host, board):
        host.armed(tick_hz=1000)
        host.reports(1000)
        board.advance(400)
        host.command(100, 200, sequence=0)
        assert board.widths == (0, 0)
        assert board.read() == b""
        (found,) = host.reports(600)
        assert board.widths == (100, 200)
        assert (found["tick"], found["width0"], found["width1"], found["applied"]) == (1, 100, 200, 0)

    def test_the_newest_command_of_an_instant_counts(self, host):
        host.armed(tick_hz=1000)
        host.reports(1000)
        host.command(100, 200, sequence=0)
        host.command(300, 0, sequence=0)
        host.command(4096, 0, sequence=0)
        (found,) = host.reports(1000)
        assert (found["width0"], found["width1"]) == (300, 0)

    def test_a_late_command_changes_nothing_and_is_counted(self, host):
        host.armed(tick_hz=1000, watchdog_ms=10)
        host.reports(2000)
        host.command(100, 200, sequence=0)
        (found,) = host.reports(1000)
        assert (found["width0"], found["late"]) == (0, 2)
        assert host.status()["refused"] == 1

    @pytest.mark.parametrize("sequence", [0, 255, 1])
    def test_before_the_first_report_no_command_is_in_time(self, host, sequence):
        host.armed(tick_hz=1000)
        host.command(100, 200, sequence=sequence)
        (found,) = host.reports(1000)
        assert (found["width0"], found["late"]) == (0, 0)
        assert host.status()["refused"] == 1

    def test_late_counts_instants_without_a_command_of_theirs(self, host):
        host.armed(tick_hz=1000, watchdog_ms=100)
        late = []
        for k in range(6):
            (found,) = host.reports(1000)
            late.append(found["late"])
            if k != 2:
                host.command(k, k, sequence=k)
        assert late == [0, 0, 0, 1, 1, 1]

    def test_sequences_go_round(self, host):
        host.armed(tick_hz=4000, watchdog_ms=2)
        for k in range(600):
            (found,) = host.reports(250)
            assert (found["tick"], found["sequence"], found["width0"]) == (k, k & 0xFF, k)
            host.command(k + 1, 0, sequence=k & 0xFF)

    def test_disarming_ends_it(self, host, board):
        host.armed(tick_hz=1000)
        host.reports(1000)
        host.disarm()
        assert host.reports(5000) == []
        assert board.tick_us == 1000

    def test_after_a_trip_it_goes_on_until_the_trip_is_cleared(self, host, board):
        host.armed(tick_hz=2000, watchdog_ms=2)
        states = [each["state"] for each in host.reports(4000)]
        assert states == [State.ARMED] * 3 + [State.TRIPPED] * 5
        host.command(5, 5, sequence=7)
        (found,) = host.reports(500)
        assert (found["width0"], found["trip"], found["late"]) == (0, Trip.WATCHDOG, 2)
        assert host.status()["refused"] == 1
        assert host.asked(CLEAR)[1]["state"] == State.CONFIGURED
        assert host.reports(5000) == []
        assert board.tick_us == 1000

    def test_a_command_for_a_later_arming_is_not_left_behind(self, host):
        host.armed(tick_hz=1000)
        host.reports(1000)
        host.command(100, 100, sequence=0)
        host.disarm()
        host.arm()
        assert [each["width0"] for each in host.reports(2000)] == [0, 0]


class TestWatchdog:
    @pytest.mark.parametrize(("tick_hz", "newest"), [(0, 0), (1000, 0), (4000, 3)])
    def test_it_trips_at_the_first_tick_after_its_time(self, host, board, tick_hz, newest):
        host.armed(watchdog_ms=10, tick_hz=tick_hz)
        host.reports(1000)
        host.command(1, 2, sequence=newest)
        board.advance(9_999)
        assert board.widths == (1, 2)
        board.advance(1)
        assert board.widths == (0, 0)
        board.read()
        found = host.status()
        assert (found["state"], found["trip"], found["trips"]) == (State.TRIPPED, Trip.WATCHDOG, 1)

    def test_it_runs_from_arming_on(self, host, board):
        host.armed(watchdog_ms=5)
        board.advance(5000)
        assert host.status()["state"] == State.TRIPPED

    def test_only_valid_commands_feed_it(self, host, board):
        host.armed(watchdog_ms=5)
        host.commanded(9, 9)
        for _ in range(5):
            host.commanded(4096, 0)
            host.status()
            host.asked(HELLO)
            host.configure()
            board.write(COMMAND.encode({"width0": 3})[:-1] + b"\0" + READ_REQUEST)
            board.advance(1000)
        assert board.widths == (0, 0)

    def test_each_valid_command_feeds_it(self, host, board):
        host.armed(watchdog_ms=2)
        for _ in range(10):
            host.commanded(9, 9)
            board.advance(1999)
            assert board.widths == (9, 9)

    def test_the_clocks_wrap_changes_nothing(self, host, board):
        board.clock_us = 2**32 - 5000
        host.armed(watchdog_ms=10)
        host.commanded(9, 9)
        board.advance(9000)
        assert board.widths == (9, 9)
        board.advance(1000)
        assert board.widths == (0, 0)


class TestTrip:
    def test_it_is_latched_until_clear_and_arm(self, host, board):
        host.armed()
        host.commanded(9, 9)
        board.advance(11_000)
        assert host.commanded(9, 9)["state"] == State.TRIPPED
        assert host.disarm()[1]["state"] == State.TRIPPED
        assert host.asked(CLEAR)[1]["state"] == State.CONFIGURED
        assert host.commanded(9, 9)["width0"] == 0
        host.arm()
        assert host.commanded(9, 9)["width0"] == 9
        assert host.status()["trip"] == Trip.WATCHDOG

    @pytest.mark.parametrize("tick_hz", [0, 1000])
    def test_a_stop_input_that_goes_low_trips(self, host, board, tick_hz):
        board.inputs = 0b100
        host.armed(stop_pins=0b100, tick_hz=tick_hz)
        host.reports(1000)
        host.command(9, 9, sequence=0)
        board.advance(1000)
        assert board.widths == (9, 9)
        board.inputs = 0
        board.advance(1000)
        board.read()
        assert board.widths == (0, 0)
        board.inputs = 0b100
        host.reports(0)
        found = host.status()
        assert (found["state"], found["trip"], found["trips"]) == (State.TRIPPED, Trip.STOP_INPUT, 1)

    def test_it_cannot_be_cleared_while_a_stop_input_is_low(self, host, board):
        board.inputs = 1
        host.armed(stop_pins=1)
        board.inputs = 0
        board.advance(1000)
        assert refusal(host.asked(CLEAR)) == Refused.STOP_INPUT
        board.inputs = 1
        assert host.asked(CLEAR)[1]["state"] == State.CONFIGURED

    def test_clear_in_other_states(self, host):
        assert host.asked(CLEAR)[1]["state"] == State.IDLE
        host.configure(stop_pins=1)
        assert host.asked(CLEAR)[1]["state"] == State.CONFIGURED
        host.armed()
        assert refusal(host.asked(CLEAR)) == Refused.STATE

    def test_disarm_after_a_trip_ends_the_tick_alone(self, host):
        host.armed(tick_hz=1000, watchdog_ms=2)
        host.reports(5000)
        assert host.disarm()[1]["state"] == State.TRIPPED
        assert host.reports(5000) == []


class TestDisarm:
    def test_outputs_go_off_at_once(self, host, board):
        host.armed()
        host.commanded(9, 9)
        name, values = host.disarm()
        assert (name, values["state"], values["width0"], values["trip"]) == ("STATUS", State.CONFIGURED, 0, Trip.NONE)
        assert board.widths == (0, 0)

    def test_those_of_the_vendors_logic_too(self, host, board):
        board.write(VENDOR_ON)
        assert host.disarm()[1]["state"] == State.IDLE
        assert board.widths == (0, 0)
        assert decode_read(board.asked(READ_REQUEST), logic=0x0111)["pwm0_width"] == 0


class TestBothLogics:
    def test_while_armed_the_vendors_commands_are_ignored(self, host, board):
        host.armed()
        host.commanded(9, 9)
        assert board.asked(VENDOR_ON + READ_REQUEST + VENDOR_SAFE) == b""
        assert board.widths == (9, 9)
        host.disarm()
        assert decode_read(board.asked(READ_REQUEST), logic=0x0111)["pwm0_width"] == 0

    def test_after_a_trip_they_set_nothing_until_it_is_cleared(self, host, board):
        host.armed()
        board.advance(11_000)
        before = board.asked(READ_REQUEST)
        board.write(VENDOR_SAFE)
        board.write(VENDOR_ON)
        assert board.widths == (0, 0)
        assert board.asked(READ_REQUEST) == before
        host.asked(CLEAR)
        board.write(VENDOR_ON)
        assert board.widths == (200, 0)

    def test_the_vendors_widths_are_in_the_status(self, host, board):
        board.write(VENDOR_ON)
        assert host.status()["width0"] == 200

    def test_the_vendors_watchdog_is_a_trip_without_a_latch_of_the_open_logic(self, host, board):
        board.write(VENDOR_ON)
        board.advance(251_000)
        found = host.status()
        assert (found["state"], found["trip"], found["trips"]) == (State.IDLE, Trip.VENDOR_WATCHDOG, 1)
        assert host.armed().commanded(9, 9)["width0"] == 9


class TestLine:
    def test_a_frame_may_arrive_byte_by_byte(self, board):
        for byte in QUERY.encode()[:-1]:
            assert board.asked(bytes([byte])) == b""
            board.advance(1999)
        assert decoded(board.asked(QUERY.encode()[-1:]))[0][0] == "STATUS"

    @pytest.mark.parametrize("arrived", [1, 2, 3, 5])
    def test_silence_drops_a_frame(self, host, board, arrived):
        board.write(QUERY.encode()[:arrived])
        board.advance(2000)
        assert board.asked(QUERY.encode()[arrived:]) == b""
        assert host.status()["bad_frames"] == 1

    def test_every_changed_bit_drops_the_frame(self, board, host):
        frame = COMMAND.encode({"width0": 0x0234}, sequence=3)
        for bit in range(8, 8 * len(frame)):
            board.reset()
            damaged = bytearray(frame)
            damaged[bit // 8] ^= 1 << bit % 8
            assert board.asked(damaged) == b""
            board.advance(2000)
            assert host.status()["bad_frames"] == 1

    @pytest.mark.parametrize("kind", [0x00, 0x08, 0x7F, 0x81, 0x84, 0xFF])
    def test_kinds_that_the_host_does_not_have(self, host, board, kind):
        assert board.asked(bytes([0xA5, kind])) == b""
        assert host.status()["bad_frames"] == 1

    def test_the_byte_that_breaks_a_frame_may_begin_one(self, board):
        assert decoded(board.asked(b"\xa5" + QUERY.encode()))[0][1]["bad_frames"] == 1
        assert decoded(board.asked(b"\xa5\x06" + QUERY.encode()))[0][1]["bad_frames"] == 2
        assert len(board.asked(b"\xa5" + READ_REQUEST)) == 150

    def test_bytes_between_frames_are_ignored(self, board):
        assert decoded(board.asked(bytes(range(0x80)) + QUERY.encode()))[0][1]["bad_frames"] == 0

    def test_a_frame_ends_a_send_frame(self, board):
        board.write(VENDOR_ON[:100] + QUERY.encode() + VENDOR_ON[100:])
        assert board.widths == (0, 0)

    def test_inside_a_frame_every_byte_is_the_frames(self, host, board):
        host.armed()
        host.commanded(0x0181, 0x0282, sequence=0x82)
        assert board.widths == (0x181, 0x282)

    def test_an_answer_that_does_not_fit_is_not_cut(self, board):
        board.room = REPORT.table.size - 1
        assert board.asked(COMMAND.encode()) == b""
        board.room = REPORT.table.size
        assert len(board.asked(COMMAND.encode())) == REPORT.table.size
