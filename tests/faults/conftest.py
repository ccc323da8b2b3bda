import os
import tempfile
import time
from pathlib import Path

import pytest

from inteco_abs.realtime import memory
from tests.faults.stage import configured

SHORT = ("loop.rate_hz=500", "experiment.start_speed_rad_s=10", "experiment.idle_s=0.02", "experiment.hold_s=0.02")
"""A stop of some 280 ticks."""


@pytest.fixture(scope="session", params=["sim_usb2", pytest.param("sim_usb", marks=pytest.mark.long), "sim_pci"])
def short(request):
    """Configuration of a short stop on each kind of board; the first generation's keeps 250 Hz."""
    slow = ("loop.rate_hz=250",) if request.param == "sim_usb" else ()
    return configured(*SHORT, *slow, profile=request.param)


@pytest.fixture
def memories(monkeypatch):
    """Memory of every run, in order, which stays readable when its file is gone."""
    made, create = [], memory.RunMemory.create.__func__

    def remembered(kind, *sizes):
        made.append(create(kind, *sizes))
        return made[-1]

    with tempfile.TemporaryDirectory(prefix="abs-", dir=memory.FOLDER) as folder:
        monkeypatch.setattr(memory, "FOLDER", Path(folder))
        monkeypatch.setattr(memory.RunMemory, "create", classmethod(remembered))
        yield made


PATIENCE_S = 10.0


@pytest.fixture
def left_processes():
    """Command lines of processes of ours that are still there after a while."""

    def look():
        children = Path(f"/proc/self/task/{os.getpid()}/children").read_text(encoding="ascii").split()
        lines = (Path(f"/proc/{pid}/cmdline").read_bytes() for pid in children)
        return [line for line in lines if b"inteco_abs" in line]

    def wait():
        end = time.monotonic() + PATIENCE_S
        while look() and time.monotonic() < end:
            time.sleep(0.02)
        return look()

    return wait
