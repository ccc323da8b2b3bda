"""Playing a session: what viewers and the terminal get of it."""

import math
import socket
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, nullcontext
from pathlib import Path

import numpy as np
import pytest
from live_client import watching
from mcap.reader import make_reader
from on_terminal import OnTerminal

from inteco_abs.realtime.foxglove_server import FoxgloveServer
from inteco_abs.sessions import TICK, TRUTH, Session, open_session, session_config
from inteco_abs.views.playback import FASTEST, SLOWEST, Playback
from inteco_abs.views.player import Player, session_channels

PAUSED, ENDED = 1, 3
LOG, PARAMETERS, RESULT = "/abs/event", "/abs/params", "/abs/result"


class Clock:
    """Goes on by 10 ms in every period."""

    now_s = 0.0

    def monotonic(self):
        return self.now_s


class Viewers:
    """Takes what a server would send; calls `each` in every period."""

    def __init__(self, clock, each=lambda: None):
        self._clock = clock
        self.sent, self.kept, self.times, self.forgotten, self.over = [], [], [], [], False
        self.each = each

    def send(self, topic, time_ns, data, *, keep=False):
        (self.kept if keep else self.sent).append((topic, time_ns, data))

    def forget(self, topic):
        self.forgotten.append(topic)

    def tell_state(self, *, did_seek):
        pass

    def tell_time(self, time_ns):
        self.times.append(time_ns)

    def listen(self, most_s):
        self._clock.now_s += most_s
        self.each()

    def leave(self):
        self.over = True

    def of(self, topic):
        return [(time_ns, data) for of, time_ns, data in (*self.sent, *self.kept) if of == topic]


class Keys:
    """A dashboard with keys that a test presses."""

    def __init__(self):
        self.press, self.shown, self.stops = None, [], []

    def keys(self, handle):
        self.press = handle
        return nullcontext(True)

    def rewind(self, stops):
        self.stops.append(stops)

    def describe(self, state, hint):
        pass

    def show(self, snapshot):
        self.shown.append(snapshot)


@pytest.fixture(scope="module")
def two_stops(run_at, tmp_path_factory):
    settings = ("experiment.start_speed_rad_s=20", "experiment.hold_s=0.05", "experiment.stops=2")
    return run_at(tmp_path_factory.mktemp("two") / "stops.mcap", settings)


@pytest.fixture(autouse=True)
def clock(request, monkeypatch):
    made = Clock()
    if "viewers" in request.fixturenames:
        monkeypatch.setattr("inteco_abs.views.player.time", made)
    return made


@pytest.fixture
def viewers(clock):
    return Viewers(clock)


def played(run, viewers, dashboard=None, **place):
    session = open_session(run.path)
    playback = Playback(session.duration_s, **place)
    Player(session, session_config(session, ()), playback).play(dashboard, viewers)


def in_file(path, topic):
    with path.open("rb") as file:
        return [(message.log_time, message.data) for _, _, message in make_reader(file).iter_messages(topics=[topic])]


def test_viewers_get_what_the_file_has(two_stops, viewers):
    played(two_stops, viewers, speed=64.0)
    assert viewers.over
    for topic in (LOG, RESULT):
        assert [data for _, data in viewers.of(topic)] == [data for _, data in in_file(two_stops.path, topic)]
    assert [time_ns for time_ns, _ in viewers.of(LOG)] == [time_ns for time_ns, _ in in_file(two_stops.path, LOG)]
    assert [data for _, data in viewers.of(PARAMETERS)] == [data for _, data in in_file(two_stops.path, PARAMETERS)]
    for message in (TICK, TRUTH):
        sent, kept = viewers.of(message.topic), in_file(two_stops.path, message.topic)
        assert sent == sorted(sent)
        assert set(sent) <= set(kept)
        assert sent[-1] == kept[-1]
        assert len(sent) > 20
    assert viewers.times == sorted(viewers.times)


def test_every_tick_is_sent_in_real_time(two_stops, viewers):
    played(two_stops, viewers)
    assert viewers.of(TICK.topic) == in_file(two_stops.path, TICK.topic)
    assert viewers.of(TRUTH.topic) == in_file(two_stops.path, TRUTH.topic)[-len(viewers.of(TRUTH.topic)) :]


def test_channels_have_the_units_of_the_file_and_the_names_of_internals(two_stops):
    with two_stops.path.open("rb") as file:
        channels = {each.topic: each.metadata for each in make_reader(file).get_summary().channels.values()}
    served = {channel.topic: channel.facts for channel in session_channels(open_session(two_stops.path))}
    assert served == {topic: channels[topic] for topic in served}
    assert "internals" in served[TICK.topic]


def test_who_goes_back_sees_the_stop_so_far_and_viewers_begin_their_log_again(two_stops, viewers):
    dashboard = Keys()
    viewers.each = lambda: step.pop()() if step else dashboard.press(b"q")
    step = [lambda: None, lambda: dashboard.press(b"\x1b[D"), lambda: None, lambda: dashboard.press(b" \x1b[F")]
    played(two_stops, viewers, dashboard)
    session = open_session(two_stops.path)
    starts_ns = [entry.unix_ns for entry in session.log if entry.text == "phase IDLE"]
    back = int(np.argmin(np.diff(viewers.times)))
    to_ns = viewers.times[back + 1]
    assert viewers.times[back] - to_ns == pytest.approx(1e9, abs=1e6)
    assert viewers.forgotten == [LOG, RESULT]
    assert dashboard.stops == [0, 1, 1 if to_ns >= starts_ns[1] else 0]
    at_end, back_again = dashboard.shown[-2:]
    assert at_end.phase.name == "DONE"
    expected = session.ticks[(session.ticks["time_ns"] + session.epoch_ns) < to_ns]
    assert back_again.ticks == len(expected)
    assert [point.time_ns for point in back_again.recent][-1] == expected["time_ns"][expected["tick"] % 10 == 0][-1]
    again = [time_ns for time_ns, _ in viewers.of(LOG)]
    assert again.count(starts_ns[0]) == 2
    assert max(again[again.index(starts_ns[0], 1) :]) <= to_ns


@contextmanager
def served(run, **place):
    """A session that plays to a websocket in a thread; its playback and a function that makes a viewer."""
    session = open_session(run.path)
    playback = Playback(session.duration_s, **place)
    player = Player(session, session_config(session, ()), playback)
    server = FoxgloveServer(0, "an-id", session_channels(session), playback=player.controls)
    with closing(server), ThreadPoolExecutor(1) as pool:
        yield playback, lambda *topics: watching(server.port, *topics), lambda: pool.submit(player.play, None, server)


def test_a_viewer_follows_over_a_websocket(two_stops):
    with served(two_stops, speed=8.0) as (playback, viewing, play):
        playback.paused = True
        playing = play()
        with viewing(TICK.topic, LOG, PARAMETERS, RESULT) as viewer:
            playback.paused = False
            messages = viewer.rest()
        playing.result(10.0)
    for topic in (LOG, PARAMETERS, RESULT):
        found = [data for of, _, data in messages if of == topic]
        assert found == [data for _, data in in_file(two_stops.path, topic)]
    ticks = [(time_ns, data) for of, time_ns, data in messages if of == TICK.topic]
    assert ticks[-1] == in_file(two_stops.path, TICK.topic)[-1]


def test_a_viewers_controls_pause_seek_and_set_the_speed(two_stops):
    times_ns = [time_ns for time_ns, _ in in_file(two_stops.path, TICK.topic)]
    with served(two_stops, speed=SLOWEST) as (playback, viewing, play):
        playing = play()
        with viewing(TICK.topic) as viewer:
            info = viewer.info
            seek_ns = times_ns[0] + 10**9
            assert viewer.control(pause=True, speed=2.0, seek_ns=seek_ns) == (PAUSED, seek_ns, 2.0, 1)
            assert viewer.control(pause=True, speed=math.nan) == (PAUSED, seek_ns, 2.0, 0)
            assert viewer.control(pause=True, speed=math.inf, seek_ns=0) == (PAUSED, times_ns[0], FASTEST, 1)
            assert viewer.control(pause=False, speed=1.0, seek_ns=(1 << 64) - 1) == (ENDED, times_ns[-1] + 1, 1.0, 1)
            assert not playing.done()
            viewer.raw(b"\3\1")
        playing.result(10.0)
    assert info["capabilities"] == ["time", "playbackControl"]
    begin, end = (each["sec"] * 10**9 + each["nsec"] for each in (info["dataStartTime"], info["dataEndTime"]))
    assert (begin, end) == (times_ns[0], times_ns[-1])
    assert playback.at_end


def test_values_that_are_no_numbers_are_shown_as_they_are(two_stops, viewers):
    session = open_session(two_stops.path)
    ticks = session.ticks.copy()
    for name, value in (("late_us", np.nan), ("slip", np.inf), ("road_speed_rad_s", np.nan)):
        ticks[name] = value
    dashboard = Keys()
    viewers.each = lambda: dashboard.press(b"\x1b[Fq")
    playback = Playback(session.duration_s)
    Player(session.with_rows(ticks), session_config(session, ()), playback).play(dashboard, viewers)
    assert dashboard.shown[-1].slip == np.inf
    assert dashboard.shown[-1].late_us[0] is None


def test_only_what_is_played_is_read(two_stops, viewers, monkeypatch):
    parts = []
    part_of = Session.__getitem__

    def remembered(session, part):
        parts.append((part.start, part.stop))
        return part_of(session, part)

    monkeypatch.setattr(Session, "__getitem__", remembered)
    length_s = open_session(two_stops.path).duration_s
    played(two_stops, viewers, from_s=length_s - 0.01)
    assert parts == [(2.0 * (length_s // 2.0), 2.0 * (length_s // 2.0) + 2.0)]


@pytest.mark.parametrize(
    ("arguments", "code", "why"),
    [
        ((), 2, "--live: there is no terminal to play on; add --foxglove, or use a terminal"),
        (("--foxglove=0", "--from=99"), 2, "--from: 99 s: the session has 2."),
        (("--foxglove=0", "--from=-1"), 2, "must be a number of at least 0.0 s"),
        (("--foxglove=0", "--speed=0"), 2, "'0': must be a number"),
        (("--foxglove=0", "--speed=nan"), 2, "'nan': must be a number"),
    ],
)
def test_what_cannot_be_played_is_refused(verb, two_stops, arguments, code, why):
    done = verb("play", two_stops.path, *arguments)
    assert done.code == code
    assert why in done.err


def test_a_taken_port_and_a_file_that_is_no_session_are_refused(verb, two_stops, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert "cannot be served" in verb("play", two_stops.path, "--foxglove", taken.getsockname()[1]).err
    (tmp_path / "text.mcap").write_text("not a session")
    assert verb("play", tmp_path / "text.mcap", "--foxglove=0").code == 1


def test_a_cut_session_is_played_up_to_its_end(verb, two_stops, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(two_stops.path.read_bytes()[:-100_000])
    done = verb("play", cut, "--foxglove=0", "--speed=1024")
    assert done.code == 3
    assert "recover" in done.err


def test_keys_on_a_terminal_pause_seek_and_end(two_stops):
    command = [Path(sys.executable).with_name("inteco-abs"), "play", two_stops.path, "--speed", "4"]
    terminal = OnTerminal(command, columns=120, rows=34)
    try:
        terminal.until("space pauses")
        terminal.press("\x1b[F")
        terminal.until("ended")
        terminal.until("DONE")
        terminal.press(" ")
        terminal.until("SPIN-UP")
        terminal.press(" ")
        terminal.until("paused")
        terminal.press("q")
        assert terminal.end() == 0
        assert terminal.settings == terminal.at_first
    finally:
        terminal.close()
