"""The operator at the rig: reads what happens, answers what no program can know."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol, TypeVar

from inteco_abs.errors import ProbeError, Stopped

_MOST_TRIALS: Final = 3
_STOP: Final = ("stop", "s", "q", "quit")
_YES_NO: Final = {"yes": True, "y": True, "no": False, "n": False}

T = TypeVar("T")


class Operator(Protocol):
    """The person who answers, each question with one line of text."""

    def tell(self, text: str) -> None:
        """Print a paragraph."""
        ...

    def show(self, text: str) -> None:
        """Show a live value; each text replaces the one before."""
        ...

    def ask(self, question: str) -> str:
        """One line, without the white space around it."""
        ...


def ask_for(person: Operator, question: str, read: Callable[[str], T | None], wanted: str) -> T:
    """Ask until `read` accepts the answer; `wanted` describes what it accepts.

    Raises Stopped for the answer `stop`, ProbeError after three answers that it rejects.
    """
    for _ in range(_MOST_TRIALS):
        answer = person.ask(question)
        if answer.lower() in _STOP:
            raise Stopped("stopped by the operator")
        value = read(answer)
        if value is not None:
            return value
        person.tell(f"{answer!r}: must be {wanted}, or stop")
    raise ProbeError(f"no valid answer in {_MOST_TRIALS} trials to: {question}")


def agree(person: Operator, question: str) -> bool:
    """Ask yes or no; there is no default."""
    return ask_for(person, f"{question} (yes/no)", lambda answer: _YES_NO.get(answer.lower()), "yes or no")


def wait_for(person: Operator, request: str) -> None:
    """Ask the person to do something and to press Enter."""
    ask_for(person, f"{request} Press Enter, or type stop.", lambda answer: True if not answer else None, "just Enter")


def require_phrase(person: Operator, request: str, phrase: str) -> None:
    """Have `phrase` typed; anything else is a refusal. Case and spacing do not matter. Raises ProbeError."""
    answer = person.ask(f'{request}\nType "{phrase}":')
    if answer.lower().split() != phrase.lower().split():
        raise ProbeError(f'{answer!r} is not "{phrase}": nothing was written to the board')
