"""Writes a run to its file; if the disk fails, to a second file, or from memory at the end.

It keeps no rows: a new file is copied from the previous one, even if that was unlinked, and from the memory of the
caller, which keeps rows until they are in a file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np

from inteco_abs.config import RigConfig
from inteco_abs.control import GainChange
from inteco_abs.errors import AbsError, ConfigError, SessionError, describe_disk, on_one_line
from inteco_abs.format import TICK, TRUTH, Message
from inteco_abs.sessions.environment import Environment
from inteco_abs.sessions.file_writer import FileWriter
from inteco_abs.sessions.files import atomic_write, require_own_file
from inteco_abs.sessions.session_writer import RunEnd, RunHeader, RunResult, SessionWriter

Opener = Callable[[Path], FileWriter]
"""Opens a file for the session at a path; id and times of the session do not depend on the path."""
Report = Callable[[str, Path], None]
"""Gets the disk's error with its consequence, and the file that is now written."""
RowBlocks = Iterable[tuple[bytes, bytes]]
"""Ticks and states of the simulated rig in blocks, each back to back and in order."""


def check_spill(config: RigConfig) -> None:
    """Raise ConfigError if `session.spill` is not a folder."""
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
    """Second path for the session at `out`; None if it is not configured."""
    if not config.session.spill:
        return None
    path = Path(config.session.spill).expanduser().absolute() / out.name
    try:
        taken = path.exists()
    except OSError:  # unknown
        taken = True
    return path.with_name(f"{out.stem}-{session_id[:8]}{out.suffix}") if taken else path


def joined(stored: Callable[[], RowBlocks], held: Callable[[], RowBlocks]) -> Iterator[tuple[bytes, bytes]]:
    """Each row of a run once: those `stored` in a file, then the newest, `held` in memory.

    The file is read only if memory lacks the beginning, and then first: meanwhile the loop may overwrite rows that are
    in the file, but no others. Raises the errors of reading the file.
    """
    first, _ = next(iter(held()), (b"", b""))
    tick = state_ns = -1
    if not first or TICK.array(first)["tick"][0]:
        for ticks, states in stored():
            tick = int(TICK.array(ticks)["tick"].max()) if ticks else tick
            state_ns = int(TRUTH.array(states)["time_ns"].max()) if states else state_ns
            yield ticks, states
    for ticks, states in held():
        yield _newer(TICK, "tick", ticks, tick), _newer(TRUTH, "time_ns", states, state_ns)


def _newer(message: Message, column: str, rows: bytes, newest: int) -> bytes:
    """The rows after `newest`; rows are in order."""
    return rows[int((message.array(rows)[column].astype(np.int64) <= newest).sum()) * message.size :]


class FailoverWriter:
    """Writes one run to a file at `out`. Raises SessionError if the disk fails before the header is written.

    After later failures the run continues in a file at `spill`, or, if that fails too, in memory until `finish` tries
    both again. `held` returns the rows in the caller's memory: at least all since the latest `flush` after which
    `writing` was true.
    """

    def __init__(
        self,
        out: Path,
        opener: Opener,
        held: Callable[[], RowBlocks],
        spill: Path | None = None,
        report: Report | None = None,
    ) -> None:
        self.path = out
        """File that is being written, or was the last one."""
        self._out, self._spill = out, spill
        self._session = out
        self._open = opener
        self._held = held
        self._report = report or (lambda _text, _path: None)
        self._problems: list[str] = []
        self._warnings: list[tuple[int, str]] = []
        self._recorder = opener(out)
        self._writer: SessionWriter | None = None
        self._failed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._close()

    @property
    def writing(self) -> bool:
        """Whether added rows reach a file, as far as is known."""
        return not self._failed

    @property
    def ticks(self) -> int:
        """Number of ticks added."""
        return self._writer.card.ticks if self._writer is not None else 0

    @property
    def synced(self) -> int:
        """Number of ticks that are on the disk, as far as is known."""
        return self._recorder.synced

    @property
    def header(self) -> RunHeader:
        """The run's header."""
        return self._begun.header

    def write_header(self, config: RigConfig, header: RunHeader, session: Path) -> None:
        """Write the header before the first tick; `session` is the file's name for the user."""
        self._session = session
        writer = SessionWriter(self._recorder, config, header, session)
        try:
            writer.write_header()
        except SessionError as error:
            with suppress(SessionError):  # a failing disk may not remove files either
                self.discard()
            raise SessionError(f"{error}; the rig was not moved") from error
        self._writer = writer

    def add_environment(self, found: Environment) -> None:
        """Add the environment, if the header was written without it."""
        self._attempt(lambda: self._begun.add_environment(found))

    def add(self, ticks: bytes, truths: bytes) -> None:
        """Add tick records and states of the simulated rig, each back to back."""
        if self._failed:
            self._begun.remember(ticks, truths)
        else:
            self._attempt(lambda: self._begun.add(ticks, truths))

    def change(self, changes: Sequence[GainChange]) -> None:
        """Add changes of gains, before the ticks from which on they hold."""
        if self._failed:
            self._begun.changes += changes
        elif changes:
            self._attempt(lambda: self._begun.change(changes))

    @property
    def changes(self) -> Sequence[GainChange]:
        """Gains changed so far."""
        return self._begun.changes

    def flush(self) -> None:
        """Write everything so far to the file; it reaches the disk while this program goes on."""
        if not self._failed:
            self._attempt(lambda: self._recorder.flush())  # noqa: PLW0108  of the current recorder

    def warn(self, unix_ns: int, text: str) -> None:
        """Add a warning to the session's log."""
        self._warnings.append((unix_ns, text))
        if not self._failed:
            self._attempt(lambda: self._recorder.warn(unix_ns, text))

    def slow_syncs(self) -> list[tuple[int, int]]:
        """Beginning (monotonic clock) and duration, ns, of the syncs since the last call that took over a second."""
        return self._recorder.slow_syncs()

    def finish(self, end: RunEnd) -> RunResult:
        """Complete the file; after a failure, try again to write all of it. Raises SessionError if every disk fails."""
        while not self._failed:
            try:
                return self._reported(self._begun.finish(end))
            except SessionError as error:
                self._move(error)
        for place in filter(None, (self._out, self._spill)):
            with suppress(AbsError):
                return self._reported(self._complete(place, end))
        raise SessionError(f"{'; '.join(self._problems)}; the file could not be written again at the end either")

    def rows(self) -> Iterator[tuple[bytes, bytes]]:
        """All rows, from the last file and from memory; ends the writing."""
        return joined(self._stored, self._held)

    def discard(self) -> None:
        """Remove the file of a run without ticks. Raises SessionError if it cannot be removed."""
        self._recorder.discard()

    @property
    def _begun(self) -> SessionWriter:
        if self._writer is None:
            raise RuntimeError("call write_header first")
        return self._writer

    def _attempt(self, work: Callable[[], None]) -> None:
        try:
            work()
        except SessionError as error:
            self._move(error)

    def _move(self, error: SessionError) -> None:
        """Continue at the second path after a disk error, if everything so far can be written there."""
        known = len(self._problems)
        self._problems.append(str(error))
        self._failed = True
        if self._spill is not None and self.path != self._spill:
            try:
                self._move_to(self._spill)
            except AbsError as second:
                self._problems.append(on_one_line(second))
        where = "its ticks are kept in memory" if self._failed else f"it is now written to {self.path}"
        self._report(f"{'; '.join(self._problems[known:])}; the run continues, and {where}", self.path)

    def _move_to(self, path: Path) -> None:
        recorder = self._open(path)
        try:
            writer = self._rewritten(recorder, path)
            recorder.flush()
        except SessionError:
            with suppress(SessionError):
                recorder.close()
            raise
        self._close()
        self._recorder, self._writer, self.path, self._failed = recorder, writer, path, False

    def _complete(self, place: Path, end: RunEnd) -> RunResult:
        with atomic_write(place) as part, self._open(part) as recorder:
            require_own_file(place, recorder.session_id)
            result = self._rewritten(recorder, place).finish(end)
        self.path = place
        return result

    def _rewritten(self, recorder: FileWriter, place: Path) -> SessionWriter:
        writer = self._begun.continued(recorder, self._session if place == self._out else place)
        for ticks, truths in self.rows():
            writer.write(ticks, truths)
        for unix_ns, text in (*self._warnings, *((recorder.started_ns, text) for text in self._problems)):
            recorder.warn(unix_ns, text)
        return writer

    def _stored(self) -> RowBlocks:
        """The rows in the last file, up to where its disk fails."""
        try:
            yield from self._recorder.stored()
        except SessionError as error:
            if str(error) not in self._problems:
                self._problems.append(str(error))

    def _reported(self, result: RunResult) -> RunResult:
        if not self._problems:
            return result
        lost = self.ticks - result.card["ticks"]
        what = f"the session, but for {lost} ticks that are lost," if lost else "the whole session"
        problems = [*self._problems, *filter(None, [result.trouble]), f"{what} is in {result.card['session']}"]
        return replace(result, trouble="; ".join(problems))

    def _close(self) -> None:
        with suppress(SessionError):  # its error was reported already
            self._recorder.close()
