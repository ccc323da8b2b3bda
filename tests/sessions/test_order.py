"""Messages stand in the file by time, as viewers that play it want them, however ticks and states come."""

import itertools

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader

from inteco_abs.sessions import TICK, TRUTH, FileWriter, read_session


def log_times(path):
    with path.open("rb") as file:
        return [message.log_time for _, _, message in NonSeekingReader(file).iter_messages(log_time_order=False)]


def test_a_run_is_in_order(quick):
    times = log_times(quick.path)
    assert times == sorted(times)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    states=st.lists(st.integers(0, 320), max_size=60),
    phases=st.lists(st.integers(1, 5), min_size=30, max_size=30),
    cuts=st.lists(st.integers(0, 30), max_size=4),
)
def test_ticks_states_and_events_are_in_order(tmp_path_factory, states, phases, cuts):
    ticks = TICK.array(TICK.blank(30))
    ticks["time_ns"], ticks["tick"], ticks["phase"] = 10 * np.arange(30), np.arange(30), phases
    truth = TRUTH.array(TRUTH.blank(len(states)))
    truth["time_ns"] = sorted(states)
    path = tmp_path_factory.mktemp("order") / "session.mcap"
    with FileWriter(path, 0, epoch_ns=10**18) as recorder:
        recorder.begin({})
        for first, end in itertools.pairwise([0, *sorted(cuts), 30]):
            now = (truth["time_ns"] >= 10 * first - 9 * (first > 0)) & (truth["time_ns"] < 10 * end - 9)
            recorder.truths(truth.view(f"V{TRUTH.size}")[now].tobytes())
            recorder.ticks(ticks[first:end].tobytes())
            recorder.flush()
        recorder.truths(truth.view(f"V{TRUTH.size}")[truth["time_ns"] > 290].tobytes())
        recorder.finish("completed", "", {"overruns": 0, "lost_ticks": 0, "lateness_us": {}})
    session = read_session(path)
    assert session.payload == ticks.tobytes()
    assert session.truth.tobytes() == truth.tobytes()
    times = log_times(path)
    assert times == sorted(times)
