"""The mock open board answers as the firmware does, whatever a host sends and when."""

import random

import pytest
from benches import HandClock, SteeredDevice, configured
from host_board import HostBoard

from firmware_protocol.open_board import (
    ARM,
    CHALLENGE_MASK,
    CLEAR,
    COMMAND,
    CONFIGURE,
    DISARM,
    HELLO,
    QUERY,
    SILENCE_MS,
    Receiver,
    decode,
)
from inteco_abs.mock_board import front_end_of

OWN = {"name", "date", "unique_id", "challenge", "pins"}
"""What two boards need not have in common."""
MESSAGES = 60


class Pair:
    """The firmware and the mock, which get the same bytes at the same times."""

    def __init__(self, folder, seed):
        self._random = random.Random(seed)
        self._clock = HandClock()
        self._clock.time_ns = 0
        self._firmware = HostBoard(folder)
        self._firmware.clock_us = 0
        self._device = SteeredDevice(configured("sim_open", ()), self._clock.now_ns)
        self._device.seize()
        self._device.show(0, 0)
        self._mock = front_end_of(self._device)
        self._challenges = [0, 0]
        self._sequence = 0  # of the newest report
        self._unfinished = False  # whether a frame may have begun

    def step(self):
        """Send the same to both, and let time pass; what each has answered."""
        messages = self._messages()
        # whole milliseconds: without a tick the firmware looks at its watchdog once in each
        passed_ms = self._random.choice((0, 0, 0, 1, 1, 2, 3, 20))
        self._unfinished = self._unfinished and passed_ms < SILENCE_MS
        self._firmware.write(messages[0])
        self._mock.bulk_out(messages[1])
        answers = [self._firmware.read(), self._waiting()]
        self._firmware.advance(1000 * passed_ms)
        self._clock.advance(1_000_000 * passed_ms)
        self._device.catch_up()
        answers[0] += self._firmware.read()
        answers[1] += self._waiting()
        return [self._decoded(i, data) for i, data in enumerate(answers)]

    def _waiting(self):
        return b"".join(iter(lambda: self._mock.bulk_in(64), b""))

    def _decoded(self, side, data):
        found = []
        for frame in Receiver(from_host=False).feed(data):
            message, values = decode(frame)
            self._challenges[side] = values.get("challenge", self._challenges[side])
            if message.name == "REPORT" and side == 0:
                self._sequence = values["sequence"]
            found.append((message.name, {name: value for name, value in values.items() if name not in OWN}))
        return found

    def _messages(self):
        choose, number = self._random.choice, self._random.randrange
        kind = choose((HELLO, CONFIGURE, CONFIGURE, ARM, ARM, *(COMMAND,) * 4, DISARM, QUERY, CLEAR, None))
        sequence = number(256)
        if kind is ARM and self._unfinished:
            kind = QUERY  # the answers to two challenges are different bytes, and would end the frame in different ways
        if kind is None:
            self._unfinished = True
            damaged = bytearray(QUERY.encode(sequence=sequence))
            damaged[number(len(damaged))] ^= 1 << number(8)
            # neither: a command of the other logic, which the mock does not have
            return [b"" if set(damaged) & set(range(0x80, 0x84)) else bytes(damaged[: choose((3, 6))])] * 2
        values = {}
        if kind is CONFIGURE:
            values["watchdog_ms"] = choose((1, 2, 5, 20, 100, 101))
            values["tick_hz"] = choose((0, 0, 99, 100, 333, 1000, 2000, 4000))
            values |= {"stop_pins": choose((0, 0, 0, 4)), "pwm_mode": choose((0, 1, 1, 2)), "pwm_prescaler": number(99)}
        elif kind is COMMAND:
            values = {"width0": choose((0, 1, 200, 255, 256, 4095, 5000)), "width1": choose((0, 0, 7, 300))}
            sequence = choose((self._sequence, self._sequence, self._sequence, sequence))
        elif kind is ARM:
            wrong = choose((0, 0, 0, 0, 1))
            return [
                ARM.encode({"answer": each ^ CHALLENGE_MASK ^ wrong}, sequence=sequence) for each in self._challenges
            ]
        return [kind.encode(values, sequence=sequence)] * 2


@pytest.mark.parametrize("seeds", [range(20), pytest.param(range(20, 2000), marks=pytest.mark.long)], ids=str)
def test_it_answers_as_the_firmware(tmp_path, seeds):
    states = set()
    for seed in seeds:
        pair = Pair(tmp_path, seed)
        for number in range(MESSAGES):
            firmware, mock = pair.step()
            assert mock == firmware, (seed, number)
            states |= {(name, values.get("state"), values.get("trip")) for name, values in firmware}
    assert {("REPORT", 2, 0), ("REPORT", 3, 1), ("STATUS", 1, 0), ("REFUSAL", 2, 0)} <= states
