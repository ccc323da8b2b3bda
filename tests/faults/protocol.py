"""Who watches whom in a run, as a small model whose every state can be enumerated.

Loop, guardian, supervisor and recorder, as `inteco_abs.realtime` has them, each step of theirs an atom; any of them may
be killed before any step, the loop may stand still and go on again, and the whole computer may stand still. Time is
counted in polls: in each of them every process that lives and does not stand still acts once, in any order.

This is a model, not the code: what it says is that the rules suffice. That the code keeps to them is for the tests of
`tests/realtime` and for the kills of `tests/system/test_deaths.py`.
"""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

WINDOW = 3
"""Polls that a heartbeat may be missing."""
BOUND = 4 * WINDOW
"""Polls: a loop that stands still, whose guardian dies as it takes over, so that the supervisor has to."""


class Rules(NamedTuple):
    """What each process does for the others. All of them hold; a test takes out one after the other."""

    guardian_waits_for_the_end: bool = True
    guardian_takes_over: bool = True
    guardian_kills_a_silent_loop: bool = True
    guardian_counts_its_own_time: bool = True
    """A pause of the whole computer is nobody's silence."""
    guardian_watches_the_others: bool = True
    loop_watches_the_guardian: bool = True
    loop_waits_for_the_guardian: bool = True
    supervisor_watches: bool = True
    supervisor_rescues: bool = True
    let_go_after_safe: bool = True
    """The loop says that it does not hold the board only once SAFE was read back."""


class State(NamedTuple):
    """Everything that a step depends on."""

    loop: str = "new"  # new, held, driving, standing, safe, left, dying, dead
    guardian: str = "idle"  # idle, watching, killing, claiming, done, dead
    supervisor: str = "runs"  # runs, dead
    recorder: str = "runs"  # runs, dead
    output: bool = False
    holds: bool = False
    stop: bool = False
    stood_still: bool = False
    """The loop has not acted since it stood still."""
    loop_silent: int = 0
    """Polls since the loop's newest tick, as the guardian counts them."""
    guardian_silent: int = 0
    """Polls since the guardian's newest beat, as the loop counts them."""
    acted: frozenset[str] = frozenset()
    """Who has acted in this poll."""
    kills: int = 0
    on_since_trouble: int = 0
    """Polls with the output on since somebody was killed or stood still."""
    healthy_killed: bool = False
    two_hosts: bool = False


IDLE = ("dead", "dying", "standing")
FOR_EVER = 40
PROCESSES = ("loop", "guardian", "supervisor", "recorder")


def steps(state: State, rules: Rules, most_kills: int) -> Iterator[State]:
    """All states that may follow."""
    for name in PROCESSES:
        if name not in state.acted and getattr(state, name) not in IDLE:
            yield from (each._replace(acted=each.acted | {name}) for each in _ACTS[name](state, rules))
    if state.kills < most_kills:
        alive = (name for name in PROCESSES if getattr(state, name) not in ("dead", "dying"))
        yield from (state._replace(**{name: "dead"}, kills=state.kills + 1) for name in alive)
    yield from _left_to_itself(state, rules)


def _left_to_itself(state: State, rules: Rules) -> Iterator[State]:
    """What happens without anybody's doing: pauses, the end of a killed process, time."""
    if state.loop == "driving":
        yield state._replace(loop="standing", stood_still=True)
    if state.loop == "standing":
        yield state._replace(loop="driving")
    if state.loop == "dying":
        yield state._replace(loop="dead")
    if all(getattr(state, name) in IDLE or name in state.acted for name in PROCESSES):
        yield _next_poll(state)
    if state.loop == "driving" and state.guardian == "watching" and not state.acted and state.loop_silent <= 1:
        yield _computer_stands_still(state, rules)


def _next_poll(state: State) -> State:
    trouble = state.kills or state.loop == "standing" or state.stop
    return state._replace(
        acted=frozenset(),
        loop="dead" if state.loop == "dying" else state.loop,
        loop_silent=min(state.loop_silent + 1, WINDOW + 1),
        guardian_silent=min(state.guardian_silent + 1, WINDOW + 1),
        on_since_trouble=min(state.on_since_trouble + 1, FOR_EVER) if trouble and state.output else 0,
    )


def _computer_stands_still(state: State, rules: Rules) -> State:
    """Everybody for longer than any window; the guardian's own clock has counted two polls at most of it."""
    seen = 2 if rules.guardian_counts_its_own_time else WINDOW + 1
    return state._replace(loop_silent=min(state.loop_silent + seen, WINDOW + 1) if seen > 2 else seen)


def _loop(state: State, rules: Rules) -> Iterator[State]:
    if state.loop == "new":
        if state.guardian == "watching" or not rules.loop_waits_for_the_guardian:
            yield state._replace(loop="held", holds=True)
        else:
            yield state
    elif state.loop == "held":
        ready = state.supervisor == "runs" and not state.stop
        yield state._replace(loop="driving", output=True, loop_silent=0) if ready else state._replace(loop="safe")
    elif state.loop == "driving":
        alone = rules.loop_watches_the_guardian and state.guardian_silent > WINDOW
        if state.stop or alone:
            yield state._replace(loop="safe", output=False)
        else:
            trouble = state.on_since_trouble if state.kills else 0
            yield state._replace(loop_silent=0, stood_still=False, on_since_trouble=trouble)
    elif state.loop == "safe":
        yield state._replace(loop="left", holds=False)
    elif state.loop == "left":
        yield state._replace(loop="dead")
    if not rules.let_go_after_safe and state.loop == "driving" and state.stop:
        yield state._replace(loop="left", holds=False)


def _guardian(state: State, rules: Rules) -> Iterator[State]:
    beaten = state._replace(guardian_silent=0)
    if state.guardian == "idle":
        yield beaten._replace(guardian="watching") if state.supervisor == "runs" else beaten._replace(stop=True)
    elif state.guardian == "watching":
        yield _watching(beaten, rules)
    elif state.guardian == "killing":
        ended = state.loop == "dead"
        if ended or not rules.guardian_waits_for_the_end:
            yield beaten._replace(guardian="claiming")
        else:
            yield beaten._replace(loop="dying")
    elif state.guardian == "claiming":
        yield beaten._replace(guardian="done", output=False, two_hosts=state.loop != "dead")
    else:
        yield beaten


def _watching(state: State, rules: Rules) -> State:
    lost = "dead" in (state.supervisor, state.recorder)
    told = state._replace(stop=state.stop or (lost and rules.guardian_watches_the_others))
    if state.loop == "dead":
        takes = state.holds and rules.guardian_takes_over
        return told._replace(guardian="claiming" if takes else "done")
    silent = state.holds and state.loop in ("driving", "standing") and state.loop_silent > WINDOW
    if silent and rules.guardian_kills_a_silent_loop:
        return told._replace(guardian="killing", healthy_killed=not state.stood_still)
    return told


def _supervisor(state: State, rules: Rules) -> Iterator[State]:
    lost = rules.supervisor_watches and "dead" in (state.guardian, state.recorder)
    seen = state._replace(stop=state.stop or lost)
    if state.loop == "dead" and state.guardian == "dead" and state.holds and rules.supervisor_rescues:
        seen = seen._replace(output=False, holds=False)
    elif state.guardian == "dead" and state.stood_still and rules.supervisor_rescues:
        seen = seen._replace(loop="dead")  # told to stop, and still there: killed
    yield seen
    if not state.stop and state.loop == "driving":
        yield seen._replace(stop=True)  # the operator


def _recorder(state: State, _rules: Rules) -> Iterator[State]:
    yield state


_ACTS = {"loop": _loop, "guardian": _guardian, "supervisor": _supervisor, "recorder": _recorder}


def explore(rules: Rules, most_kills: int, bound: int) -> tuple[int, int, str]:
    """Number of states and of steps, and the first violation: empty if there is none.

    `bound`: polls that the output may stay on after the first trouble, while one of loop, guardian and supervisor that
    can still act is left.
    """
    seen, waiting, count = {State()}, deque([State()]), 0
    while waiting:
        state = waiting.popleft()
        problem = violation(state, bound)
        if problem:
            return len(seen), count, problem
        for following in steps(state, rules, most_kills):
            count += 1
            if following not in seen:
                seen.add(following)
                waiting.append(following)
    return len(seen), count, ""


def violation(state: State, bound: int) -> str:
    helpless = (state.loop == "dead" or state.stood_still) and state.guardian == "dead" == state.supervisor
    if state.two_hosts:
        return f"two hosts have written to the board: {state}"
    if state.healthy_killed:
        return f"a healthy loop was killed: {state}"
    if state.on_since_trouble > bound and not helpless:
        return f"the output stayed on: {state}"
    if state.output and not state.holds:
        return f"nobody holds a board whose output is on: {state}"
    return ""
