"""The grader's side of a submission: a process to ask, with limits of time; its answers are numbers and names."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from typing import IO, Any, Final, Self, cast

from inteco_abs.control import Setup
from inteco_abs.errors import AbsError
from inteco_abs.signals import BrakeDemand, Estimate

_STUDENT: Final = "inteco_abs.course.student"
_PASSED_ON: Final = ("PATH", "HOME", "LANG", "LC_ALL", "PYTHONPATH", "SYSTEMROOT")
_TIMES: Final = 5.0
"""How many times as long as it may compute a submission may take, on a computer that is busy with others."""
_MOST_LETTERS: Final = 1_000_000
_PRINTED_LINES: Final = 20
_LONGEST: Final = 1000
"""Letters of an error's text, and of a line that is printed."""
_LONGEST_NAME: Final = 40
_LEAVING_S: Final = 1.0


class SubmissionError(AbsError):
    """A submission that failed: it does not load, raises, is too slow, or has ended."""


class Submission:
    """A submission's process, which loads it when it is entered. Each request raises SubmissionError where it fails."""

    def __init__(self, file: str, source: str, name: str, may_import: Sequence[str], cpu_s: int) -> None:
        environment = {key: os.environ[key] for key in _PASSED_ON if key in os.environ}
        self._process = subprocess.Popen(  # noqa: S603  our own module
            [sys.executable, "-u", "-P", "-m", _STUDENT],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"},
            start_new_session=True,
        )
        self._requests, self._replies, self._errors = (
            cast("IO[bytes]", pipe) for pipe in (self._process.stdin, self._process.stdout, self._process.stderr)
        )
        self.printed: deque[str] = deque(maxlen=_PRINTED_LINES)
        """The last lines that it printed."""
        self.failure: SubmissionError | None = None
        """Why it has failed; there is no more answer then."""
        self._late = False
        self._cpu_s = cpu_s
        self._over = threading.Event()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._listen, self._watch)]
        for thread in self._threads:
            thread.start()
        self._load = file, source, name, list(may_import)
        self.confined: tuple[str, ...] | None = None
        """What it is kept from; None before it is started."""

    def __enter__(self) -> Self:
        try:
            self.confined = tuple(map(str, self.ask("confine", self._cpu_s)))
            self.ask("load", *self._load)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def ask(self, kind: str, *given: object) -> Any:
        """Return its answer, which may be anything that JSON has. Raises SubmissionError for an error or none."""
        if self.failure is not None:
            raise self.failure
        line = b""
        with suppress(OSError):  # it has ended: the answer is empty
            self._requests.write(json.dumps((kind, *given)).encode() + b"\n")
            self._requests.flush()
            line = self._replies.readline(_MOST_LETTERS)
        if not line.endswith(b"\n"):
            raise self._failed(self._ended())
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):
            raise self._failed("has written into the pipe of its answers") from None
        if isinstance(answer, dict) and "error" in answer:
            raise self._failed(_plain(str(answer["error"])[:_LONGEST]))
        return answer

    def number(self, kind: str, *given: object) -> float:
        """As `ask`, for a number."""
        return self.numbers(1, kind, *given)[0]

    def numbers(self, count: int, kind: str, *given: object) -> list[float]:
        """As `ask`, for as many finite numbers."""
        answer = self.ask(kind, *given)
        found = answer if isinstance(answer, list) else [answer]
        if len(found) != count or not all(type(each) is float and abs(each) < float("inf") for each in found):
            raise self._failed("has written into the pipe of its answers")
        return found

    def name(self, kind: str, *given: object) -> str:
        """As `ask`, for a word."""
        return _plain(str(self.ask(kind, *given))[:_LONGEST_NAME])

    def _failed(self, problem: str) -> SubmissionError:
        self.failure = SubmissionError(problem)
        return self.failure

    def _ended(self) -> str:
        """Why there is no answer."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_LEAVING_S)
        code = self._process.returncode
        if self._late:
            return f"was killed: it has not come to an end within {_TIMES * self._cpu_s:g} s"
        if code is None:
            return "has closed the pipe of its answers"
        if code in {-getattr(signal, "SIGXCPU", 0), -getattr(signal, "SIGKILL", 0)}:
            return f"was killed: it may compute for {self._cpu_s} s"
        return f"has ended its own process: {f'exit code {code}' if code >= 0 else signal.Signals(-code).name}"

    def _listen(self) -> None:
        """Keep what it prints, which goes nowhere else."""
        with suppress(OSError, ValueError):
            for line in iter(lambda: self._errors.readline(_LONGEST), b""):
                self.printed.append(_plain(line.decode(errors="replace").rstrip("\n")))

    def _watch(self) -> None:
        """End it when it takes too long, as one that sleeps."""
        self._late = not self._over.wait(_TIMES * self._cpu_s)
        if self._late:
            self._process.kill()

    def close(self) -> None:
        """End the process, and those that it started."""
        self._over.set()
        with suppress(OSError):
            self._requests.close()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_LEAVING_S)
        if hasattr(os, "killpg"):
            with suppress(OSError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()
        self._process.wait()
        for thread in self._threads:
            thread.join(_LEAVING_S)
        for pipe in (self._replies, self._errors):
            pipe.close()


def _plain(text: str) -> str:
    """Escaped, so that it cannot move the cursor, and pass for a grade."""
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in text)


class RemoteController:
    """The controller of a submission, as one of a stop; calling it makes a new one, as calling its class does."""

    gains = ()
    internals = ()

    def __init__(self, submission: Submission) -> None:
        self._submission = submission

    def __call__(self, setup: Setup) -> RemoteController:
        self._submission.ask("controller", setup.reference_slip, setup.hold_below_rad_s)
        return self

    def update(self, estimate: Estimate, dt_s: float) -> BrakeDemand:
        """Ask for the demand."""
        wheel, road, slip, valid, outlook = estimate
        return BrakeDemand(self._submission.number("demand", dt_s, wheel, road, slip, bool(valid), outlook))
