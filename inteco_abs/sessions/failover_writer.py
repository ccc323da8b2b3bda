"""Keeps a run whatever its disk does: in its file, else in a second one, else in memory until the end.

It holds no row itself. What a new file needs is read again from the file before, even where that has lost its name, and
from the memory of whoever adds the rows, who keeps them until they are in a file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np

from inteco_abs.config import RigConfig
from inteco_abs.errors import AbsError, ConfigError, SessionError, describe_disk, in_a_line
from inteco_abs.format import TICK, TRUTH, Message
from inteco_abs.sessions.environment import Environment
from inteco_abs.sessions.files import atomic_write, require_own_file
from inteco_abs.sessions.session_writer import RunEnd, RunHeader, RunResult, SessionWriter
from inteco_abs.sessions.writer import FileWriter

Opener = Callable[[Path], FileWriter]
"""Opens a file for the session at a path; the same session, with the same times, whichever the path."""
Say = Callable[[str, Path], None]
"""Told what a disk has refused and what came of it, and which file is written by now."""
RowBlocks = Iterable[tuple[bytes, bytes]]
"""Ticks and states of the simulated rig in blocks, each back to back and in order."""


def check_spill(config: RigConfig) -> None:
    """Refuse, before anything is opened, a second place that is none. Raises ConfigError."""
    folder = config.session.spill
    problem = ""
    try:
        if folder and not Path(folder).expanduser().is_dir():
            problem = "is not a folder; create it first"
    except OSError as error:
        problem = describe_disk(error)
    if problem:
        raise ConfigError.of("session.spill", f"{folder}: {problem}")


def spill_path(out: Path, config: RigConfig, session_id: str) -> Path | None:
    """Second place for the session that should be at `out`; None if there is none to be had."""
    if not config.session.spill:
        return None
    path = Path(config.session.spill).expanduser().absolute() / out.name
    try:
        taken = path.exists()
    except OSError:  # nobody knows
        taken = True
    return path.with_name(f"{out.stem}-{session_id[:8]}{out.suffix}") if taken else path


def joined(stored: Callable[[], RowBlocks], held: Callable[[], RowBlocks]) -> Iterator[tuple[bytes, bytes]]:
    """A run from what a file has `stored` of it and the newest part, which memory has `held`: each row once.

    The file is not looked at where memory has everything. Else it comes first: the loop goes on meanwhile and may take
    the place of what a file has, never of what none has. Raises what reading the file raises.
    """
    first, _ = next(iter(held()), (b"", b""))
    tick = state_ns = -1
    if not first or TICK.array(first)["tick"][0]:
        for ticks, states in stored():
            tick = int(TICK.array(ticks)["tick"].max()) if ticks else tick
            state_ns = int(TRUTH.array(states)["time_ns"].max()) if states else state_ns
            yield ticks, states
    for ticks, states in held():
        yield _behind(TICK, "tick", ticks, tick), _behind(TRUTH, "time_ns", states, state_ns)


def _behind(message: Message, column: str, rows: bytes, newest: int) -> bytes:
    """Those of the rows, which are in order, that are newer."""
    return rows[int((message.array(rows)[column].astype(np.int64) <= newest).sum()) * message.size :]


class FailoverWriter:
    """Tells one run to a file at `out`. A disk that refuses before the run was introduced is a SessionError.

    Later it is none before the end: the run is told anew to a file at `spill`, or, where that refuses too, kept in
    memory until `finish` tries both once more. `held` gives what was added and is still in the memory of whoever
    adds it: at least everything since the newest `flush` after which the keeper was `writing`.
    """

    def __init__(
        self,
        out: Path,
        opener: Opener,
        held: Callable[[], RowBlocks],
        spill: Path | None = None,
        say: Say | None = None,
    ) -> None:
        self.path = out
        """File that is being written, or was last."""
        self._out, self._spill = out, spill
        self._session = out
        self._open = opener
        self._held = held
        self._say = say or (lambda _text, _path: None)
        self._troubles: list[str] = []
        self._remarks: list[tuple[int, str]] = []
        self._recorder = opener(out)
        self._scribe: SessionWriter | None = None
        self._refused = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._let_go()

    @property
    def writing(self) -> bool:
        """Whether a file takes in what is added, as far as is known."""
        return not self._refused

    @property
    def ticks(self) -> int:
        """Ticks that were added."""
        return self._scribe.ticks if self._scribe is not None else 0

    @property
    def header(self) -> RunHeader:
        """What the run was introduced with."""
        return self._told.header

    def write_header(self, config: RigConfig, header: RunHeader, session: Path) -> None:
        """Everything that explains the run, on the disk before the first tick; the user calls the file `session`."""
        self._session = session
        scribe = SessionWriter(self._recorder, config, header, session)
        try:
            scribe.write_header()
        except SessionError as error:
            with suppress(SessionError):  # a disk that takes nothing may give nothing back either
                self.discard()
            raise SessionError(f"{error}; the rig was not moved") from error
        self._scribe = scribe

    def add_environment(self, found: Environment) -> None:
        """What surrounded the run, if it was introduced without."""
        self._attempt(lambda: self._told.add_environment(found))

    def add(self, ticks: bytes, truths: bytes) -> None:
        """More of the run: tick records and states of the simulated rig, each back to back."""
        if self._refused:
            self._told.remember(ticks, truths)
        else:
            self._attempt(lambda: self._told.add(ticks, truths))

    def flush(self) -> None:
        """Everything so far into the file."""
        if not self._refused:
            self._attempt(lambda: self._recorder.flush())  # noqa: PLW0108  of the recorder that there is then

    def warn(self, unix_ns: int, text: str) -> None:
        """Add a warning to the session's log."""
        self._remarks.append((unix_ns, text))
        if not self._refused:
            self._attempt(lambda: self._recorder.warn(unix_ns, text))

    def finish(self, end: RunEnd) -> RunResult:
        """Complete the file, or make it as a whole where that can be done by now.

        Raises SessionError if no disk takes it: there is no complete file then.
        """
        while not self._refused:
            try:
                return self._accounted(self._told.finish(end))
            except SessionError as error:
                self._move(error)
        for place in filter(None, (self._out, self._spill)):
            with suppress(AbsError):
                return self._accounted(self._as_a_whole(place, end))
        raise SessionError(f"{'; '.join(self._troubles)}; nor could the file be made anew at the end")

    def rows(self) -> Iterator[tuple[bytes, bytes]]:
        """Everything that was added, out of the last file and memory; only once no file is written any more."""
        return joined(self._stored, self._held)

    def discard(self) -> None:
        """Remove the file: nothing ran, so there is nothing to keep. Raises SessionError if it cannot be removed."""
        self._recorder.discard()

    @property
    def _told(self) -> SessionWriter:
        if self._scribe is None:
            raise RuntimeError("a run is introduced before anything else is told of it")
        return self._scribe

    def _attempt(self, work: Callable[[], None]) -> None:
        try:
            work()
        except SessionError as error:
            self._move(error)

    def _move(self, error: SessionError) -> None:
        """The disk refuses: go on in the second place, if there is one that takes everything so far."""
        known = len(self._troubles)
        self._troubles.append(str(error))
        self._refused = True
        if self._spill is not None and self.path != self._spill:
            try:
                self._begin_anew(self._spill)
            except AbsError as second:
                self._troubles.append(in_a_line(second))
        goes_on = "its ticks are kept in memory" if self._refused else f"it is written to {self.path} by now"
        self._say(f"{'; '.join(self._troubles[known:])}; the run goes on, and {goes_on}", self.path)

    def _begin_anew(self, path: Path) -> None:
        recorder = self._open(path)
        try:
            scribe = self._retold(recorder, path)
            recorder.flush()
        except SessionError:
            with suppress(SessionError):
                recorder.close()
            raise
        self._let_go()
        self._recorder, self._scribe, self.path, self._refused = recorder, scribe, path, False

    def _as_a_whole(self, place: Path, end: RunEnd) -> RunResult:
        with atomic_write(place) as part, self._open(part) as recorder:
            require_own_file(place, recorder.session_id)
            account = self._retold(recorder, place).finish(end)
        self.path = place
        return account

    def _retold(self, recorder: FileWriter, place: Path) -> SessionWriter:
        scribe = self._told.anew(recorder, self._session if place == self._out else place)
        for ticks, truths in self.rows():
            scribe.write(ticks, truths)
        for unix_ns, text in (*self._remarks, *((recorder.started_ns, text) for text in self._troubles)):
            recorder.warn(unix_ns, text)
        return scribe

    def _stored(self) -> RowBlocks:
        """What the last file has; where its disk does not give that back, no more than it gives."""
        try:
            yield from self._recorder.stored()
        except SessionError as error:
            if str(error) not in self._troubles:
                self._troubles.append(str(error))

    def _accounted(self, account: RunResult) -> RunResult:
        if not self._troubles:
            return account
        lost = self.ticks - account.card["ticks"]
        what = f"the session, but for {lost} ticks that are lost," if lost else "the whole session"
        troubles = [*self._troubles, *filter(None, [account.trouble]), f"{what} is in {account.card['session']}"]
        return replace(account, trouble="; ".join(troubles))

    def _let_go(self) -> None:
        with suppress(SessionError):  # what it could not write any more has been said
            self._recorder.close()
