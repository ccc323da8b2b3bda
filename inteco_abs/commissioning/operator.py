"""Questions to the operator at the rig."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol, TypeVar

from inteco_abs.errors import AnswerError, Stopped

_MOST_TRIALS: Final = 3
_STOP: Final = ("stop", "s", "q", "quit")
_YES_NO: Final = {"yes": True, "y": True, "no": False, "n": False}

T = TypeVar("T")


class Operator(Protocol):
    """Person at the rig who answers each question with one line of text."""

    def say(self, text: str) -> None:
        """Print a paragraph."""
        ...

    def show(self, text: str) -> None:
        """Show a live value; each text replaces the one before."""
        ...

    def ask(self, question: str) -> str:
        """Return one line, stripped."""
        ...


def ask_for(operator: Operator, question: str, read: Callable[[str], T | None], wanted: str) -> T:
    """Ask until `read` accepts the answer; `wanted` describes what it accepts.

    Raises Stopped for the answer `stop`, AnswerError after three answers that it rejects.
    """
    for _ in range(_MOST_TRIALS):
        answer = operator.ask(question)
        if answer.lower() in _STOP:
            raise Stopped("stopped by the operator")
        value = read(answer)
        if value is not None:
            return value
        operator.say(f"{answer!r}: must be {wanted}, or stop")
    raise AnswerError(f"no valid answer in {_MOST_TRIALS} trials to: {question}")


def agree(operator: Operator, question: str) -> bool:
    """Ask yes or no; there is no default."""
    return ask_for(operator, f"{question} (yes/no)", lambda answer: _YES_NO.get(answer.lower()), "yes or no")


def wait_for(operator: Operator, request: str) -> None:
    """Ask the operator to do something and to press Enter."""
    ask_for(operator, f"{request} Press Enter, or type stop.", lambda answer: not answer or None, "just Enter")


def require_phrase(operator: Operator, request: str, phrase: str) -> None:
    """Have `phrase` typed, in any case and spacing. Raises AnswerError for anything else."""
    answer = operator.ask(f'{request}\nType "{phrase}":')
    if answer.lower().split() != phrase.lower().split():
        raise AnswerError(f'{answer!r} is not "{phrase}": nothing was written to the board')
