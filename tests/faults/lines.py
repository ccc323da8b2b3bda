"""The lines of ours that a piece of work executes, and something done just before the n-th execution of one of them."""

import linecache
import sys
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple, Self

import inteco_abs

OURS = str(Path(inteco_abs.__file__).parent)


class Line(NamedTuple):
    """A line that is executed."""

    code: CodeType
    number: int

    @property
    def text(self) -> str:
        return linecache.getline(self.code.co_filename, self.number)

    def __str__(self) -> str:
        return f"{Path(self.code.co_filename).relative_to(OURS)}:{self.number}"


class Tracing:
    """While it is entered, Python's tracer of this thread."""

    def __enter__(self) -> Self:
        sys.settrace(self._entered)
        return self

    def __exit__(self, *_error: object) -> None:
        sys.settrace(None)
        sys.setprofile(None)

    def _entered(self, frame: FrameType, event: str, _: Any) -> Any:
        raise NotImplementedError


class Counting(Tracing):
    """Counts how often each line of ours is executed."""

    def __init__(self) -> None:
        self._times: defaultdict[CodeType, Counter[int]] = defaultdict(Counter)

    @property
    def times(self) -> dict[Line, int]:
        return {Line(code, number): n for code, lines in self._times.items() for number, n in lines.items()}

    def _entered(self, frame: FrameType, _event: str, _: Any) -> Any:
        return self._at if frame.f_code.co_filename.startswith(OURS) else None

    def _at(self, frame: FrameType, event: str, _: Any) -> Any:
        if event == "line":
            self._times[frame.f_code][frame.f_lineno] += 1
        return self._at


class Strike(Tracing):
    """Has `act` called once: before the `n`-th execution of a line, counted from 1; `again` at the next call of ours.

    A call is one of or by a function of ours, or its end.
    """

    def __init__(self, line: Line, n: int, act: Callable[[], None], again: Callable[[], None] | None = None) -> None:
        self.struck = False
        self._line = line
        self._left = n
        self._act, self._again = act, again

    def _entered(self, frame: FrameType, _event: str, _: Any) -> Any:
        return self._at if frame.f_code is self._line.code else None

    def _at(self, frame: FrameType, event: str, _: Any) -> Any:
        if event == "line" and frame.f_lineno == self._line.number:
            self._left -= 1
            if not self._left:
                self.struck = True
                sys.settrace(None)  # the rest at full speed
                if self._again is not None:
                    sys.setprofile(self._called)
                self._act()
        return self._at

    def _called(self, frame: FrameType, _event: str, _: Any) -> None:
        if frame.f_code.co_filename.startswith(OURS):
            sys.setprofile(None)
            self._again()
