"""Output and questions of the command: text, JSON, tables, result cards, progress."""

from __future__ import annotations

import json
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import date
from typing import TYPE_CHECKING, Any, TextIO

import click

from inteco_abs.errors import Stopped

if TYPE_CHECKING:
    from rich.console import RenderableType

    from inteco_abs.montecarlo import Progress


def on_terminal(stream: TextIO | None) -> bool:
    """Whether the stream is a terminal; a stream that the shell closed is None."""
    return stream is not None and stream.isatty()


def say(text: str = "", *, err: bool = False, nl: bool = True) -> None:
    """Print lines, escaped: any text may come from an untrusted file."""
    click.echo("\n".join(map(plain, text.split("\n"))), err=err, nl=nl)  # noqa: TID251


def plain(text: object) -> str:
    """`text` escaped: it cannot move the cursor, change colours or begin a line."""
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in str(text))


def show(*renderables: RenderableType, width: int = 0) -> None:
    """Print what rich renders on stdout, without markup and at least `width` columns wide."""
    from rich.console import Console

    console = Console(markup=False, highlight=False)
    console.width = max(console.width, width)
    console.print(*renderables, sep="\n")


def print_json(data: Mapping[str, Any]) -> None:
    """Print one object on one line. Raises ValueError for NaN and infinity, which JSON does not have."""
    say(json.dumps(data, allow_nan=False, default=date.isoformat))


def print_card(card: Mapping[str, Any], explanation: str, before: Mapping[str, Any] | None = None) -> None:
    """Print a result card; `before` is the one to compare it with."""
    from rich.console import Console

    from inteco_abs.views import render_card

    console = Console()
    shown, earlier = _escaped(card), None if before is None else _escaped(before)
    console.print(render_card(shown, plain(explanation), earlier, plain=console.options.ascii_only))


def _escaped(card: Mapping[str, Any]) -> dict[str, Any]:
    return {key: plain(value) if isinstance(value, str) else value for key, value in card.items()}


@contextmanager
def items_progress(
    items: str = "stops", beginning: str = "compiling, then braking", going: str = "braking"
) -> Iterator[Progress | None]:
    """Progress bar over `items` on a terminal's stderr; None where stderr is not a terminal."""
    if not on_terminal(sys.stderr):
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, Task, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Rate(TextColumn):
        def render(self, task: Task) -> Text:
            return Text(items if task.speed is None else f"{items}, {task.speed:.3g} per s", self.style)

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(""),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(beginning, total=None)

        def update(done: int, total: int) -> None:
            if bar.tasks[task].total is None:  # what an earlier command braked says nothing of the rate
                bar.reset(task, completed=done, total=total)
            else:
                bar.update(task, completed=done, description=going)

        yield update


@contextmanager
def fit_progress() -> Iterator[Callable[[float, float], None] | None]:
    """Line on a terminal's stderr with the step of a fit and its residuals in counts; None without a terminal."""
    if not on_terminal(sys.stderr):
        yield None
        return
    from rich.console import Console

    steps = 0
    with Console(stderr=True).status("compiling, then fitting") as status:

        def update(noise: float, rms: float) -> None:
            nonlocal steps
            steps += 1
            status.update(f"fitting: step {steps}, residuals {rms:.3g} counts rms, weighed as {noise:g} counts")

        yield update


def wrapped(text: str, columns: int) -> str:
    """Each line of `text` in lines of at most so many columns; a line's indentation is that of all its parts."""
    lines = []
    for line in text.split("\n"):
        indent = " " * (len(line) - len(line.lstrip(" ")))
        lines += textwrap.wrap(line, columns, subsequent_indent=indent, break_on_hyphens=False) or [line]
    return "\n".join(lines)


class Terminal:
    """Operator that reads stderr and answers on stdin, from a terminal or a file of answers."""

    def __init__(self) -> None:
        self._showing = False

    def say(self, text: str) -> None:
        """Print one paragraph, on a terminal without broken words."""
        text = wrapped(text, shutil.get_terminal_size().columns) if on_terminal(sys.stderr) else text
        say(f"\n{text}" if self._showing else text, err=True)
        self._showing = False

    def show(self, text: str) -> None:
        """Replace the current line, on a terminal only."""
        if on_terminal(sys.stderr):
            click.echo(f"\r\033[K  {plain(text)}", nl=False, err=True)  # noqa: TID251  it replaces a line
            self._showing = True

    def ask(self, question: str) -> str:
        """Return one line, stripped. Raises Stopped at the end of the input."""
        try:
            answer: str = click.prompt(question, default="", show_default=False, prompt_suffix=" ", err=True)
        except click.Abort as abort:
            if isinstance(abort.__context__, EOFError):
                raise Stopped("standard input has no more answers; the same command continues from here") from None
            raise
        return answer.strip()
