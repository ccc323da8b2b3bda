"""The decision path, enumerated: every state that it can reach from power-up, with every event in each of them.

The real pipeline at its slowest rate, in which windows and times are a handful of ticks long. Two states are one if no
later input can tell them apart: times and counts are taken relative to the newest sample.
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
    pipeline = deepcopy(state.pipeline, {id(state.pipeline._machine._config): state.pipeline._machine._config})
    tick = pipeline.step(sample, stop)
    return State(pipeline, sample, tick)


def key(state):
    """What later inputs could tell: everything that changes, relative to now."""
    return state.pipeline.command, *_relative(vars(state.pipeline), state.sample, 0)


def _relative(values, sample, depth):
    for name, value in sorted(values.items()):
        if isinstance(value, bool | str | Phase | Reason) or value is None:
            yield name, value
        elif isinstance(value, int) and name.endswith("_ns") and value >= 0:
            yield name, min(sample.time_ns - value, 60 * PERIOD_NS)
        elif isinstance(value, int | float):
            yield name, round(value, 6)
        elif isinstance(value, Sample):
            yield name, sample.wheel_count - value.wheel_count, sample.road_count - value.road_count, value.board_flags
        elif isinstance(value, deque):
            yield name, *(tuple(_since(each, sample)) for each in value)
        elif depth < 3 and (inner := _parts(value)):
            yield name, *_relative(inner, sample, depth + 1)


def _parts(value):
    if hasattr(value, "__dict__"):
        return vars(value)
    return {each: getattr(value, each) for each in getattr(value, "__slots__", ()) if hasattr(value, each)}


def _since(each, sample):
    time_ns, *rest = each
    yield sample.time_ns - time_ns
    counts = (sample.wheel_count, sample.road_count)[-len(rest) :]
    for value, now in zip(rest, counts, strict=True):
        yield now - value if isinstance(value, int) else round(value, 3)


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
