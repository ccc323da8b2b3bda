"""In the guest: what every scenario does. What is written to /mnt lands with the host."""

import json
import os
import subprocess
import sys
import sysconfig
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from guest import bus

from inteco_abs.sessions import read_session

COMMAND = Path(sysconfig.get_path("scripts")) / "inteco-abs"
SCRATCH = Path("/dev/shm")  # noqa: S108 - the guest's own
RESULTS = Path("/mnt")
STOP = (
    "guard.missed_in_a_row=200",
    "guard.bucket_limit=3000",
)
"""The simulated rig costs most where its wheels begin and cease to turn: there this processor falls behind by a fifth
of a second.
"""
MOCK_BOARD = """
from inteco_abs import cli, elementary
with elementary.arithmetic(elementary.LIBM):
    cli.main()
"""
"""The mock board stands for hardware and is not replayed: the C library's arithmetic costs half of the portable one."""
_USED = (
    "inteco_abs.cli",
    "inteco_abs.experiment",
    "inteco_abs.realtime.processes.guardian",
    "inteco_abs.realtime.processes.recorder",
    "inteco_abs.realtime.processes.loop",
    "inteco_abs.analysis.replay",
    "inteco_abs.mock_board_process",
)


def abs_command(*arguments):
    """Run `inteco-abs`; exit code, output, messages."""
    ended = subprocess.run([COMMAND, *map(str, arguments)], capture_output=True, text=True, check=False, cwd=SCRATCH)
    return ended.returncode, ended.stdout, ended.stderr


def prepare(used, *modules, rules=()):
    """Read what is used, Python's modules `used` too; load kernel modules; start udev with the product's own rules."""
    bus.keep_in_memory((*_USED, *used))
    bus.load("vhci-hcd", *modules)
    bus.start_udev(abs_command("doctor", "--rules", *rules)[1])


@contextmanager
def mock_board(*arguments):
    """The product's own mock board plugged in: its folder in sysfs."""
    path = SCRATCH / "mock"
    command = [sys.executable, "-c", MOCK_BOARD, "mock-board", *arguments, "--usbip", f"unix:{path}"]
    with subprocess.Popen(command) as server:
        try:
            folder = bus.attach(path)
            bus.favour(server)
            yield folder
        finally:
            server.terminate()


def braking_stop(board, profile, rate_hz):
    """Run a complete stop with `board`, then replay it: figures of both. The session is kept."""
    session = SCRATCH / "stop.mcap"
    sets = [
        word for setting in (f"profile={profile}", f"loop.rate_hz={rate_hz}.0", *STOP) for word in ("--set", setting)
    ]
    code, card, messages = abs_command("run", "--board", board, "--out", session, "--json", *sets)
    found = {"exit_code": code, "messages": messages, "card": json.loads(card) if card else {}}
    if session.exists():
        replayed, report, messages = abs_command("replay", session, "--json")
        found["replay"] = {"exit_code": replayed, "messages": messages, **json.loads(report or "{}")}
        found |= _timing(session)
        (RESULTS / session.name).write_bytes(session.read_bytes())
    return found


def save(report):
    """Leave the report for the host, also when a later step fails."""
    (RESULTS / "report.json").write_text(json.dumps(report, indent=1))
    os.sync()


def _timing(path):
    """Timing of all ticks while the road wheel turns: there the simulated rig is cheap enough for this processor."""
    session = read_session(path)
    turning = session.ticks[session.ticks["road_speed_rad_s"] > 10.0]
    return {
        "rate_hz": round(1.0 / float(session.metadata["controller"]["sample_time_s"])),
        "turning": {
            "ticks": len(turning),
            "overruns": int(turning["skipped"].sum()),
            "failed_or_slow": int((turning["board_flags"] != 0).sum()),
            "io_us": _quantiles(turning["io_us"]),
            "late_us": _quantiles(turning["late_us"]),
        },
        "realtime": session.metadata["realtime"],
    }


def _quantiles(values_us):
    if not len(values_us):
        return {}  # no wheel has turned: how the run ended says why
    return {name: float(np.percentile(values_us, share)) for name, share in (("p50", 50), ("p99", 99), ("max", 100))}
