"""In virtual time a stop is the same to the last bit over every link."""

import functools
import hashlib
import os
import subprocess
import sys
from itertools import zip_longest
from pathlib import Path

import pytest
from same_stop import stop

from inteco_abs.config import load_config
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.format import TICK
from inteco_abs.sessions import read_session
from inteco_abs.signals import Phase

pytestmark = pytest.mark.untraced  # the same code runs traced elsewhere, and these are many runs

HERE = Path(__file__).parent
SEED = 7
SHORT = ("experiment.idle_s=0.02", "experiment.hold_s=0.05", "experiment.start_speed_rad_s=15.0")
"""Real libusb on an emulated device file takes milliseconds for a tick."""


@functools.cache
def in_process(*settings):
    return stop("in process", SEED, settings)


def difference(ticks, reference):
    """Empty for the same ticks, else where they begin to differ, and how."""
    digest, wanted = (hashlib.sha256(each).hexdigest() for each in (ticks, reference))
    if digest == wanted:
        return ""
    found, expected = tick_by_tick(ticks), tick_by_tick(reference)
    number, one, other = next(
        (number, one, other)
        for number, (one, other) in enumerate(zip_longest(found, expected, fillvalue=b""))
        if one != other
    )
    names = TICK.array(b"").dtype.names
    values = [TICK.array(each).tolist() or [("none",) * len(names)] for each in (one, other)]
    rows = zip(names, *(row for (row,) in values), strict=True)
    fields = [f"{name} {a}, not {b}" for name, a, b in rows if repr(a) != repr(b)]  # NaN is NaN
    return (
        f"SHA-256 {digest}, not {wanted}; tick {number} of {len(expected)} (found {len(found)}): "
        f"{one.hex()}, not {other.hex()}: {'; '.join(fields)}"
    )


def tick_by_tick(ticks):
    return [ticks[at : at + TICK.size] for at in range(0, len(ticks), TICK.size)]


def assert_same(ticks, reference):
    problem = difference(ticks, reference)
    assert not problem, problem


@pytest.mark.long
@pytest.mark.parametrize("link", ["pyusb", "USB/IP"])
def test_a_whole_stop_is_the_same_over_every_link_of_this_process(link):
    reference = in_process()
    assert TICK.array(reference)["phase"][-1] == Phase.DONE
    assert len(reference) > 10_000 * TICK.size
    assert_same(stop(link, SEED), reference)


@pytest.mark.parametrize("link", ["pyusb", pytest.param("USB/IP", marks=pytest.mark.long)])
def test_a_short_stop_is_the_same_over_every_link_of_this_process(link):
    assert_same(stop(link, SEED, SHORT), in_process(*SHORT))


@pytest.fixture
def over_libusb(tmp_path, preload):  # noqa: ARG001  its absence is asserted there
    """Ticks of a stop in a process with real libusb."""
    library = {"LD_PRELOAD": "libumockdev-preload.so.0", "UMOCKDEV_DIR": str(tmp_path)}
    environment = {**os.environ, "PYTHONPATH": f"{HERE.parents[1]}{os.pathsep}{HERE}", **library}

    def ticks(link, *settings):
        out = tmp_path / "ticks"
        child = subprocess.run(
            ["timeout", "-k", "5", "300", sys.executable, HERE / "same_stop.py", link, out, str(SEED), *settings],
            env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert child.returncode == 0, child.stderr
        return out.read_bytes()

    return ticks


@pytest.mark.xdist_group("real libusb")
@pytest.mark.parametrize("link", ["libusb, queued", pytest.param("libusb, one by one", marks=pytest.mark.long)])
def test_a_short_stop_is_the_same_over_real_libusb(over_libusb, link):
    assert_same(over_libusb(link, *SHORT), in_process(*SHORT))


@pytest.mark.long
@pytest.mark.xdist_group("real libusb")
@pytest.mark.parametrize("link", ["libusb, one by one", "libusb, queued"])
def test_a_whole_stop_is_the_same_over_real_libusb(over_libusb, link):
    assert_same(over_libusb(link), in_process())


def test_these_are_the_ticks_that_a_virtual_run_records(tmp_path):
    run_stop(load_config(settings=SHORT), Plan(tmp_path / "stop.mcap", seed=SEED))
    assert_same(read_session(tmp_path / "stop.mcap").payload, in_process(*SHORT))


def test_another_seed_gives_other_ticks():
    assert difference(stop("in process", SEED + 1, SHORT), in_process(*SHORT))


def test_one_changed_bit_or_a_missing_tick_is_reported_by_its_number():
    ticks = bytearray(in_process(*SHORT))
    count = len(ticks) // TICK.size
    assert f"tick {count - 1} of {count} (found {count - 1})" in difference(ticks[: -TICK.size], bytes(ticks))
    ticks[100 * TICK.size + 5] ^= 1
    assert "; tick 100 of " in difference(ticks, in_process(*SHORT))
