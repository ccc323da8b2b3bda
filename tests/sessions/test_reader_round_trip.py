import pytest

from inteco_abs.quantities import Quantity
from inteco_abs.sessions import TICK, TRUTH, FileWriter, gains_of, internals_of, read_session
from inteco_abs.signals import Phase, Tick

RATE, GAIN = Quantity("f", "1/s", "rate"), Quantity("Mk", "1/s", "proportional")
NOTE = "überprüft: 2 µm, 制动"


@pytest.fixture(scope="module")
def written(tmp_path_factory, quick):
    """A session made through the recorder, and what was put into it."""
    path = tmp_path_factory.mktemp("written") / "stop.mcap"
    first = Tick(*quick.session.ticks[0].tolist())
    ticks = [
        first._replace(tick=number, time_ns=number * 500_000, phase=phase, slip=number / 7.0, wheel_count=-number)
        for number, phase in enumerate([Phase.IDLE, Phase.IDLE, Phase.BRAKING, Phase.DONE])
    ]
    truths = [(tick.time_ns, 1.0, 2.0, tick.slip, 3.0, 0.5, 0.25, 0.3) for tick in ticks]
    with FileWriter(path, 0, internals=[RATE], gains=[GAIN]) as recorder:
        recorder.describe("rig", {"note": NOTE, "": "empty key", "empty value": ""})
        recorder.attach("config.toml", "application/toml", NOTE.encode())
        recorder.attach("empty", "application/octet-stream", b"")
        recorder.begin({"Mk": 2.0})
        recorder.ticks(b"".join(map(TICK.pack, ticks)))
        recorder.truths(b"".join(map(TRUTH.pack, truths)))
        recorder.finish("completed", "no fault", quick.stop.card)
    return path, ticks, truths


def test_ticks_come_back(written):
    path, ticks, _ = written
    session = read_session(path)
    assert session.payload == b"".join(map(TICK.pack, ticks))
    assert TICK.array(session.payload).tobytes() == session.ticks.tobytes()
    assert session.ticks["slip"].tolist() == [tick.slip for tick in ticks]
    assert session.ticks["wheel_count"].tolist() == [tick.wheel_count for tick in ticks]


def test_truths_come_back(written):
    path, _, truths = written
    assert read_session(path).truth.tolist() == truths


def test_metadata_and_attachments_come_back(written):
    session = read_session(written[0])
    assert session.metadata["rig"] == {"note": NOTE, "": "empty key", "empty value": ""}
    assert session.attachments == {"config.toml": NOTE.encode(), "empty": b""}


def test_channels_come_back(written):
    channels = read_session(written[0]).channels
    assert channels.keys() == {"/abs/tick", "/abs/event", "/abs/params", "/abs/result", "/sim/truth"}
    assert channels["/abs/tick"]["internals"] == '["f"]'
    assert internals_of(channels) == (RATE,)
    assert GAIN in gains_of(channels)


def test_events_are_counted(written):
    assert read_session(written[0]).events == 3


def test_a_whole_file_is_not_incomplete(written, quick, tiny, chunked):
    assert {read_session(path).incomplete for path in (written[0], quick.path, tiny.path, chunked.path)} == {""}


def test_ticks_and_truths_of_several_chunks_are_in_order(chunked):
    session = chunked.session
    count = chunked.stop.card["ticks"]
    assert session.ticks["tick"].tolist() == list(range(count))
    assert session.truth["time_ns"][:count].tolist() == session.ticks["time_ns"].tolist()
    assert (session.ticks.dtype, session.truth.dtype) == (TICK.dtype, TRUTH.dtype)


def test_reading_changes_nothing(quick):
    before = quick.path.read_bytes()
    assert read_session(quick.path).path == quick.path
    assert quick.path.read_bytes() == before
