import time

import pytest
import serial
from emulated import emulated_board, let_go_at_the_first_tick

from firmware_protocol.rtdac_usb import FRAME_BYTES, READ_REQUEST, logic_of

pytestmark = pytest.mark.xdist_group("emulated board")

LOGIC = logic_of(0x0111)
WATCHDOG_US = 250_000


def drive(width, brake=0):
    """A frame of the vendor's logic that sets the outputs."""
    return LOGIC.send.encode({"pin_mode": 3, "pwm0_width": width, "pwm1_width": brake})


def exchange(line, width):
    line.write(drive(width) + READ_REQUEST)
    answer = line.read(FRAME_BYTES)
    assert len(answer) == FRAME_BYTES
    return LOGIC.read.decode(answer)


def test_the_emulated_board_drives_the_wheel_and_lets_go_when_its_host_is_silent(tmp_path):
    with emulated_board(tmp_path) as board:
        with serial.Serial(str(board.link), timeout=10) as line:
            first = exchange(line, 0)
            assert (first["logic_version"], first["application_name"]) == (0x0111, "ABSIM")
            for width in range(240, 256):
                newest = exchange(line, width)
                time.sleep(0.02)
        board.wait_until_off(since=2)
        *_, last, off = board.changes()
    assert newest["encoder0_count"] > first["encoder0_count"] + 20
    assert last.widths == (255, 0)
    assert let_go_at_the_first_tick(last, off, WATCHDOG_US)
