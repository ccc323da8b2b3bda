"""One real-time run whose processes are killed at a random moment, and what has become of its ticks.

The judge is the ring itself, mapped into this process: it outlives its file, and only the loop and the mock board
write records into it. The board's own record also shows whether every exchange has become a tick.
"""

import os
import random
import signal
import subprocess
import time
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from live import LiveRun

from inteco_abs.realtime.memory import Field
from inteco_abs.sessions import TICK, TRUTH, read_session

ROLES = ("loop", "recorder", "guardian", "supervisor")
KINDS = tuple(victims for count in range(1, 5) for victims in combinations(ROLES, count))
"""Every process alone, and every combination of them."""
RUNS = 20
"""Runs of each kind; 300 in all."""
SHORT = (
    "experiment.start_speed_rad_s=20.0",
    "experiment.idle_s=0.02",
    "experiment.hold_s=0.05",
    "guard.silence_s=0.2",
)
LAST_TICK = 1700
"""Last tick to strike at, in a stop of some 2000."""
EVERY_LONG = 5
LONG = (*SHORT, "experiment.stops=6", "loop.ring_s=4.0")
"""Every fifth run: stops in a row, of which the ring soon holds the newest 8000 ticks only."""
LONG_TICKS = 8000, 11_000
LONGEST_START_S, LONGEST_END_S, LONGEST_GAP_S = 3.0, 0.6, 1.0
PATIENCE_S = 60.0


class KilledRun(NamedTuple):
    """One run whose processes were killed, and what is left of its ticks."""

    seed: str
    """The same seed kills the same processes at the same moments."""
    stage: str
    """`start`, `run` or `end`, in which the first kill fell."""
    packed: int
    """Ticks that the loop packed, by the ring's memory."""
    kept: int = 0
    """How many of these are in the session: bit for bit what the ring still holds, by their numbers what it held."""
    foreign: int = 0
    """Ticks in the session that the loop did not pack, or in another order."""
    unseen: int = 0
    """Exchanges that the board counted between two ticks that the ring holds, and that became no tick."""
    recovered: bool = False
    """Whether it took `inteco-abs recover`."""

    @property
    def lost(self):
        return self.packed - self.kept

    @property
    def passed(self):
        return not (self.lost or self.foreign or self.unseen)


def run_and_kill(command, folder, environment, victims, number):
    """Run a stop, kill `victims` in it, recover what must be recovered, judge. `number` seeds all that is random."""
    seed = f"{'+'.join(victims)} {number}"
    chance = random.Random(seed)
    long = number % EVERY_LONG == EVERY_LONG - 1
    run = LiveRun(command, folder, environment, settings=LONG if long else SHORT, begun=False)
    try:
        stage = chance.choices(("start", "run", "end"), (1, 7, 2))[0]
        await_moment(run, stage, LONG_TICKS if long else (1, LAST_TICK), chance)
        kill_all(run, chance.sample(victims, len(victims)), chance)
        await_everybodys_end(run, f"{seed}, at its {stage}")
        packed, held, exchanged_ns = remembered(run)
        recovered = packed > 0 and run.memory.path.exists()
        if recovered:
            again = folder / "again.mcap"
            subprocess.run([command, "recover", run.memory.path, "-o", again], env=environment, check=True,
                           capture_output=True)  # fmt: skip
            kept = whole(again)
        else:
            kept = whole(run.out) if packed else []
        return judged(KilledRun(seed, stage, packed, recovered=recovered), held, kept, exchanged_ns)
    finally:
        run.destroy()


def table(found):
    """Lines of a table with a row for each kind in `found`, lists of runs by victims, and their sums."""
    names = ("runs", "packed", "in file", "lost", "foreign", "unseen", "by recover")
    yield f"{'killed':38}" + "".join(f"{name:>11}" for name in names)
    sums = [run for runs in found.values() for run in runs]
    for kind, runs in [*(("+".join(victims), each) for victims, each in found.items()), ("all", sums)]:
        columns = [[getattr(each, name) for each in runs] for name in KilledRun._fields[2:]]
        packed, kept, foreign, unseen, recovered = map(sum, columns)
        figures = (len(runs), packed, kept, packed - kept, foreign, unseen, recovered)
        yield f"{kind:38}" + "".join(f"{figure:11}" for figure in figures)


def await_moment(run, stage, ticks, chance):
    if stage == "start":
        longest_s = LONGEST_START_S
    elif stage == "run":
        tick, longest_s = chance.randrange(*ticks), 0.0005
        wait(run, lambda: run.ticks.written >= tick)
    else:
        longest_s = LONGEST_END_S
        wait(run, lambda: run.ticks.written and not run.words[Field.HOLDER_PID])
    time.sleep(chance.random() * longest_s)


def wait(run, condition):
    """Until then, or until the run has ended before: on a busy computer it may stop for safety."""
    while not condition() and run.process.poll() is None:
        time.sleep(0.0005)


def kill_all(run, victims, chance):
    """Kill them in this order: at once, or with time between for the others to notice."""
    longest_s = chance.choice((0.0, 0.0, LONGEST_GAP_S))
    for victim in victims:
        if victim == "supervisor":
            run.process.kill()
        elif pid := run.child(victim):
            os.kill(pid, signal.SIGKILL)
        time.sleep(chance.random() * longest_s)


def await_everybodys_end(run, seed):
    end = time.monotonic() + PATIENCE_S
    while run.process.poll() is None or run.processes():
        assert time.monotonic() < end, f"{seed}: still there are {[words(pid) for pid in run.processes()]}"
        time.sleep(0.02)
    run.process.communicate()


def words(pid):
    return (Path("/proc") / str(pid) / "cmdline").read_text().split("\0")[4:6]


def remembered(run):
    """How many records the loop packed, those that the ring holds, and the times of the board's newest exchanges."""
    ticks, truths = run.memory.tick_reader(), run.memory.truth_reader()
    first, first_truth = ticks.held_from(), truths.held_from()
    ticks.release(first)
    truths.release(first_truth)
    held, exchanges = rows(ticks.take()), TRUTH.array(truths.take())
    assert (len(held), len(exchanges)) == (ticks.written - first, truths.written - first_truth)
    return ticks.written, held, exchanges["time_ns"].astype(np.int64)


def whole(path):
    """Records of a session that is not cut."""
    session = read_session(path)
    assert session.incomplete == "", session.incomplete
    return rows(session.payload)


def rows(records):
    return [bytes(records[at : at + TICK.size]) for at in range(0, len(records), TICK.size)]


def judged(run, held, kept, exchanged_ns):
    first = run.packed - len(held)
    numbers = TICK.array(b"".join(kept))["tick"].tolist()
    alike = sum(number == at for at, number in enumerate(numbers[:first]))
    alike += sum(a == b for a, b in zip(held, kept[first:], strict=False))
    ticks_ns = TICK.array(b"".join(held))["time_ns"].astype(np.int64)
    ticks_ns = ticks_ns[ticks_ns >= exchanged_ns[0]] if len(exchanged_ns) else ticks_ns
    # one between any two ticks, or two after none: the board may be late, and a tick has the host's time
    exchanges = np.diff(np.searchsorted(exchanged_ns, ticks_ns))
    return run._replace(kept=alike, foreign=len(kept) - alike, unseen=max(0, int((exchanges - 1).sum())))
