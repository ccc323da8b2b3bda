"""Damaged bytes at the firmware, built with sanitizers; firmware/hal/host/stress.c says what it looks for."""

import json
import shutil
import subprocess
from functools import partial

import pytest
from host_board import FIRMWARE, built

RUN = partial(subprocess.run, capture_output=True, text=True, check=False, timeout=600)
SABOTAGE = {
    "the watchdog trips a millisecond late": ("outputs.c", ">= outputs.watchdog_us", ">= outputs.watchdog_us + 1000u"),
    "any answer arms": ("open_logic.c", "!= (open.challenge ^ OPEN_CHALLENGE_MASK)", "== 0x12345"),
    "a damaged frame counts": ("open_logic.c", "if (crc == frame_crc", "if (crc != 0x12345u || crc == frame_crc"),
    "widths count where nothing is armed": ("open_logic.c", "if (open.state != OPEN_STATE_ARMED) {", "if (false) {"),
    "a SEND frame is a byte short": ("rtdac_usb.c", "== RTDAC_USB_SEND_BYTES", "== RTDAC_USB_SEND_BYTES - 1u"),
    "disarming leaves the outputs on": ("open_logic.c", "    outputs_off();\n", ""),
    "the parser writes beyond its frame": ("open_logic.c", "open.arrived == expected_bytes()", "open.arrived == 255u"),
    "a tick enters a locked core": ("board.c", "hal_lock();", ""),
}


def assert_busy(count, seed):
    """Outputs were on, the board tripped, and messages were damaged often enough to mean something."""
    done = RUN([built("build/host/stress"), str(count), str(seed)])
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.pop("bytes") >= count
    assert min(found.values()) > count // 4000, found


@pytest.mark.long
def test_a_million_bytes():
    assert_busy(1_000_000, 1)


@pytest.mark.long
def test_a_hundred_million_bytes():
    for seed in range(2, 12):
        assert_busy(10_000_000, seed)


@pytest.mark.long
@pytest.mark.parametrize("what", SABOTAGE)
def test_stress_test_finds_sabotage(what, tmp_path):
    shutil.copytree(FIRMWARE, tmp_path / "firmware", ignore=shutil.ignore_patterns("build"))
    name, old, new = SABOTAGE[what]
    file = tmp_path / "firmware" / "core" / name
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    made = RUN(["make", "-C", str(tmp_path / "firmware"), "WARNINGS=-std=c11", "build/host/stress"])
    assert made.returncode == 0, made.stderr
    assert RUN([tmp_path / "firmware/build/host/stress", "1000000", "1"]).returncode != 0
