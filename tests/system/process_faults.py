"""One real-time run whose processes are killed or frozen at drawn moments, judged by the board's own record.

The record is in the run's memory, mapped into this process: no output of the program is used.
"""

import os
import random
import signal
import threading
import time
from contextlib import contextmanager, suppress
from itertools import combinations, product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from live import STARTS, LiveRun

from inteco_abs.boards import STILL_ON
from inteco_abs.realtime.memory import Field
from inteco_abs.sessions import TRUTH
from tests.faults.protocol import Seen

ROLES = ("loop", "guardian", "supervisor", "recorder")
ACTORS = {"loop", "guardian", "supervisor"}
"""Each of these makes the board safe, or has it made so, if it alone is left."""
HOW = {"kill": signal.SIGKILL, "freeze": signal.SIGSTOP}
KINDS = tuple(
    tuple(zip(roles, hows, strict=True))
    for count in (1, 2, 3)
    for roles in combinations(ROLES, count)
    for hows in product(HOW, repeat=count)
)
"""8 singles, 24 pairs, 32 triples, each of `(role, how)`."""
LONG = (
    "experiment.start_speed_rad_s=40.0",
    "experiment.idle_s=0.02",
    "experiment.hold_s=0.1",
    "guard.silence_s=0.05",
    "experiment.stops=3",
)
"""So long that no end by itself is taken for a reaction."""
TICKS = 100, 2500
LONGEST_GAP_S = 0.2
PATIENCE_S = 3.0
SAID_S = 0.1
LOOKS_S = 0.001


class FaultedRun(NamedTuple):
    """Result of one run."""

    seed: str
    """Seed of the faults: it repeats them at the same moments."""
    on: bool
    """Whether an output was on at the last fault, or came on after it."""
    off_ms: float
    """From the last fault until both outputs were off for good; infinite if that did not come."""
    warned: bool
    """Whether the user was warned to press the emergency switch."""
    trace: tuple[Seen, ...]
    """What was seen from just before the first fault on, in order, each different from the one before."""


def any_actor_left(kind):
    """Whether a process is left that can make the board safe."""
    return bool(ACTORS - {role for role, _ in kind})


def name_of(kind):
    return " + ".join(f"{how} {role}" for role, how in kind)


def seed_of(kind, number):
    return f"{name_of(kind)} #{number}"


def run_with_faults(command, folder, environment, kind, number):
    """Run a stop, kill or freeze its processes, wait for its outputs to go off. `number` seeds all that is random.

    A run that a busy computer ends before the first fault is repeated.
    """
    seed = seed_of(kind, number)
    for _ in range(STARTS - 1):
        try:
            return _faulted(LiveRun(command, folder, environment, settings=LONG), kind, seed)
        except AssertionError as error:
            if "MISSED_EXCHANGES" not in str(error):
                raise
            (folder / "stop.mcap").unlink(missing_ok=True)
    return _faulted(LiveRun(command, folder, environment, settings=LONG), kind, seed)


def _faulted(run, kind, seed):
    chance = random.Random(seed)
    try:
        pids = {role: run.pid(role) for role in ROLES}
        run.until_tick(chance.randrange(*TICKS))
        gap_s = chance.choice((0.0, 0.0, LONGEST_GAP_S))
        with watched(run, pids) as trace:
            for role, how in chance.sample(kind, len(kind)):
                time.sleep(chance.random() * (gap_s + 0.0005))
                last_ns = time.monotonic_ns()
                try:
                    os.kill(pids[role], HOW[how])
                except ProcessLookupError:  # the fault before has ended it
                    continue
            end = time.monotonic() + PATIENCE_S
            while run.words[Field.HOLDER_PID] not in (0, run.words[Field.RESCUED_PID]) and time.monotonic() < end:
                time.sleep(0.01)
            time.sleep(SAID_S)
        on, off_ms = turned_off(run, last_ns)
    finally:
        for pid in run.processes():
            with suppress(ProcessLookupError):  # it may end meanwhile
                os.kill(pid, signal.SIGKILL)
        run.process.kill()
        _, said = run.process.communicate()
        run.memory.remove()
    return FaultedRun(seed, on, off_ms, STILL_ON in said, tuple(trace))


@contextmanager
def watched(run, pids):
    """Look at the run every millisecond while inside; gives the list that what is seen is added to."""
    trace, over = [look(run, pids)], threading.Event()

    def watch():
        before = None
        while not over.wait(LOOKS_S):
            seen = look(run, pids)
            # what changes while it is looked at is not one instant: it counts once it was seen twice
            if seen == before != trace[-1]:
                trace.append(seen)
            before = seen

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield trace
    finally:
        over.set()
        thread.join()


def look(run, pids):
    words, newest = run.words, run.memory.truth_reader().newest()
    row = TRUTH.array(newest)[0] if newest is not None else None
    return Seen(
        **{role: state_of(pid) for role, pid in pids.items()},
        holds=words[Field.HOLDER_PID] == pids["loop"] != words[Field.RESCUED_PID],
        stop=bool(words[Field.STOP] or words[Field.GUARDIAN_STOP]),
        output=row is not None and bool(row["drive"] > 0.0 or row["brake"] > 0.0),
    )


def state_of(pid):
    """State of a process: `runs`, `stopped` or `gone`."""
    try:
        letter = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][0]
    except OSError:
        return "gone"
    return {"T": "stopped", "Z": "gone", "X": "gone"}.get(letter, "runs")


def turned_off(run, killed_ns):
    """Whether an output was on at the fault or after it, and how much later both went off for good, ms."""
    reader = run.memory.truth_reader()
    reader.release(reader.held_from())
    rows = TRUTH.array(reader.take())
    times = rows["time_ns"].astype(np.int64)
    on = (rows["drive"] > 0.0) | (rows["brake"] > 0.0)
    if on[-1]:
        return True, float("inf")
    last = int(np.flatnonzero(on)[-1]) if on.any() else -1
    off_ms = max(0.0, (int(times[last + 1]) - killed_ns) * 1e-6)
    return off_ms > 0.0, off_ms
