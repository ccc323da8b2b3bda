"""A run as lines of JSON for the program that started it, and that program's commands."""

from __future__ import annotations

import json
import math
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, Final, TextIO

from inteco_abs.errors import AbsError, on_one_line
from inteco_abs.realtime import NoScreen, Point, Snapshot, StartCheck
from inteco_abs.views.tuning_panel import Tunable

STOP: Final = "stop"
"""Command that ends the run; the others are NAME=VALUE."""
_DIGITS: Final = 6
_AT_ONCE: Final = 1 << 12


class JsonLines(NoScreen):
    """Writes what happens in a run to `stream`, one JSON object a line, and obeys lines of the descriptor `commands`.

    Keys of the objects: `check` and `detail`, `state` with `points`, `gains`, `values`, `changed`, `refused`, `note`,
    `warning`. The end of the commands ends the run: whoever could stop it is gone. With a `tuner` the commands change
    gains.
    """

    period_s = 0.04

    def __init__(self, stream: TextIO, commands: int, tuner: Tunable | None = None) -> None:
        self._stream, self._commands, self._tuner = stream, commands, tuner
        self._turn = threading.Lock()
        self._first_ns: int | None = None
        self._values: Mapping[str, float] = {}

    @contextmanager
    def listening(self, stop: Callable[[], None]) -> Iterator[None]:
        """Obey commands inside the context, from a thread that ends with the commands or the process."""
        threading.Thread(target=self._obey, args=(stop,), name="commands", daemon=True).start()
        yield

    def passed(self, check: StartCheck, detail: str = "") -> None:
        """Write a check."""
        self._write(check=check.value, detail=detail)

    def show(self, snapshot: Snapshot) -> None:
        """Write the state with the points since the last one; before it, gains and values that are new."""
        if self._tuner is not None:
            self._show_gains(self._tuner)
        state = snapshot._asdict() | {"phase": snapshot.phase.name}
        del state["recent"]
        self._write(state=_plain(state), points=[self._numbers(point) for point in snapshot.recent])

    def note(self, text: str) -> None:
        """Write a remark."""
        self._write(note=text)

    def warn(self, text: str) -> None:
        """Write a warning."""
        self._write(warning=text)

    def _show_gains(self, tuner: Tunable) -> None:
        if not self._values and tuner.gains:
            self._write(gains=[gain._asdict() for gain in tuner.gains])
        values = tuner.values
        if values != self._values:
            self._values = values
            self._write(values=values)

    def _numbers(self, point: Point) -> list[float | None]:
        """Its columns, with seconds since the first one in place of the time."""
        time_ns, *others = point
        self._first_ns = time_ns if self._first_ns is None else self._first_ns
        return list(map(_plain, ((time_ns - self._first_ns) * 1e-9, *others)))

    def _obey(self, stop: Callable[[], None]) -> None:
        for line in _lines(self._commands):
            if line == STOP:
                stop()
            elif line:
                with suppress(OSError, ValueError):  # the reader is gone: its end follows
                    self._change(line)
        stop()

    def _change(self, line: str) -> None:
        name, _, typed = line.partition("=")
        try:
            value = float(typed)
        except ValueError:
            self._write(refused=f"{line}: must be {STOP}, or NAME=VALUE with a number")
            return
        if self._tuner is None:
            self._write(refused=f"{name}: gains of a run in virtual time change as planned only, with --change")
            return
        try:
            tick = self._tuner.change(name, value)
        except AbsError as error:
            self._write(refused=on_one_line(error))
        else:
            self._write(changed={"name": name, "value": value, "tick": tick})

    def _write(self, **record: Any) -> None:
        line = json.dumps(record, allow_nan=False, separators=(",", ":"))
        with self._turn:
            self._stream.write(f"{line}\n")
            self._stream.flush()


def _plain(value: Any) -> Any:
    """Numbers short, and those that JSON does not have as null."""
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    return [_plain(each) for each in value] if isinstance(value, Iterable) and not isinstance(value, str) else value


def _lines(descriptor: int) -> Iterator[str]:
    """Lines until the other end is gone; a thread that waits in it does not hold up the end of the process."""
    rest = b""
    while True:
        try:
            read = os.read(descriptor, _AT_ONCE)
        except OSError:
            return
        if not read:
            return
        *lines, rest = (rest + read).split(b"\n")
        rest = rest[:_AT_ONCE]
        yield from (line.decode("utf-8", "replace").strip() for line in lines)
