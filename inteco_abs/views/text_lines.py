"""Lines for a terminal as pieces of text with a style each, cheap to draw."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from rich.console import Console, ConsoleOptions, RenderResult
from rich.segment import Segment
from rich.style import Style

Piece = tuple[str, str]
"""Text, and a style as rich names it; empty for none."""
Line = list[Piece]


class TextLines:
    """Lines cut at the terminal's width, without layout and wrapping, which take rich ten times as long."""

    def __init__(self, lines: Sequence[Line]) -> None:
        self.lines = lines

    def __rich_console__(self, _console: Console, options: ConsoleOptions) -> RenderResult:
        """Segments, line by line."""
        for line in self.lines:
            for text, style in fitted(line, options.max_width):
                yield Segment(text, Style.parse(style) if style else None)
            yield Segment.line()


def length(line: Line) -> int:
    """Cells of a line; every character here takes one."""
    return sum(len(text) for text, _ in line)


def fitted(line: Line, width: int) -> Line:
    """The line, cut to `width` cells."""
    left, kept = max(0, width), Line()
    for text, style in line:
        kept.append((text[:left], style))
        left -= len(kept[-1][0])
    return kept


def padded(line: Line, width: int) -> Line:
    """The line in exactly `width` cells."""
    return [*fitted(line, width), (" " * max(0, width - length(line)), "")]


def apart(left: Line, right: Line, width: int) -> Line:
    """`left` and `right` at the ends of one line; only `left` without room for both."""
    room = width - length(left) - length(right)
    return [*left, (" " * room, ""), *right] if room > 0 else left


def runs(text: str, styles: Sequence[str]) -> Line:
    """Text with a style for each character, in as few pieces as possible."""
    made, at = Line(), 0
    for style, group in groupby(styles):
        size = sum(1 for _ in group)
        made.append((text[at : at + size], style))
        at += size
    return made
