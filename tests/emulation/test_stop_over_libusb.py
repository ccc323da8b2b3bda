"""Whole stops in real time over pyusb, libusb1 and real libusb, with the limits that a real board's profile has."""

import json
import os
import subprocess
import sysconfig
import threading
import time
from pathlib import Path

import pytest
from usbfs import UsbfsTree

from inteco_abs.boards.families.usb2.mock import Usb2FrontEnd
from inteco_abs.config import load_config
from inteco_abs.mock_board import Device, UsbBoard, UsbHost, UsbIdentity
from inteco_abs.sessions import read_session

pytestmark = [pytest.mark.xdist_group("real time"), pytest.mark.usefixtures("preload"), pytest.mark.untraced]

COMMAND = Path(sysconfig.get_path("scripts")) / "inteco-abs"
UNTRACED = {key: value for key, value in os.environ.items() if not key.startswith("COV")}
REAL = load_config(profile="usb2_generic_0103").guard
SETTINGS = (
    "profile=sim_usb2",
    f"guard.missed_in_a_row={REAL.missed_in_a_row}",
    f"guard.bucket_limit={REAL.bucket_limit}",
    "estimator.window_s=0.04",
    "experiment.start_speed_rad_s=60",
)
RATES_HZ = (200, 100, 50)
"""The emulated device file takes a millisecond or two for an exchange, more on a busy computer."""
BUSY = ("set loop.rate_hz to", "late, slow or failed")
"""What a run says where the device file, which is a thread of an ordinary process, was not served in time."""
LATE_S = 0.003


class TroubledBoard(UsbBoard):
    """From the first command that turns a motor, every so many answers one is lost, and one late by 3 ms."""

    def __init__(self, *arguments, lost_every=0, late_every=0):
        super().__init__(*arguments)
        self.host = None
        self.struck = 0
        self._every = {"lost": lost_every, "late": late_every}
        self._answers = 0
        self._late = []

    def _send(self, endpoint, message):
        self._answers += any(self.front_end.device.duties) or bool(self._answers)
        fates = [fate for fate, every in self._every.items() if every and self._answers % every == every - 1]
        self.struck += bool(fates)
        if "lost" in fates:
            return
        if fates or self._late:  # what comes after a late answer does not overtake it
            self._late.append((endpoint, message))
        if fates:
            threading.Timer(LATE_S, self.host.catch_up).start()
        elif not self._late:
            super()._send(endpoint, message)

    def catch_up(self):
        super().catch_up()
        late, self._late = self._late, []
        for endpoint, message in late:
            super()._send(endpoint, message)


def stop(folder, engine, **trouble):
    """Session, result card and board of a stop, at the first rate that this computer keeps."""
    for rate_hz in RATES_HZ:
        device = Device(load_config(), time.monotonic_ns, 1)
        board = TroubledBoard(Usb2FrontEnd(device), UsbIdentity(serial=900_000_001), **trouble)
        board.host = UsbHost(board)
        tree, out = UsbfsTree(board.host), folder / f"stop{rate_hz}.mcap"
        sets = [
            word for each in (*SETTINGS, f"usb.engine={engine}", f"loop.rate_hz={rate_hz}") for word in ("--set", each)
        ]
        try:
            child = subprocess.run(
                ["timeout", "-k", "5", "100", COMMAND, "run", "--board", "usb2:", "--out", out, "--json", *sets],
                env=UNTRACED | tree.environment(), cwd=folder, capture_output=True, text=True, check=False,
            )  # fmt: skip
        finally:
            tree.close()
        assert device.duties == (0.0, 0.0)
        if not any(words in child.stderr for words in BUSY):
            assert child.returncode in (0, 3), child.stderr
            return read_session(out), json.loads(child.stdout), board
    raise AssertionError(f"the computer is too busy for any rate: {child.stderr}")


@pytest.mark.long
@pytest.mark.parametrize("engine", ["faster", "one-by-one"])
def test_stop_completes_from_tick_0_and_the_session_reports_engine_times(tmp_path, engine):
    session, card, board = stop(tmp_path, engine)
    assert card["outcome"] == "completed"
    assert session.ticks["tick"][0] == 0
    assert board.jtag_transfers == 0
    facts = session.metadata["realtime"]
    assert facts["engine"] in {"queued", "one-by-one"}
    assert "p99" in facts["exchanges"]
    assert ("exchanges, queued" in facts) is (engine == "faster")
    checked = subprocess.run(
        [COMMAND, "validate", session.path], env=UNTRACED, capture_output=True, text=True, check=False
    )
    assert checked.returncode == 0, checked.stdout


@pytest.mark.long
@pytest.mark.parametrize(
    "trouble", [{"lost_every": 50, "late_every": 70}, {"lost_every": 50}, {"late_every": 70}], ids=" and ".join
)
def test_a_stop_survives_lost_and_late_answers_and_counts_them(tmp_path, trouble):
    _, card, board = stop(tmp_path, "queued", **trouble)
    assert card["outcome"] == "completed"
    assert board.struck > 2
    assert card["link_errors"] > 0 or "lost_every" not in trouble
