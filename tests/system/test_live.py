"""`inteco-abs run --foxglove` in real time, with a viewer that connects to it."""

import socket

import pytest
from live import LiveRun
from live_client import TICKS, watching
from mcap.reader import make_reader

from inteco_abs.realtime.memory import Field

TOPICS = (TICKS, "/abs/burst", "/sim/truth", "/abs/event", "/abs/params", "/abs/result")
SHORT = ("experiment.start_speed_rad_s=20.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")

pytestmark = [pytest.mark.xdist_group("real time"), pytest.mark.untraced]


def test_a_viewer_sees_what_is_in_the_session_and_the_session_is_whole(command_path, tmp_path, untraced):
    run = LiveRun(command_path, tmp_path, untraced, "--foxglove=0", settings=SHORT, begun=False)
    run.until(lambda: run.words[Field.LIVE_PORT])
    with watching(run.words[Field.LIVE_PORT], *TOPICS) as viewer:
        events = []
        _, _, parameters = viewer.next_of("/abs/params")
        while not events or "BRAKING" not in events[-1].message:
            events.append(viewer.decode(viewer.next_of("/abs/event")[2], "/abs/event"))
        burst, response = viewer.call(1, {"ms": 50})
        rest = viewer.rest()
    code, card, report = run.end()
    session = run.session()
    assert code in {0, 3}
    assert (card["outcome"], card["lost_ticks"], session.incomplete) == ("completed", 0, "")
    assert f"open the connection ws://127.0.0.1:{run.words[Field.LIVE_PORT]} in Lichtblick" in report
    kept = {topic: set() for topic in TOPICS}
    with run.out.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(topics=TOPICS):
            kept[channel.topic].add((message.log_time, message.data))
            units = channel.metadata.get("units")
            assert viewer.info["metadata"].get(f"{channel.topic} units") == units
    seen = {topic: [(time, data) for of, time, data in rest if of == topic] for topic in TOPICS}
    span_s = (int(session.ticks["time_ns"][-1]) - int(session.ticks["time_ns"][0])) * 1e-9
    assert 5 < len(seen[TICKS]) <= 100 * span_s + 2
    assert kept[TICKS].issuperset(seen[TICKS])
    assert kept["/sim/truth"].issuperset(seen["/sim/truth"])
    assert len(seen["/sim/truth"]) > 5
    assert {data for _, data in seen["/abs/result"]} == {data for _, data in kept["/abs/result"]}
    events += [viewer.decode(data, "/abs/event") for _, data in seen["/abs/event"]]
    assert events == [viewer.decode(data, "/abs/event") for _, data in sorted(kept["/abs/event"])]
    assert {parameters} == {data for _, data in kept["/abs/params"]}
    assert kept[TICKS].issuperset(burst)
    assert [viewer.decode(data).tick for _, data in burst] == [
        *range(response["first_tick"], response["last_tick"] + 1)
    ]
    assert len(burst) == response["ticks"] == 100


def test_a_port_that_is_taken_is_reported_before_anything_moves(inteco_abs, tmp_path, untraced):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        run = inteco_abs("run", "--foxglove", port, "--out", "stop.mcap", check=1, environment=untraced)
    assert f"ws://127.0.0.1:{port} cannot be served" in run.stderr
    assert "nothing was started" in run.stderr
    assert list(tmp_path.iterdir()) == []
