"""However the server ends in mid-run, the run ends in SAFE with a complete session."""

import json
import signal
import time
import urllib.request

import pytest
from serving import QUICK, serving_command
from websockets.sync.client import connect

from inteco_abs.errors import SessionError
from inteco_abs.sessions import read_session

pytestmark = [pytest.mark.long, pytest.mark.untraced, pytest.mark.xdist_group("real time")]


def complete(path):
    try:
        return not read_session(path).incomplete
    except SessionError:  # its end is being written
        return False


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_server_that_ends_leaves_no_motor_on(tmp_path, number):
    slow = "--set=experiment.start_speed_rad_s=200.0"
    with serving_command(tmp_path, *QUICK, slow) as (process, address):
        place, _, token = address.partition("/?token=")
        bearer = {"Authorization": f"Bearer {token}"}
        with connect(f"{place.replace('http', 'ws')}/live", additional_headers=bearer) as viewer:
            urllib.request.urlopen(urllib.request.Request(f"{place}/run", b"{}", bearer)).close()  # noqa: S310  ours
            while json.loads(viewer.recv(60)).get("state", {}).get("phase") != "SPIN_UP":
                pass
            process.send_signal(number)
            code = process.wait(60)
    (path,) = tmp_path.glob("*.mcap")
    if number == signal.SIGKILL:
        end = time.monotonic() + 60.0
        while not complete(path):
            assert time.monotonic() < end
            time.sleep(0.05)
    else:
        assert code == 0
    session = read_session(path)
    assert session.metadata["session"]["outcome"] == "interrupted"
    assert session.truth["drive"].max() == 1.0  # the motor was on
    assert session.truth["drive"][-1] == session.truth["brake"][-1] == 0.0
