"""Lives of the command `inteco-abs run` in this process, and signals before the lines that it executes."""

import os
import random
import shutil
import signal
import sys
import traceback
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from functools import partial
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import pytest

import inteco_abs.experiment.virtual_run
from inteco_abs.cli import main
from inteco_abs.mock_board import Device
from inteco_abs.rig import plant
from inteco_abs.sessions import provenance, read_session
from tests.faults.lines import OURS, Counting, Line, Strike, Tracing
from tests.faults.stage import SHORTEST

INTERRUPTED = 130
FEWER = 10
"""Executions that a line may have fewer of in another life."""
SIGNALS = {
    "SIGINT": (signal.SIGINT,),
    "SIGTERM": (signal.SIGTERM,),
    "SIGHUP": (signal.SIGHUP,),
    "SIGINT twice": (signal.SIGINT, signal.SIGINT),
}
TOP = ("cli/__init__.py", "cli/command.py")
"""Always struck, as no handler is above them."""
DEADLY = (signal.SIGTERM, signal.SIGHUP)
"""Where no handler receives them."""


class Died(BaseException):
    """The process would have been gone at this point, with nothing of ours executed any more."""


@dataclass
class Life:
    """One life of the command."""

    code: int | None = None
    """What it ended with; None if a signal killed it."""
    duties: list[tuple[float, float]] = field(default_factory=list)
    """Duties of every board at its end."""
    escaped: BaseException | None = None
    said: str = ""
    struck: bool = True


@contextmanager
def handled(numbers, handler):
    """Signals handled so from outside of the command."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


class Lives:
    """`inteco-abs run` in this process, in a folder that is empty each time."""

    def __init__(self, folder: Path, *options: str, virtual: bool = True) -> None:
        self.folder = folder
        settings = [word for setting in SHORTEST for word in ("--set", setting)]
        self._words = ["inteco-abs", "run", "--seed", "1", "--json", "--out", "stop.mcap", *settings, *options]
        self._words += ["--virtual"] if virtual else []

    def clear(self) -> None:
        for path in self.folder.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    def live(self, tracing: Tracing | None = None) -> Life:
        """From its first line to its last."""
        devices = []

        class Remembered(Device):
            def __init__(self, *arguments, **named):
                super().__init__(*arguments, **named)
                devices.append(self)

        life = Life()

        def die(*_):
            life.duties = [device.duties for device in devices]
            raise Died

        with (
            pytest.MonkeyPatch.context() as patch,
            handled(DEADLY, die),
            redirect_stdout(StringIO()),
            redirect_stderr(StringIO()) as said,
        ):
            patch.setattr(inteco_abs.experiment.virtual_run, "Device", Remembered)
            patch.setattr(sys, "argv", self._words)
            patch.setenv("NUMBA_DISABLE_JIT", "1")  # another test may put machine code on the disk meanwhile
            patch.chdir(self.folder)
            try:
                with tracing or nullcontext():
                    main()
            except SystemExit as end:
                life.code = int(end.code or 0)
            except Died:
                pass
            except BaseException as error:  # noqa: BLE001  every exception is judged
                life.escaped = error
            else:
                raise AssertionError("the command returned")
        life.duties += [device.duties for device in devices]
        life.said = said.getvalue()
        return life

    def struck(self, line: Line, n: int, numbers: tuple[int, ...]) -> Life:
        """The same with signals before the `n`-th execution of `line`.

        What the session tells of the computer may be shorter than when executions were counted: then before the newest
        one that there is.
        """
        for number in range(n, max(0, n - FEWER), -1):
            self.clear()
            strike = Strike(line, number, *(partial(os.kill, os.getpid(), each) for each in numbers))
            life = self.live(strike)
            life.struck = strike.struck
            if life.struck:
                break
        return life


def problems(lives: Lives, life: Life) -> Iterator[str]:
    if not life.struck:
        yield "was never struck"
    if any(any(duties) for duties in life.duties):
        yield f"outputs were left on: {life.duties}"
    if life.escaped is not None and not no_one_left(life.escaped):
        yield f"{life.escaped!r} left the command"
    # a second interrupt in what is being thrown away already is Python's to tell of, and the first one was heard
    if ("Traceback" in life.said and "Exception ignored in" not in life.said) or "internal error" in life.said:
        yield life.said
    if life.code not in {None, 0, INTERRUPTED}:  # None: killed, as the system does it, where nothing is open
        yield f"ended with exit code {life.code}: {life.said}"
    for path in lives.folder.iterdir():
        if path.name != "stop.mcap":
            yield f"left {path.name}"
        elif read_session(path).incomplete:
            yield "left a session that is cut"


def no_one_left(error: BaseException) -> bool:
    """Whether an interrupt came at the first or last line of the command, around which there is nothing of ours.

    There always are such lines; Python then ends with the same code, and a traceback.
    """
    ours = [frame.filename for frame in traceback.extract_tb(error.__traceback__) if frame.filename.startswith(OURS)]
    return isinstance(error, KeyboardInterrupt) and set(ours) <= {str(Path(OURS, "cli", "__init__.py"))}


def deliveries(times: dict[Line, int], draw: random.Random) -> list[tuple[Line, int]]:
    """Each line at its first and its last execution and at one between."""
    return [
        (line, n)
        for line, most in times.items()
        for n in sorted({1, most, draw.randint(1, most)})
    ]  # fmt: skip


class Struck(NamedTuple):
    """What became of many lives."""

    lines: int
    """That a life executes."""
    possible: int
    """Signals that there could be: of each kind before each line's first, last and another execution."""
    delivered: int
    ends: Counter[int | str]
    bad: list[str]

    def __str__(self) -> str:
        how = ", ".join(f"{number} with {end}" for end, number in sorted(self.ends.items(), key=str))
        left_on = sum("left on" in problem for problem in self.bad)
        return (
            f"{self.delivered} of {self.possible} signals before {self.lines} lines of a run, which ended {how}; "
            f"outputs left on: {left_on}, other violations: {len(self.bad) - left_on}"
        )


def strike_each(lives: Lives, names: Iterable[str], share: float) -> Struck:
    """Signals of these names at a share of all moments, drawn with a fixed seed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plant, "MOST_CUTS", 1)
        patch.setattr(provenance, "_git", lambda *_: None)
        lives.live()  # imports happen once, and what is cached is computed once
        lives.clear()
        counting, draw = Counting(), random.Random(3)
        lives.live(counting)
        every = [(name, *moment) for moment in deliveries(counting.times, draw) for name in names]
        drawn = draw.sample(every, round(share * len(every)))
        top = [each for each in every if str(each[1]).startswith(TOP) and signal.SIGINT in SIGNALS[each[0]]]
        chosen, bad, ends = list(dict.fromkeys([*drawn, *top])), [], Counter()
        for name, line, n in chosen:
            life = lives.struck(line, n, SIGNALS[name])
            ends["killed" if life.code is None else life.code] += 1
            bad += [f"{name} at {line}, execution {n}: {problem}" for problem in problems(lives, life)]
    return Struck(len(counting.times), len(every), len(chosen), ends, bad)
