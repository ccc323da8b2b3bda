"""`inteco-abs run --foxglove` in real time, with a viewer that connects to it."""

import socket

import pytest
from live import LiveRun
from live_client import watching

from inteco_abs.realtime.memory import Field
from inteco_abs.sessions import TICK

SHORT = ("experiment.start_speed_rad_s=20.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")

pytestmark = [pytest.mark.xdist_group("real time"), pytest.mark.untraced]


def test_a_viewer_sees_ticks_that_are_in_the_session_and_the_session_is_whole(command_path, tmp_path, untraced):
    run = LiveRun(command_path, tmp_path, untraced, "--foxglove=0", settings=SHORT, begun=False)
    run.until(lambda: run.words[Field.LIVE_PORT])
    with watching(run.words[Field.LIVE_PORT]) as viewer:
        seen = viewer.rest()
        decoded = [viewer.decode(data) for _, data in seen]
    code, card, report = run.end()
    session = run.session()
    assert code in {0, 3}
    assert (card["outcome"], card["lost_ticks"]) == ("completed", 0)
    assert f"open the connection ws://127.0.0.1:{run.words[Field.LIVE_PORT]} in Lichtblick" in report
    kept = {int(row["tick"]): row.tobytes() for row in TICK.array(bytes(session.payload))}
    span_s = (int(session.ticks["time_ns"][-1]) - int(session.ticks["time_ns"][0])) * 1e-9
    assert 5 < len(seen) <= 100 * span_s + 2
    assert all(TICK.array(data)[0].tobytes() == kept[each.tick] for (_, data), each in zip(seen, decoded, strict=True))
    assert len({log_time - each.time_ns for (log_time, _), each in zip(seen, decoded, strict=True)}) == 1
    assert session.incomplete == ""


def test_a_port_that_is_taken_is_reported_before_anything_moves(inteco_abs, tmp_path, untraced):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        run = inteco_abs("run", "--foxglove", port, "--out", "stop.mcap", check=1, environment=untraced)
    assert f"ws://127.0.0.1:{port} cannot be served" in run.stderr
    assert "nothing was started" in run.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("port", ["65536", "viewer"])
def test_an_invalid_port_is_refused(inteco_abs, port):
    assert "'--foxglove'" in inteco_abs("run", f"--foxglove={port}", check=2).stderr
