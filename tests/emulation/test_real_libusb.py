"""The check list and more through real pyusb and real libusb, on a device file that umockdev redirects to the board."""

import functools
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from check_list import CHECKS
from drill import new_host
from usbfs import UsbfsTree

from inteco_abs.mock_board import UsbSpeed

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


pytestmark = [pytest.mark.usefixtures("preload"), pytest.mark.untraced]


def run(task, speed, *, replugged=False, prefix=(), **tree):
    """Results of a task in a child process."""
    host = new_host(speed)
    if replugged:
        host.listeners.append(lambda plugged: plugged or threading.Timer(0.3, host.plug).start())
    emulated = UsbfsTree(host, **tree)
    environment = {key: value for key, value in os.environ.items() if not key.startswith("COV")}
    environment |= {"PYTHONPATH": f"{ROOT}{os.pathsep}{HERE}", "PYTHONDONTWRITEBYTECODE": "1"} | emulated.environment()
    try:
        child = subprocess.run(
            [
                *prefix,
                "timeout",
                "-k",
                "5",
                "60",
                sys.executable,
                HERE / "usbfs_client.py",
                task,
                str(speed.packet_bytes),
            ],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
    finally:
        emulated.close()
    assert child.returncode == 0, child.stderr
    return json.loads(child.stdout)["results"]


@functools.cache
def check_list(speed):
    return run("check_list", speed)


@pytest.mark.xdist_group("real libusb")
@pytest.mark.parametrize("name", CHECKS)
def test_check_passes_through_the_real_libusb(speed, name):
    failure = check_list(speed)[name]
    assert failure is None, failure


@pytest.mark.parametrize("task", ["read_while_another_thread_writes", "unplug_during_a_blocked_read"])
def test_threads(task, speed):
    assert run(task, speed) == {task: None}


def test_replug():
    assert run("replug", UsbSpeed.HIGH, replugged=True) == {"replug": None}


def test_permission_denied():
    # root has to give up its rights to be refused anything
    prefix = ("setpriv", "--inh-caps=-all", "--bounding-set=-all") if os.geteuid() == 0 else ()
    assert run("permission_denied", UsbSpeed.HIGH, mode=0, prefix=prefix) == {"permission_denied": None}


def test_bound_driver():
    assert run("bound_driver", UsbSpeed.HIGH, driver="usbtest") == {"bound_driver": None}
