"""Damaged bytes on the emulated board's own line; the host build gets ten million of them (test_stress.py)."""

import os
import random

import pytest
from emulated import emulated_board
from test_lets_go import CHALLENGE_MASK, FULL, Line

from firmware_protocol.open_board import ARM, CLEAR, COMMAND, CONFIGURE, DISARM, QUERY, Receiver, State

pytestmark = [pytest.mark.long, pytest.mark.xdist_group("real time")]

BYTES = 200_000
BURST_BITS = 16
"""A CRC of 16 bits finds every burst of up to 16 wrong bits."""


def damaged(draw, frame):
    """A frame with wrong bits next to each other, or without its end."""
    if draw.random() < 0.3:
        return frame[: draw.randrange(1, len(frame))]
    start = draw.randrange(8 * len(frame) - BURST_BITS)
    burst = draw.getrandbits(BURST_BITS) | 1
    return (int.from_bytes(frame, "little") ^ burst << start).to_bytes(len(frame), "little")


def test_damaged_commands_never_reach_the_outputs_and_the_board_goes_on(tmp_path):
    draw, judge = random.Random(3), Receiver(from_host=True)
    sent = 0
    with emulated_board(tmp_path) as board:
        line = Line(board.link)
        while sent < BYTES:
            line.ask(DISARM)
            line.ask(CLEAR)
            status = line.ask(CONFIGURE, watchdog_ms=100, pwm_mode=1, pwm_prescaler=2)
            assert line.ask(ARM, answer=status["challenge"] ^ CHALLENGE_MASK)["state"] == State.ARMED
            for _ in range(20):
                data = b"".join(damaged(draw, COMMAND.encode({"width0": FULL, "width1": FULL})) for _ in range(20))
                assert not any(frame[1] == COMMAND.kind for frame in judge.feed(data)), "draw others: this one is good"
                sent += os.write(line.file, data)
                line.send(COMMAND, 1)  # so that it stays armed
            line.receive(QUERY, within_s=0.01)
        status = line.ask(QUERY)
        assert {change.widths for change in board.changes()} == {(0, 0)}
    assert status["bad_frames"] > 1000
