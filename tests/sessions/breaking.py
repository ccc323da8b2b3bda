"""Breaks one session file again and again, and judges what is said of what is left."""

import random
import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from inteco_abs.analysis import before_the_gap, replay_session
from inteco_abs.control import CONTROLLERS, build_pipeline, control_check
from inteco_abs.errors import AbsError
from inteco_abs.sessions import read_session, recover_session, session_config, validate

MOST_BYTES = 256 << 20
"""What may be allocated for a file of 20 kB, in one piece or all together."""
LONGEST_S = 60
"""No promise: what is over in 30 ms has hung by then."""


class HangsError(BaseException):
    """Past every `except Exception`."""


@contextmanager
def bounds(what):
    """At most that much memory and time, for any content of the file."""

    def give_up(_number, _frame):
        raise HangsError(what)

    memory = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    handler = signal.signal(signal.SIGALRM, give_up)
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, memory[1]))
    signal.alarm(LONGEST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)
        resource.setrlimit(resource.RLIMIT_AS, memory)


class Trial:
    """Breaks one file again and again, and remembers what was said of it that is not so."""

    def __init__(self, path, tmp_path) -> None:
        self.data, self.whole = path.read_bytes(), read_session(path)
        self.ticks = {int(row["tick"]): row.tobytes() for row in self.whole.ticks}
        self.broken, self.out = tmp_path / "broken.mcap", tmp_path / "recovered.mcap"
        self.lies = []
        self._lossless = False
        self.recovered = []
        """Ticks that each recovery gave."""
        self.lossless = []
        """Variants of which a recovery said that nothing was lost."""

    def of(self, data, what) -> None:
        self.broken.write_bytes(data)
        for check in (self._reads, self._validates, self._recovers):
            wrong = self._said_by(check, what)
            if wrong:
                self.lies.append((what, check.__name__, wrong))
        self.lossless += [what] if self._lossless else []

    def of_ticks(self, data, what) -> None:
        """For a file without a sign that its ticks are not the recorded ones."""
        self.broken.write_bytes(data)
        for check in (self._replays_what_it_reads, self._validates, self._recovers):
            wrong = self._said_by(check, what)
            self.lies += [(what, wrong)] if any(isinstance(each, Exception) for each in wrong) else []

    @staticmethod
    def _said_by(check, what):
        with bounds(what):
            try:
                return list(check())
            except AbsError:
                return []
            except Exception as error:  # noqa: BLE001  which variant made it fail says more than the traceback
                return [error]

    def _replays_what_it_reads(self) -> Iterator[str]:
        return self._replays(read_session(self.broken))

    def _reads(self) -> Iterator[str]:
        session = read_session(self.broken)
        if self.whole.payload[: len(session.payload)] != session.payload:
            yield "a tick that was not recorded"
        yield from self._replays(session)

    def _replays(self, session) -> Iterator[str]:
        config = session_config(session, (control_check(CONTROLLERS),))
        if replay_session(before_the_gap(session), build_pipeline(config, CONTROLLERS)).differing:
            yield "a replay that differs"

    def _validates(self) -> Iterator[str]:
        if validate(self.broken).verdict == "well":
            yield "all is well"

    def _recovers(self) -> Iterator[str]:
        self.out.unlink(missing_ok=True)
        self.recovered.append(0)
        self._lossless = False
        recovery = recover_session(self.broken, self.out)
        session = read_session(self.out)
        self.recovered[-1] = len(session.ticks)
        self._lossless = not recovery.losses
        numbers = session.ticks["tick"].tolist()
        if session.incomplete or session.metadata["session"]["outcome"] != "recovered":
            yield "no whole session"
        if [self.ticks.get(number) for number in numbers] != [row.tobytes() for row in session.ticks]:
            yield "a tick that was not recorded"
        missing = {number for first, last in recovery.missing for number in range(first, last + 1)}
        if missing & set(numbers) or missing | set(numbers) < set(range(max(numbers))):
            yield f"missing are {sorted(missing)}"
        if not recovery.losses and session.payload != self.whole.payload:
            yield "nothing was lost"
        if len(self.recovered) % 4 == 0:
            if validate(self.out).verdict != ("losses" if recovery.losses else "well"):
                yield f"what was recovered is {validate(self.out).findings}"
            yield from self._replays(session)


def cut(trial, seed, times) -> None:
    """End anywhere."""
    for end in random.Random(seed).choices(range(len(trial.data)), k=times):
        trial.of(trial.data[:end], end)


def flip(trial, seed, times) -> None:
    """Another value for one byte, for two, or for a stretch of them."""
    generator = random.Random(seed)
    for number in range(times):
        data = bytearray(trial.data)
        for _ in range(generator.choice((1, 1, 1, 2))):
            at = generator.randrange(len(data))
            length = generator.choice((1, 1, 1, 50))
            fresh = generator.randbytes(length)
            data[at : at + length] = bytes(a ^ (b or 1) for a, b in zip(data[at : at + length], fresh, strict=False))
        trial.of(bytes(data), (seed, number))
