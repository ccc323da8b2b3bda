"""The verb `inteco-abs wire`: import, show, changes, diff, replay."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from inteco_abs.cli.options import DIFFERS, FILE, RunOptions, VerbGroup, Whole, json_option, run_options
from inteco_abs.cli.terminal import print_json, say
from inteco_abs.cli.terminal import show as print_rich
from inteco_abs.errors import ConfigError
from inteco_abs.quantities import shown

if TYPE_CHECKING:
    from inteco_abs.boards.board_report import BoardReport
    from inteco_abs.wire import Capture

_SCHEMA: Final = 1
_MOST_SHOWN: Final = 20


@click.group(cls=VerbGroup, aliases={"moved": "changes"})
def wire() -> None:
    """Import, show, compare and replay captures of a board.

    A capture holds the messages between a host and the board; a session recorded with --frames is a capture too.
    """


@wire.command("import")
@click.argument("file", type=FILE)
@click.option("--out", "-o", type=FILE, required=True, help="Capture to write, as JSON lines.")
@click.option(
    "--device", default="", metavar="BUS.ADDR", help="Bus and address of the board, if several devices qualify."
)
@click.option("--protocol", metavar="NAME", help="Protocol of the board, as in usb1-111; default: usb2.")
def import_(file: Path, out: Path, device: str, protocol: str | None) -> int:
    """Import the board's messages from a session or a pcap.

    Wireshark captures are pcap or pcapng, of usbmon or USBPcap.
    """
    from inteco_abs.wire import RecordKind, check_target, import_pcap, write_capture

    check_target(out)
    capture = _of_session(file) or import_pcap(file, protocol, device=device)
    write_capture(out, capture)
    for record in capture.records:
        if record.kind is RecordKind.WARNING:
            say(f"inteco-abs: at {record.t_s:.6f} s: {record.text}", err=True)
    say(f"{out}: {capture.messages} messages, {capture.recorded_by}", err=True)
    return 0


@wire.command()
@click.argument("file", type=FILE)
@json_option
def show(file: Path, as_json: bool) -> int:
    """Show the messages, rates, failures and board of a capture."""
    from inteco_abs.wire import summarize

    capture = _read(file)
    if capture.report is not None:
        return _show_report(file, capture, capture.report, as_json=as_json)
    summary = summarize(capture)
    if as_json:
        traffic = {role: one._asdict() for role, one in summary.traffic.items()}
        _print_json({"capture": str(file), **summary._asdict(), "traffic": traffic})
        return 0
    version = summary.logic_version
    logic = "no READ answer" if version is None else f"logic 0x{version:04X} {summary.application_name!r}"
    board = f"{summary.board}, {logic}"
    facts = [("board", board), ("recorded by", summary.recorded_by), ("clock", summary.clock)]
    facts += [("duration", f"{summary.duration_s:.6f} s"), ("control transfers", str(summary.control_transfers))]
    facts += [("failure", f"{text} ({count} times)") for text, count in summary.errors.items()]
    facts += [("warning", text) for text in (*summary.warnings, summary.caution) if text]
    _print_table(("", ""), facts)
    say()
    rows = [
        (role, str(each.messages), *(shown(number, ".6g") for number in each[1:]))
        for role, each in summary.traffic.items()
    ]
    _print_table(("messages", "count", "per second", "median interval s", "longest s"), rows)
    return 0


def _show_report(file: Path, capture: Capture, report: BoardReport, *, as_json: bool) -> int:
    """Print everything in the report, so that you can see what you pass on."""
    images = [record.data.hex() for record in capture.records if record.kind == "in"]
    if as_json:
        facts = report.model_dump(mode="json", exclude_defaults=True)
        _print_json({"capture": str(file), "board": capture.board, "report": facts, "images": images})
        return 0
    parts = {"board": capture.board, "recorded by": capture.recorded_by}
    for name, part in report.model_dump(mode="json", exclude_defaults=True).items():
        parts |= {f"{name}.{key}": value for key, value in part.items()} if isinstance(part, dict) else {name: part}
    parts |= {f"image {number}": image for number, image in enumerate(images, 1)}
    _print_table(("", ""), [(name, str(value)) for name, value in parts.items()])
    return 0


@wire.command()
@click.argument("file", type=FILE)
@json_option
def changes(file: Path, as_json: bool) -> int:
    """List the words that changed during a capture.

    The most significant one is first, to find what a slider does.
    """
    from inteco_abs.wire import caution, changed_words

    capture = _read(file)
    words, doubt = changed_words(capture), caution(capture)
    if as_json:
        _print_json({"capture": str(file), "caution": doubt, "moved": [word._asdict() for word in words]})
        return 0
    if doubt:
        say(f"inteco-abs: {doubt}", err=True)
    if not words:
        say(f"{file}: no word of any frame changed")
        return 0
    rows = [
        (
            word.direction,
            word.word,
            f"0x{word.bits:04X}",
            f"{word.minimum}..{word.maximum}",
            str(word.distinct),
            "always changing" if word.restless else f"{word.changes} times, {word.alone:.0%} alone",
            word.course,
            f"{word.first_s:.3f}..{word.last_s:.3f}",
            ", ".join(word.fields),
        )
        for word in words
    ]
    _print_table(("frame", "word", "bits", "range", "values", "changed", "course", "from..to s", "fields"), rows)
    return 0


@wire.command()
@click.argument("first", type=FILE)
@click.argument("second", type=FILE)
@click.option(
    "--numbering-pwm",
    type=Whole(0),
    metavar="CHANNEL",
    help="Ignore the prescaler of this PWM channel, which numbers our frames.",
)
@click.option("--ignore", multiple=True, metavar="FIELD", help="Ignore another field.")
@json_option
def diff(first: Path, second: Path, numbering_pwm: int | None, ignore: tuple[str, ...], as_json: bool) -> int:
    """Compare the SEND frames of two captures.

    It compares the n-th with the n-th. Ends with 4 if they differ.
    """
    from inteco_abs.wire import compare_sends

    ignored = [*ignore, *([] if numbering_pwm is None else [f"pwm{numbering_pwm}_prescaler"])]
    one, other = _read(first), _read(second)
    if one.board != other.board:
        raise ConfigError.of("SECOND", f"{second} is of a {other.board} board, {first} of a {one.board}")
    outcome = compare_sends(one, other, ignored)
    if as_json:
        words = [word._asdict() for word in outcome.words]
        _print_json({"first": str(first), "second": str(second), **outcome._asdict(), "words": words})
        return 0 if outcome.same else DIFFERS
    say(
        f"{outcome.first_frames} and {outcome.second_frames} SEND frames, "
        f"{outcome.differing_frames or 'none'} of the pairs differ"
    )
    rows = [
        (
            word.word,
            f"0x{word.bits:04X}",
            f"{word.frames} frames",
            f"frame {word.first_frame}: 0x{word.first_value:04X} and 0x{word.second_value:04X}",
            ", ".join(word.fields),
        )
        for word in outcome.words
    ]
    if rows:
        _print_table(("word", "bits", "differs in", "first", "fields"), rows)
    return 0 if outcome.same else DIFFERS


@wire.command()
@click.argument("file", type=FILE)
@run_options("config", settings="Override a key of the configuration, as in profile=usb1_0111.")
@json_option
def replay(file: Path, options: RunOptions, as_json: bool) -> int:
    """Replay a capture with the driver and compare every message.

    Ends with 4 if they differ.
    """
    from inteco_abs.boards import kind_check
    from inteco_abs.config import load_config
    from inteco_abs.wire import profile_for, replay_wire

    capture = _read(file)
    outcome = replay_wire(
        capture, load_config(options.config, options.settings, [kind_check], profile=profile_for(capture))
    )
    if as_json:
        differences = [one._asdict() for one in outcome.differences]
        _print_json({"capture": str(file), **outcome._asdict(), "differences": differences})
    else:
        say(
            f"{file}: {outcome.exchanges} exchanges, {outcome.failed} of them failed, "
            f"{outcome.differing or 'no'} words differ"
        )
        for difference in outcome.differences[:_MOST_SHOWN]:
            say(f"  {difference}")
        if outcome.differing > _MOST_SHOWN:
            say(f"  and {outcome.differing - _MOST_SHOWN} more; --json has {len(outcome.differences)}")
        if outcome.ended:
            say(f"  the capture could not be replayed to its end: {outcome.ended}")
    return DIFFERS if outcome.differing or outcome.ended else 0


def _read(file: Path) -> Capture:
    from inteco_abs.wire import read_capture

    return _of_session(file) or read_capture(file)


def _of_session(file: Path) -> Capture | None:
    """The raw frames of a session; None if the file is not a session."""
    from inteco_abs.sessions import is_session_file, read_frames

    return read_frames(file) if is_session_file(file) else None


def _print_json(data: dict[str, Any]) -> None:
    print_json({"schema_version": _SCHEMA, **data})


def _print_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for _ in head:
        table.add_column(overflow="fold")
    if any(head):
        table.add_row(*(Text(name, style="dim") for name in head))
    for row in rows:
        table.add_row(*map(Text, row))
    print_rich(table)
