"""The power is cut at many points of a run in real time, on a block device that drops what was not flushed.

Needs root, /dev/fuse, a loop device and ext4; `test_recording` has a short form for every computer.
"""

import os
import random
import shutil

import numpy as np
import pytest
from volatile_disk import FUSE, loop_mounted, volatile_disk

from inteco_abs.errors import SessionError
from inteco_abs.sessions import read_session, recover_session
from inteco_abs.signals import Phase

pytestmark = [pytest.mark.long, pytest.mark.untraced, pytest.mark.xdist_group("real time")]

CUTS = 40
MOST_MS = 300.0
"""A sync every 200 ms, and the tenth of a second between two flushes."""
MOST_SLOW_MS = 700.0
"""Of a disk whose every flush takes 50 ms: a sync has up to three, and the one before may have begun just earlier."""


@pytest.fixture
def disk(tmp_path):
    if os.geteuid() or not os.access(FUSE, os.W_OK) or shutil.which("mkfs.ext4") is None:
        pytest.skip("needs root, /dev/fuse and mkfs.ext4")
    with volatile_disk(tmp_path) as (served, mounted):
        yield served, mounted


def recovered(image, folder, name):
    """Payload of the session that `recover` makes of what is on a disk after a cut; empty if it has no tick."""
    with loop_mounted(image, folder / "after"):
        try:
            recover_session(folder / "after" / name, folder / "recovered.mcap")
        except SessionError as error:
            assert "has no intact tick" in str(error)  # noqa: PT017  but its name is there
            return b""
    payload = bytes(read_session(folder / "recovered.mcap").payload)
    (folder / "recovered.mcap").unlink()
    return payload


@pytest.mark.parametrize(("flush_s", "most_ms"), [(0.0, MOST_MS), (0.05, MOST_SLOW_MS)], ids=["fast", "slow"])
def test_a_cut_at_any_time_loses_no_tick_but_the_newest(
    disk, inteco_abs, untraced, tmp_path, record_property, flush_s, most_ms
):
    served, mounted = disk
    served.flush_s = flush_s
    session = mounted / "stop.mcap"
    done = inteco_abs("run", "--set", "experiment.start_speed_rad_s=60", "--out", session, environment=untraced)
    assert done.returncode in {0, 3}, done.stderr
    served.flush_s, flushes = 0.0, sum(not request.data for request in served.requests)
    end_ns = served.requests[-1].ended_ns
    whole = read_session(session)
    times_ns = whole.ticks["time_ns"].astype(np.int64)
    payload, size = bytes(whole.payload), len(whole.payload) // len(times_ns)
    (tmp_path / "after").mkdir()
    generator, image = random.Random(1), tmp_path / "cut.img"
    lost_ms, phases = [], set()
    for cut_ns in np.linspace(times_ns[0] + 1, times_ns[-1], CUTS).astype(np.int64).tolist():
        for share in (0.0, 0.5):  # of the sectors that were not flushed
            served.after_a_cut(cut_ns, image, lambda share=share: generator.random() < share)
            saved = recovered(image, tmp_path, session.name)
            assert payload.startswith(saved)
            newest = len(saved) // size - 1
            lost_ms.append((cut_ns - int(times_ns[max(newest, 0)])) * 1e-6)
            phases.add(Phase(whole.ticks["phase"][np.searchsorted(times_ns, cut_ns)]))
    assert phases >= {Phase.IDLE, Phase.SPIN_UP, Phase.BRAKING}
    assert max(lost_ms) <= most_ms
    served.after_a_cut(end_ns, image, lambda: False)
    with loop_mounted(image, tmp_path / "after"):
        after = read_session(tmp_path / "after" / session.name)
        assert not after.incomplete  # the command has said that it is there
        assert bytes(after.payload) == payload
    text = f"median {np.median(lost_ms):.0f} ms, worst {max(lost_ms):.0f} ms of {len(lost_ms)} cuts lost"
    record_property("figures", f"power loss, flushes of {flush_s * 1e3:.0f} ms: {text}; {flushes} flushes in all")
