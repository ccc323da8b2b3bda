"""The open board's firmware as a library of this computer, with simulated pins, clock and line."""

import ctypes
import fcntl
import os
import shutil
import subprocess
from functools import cache
from pathlib import Path

from emulated import require

FIRMWARE = Path(__file__).parents[2] / "firmware"
NUMBER = ctypes.c_uint
_ROOM = 1 << 16


@cache
def built(target):
    """Path of what `make` builds; one worker of the tests at a time."""
    require("cc", "make")
    with (FIRMWARE / "Makefile").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        done = subprocess.run(["make", "-C", str(FIRMWARE), target], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return FIRMWARE / target


def library():
    """Path of the library; another one for a process that measures or mutates it."""
    return Path(os.environ.get("HOST_BOARD") or built("build/host/libboard.so"))


class HostBoard:
    """A board of its own. Times are microseconds of its clock."""

    def __init__(self, folder):
        self._copy = folder / f"board{id(self)}.so"  # a library that is loaded twice is one board
        shutil.copyfile(library(), self._copy)
        self._board = ctypes.CDLL(str(self._copy))
        self._copy.unlink()
        self._board.host_twelve_bits.restype = ctypes.c_bool
        self._answer = (ctypes.c_ubyte * _ROOM)()
        self._board.host_reset()

    def reset(self):
        """Power down and up."""
        self._board.host_reset()

    def write(self, data):
        """Bytes from the host arrive at once."""
        self._board.host_write(bytes(data), len(data))
        assert self._board.host_faults() == 0

    def read(self):
        """All bytes that the board has sent."""
        count = self._board.host_read(self._answer, _ROOM)
        return bytes(memoryview(self._answer)[:count])

    def asked(self, data):
        """What the board answers."""
        self.write(data)
        return self.read()

    def advance(self, duration_us):
        """Let time pass."""
        self._board.host_advance(NUMBER(duration_us))
        assert self._board.host_faults() == 0

    def turn(self, channel, counts):
        """Turn an encoder."""
        self._board.host_turn(channel, counts)

    @property
    def clock_us(self):
        return NUMBER(self._board.host_clock_us()).value

    @clock_us.setter
    def clock_us(self, time_us):
        self._board.host_set_clock(NUMBER(time_us))

    @property
    def tick_us(self):
        return self._board.host_tick_period_us()

    @property
    def off_us(self):
        """When the board switched its outputs off last."""
        return NUMBER(self._board.host_off_us()).value

    @property
    def inputs(self):
        raise AttributeError

    @inputs.setter
    def inputs(self, levels):
        self._board.host_set_inputs(levels)

    @property
    def driven(self):
        """Pins that the board drives, and their levels."""
        return self._board.host_outputs(), self._board.host_levels()

    @property
    def widths(self):
        return tuple(self._board.host_width(i) for i in range(2))

    @property
    def pwm(self):
        """Width, mode and prescaler of both outputs."""
        board = self._board
        return tuple((board.host_width(i), int(board.host_twelve_bits(i)), board.host_prescaler(i)) for i in range(2))

    @property
    def room(self):
        raise AttributeError

    @room.setter
    def room(self, count):
        self._board.host_set_room(count)
