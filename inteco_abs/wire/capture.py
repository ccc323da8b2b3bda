"""Captures: the messages of a link or a bus monitor, as JSON lines.

The first line describes the file; each other line is one event, in order:

    {"format": "inteco-abs wire", "version": 1, "board": "usb2", "recorded_by": "...", "clock": "..."}
    {"t": 0.0, "dir": "out", "ep": 2, "hex": "ff8f0000"}
    {"t": 0.0002, "dir": "in", "ep": 132, "hex": "0301..."}
    {"t": 0.0105, "dir": "error", "of": "in", "text": "the board did not answer within 10 ms"}

`t` is in seconds since the capture began and never decreases, unless the bus monitor's times do. The first line of this
program's recordings has the clock at their beginning as `start_ns`, on the clock of a session's ticks. An error `of`
"out" has the undelivered message as `hex`; `of` "in" is a missing answer; `of` "exchange" leaves open which of the two
messages before it were delivered. A control transfer has its eight bytes of request as `setup`; a warning has only a
`text`.

The report of a commissioning (`commission --send-report`) is a capture, too: `report` in its first line has further
facts about the board, and its records are images of the board in place of READ answers.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from inteco_abs.errors import CaptureError, describe_disk, near_file

if TYPE_CHECKING:
    from inteco_abs.boards.board_report import BoardReport  # loads pydantic, which no run needs

FORMAT: Final = "inteco-abs wire"
VERSION: Final = 1
_LARGEST_ENDPOINT: Final = 0xFF
_LATEST_NS: Final = (1 << 63) - 1


class RecordKind(StrEnum):
    """Kind of an event."""

    OUT = "out"
    IN = "in"
    ERROR = "error"
    CONTROL = "control"
    WARNING = "warning"


class Record(NamedTuple):
    """One event on the wire."""

    t_s: float
    """Seconds since the capture began."""
    kind: RecordKind
    endpoint: int | None = None
    """USB address, with bit 7 for IN; None if the link has no endpoints."""
    data: bytes = b""
    text: str = ""
    """Text of an error or a warning."""
    of: str = ""
    """What failed in an error: "out", "in" or "exchange"."""
    setup: bytes = b""
    """Request of a control transfer."""


class Capture(NamedTuple):
    """Records with their description; errors call the file `name`."""

    board: str
    """Protocol of its frames, as `protocol_of` takes it."""
    recorded_by: str
    clock: str
    records: tuple[Record, ...]
    name: str = "the capture"
    start_ns: int | None = None
    """Clock at the beginning of the capture, ns, if known."""
    report: BoardReport | None = None
    """Facts of the board, if this is the report of a commissioning."""

    @property
    def messages(self) -> int:
        """Number of messages in both directions, without failures and warnings."""
        return sum(record.kind in {RecordKind.OUT, RecordKind.IN} for record in self.records)


def check_target(path: Path) -> None:
    """Raise CaptureError unless a new capture can be written at `path`; captures are never overwritten."""
    problem, part = "", _part(path)
    try:
        if part.exists() or part.is_symlink():
            problem = f"{part.name}, under which it would be written, exists already; remove it, or choose another name"
        elif path.exists():
            problem = "exists already, and captures are never overwritten; choose another name"
        elif not path.parent.is_dir():
            problem = f"the folder {path.parent} does not exist; create it first"
    except OSError as error:
        problem = describe_disk(error)
    if problem:
        raise CaptureError(f"{path}: {problem}")


def _part(path: Path) -> Path:
    """Return the name of an incomplete capture."""
    return path.with_name(f"{path.name}.part")


def write_capture(path: Path, capture: Capture) -> None:
    """Write the file, under another name until it is complete; a failure leaves nothing. Raises CaptureError."""
    head = {
        "format": FORMAT,
        "version": VERSION,
        "board": capture.board,
        "recorded_by": capture.recorded_by,
        "clock": capture.clock,
        **({} if capture.start_ns is None else {"start_ns": capture.start_ns}),
        **({} if capture.report is None else {"report": capture.report.model_dump(mode="json", exclude_defaults=True)}),
    }
    part = _part(path)
    try:
        file = part.open("x", encoding="utf-8", newline="\n")  # truncates no file, follows no link
    except OSError as error:
        raise CaptureError(f"{path}: the capture cannot be written: {part.name}: {describe_disk(error)}") from error
    try:
        with file:
            file.write(json.dumps(head) + "\n")
            file.writelines(_line(record) for record in capture.records)
    except BaseException as error:
        with suppress(OSError):  # it is not there, or cannot be removed either
            part.unlink()
        if isinstance(error, OSError):
            raise CaptureError(f"{path}: the capture cannot be written: {describe_disk(error)}") from error
        raise
    try:
        part.replace(path)
    except OSError as error:
        raise CaptureError(f"{part} is complete but cannot be renamed to {path}: {describe_disk(error)}") from error


def _check_regular(path: Path) -> None:
    """Raise CaptureError for a pipe or a device, which might never end."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise CaptureError(f"{path}: not a regular file; name one")


def read_capture(path: Path) -> Capture:
    """Read the capture in the file. Raises CaptureError naming the first wrong line."""
    _check_regular(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read: {error.strerror or error}{_instead(path)}") from error
    except UnicodeDecodeError as error:
        raise CaptureError(f"{path}: not text; for a Wireshark capture, run inteco-abs wire import first") from error
    lines = text.split("\n")
    if lines.pop():
        raise CaptureError(f"{path}: its last line has no end: the file was cut off")
    return parse_capture(lines, str(path))


def parse_capture(lines: Iterable[str], name: str) -> Capture:
    """Read the capture in these lines. Raises CaptureError naming the first wrong line."""
    head, records = _parts(lines, name)
    return head._replace(records=tuple(records))


@contextmanager
def open_capture(path: Path) -> Iterator[tuple[Capture, Iterator[Record]]]:
    """Open a capture that may be too long for memory: its head, and its records one by one. Raises CaptureError."""
    _check_regular(path)
    try:
        with path.open(encoding="utf-8") as file:
            yield _parts(file, str(path))
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read: {error.strerror or error}{_instead(path)}") from error
    except UnicodeDecodeError as error:
        raise CaptureError(f"{path}: cannot be read: {error}") from error


def _instead(path: Path) -> str:
    """What to name instead of a file that is missing."""
    if path.exists():
        return ""
    return near_file(path) or "; run --record-wire FILE and inteco-abs wire import write captures"


def _parts(lines: Iterable[str], name: str) -> tuple[Capture, Iterator[Record]]:
    numbered = enumerate(lines, 1)
    head = _head(_object(next(numbered, (1, ""))[1], f"{name}, line 1"), name)
    places = ((f"{name}, line {number}", line) for number, line in numbered)
    return head, (_record(_object(line, place), place) for place, line in places)


def _line(record: Record) -> str:
    line: dict[str, Any] = {"t": round(record.t_s, 9), "dir": record.kind}
    if record.of:
        line["of"] = record.of
    if record.kind in {RecordKind.OUT, RecordKind.IN, RecordKind.CONTROL}:
        line["ep"] = record.endpoint
    if record.kind is RecordKind.CONTROL:
        line["setup"] = record.setup.hex()
    if record.data or record.kind in {RecordKind.OUT, RecordKind.IN, RecordKind.CONTROL}:
        line["hex"] = record.data.hex()
    if record.kind in {RecordKind.ERROR, RecordKind.WARNING}:
        line["text"] = record.text
    return json.dumps(line) + "\n"


def _object(line: str, place: str) -> dict[str, Any]:
    try:
        value = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{place}: not a JSON object ({error}); captures are JSON lines") from error
    if not isinstance(value, dict):
        raise CaptureError(f"{place}: not a JSON object but {line[:40]!r}; captures are JSON lines")
    return value


def _head(head: dict[str, Any], name: str) -> Capture:
    if head.get("format") != FORMAT:
        raise CaptureError(
            f"{name}, line 1: format = {head.get('format')!r}, must be {FORMAT!r}: not a capture of inteco-abs"
        )
    if head.get("version") != VERSION:
        raise CaptureError(
            f"{name}, line 1: version = {head.get('version')!r}, this program reads {VERSION}; update it"
        )
    for key in ("board", "recorded_by", "clock"):
        if not isinstance(head.get(key), str):
            raise CaptureError(f"{name}, line 1: {key} = {head.get(key)!r}, must be text")
    start_ns = head.get("start_ns")
    if start_ns is not None and (type(start_ns) is not int or not 0 <= start_ns <= _LATEST_NS):
        raise CaptureError(f"{name}, line 1: start_ns = {start_ns!r}, must be in 0..{_LATEST_NS} ns, or left out")
    report = _report(head["report"], f"{name}, line 1") if "report" in head else None
    return Capture(head["board"], head["recorded_by"], head["clock"], (), name, start_ns, report)


def _report(table: object, place: str) -> BoardReport:
    from inteco_abs.boards.board_report import parse_report  # noqa: PLC0415 - loads pydantic, for the few that have one

    return parse_report(table, place)


def _record(line: dict[str, Any], place: str) -> Record:
    kind, t_s, endpoint = line.get("dir"), line.get("t"), line.get("ep")
    if kind not in list(RecordKind):
        raise CaptureError(f"{place}: dir = {kind!r}, must be one of {', '.join(RecordKind)}")
    if not isinstance(t_s, int | float) or isinstance(t_s, bool) or not math.isfinite(t_s):
        raise CaptureError(f"{place}: t = {t_s!r}, must be a number of seconds")
    if endpoint is not None and (type(endpoint) is not int or not 0 <= endpoint <= _LARGEST_ENDPOINT):
        raise CaptureError(f"{place}: ep = {endpoint!r}, must be an endpoint's address in 0..255, or null")
    text, of = line.get("text", ""), line.get("of", "")
    if not isinstance(text, str):
        raise CaptureError(f"{place}: text = {text!r}, must be text")
    if kind == RecordKind.ERROR and of not in {"out", "in", "exchange"}:
        raise CaptureError(f"{place}: of = {of!r}, must be out, in or exchange")
    needed = kind in {RecordKind.OUT, RecordKind.IN}
    data = _bytes(line.get("hex", None if needed else ""), "hex", place)
    return Record(float(t_s), RecordKind(kind), endpoint, data, text, of, _bytes(line.get("setup", ""), "setup", place))


def _bytes(digits: Any, key: str, place: str) -> bytes:
    try:
        return bytes.fromhex(digits)
    except (TypeError, ValueError):
        raise CaptureError(f"{place}: {key} = {str(digits)[:40]!r}, must be pairs of hex digits") from None
