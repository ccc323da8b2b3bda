"""Who watches whom in a run, as a small model whose every state can be enumerated.

Loop, guardian and supervisor, as `inteco_abs.realtime` has them, each step of theirs an atom; any of them and the
recorder may be killed or frozen before any step and go on again after any, and the whole computer may stand still.
The functions of `realtime.failure_rules` decide what guardian and supervisor do, here as in the code, and the windows
are the code's. Time is counted in polls of 25 ms: in each of them every process that can acts once, in any
order.

A frozen recorder is as good as a healthy one here: no process needs it to be safe.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

from inteco_abs.realtime import failure_rules as code
from inteco_abs.realtime.failure_rules import Action

POLL_NS = 25_000_000
LOOP_WINDOW = 50_000_000 // POLL_NS
"""Polls: `guard.silence_s` of a real board."""
GUARDIAN_WINDOW = code.GUARDIAN_WINDOW_NS // POLL_NS
LOOPS_WINDOW = code.LOOPS_WINDOW_NS // POLL_NS
SUPERVISOR_WINDOW = code.SUPERVISOR_WINDOW_NS // POLL_NS
MOST_SILENT = 1 + max(GUARDIAN_WINDOW, LOOPS_WINDOW, SUPERVISOR_WINDOW)
BOUND = 10
"""Polls from the last strike, 250 ms: a loop alone beside a dead guardian, or a supervisor that sees, kills, waits and
writes. Each step takes a poll here, and 5 ms in the code."""


class Seen(NamedTuple):
    """What can be seen of a run from outside at one instant."""

    loop: str
    """`runs`, `stopped` or `gone`; the next three likewise."""
    guardian: str
    supervisor: str
    recorder: str
    holds: bool
    """Whether the loop holds the board, and no process has taken it over."""
    stop: bool
    """Whether anybody wants the run to end."""
    output: bool
    """Whether drive or brake is on, by the board's own record."""


class Rules(NamedTuple):
    """What each process does for the others. All of them hold; a test takes out one after the other."""

    guardian_waits_for_the_end: bool = True
    guardian_takes_over: bool = True
    guardian_kills_a_silent_loop: bool = True
    guardian_counts_its_own_time: bool = True
    """A pause of the whole computer is not a process's silence."""
    guardian_watches_the_others: bool = True
    loop_watches_the_guardian: bool = True
    loop_waits_for_the_guardian: bool = True
    supervisor_stops: bool = True
    supervisor_kills: bool = True
    supervisor_waits_for_both_ends: bool = True
    supervisor_rescues: bool = True
    let_go_after_safe: bool = True
    """The loop says that it does not hold the board only once SAFE was read back."""


class State(NamedTuple):
    """Everything that a step depends on."""

    loop: str = "new"  # new, held, driving, safe, left, dying, dead
    guardian: str = "idle"  # idle, watching, claiming, done, dying, dead
    supervisor: str = "runs"  # runs, rescuing, dead
    recorder: str = "runs"  # runs, dead
    frozen: frozenset[str] = frozenset()
    output: bool = False
    holds: bool = False
    stop: bool = False
    stood_still: bool = False
    """The loop has not acted since it was frozen."""
    loop_seen: int = 0
    """Looks of the guardian's since the loop's newest tick."""
    loop_watched: int = 0
    """The same of the supervisor's."""
    guardian_seen: int = 0
    """Looks of the loop's since the guardian's newest beat."""
    guardian_watched: int = 0
    """The same of the supervisor's."""
    supervisor_seen: int = 0
    """Looks of the guardian's since the supervisor's newest beat."""
    acted: frozenset[str] = frozenset()
    """Who has acted in this poll."""
    strikes: int = 0
    on_since: int = 0
    """Polls with the output on since a process was last struck, or continued."""
    healthy_killed: bool = False
    two_hosts: bool = False


ACTORS = ("loop", "guardian", "supervisor")
GONE = ("dead", "dying")
FOR_EVER = 40


def steps(state: State, rules: Rules, most_strikes: int) -> Iterator[State]:
    """All states that may follow."""
    waiting = [name for name in ACTORS if _can_act(state, name) and name not in state.acted]
    for name in waiting:
        yield from (each._replace(acted=each.acted | {name}) for each in _ACTS[name](state, rules))
    if state.strikes < most_strikes:
        yield from _struck(state)
    for name in state.frozen:
        yield state._replace(frozen=state.frozen - {name}, on_since=0)
    if state.loop == "dying":
        yield state._replace(loop="dead")
    if state.guardian == "dying":
        yield state._replace(guardian="dead")
    if not waiting:
        yield _next_poll(state)
    if state.loop == "driving" and state.guardian == "watching" and not (state.acted or state.frozen or state.strikes):
        yield _computer_stands_still(state, rules)


def _can_act(state: State, name: str) -> bool:
    return getattr(state, name) not in GONE and name not in state.frozen


def _struck(state: State) -> Iterator[State]:
    after = state._replace(strikes=state.strikes + 1, on_since=0)
    for name in (*ACTORS, "recorder"):
        if getattr(state, name) not in GONE:
            yield after._replace(**{name: "dead"}, frozen=state.frozen - {name})
    for name in ACTORS:
        if _can_act(state, name):
            yield after._replace(frozen=state.frozen | {name}, stood_still=state.stood_still or name == "loop")


def _next_poll(state: State) -> State:
    lost = any(getattr(state, name) in GONE for name in (*ACTORS, "recorder"))
    on = state.output and (lost or state.frozen or state.stood_still or state.stop)
    return state._replace(
        acted=frozenset(),
        loop="dead" if state.loop == "dying" else state.loop,
        guardian="dead" if state.guardian == "dying" else state.guardian,
        on_since=min(state.on_since + 1, FOR_EVER) if on else 0,
    )


def _computer_stands_still(state: State, rules: Rules) -> State:
    """All processes for longer than any window: none looks, so none counts."""
    return state if rules.guardian_counts_its_own_time else state._replace(loop_seen=LOOP_WINDOW + 1)


def _more(count: int) -> int:
    return min(count + 1, MOST_SILENT)


def _loop(state: State, rules: Rules) -> Iterator[State]:
    state = state._replace(guardian_seen=_more(state.guardian_seen), stood_still=False)
    if state.loop == "new":
        watched = state.guardian == "watching" or not rules.loop_waits_for_the_guardian
        yield state._replace(loop="held", holds=True) if watched else state
    elif state.loop == "held":
        ready = state.supervisor == "runs" and not state.stop
        yield _ticked(state._replace(loop="driving", output=True)) if ready else state._replace(loop="safe")
    elif state.loop == "driving":
        alone = rules.loop_watches_the_guardian and state.guardian_seen > LOOPS_WINDOW
        if state.stop or alone:
            yield _ticked(state._replace(loop="safe", output=False))
        else:
            yield _ticked(state)
    elif state.loop == "safe":
        yield state._replace(loop="left", holds=False)
    elif state.loop == "left":
        yield state._replace(loop="dead")
    if not rules.let_go_after_safe and state.loop == "driving" and state.stop:
        yield state._replace(loop="left", holds=False)


def _ticked(state: State) -> State:
    return state._replace(loop_seen=0, loop_watched=0)


def _guardian(state: State, rules: Rules) -> Iterator[State]:
    state = state._replace(
        guardian_seen=0,
        guardian_watched=0,
        loop_seen=_more(state.loop_seen),
        supervisor_seen=_more(state.supervisor_seen),
    )
    if state.guardian == "idle":
        yield state._replace(guardian="watching") if state.supervisor == "runs" else state._replace(stop=True)
    elif state.guardian == "watching":
        yield _watching(state, rules)
    elif state.guardian == "claiming":
        hosts = state.loop != "dead" or state.supervisor == "rescuing"
        yield state._replace(guardian="done", output=False, holds=False, two_hosts=state.two_hosts or hosts)
    else:
        yield state


def _watching(state: State, rules: Rules) -> State:
    gone = "dead" in (state.supervisor, state.recorder) or state.supervisor_seen > SUPERVISOR_WINDOW
    state = state._replace(stop=state.stop or (gone and rules.guardian_watches_the_others))
    drives = state.holds and state.loop in ("driving", "safe", "dying")
    silent = drives and state.loop_seen > LOOP_WINDOW and rules.guardian_kills_a_silent_loop
    ended = state.loop == "dead"
    deed = code.guardian_does(held=state.holds, loop_ended=ended, loop_silent=silent)
    if Action.RESCUE in deed and rules.guardian_takes_over:
        return state._replace(guardian="claiming")
    if Action.KILL_LOOP in deed and rules.guardian_waits_for_the_end:
        return _killed(state)
    if Action.KILL_LOOP in deed:
        return _killed(state)._replace(guardian="claiming", two_hosts=True)  # it has not ended by now
    return state._replace(guardian="done") if ended else state


def _killed(state: State) -> State:
    if state.loop == "dead":
        return state
    healthy = state.loop == "driving" and not state.stood_still
    return state._replace(loop="dying", healthy_killed=state.healthy_killed or healthy, frozen=state.frozen - {"loop"})


def _supervisor(state: State, rules: Rules) -> Iterator[State]:
    state = state._replace(
        supervisor_seen=0,
        loop_watched=_more(state.loop_watched),
        guardian_watched=_more(state.guardian_watched),
    )
    if state.supervisor == "rescuing":
        yield state._replace(supervisor="runs", output=False, holds=False)
        return
    begun = state.loop not in ("new", "held")
    deed = Action.NONE
    if begun:
        deed = code.supervisor_does(
            held=state.holds,
            loop_ended=state.loop == "dead",
            loop_silent=state.holds and state.loop_watched > LOOP_WINDOW,
            guardian_ended=state.guardian == "dead" or not rules.supervisor_waits_for_both_ends,
            guardian_silent=state.guardian_watched > GUARDIAN_WINDOW,
        )
        if not rules.supervisor_waits_for_both_ends and state.guardian_watched <= GUARDIAN_WINDOW:
            deed = Action.NONE
    yield _done(state, deed, rules)
    if not state.stop and state.loop == "driving":
        yield _done(state, deed, rules)._replace(stop=True)  # the operator


def _done(state: State, deed: Action, rules: Rules) -> State:
    if Action.STOP in deed and rules.supervisor_stops:
        state = state._replace(stop=True)
    if Action.KILL_GUARDIAN in deed and rules.supervisor_kills and state.guardian != "dead":
        state = state._replace(guardian="dying", frozen=state.frozen - {"guardian"})
    if Action.KILL_LOOP in deed and rules.supervisor_kills:
        state = _killed(state)
    if Action.RESCUE in deed and rules.supervisor_rescues:
        hosts = state.guardian not in GONE or state.loop != "dead"
        state = state._replace(supervisor="rescuing", two_hosts=state.two_hosts or hosts)
    return state


_ACTS = {"loop": _loop, "guardian": _guardian, "supervisor": _supervisor}


def explore(rules: Rules, most_strikes: int, bound: int) -> tuple[int, int, str]:
    """Number of states and of steps, and the first violation: empty if there is none.

    `bound`: polls that the output may stay on after the last strike, while one of loop, guardian and supervisor that
    can act is left.
    """
    seen, waiting, count = {State()}, deque([State()]), 0
    while waiting:
        state = waiting.popleft()
        problem = violation(state, bound)
        if problem:
            return len(seen), count, problem
        for following in steps(state, rules, most_strikes):
            count += 1
            if following not in seen:
                seen.add(following)
                waiting.append(following)
    return len(seen), count, ""


def violation(state: State, bound: int) -> str:
    helpless = not any(_can_act(state, name) for name in ACTORS)
    if state.two_hosts:
        return f"two hosts have written to the board: {state}"
    if state.healthy_killed:
        return f"a healthy loop was killed: {state}"
    if state.on_since > bound and not helpless:
        return f"the output stayed on: {state}"
    if state.output and not state.holds:
        return f"no process holds a board whose output is on: {state}"
    return ""


UNSEEN = 8
"""Most steps that may happen between two looks a millisecond apart."""


def unexplained(trace: Sequence[Seen], most_strikes: int, known: dict[object, frozenset[State]]) -> Seen | None:
    """The first sight of a run that no path through the model leads to; None if one explains all of the trace.

    `known` keeps what was found of the beginnings of traces, for the next call.
    """
    for length in range(1, len(trace) + 1):
        key = (most_strikes, tuple(trace[:length]))
        if key not in known:
            before = known[most_strikes, tuple(trace[: length - 1])] if length > 1 else _driving()
            after = {state for state in _within(before, UNSEEN, most_strikes) if _shows(state, trace[length - 1])}
            known[key] = _staying(after, trace[length - 1], most_strikes)
        if not known[key]:
            return trace[length - 1]
    return None


def _driving() -> frozenset[State]:
    """Where a run may be before it is struck."""
    return frozenset(each for each in _reached({State()}, lambda _: True, 0) if each.loop == "driving")


def _within(states: Iterable[State], most: int, most_strikes: int) -> set[State]:
    found = newest = set(states)
    for _ in range(most):
        newest = {each for state in newest for each in _following(state, most_strikes)} - found
        found = found | newest
    return found


def _staying(states: Iterable[State], seen: Seen, most_strikes: int) -> frozenset[State]:
    """All states that look the same, however long it takes to get there."""
    return frozenset(_reached(set(states), lambda state: _shows(state, seen), most_strikes))


def _reached(states: set[State], allowed: Callable[[State], bool], most_strikes: int) -> set[State]:
    found, waiting = set(states), list(states)
    while waiting:
        for state in _following(waiting.pop(), most_strikes):
            if state not in found and allowed(state):
                found.add(state)
                waiting.append(state)
    return found


def _following(state: State, most_strikes: int) -> Iterator[State]:
    """Steps without the count of what is judged elsewhere, and a loop whose guard ends the run."""
    yield from (each._replace(on_since=0) for each in steps(state, Rules(), most_strikes))
    if state.loop == "driving" and _can_act(state, "loop"):
        yield _ticked(state._replace(loop="safe", output=False))


def _shows(state: State, seen: Seen) -> bool:
    """Whether a run in this state may look so. An output that is off may be between drive and brake."""
    if seen.output and not state.output:
        return False
    if state.loop == "dead" and not state.holds:  # the run is over, and its processes end in any order
        return not seen.holds and seen.loop == "gone"
    recorder = seen.recorder if seen.recorder == "gone" else "runs"
    alike = all(getattr(seen, name) in _sights(state, name) for name in ACTORS)
    alike = alike and recorder == ("gone" if state.recorder == "dead" else "runs")
    return alike and (seen.holds, seen.stop) == (state.holds, state.stop)


def _sights(state: State, name: str) -> tuple[str, ...]:
    doing = getattr(state, name)
    if doing == "dying":
        return "runs", "stopped", "gone"
    return ("gone",) if doing == "dead" else ("stopped",) if name in state.frozen else ("runs",)
