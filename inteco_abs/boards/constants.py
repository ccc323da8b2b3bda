"""`board.constants`: what a profile sets besides drive, brake and encoders, by field, pin or whole word."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from typing import Final, NamedTuple

from firmware_protocol import FrameTable
from firmware_protocol.fields import BYTE_BITS
from inteco_abs.config import BoardConfig
from inteco_abs.errors import ConfigError, ConfigIssue, near_match

_PIN: Final = re.compile(r"pin([0-9]|1[0-9]|2[0-5])")
_PINS_NEED: Final = ("pin_direction", "pin_output")


class ProfileConstants(NamedTuple):
    """The constants of one profile, by kind."""

    fields: dict[str, int]
    """Values by field name in the SEND frame; the board must echo them."""
    words: dict[int, int]
    """Values by data word; they are sent as they are, and need no echo."""
    pins: dict[int, int]
    """Levels by number of a CN1 pin, which becomes an output."""


def constants_of(wiring: BoardConfig, send: FrameTable, owned: Collection[str]) -> ProfileConstants:
    """Return the profile's constants for frames of `send`; the rest of the wiring decides the fields `owned`.

    Raises ConfigError with every mistake: an unknown name, a value out of range, or a field that the wiring or another
    constant decides.
    """
    found = ProfileConstants({}, {}, {})
    mistakes: list[ConfigIssue] = []
    word = re.compile(rf"{'b' if send.word_bits == BYTE_BITS else 'w'}(0|[1-9][0-9]*)")
    for key, value in wiring.constants.items():
        if key in send.fields:
            mistakes.extend(_field_mistake(key, value, send, owned))
            found.fields[key] = value
        elif (match := _PIN.fullmatch(key)) and all(name in send.fields for name in _PINS_NEED):
            mistakes.extend(_pin_mistake(key, wiring))
            found.pins[int(match[1])] = value
        elif match := word.fullmatch(key):
            taken = [*owned, *(name for name in wiring.constants if name in send.fields)]
            mistakes.extend(_word_mistake(key, int(match[1]), value, send, taken))
            found.words[int(match[1])] = value
        else:
            problem = f"neither a field, a pin nor a word of {send.title}{near_match(key, send.fields)}"
            mistakes.append(ConfigIssue(f"board.constants.{key}", problem))
    if mistakes:
        raise ConfigError(mistakes)
    return found


def _field_mistake(key: str, value: int, send: FrameTable, owned: Collection[str]) -> Iterator[ConfigIssue]:
    field, layout = send.fields[key]
    low, high = field.range(layout)
    if key in owned:
        yield ConfigIssue(f"board.constants.{key}", "the rest of [board] decides it: set it there")
    elif not low <= value <= high:
        yield ConfigIssue(f"board.constants.{key}", f"{value}: must be in {low}..{high}")


def _pin_mistake(key: str, wiring: BoardConfig) -> Iterator[ConfigIssue]:
    if wiring.constants[key] not in (0, 1):
        yield ConfigIssue(f"board.constants.{key}", f"{wiring.constants[key]}: must be 0 or 1, the pin's level")
    elif "pin_output" in wiring.constants:
        yield ConfigIssue(f"board.constants.{key}", "pin_output decides it: name the pins or the whole field")


def _word_mistake(key: str, word: int, value: int, send: FrameTable, taken: Collection[str]) -> Iterator[ConfigIssue]:
    most = (1 << send.payload_bits) - 1
    first = 0 if send.command is None or send.data_from else 1  # the command word is not data
    last = send.size * BYTE_BITS // send.word_bits - send.data_from - 1
    carried = [name for name in taken if any(part.word == word for part in send.fields[name][1])]
    if not first <= word <= last:
        yield ConfigIssue(f"board.constants.{key}", f"{send.title} has data in {key[0]}{first} to {key[0]}{last}")
    elif carried:
        yield ConfigIssue(f"board.constants.{key}", f"it carries {', '.join(carried)}, which is decided elsewhere")
    elif not 0 <= value <= most:
        yield ConfigIssue(f"board.constants.{key}", f"{value}: must be in 0..{most}, the top bit marks a command")
