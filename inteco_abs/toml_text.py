"""Reads TOML files, and explains mistakes in them with the line."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from inteco_abs.errors import ConfigError, near_file
from inteco_abs.quantities import number_hint

NOT_TOML: Final = (ValueError, RecursionError)
"""What the standard reader raises: besides its own error, for absurdly long numbers and deep nesting."""
_LARGEST_FILE: Final = 1_000_000
_LONGEST_LINE: Final = 60
_LONGEST_STATEMENT: Final = 100
"""Lines of one value; each of them is a try to read it."""
_PLACE: Final = re.compile(r"\(at line (\d+), column \d+\)")
_TWICE: Final = ("Cannot overwrite a value", "Cannot declare", "Cannot mutate")
_WORD: Final = re.compile(r"[^\W\d][\w.:-]*")


def read_toml(file: Path, if_missing: str) -> dict[str, Any]:
    """The table in `file`; `if_missing` is the next step if there is none. Raises ConfigError."""
    data = _bytes(file, if_missing)
    problem = _problem_of(data)
    if problem:
        raise ConfigError.of(str(file), problem)
    text = data.decode("utf-8-sig")  # Notepad begins a file with a byte-order mark
    try:
        return tomllib.loads(text)
    except NOT_TOML as error:
        raise ConfigError.of(str(file), f"is not TOML: {describe_toml_error(error, text)}") from error


def line_of(file: Path, path: str) -> int | None:
    """Line on which the value at the dotted `path` begins in a file that `read_toml` accepts; None if it has none.

    The standard reader gives no lines, so each statement is read by itself.
    """
    section, statement, begun = "", "", 1
    for number, line in enumerate(file.read_text(encoding="utf-8-sig").split("\n"), 1):
        statement += f"{line}\n"
        try:
            names = list(_dotted(tomllib.loads(statement)))
        except tomllib.TOMLDecodeError:
            if number - begun > _LONGEST_STATEMENT:
                return None
            continue
        if statement.lstrip().startswith("["):
            section = f"{names[-1]}."
            names = names[-1:]
        else:
            names = [section + name for name in names]
        if path in names:
            return begun
        statement, begun = "", number + 1
    return None


def _dotted(table: dict[str, Any]) -> Iterator[str]:
    """Paths of all keys, sections included."""
    for key, value in table.items():
        yield key
        if isinstance(value, dict):
            yield from (f"{key}.{name}" for name in _dotted(value))


def describe_toml_error(error: ValueError | RecursionError, text: str) -> str:
    """Description of the standard reader's error in `text`: place, line, and a correction if there is one."""
    if isinstance(error, RecursionError):
        return "its lists or tables are nested too deeply"
    if not isinstance(error, tomllib.TOMLDecodeError):
        return "it holds a number of absurdly many digits"
    place = _PLACE.search(str(error))
    if place is None:
        return str(error)
    number, lines = int(place[1]), text.splitlines()
    line = lines[number - 1].strip() if number <= len(lines) else ""
    if not line:
        return str(error)
    again = str(error).startswith(_TWICE)
    meant = _first_place(lines, number) if again else _meant(line)
    return f"{error}: {line[:_LONGEST_LINE]!r}{meant}"


def _bytes(file: Path, if_missing: str) -> bytes:
    problem = ""
    try:
        if file.is_dir():
            problem = "is a folder; name a file"
        elif not file.exists():
            problem = f"cannot be read: No such file or directory{near_file(file) or f'; {if_missing}'}"
        elif not file.is_file():
            problem = "cannot be read: it is not a regular file; name one"
        elif file.stat().st_size > _LARGEST_FILE:
            problem = f"is larger than {_LARGEST_FILE} bytes; is it a configuration?"
        else:
            return file.read_bytes()
    except OSError as error:
        raise ConfigError.of(str(file), f"cannot be read: {error.strerror}") from error
    raise ConfigError.of(str(file), problem)


def _problem_of(data: bytes) -> str:
    """Why `data` is not the text of a configuration; empty if it is."""
    if not data.strip():
        return "is empty; leave it out to have every default, or begin one with inteco-abs config init"
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        return f"is not UTF-8 text: byte {error.start} is 0x{data[error.start]:02X}; save it as UTF-8"
    zero = data.find(b"\0")
    return f"is not text: byte {zero} is zero; is it a configuration?" if zero >= 0 else ""


def _meant(line: str) -> str:
    """Correction of an invalid value: a number with a comma or a unit, or text without its quotes."""
    value = line.partition("=")[2].partition("#")[0].strip()
    if _WORD.fullmatch(value):
        return f'; text stands between quotes: "{value}"'
    return number_hint(value)


def _first_place(lines: list[str], number: int) -> str:
    """The earlier line with the key or section of line `number`; empty if it is not found."""
    wanted = _name(lines[number - 1])
    for earlier in range(number - 2, -1, -1):
        if _name(lines[earlier]) == wanted:
            return f"; line {earlier + 1} has it already: {lines[earlier].strip()[:_LONGEST_LINE]!r}"
    return ""


def _name(line: str) -> str:
    return "".join(line.partition("=")[0].partition("#")[0].split())
