"""The decision path, enumerated: every state that it can reach from power-up, with every event in each of them.

The real pipeline at its slowest rate, in which windows and times are a handful of ticks long. Two states are one if no
later input can distinguish them: times and counts are taken relative to the newest sample.
"""

from collections import Counter, deque
from copy import deepcopy
from dataclasses import dataclass

from inteco_abs.config import load_config
from inteco_abs.control import build_pipeline
from inteco_abs.signals import BoardFlags, Command, Phase, Reason, Sample

PERIOD_NS = 20_000_000
FAST = 80
"""Counts in a period: 12 rad/s, above the start speed."""
EVENTS = {
    "still": (0, 0, BoardFlags.NONE, Reason.NONE),
    "rolling": (FAST, FAST, BoardFlags.NONE, Reason.NONE),
    "locked": (0, FAST, BoardFlags.NONE, Reason.NONE),
    "jump": (0, 5000, BoardFlags.NONE, Reason.NONE),
    "stale": (0, 0, BoardFlags.STALE, Reason.NONE),
    "slow": (FAST, FAST, BoardFlags.SLOW, Reason.NONE),
    "stop": (FAST, FAST, BoardFlags.NONE, Reason.OPERATOR_STOP),
    "stop, unheard by the board": (0, 0, BoardFlags.STALE, Reason.SUPERVISOR_LOST),
    "stop and jump": (0, 5000, BoardFlags.NONE, Reason.RECORDER_LOST),
}
MAY_DRIVE = {Phase.SPIN_UP}
MAY_BRAKE = {Phase.BRAKING, Phase.STOPPED}
FOLLOWS = {
    Phase.IDLE: {Phase.IDLE, Phase.ARMED},
    Phase.ARMED: {Phase.ARMED, Phase.SPIN_UP},
    Phase.SPIN_UP: {Phase.SPIN_UP, Phase.BRAKING},
    Phase.BRAKING: {Phase.BRAKING, Phase.STOPPED},
    Phase.STOPPED: {Phase.STOPPED, Phase.DONE},
    Phase.DONE: {Phase.DONE},
    Phase.FAULT: set(),
}


@dataclass
class State:
    pipeline: object
    sample: Sample
    tick: object = None


def configured():
    return load_config(
        settings=[
            "loop.rate_hz=50", "experiment.idle_s=0.02", "experiment.hold_s=0.02", "experiment.start_speed_rad_s=10",
            "experiment.spin_up_timeout_s=1", "experiment.braking_timeout_s=1", "guard.missed_in_a_row=2",
            "guard.bucket_limit=6", "controller.name=relay", "estimator.window_s=0.02",
        ]
    )  # fmt: skip


def moved(state, event):
    wheel, road, flags, stop = EVENTS[event]
    before = state.sample
    sample = Sample(
        before.tick + 1,
        before.time_ns + PERIOD_NS,
        PERIOD_NS * 1e-9,
        before.wheel_count + wheel,
        before.road_count + road,
        flags,
    )
    pipeline = deepcopy(state.pipeline)
    tick = pipeline.step(sample, stop)
    return State(pipeline, sample, tick)


def key(state):
    """What later inputs could distinguish: everything that changes, relative to now."""
    return state.pipeline.command, *_relative(state.pipeline, state.sample, 0)


def _relative(part, sample, depth):
    for name, value in sorted(_parts(part).items()):  # k: constants
        if isinstance(value, bool | str | Phase | Reason) or value is None:
            yield name, value
        elif isinstance(value, list):
            yield name, *_in_order(name, value, part.oldest, sample)
        elif isinstance(value, int) and name.endswith("_ns") and value >= 0:
            yield name, min(sample.time_ns - value, 60 * PERIOD_NS)
        elif name in ("rest_wheel", "wheel_before"):
            yield name, sample.wheel_count - value
        elif name in ("rest_road", "road_before", "then_count"):
            yield name, sample.road_count - value
        elif isinstance(value, int | float) and name != "oldest":
            yield name, round(value, 6)
        elif depth < 3 and name != "k":
            yield name, *_relative(value, sample, depth + 1)


def _parts(value):
    slots = {each for kind in type(value).__mro__ for each in getattr(kind, "__slots__", ())}
    return {each: getattr(value, each) for each in {*slots, *getattr(value, "__dict__", ())} if hasattr(value, each)}


def _in_order(name, ring, oldest, sample):
    """From the oldest on; a ring that nothing was put in has nothing."""
    now = {"times_ns": sample.time_ns, "road_times_ns": sample.time_ns}
    now |= {"wheel_counts": sample.wheel_count, "road_counts": sample.road_count}
    entries = [] if oldest < 0 else ring[oldest:] + ring[:oldest]
    return tuple(now[name] - value if name in now else round(value, 3) for value in entries)


def check(before, event, after):
    """The invariants of docs/facts/hazards.md#invariants, as far as the decision path is concerned."""
    tick, pipeline = after.tick, after.pipeline
    was, reason = before.pipeline.phase, before.pipeline.reason
    where = f"{was.name} {event} -> {pipeline.phase.name}"
    assert pipeline.command == (tick.drive, tick.brake), where
    assert not tick.drive or pipeline.phase in MAY_DRIVE, where
    assert not tick.brake or pipeline.phase in MAY_BRAKE, where
    assert not (tick.drive and tick.brake), where
    assert pipeline.phase in FOLLOWS[was] | {Phase.FAULT}, where
    if reason is not Reason.NONE:
        assert pipeline.reason is reason, f"{where}: the first cause must survive"
    if pipeline.reason is not Reason.NONE:
        assert pipeline.phase is Phase.FAULT, where
        assert pipeline.command == Command.SAFE, where
    if EVENTS[event][3] is not Reason.NONE:
        assert pipeline.reason is not Reason.NONE, f"{where}: a stop request was lost"
        if event == "stop" and reason is Reason.NONE:
            assert pipeline.reason is Reason.OPERATOR_STOP, where
    assert (pipeline.reason is not Reason.NONE) == (pipeline.phase is Phase.FAULT), where


def nominal_states():
    """One state after the other of a stop in which nothing goes wrong."""
    first = Sample(0, PERIOD_NS, PERIOD_NS * 1e-9, 0, 0, BoardFlags.NONE)
    state = State(build_pipeline(configured()), first)
    state.tick = state.pipeline.step(first)
    yield state
    while not state.pipeline.finished:
        turning = state.pipeline.phase is Phase.SPIN_UP
        state = moved(state, "rolling" if turning else "still")
        yield state


def enumerate_states(depth):
    """Everything that can happen within `depth` ticks of any moment of a stop."""
    seen, transitions, met = set(), 0, Counter()
    waiting = deque((state, 0) for state in nominal_states())
    seen.update(key(state) for state, _ in waiting)
    while waiting:
        state, at = waiting.popleft()
        for event in EVENTS:
            after = moved(state, event)
            check(state, event, after)
            transitions += 1
            met[state.pipeline.phase, event] += 1
            found = key(after)
            if found not in seen and at + 1 < depth:
                seen.add(found)
                waiting.append((after, at + 1))
    return seen, transitions, met
