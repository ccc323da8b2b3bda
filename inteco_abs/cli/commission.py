"""The verb `inteco-abs probe`: commissioning a real board, step by step."""

from __future__ import annotations

import json
import select
import sys
from collections.abc import Callable
from contextlib import suppress
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import click

from inteco_abs.cli.options import SETTING, on_terminal, plain, say
from inteco_abs.errors import AbsError, ConfigError, ConfigIssue, Stopped

if TYPE_CHECKING:
    from inteco_abs.commissioning import Procedure, ProfileDraft, RigAccess


class Terminal:
    """Talks on stderr and hears stdin, a terminal or a file of answers."""

    def __init__(self) -> None:
        self._showing = False

    def tell(self, text: str) -> None:
        """One paragraph."""
        say(f"\n{text}" if self._showing else text, err=True)
        self._showing = False

    def show(self, text: str) -> None:
        """Over the line before, on a terminal only."""
        if on_terminal(sys.stderr):
            click.echo(f"\r\033[K  {plain(text)}", nl=False, err=True)  # noqa: TID251  it goes over a line
            self._showing = True

    def ask(self, question: str) -> str:
        """One line. Raises Stopped where the input has ended."""
        try:
            answer: str = click.prompt(question, default="", show_default=False, prompt_suffix=" ", err=True)
        except click.Abort as abort:
            if isinstance(abort.__context__, EOFError):
                raise Stopped("standard input has no more answers; the same command goes on from here") from None
            raise
        return answer.strip()


def _insist_on_answers() -> None:
    """Raise ConfigError if nobody will ever answer: no terminal, and nothing on standard input."""
    if sys.stdin is not None and (sys.stdin.isatty() or not _ended(sys.stdin)):
        return
    problem = "is missing: nobody can answer questions here; run it on a terminal, or do only steps 1 to 3, which read"
    raise ConfigError([ConfigIssue("--yes-read-only", problem)])


def _ended(stream: TextIO) -> bool:
    """Whether nothing will ever come. Who has yet to write into a pipe may take their time."""
    try:
        ready = select.select([stream], [], [], 0.0)[0]
    except (OSError, ValueError):  # no stream of the system's
        return False
    return bool(ready) and isinstance(stream.buffer, BufferedReader) and not stream.buffer.peek(1)


@click.command()
@click.option("--board", default="sim:", show_default=True, help="Board address; sim: is the mock board.")
@click.option(
    "--draft",
    "file",
    default="rig-profile.toml",
    show_default=True,
    type=click.Path(path_type=Path),
    help="Profile to write; what each step found is kept beside it.",
)
@click.option("--profile", help="Profile to begin a new draft from; by default the one for the board's kind.")
@click.option("--step", "only", default="", metavar="N|NAME", help="Do this step alone.")
@click.option("--redo", default="", metavar="N|NAME", help="Do this step again, then what is left.")
@click.option("--yes-read-only", "quiet", is_flag=True, help="Do steps 1 to 3, which only read, without questions.")
@click.option("--set", "settings", multiple=True, type=SETTING, metavar="KEY=VALUE", help="Put into the draft first.")
@click.option(
    "--send-report",
    "report",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="In the end, write what was seen of the board into one file without names, for others; nothing is sent.",
)
@click.option("--virtual", is_flag=True, help="With sim:, virtual time.")
@click.option("--dry-run", is_flag=True, help="Only tell the steps, and what each may do to the rig; opens no board.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object in the end.")
def probe(
    board: str,
    file: Path,
    profile: str | None,
    only: str,
    redo: str,
    quiet: bool,
    settings: tuple[str, ...],
    report: Path | None,
    virtual: bool,
    dry_run: bool,
    as_json: bool,
) -> int:
    """Commission a board: find out how the rig is wired, in steps of rising risk, and write a profile.

    Goes on where it was left. Steps 1 to 4 only read.
    """
    from inteco_abs.boards import check_address, check_kind, simulated
    from inteco_abs.commissioning import Procedure, ProfileDraft
    from inteco_abs.commissioning.procedure import find_step
    from inteco_abs.commissioning.step import StepContext
    from inteco_abs.wire.capture import check_target

    check_address(board)
    if virtual and not simulated(board):
        raise ConfigError([ConfigIssue("--virtual", f"{board} is a real board, and real boards have their own time")])
    for name in (only, redo):
        if name:
            find_step(name)
    if only and redo:
        raise ConfigError([ConfigIssue("--redo", "goes on after its step, --step does not: name one of them")])
    if dry_run:
        _tell_steps(as_json=as_json)
        return 0
    if not quiet:
        _insist_on_answers()
    if report is not None:
        check_target(report)
    base = profile or _real_profile(board)
    forgiving = [] if file.exists() else _forgiving(board)
    draft = ProfileDraft.open(file, board, base, [*forgiving, *settings], given=profile is not None)
    check_kind(board, draft.config)
    walk = Procedure(StepContext(_bench(board, draft, virtual=virtual), draft, Terminal(), quiet))
    _print_state(walk, file)
    try:
        _go(walk, only, redo, lambda: None if report is None else _write_report(draft, report))
    finally:
        say(err=True)
        _print_state(walk, file)
        if as_json:
            say(json.dumps(_report(walk, draft, board), allow_nan=False))
    return 0


def _go(walk: Procedure, only: str, redo: str, keep: Callable[[], None]) -> None:
    """Do the steps, and keep what was seen of the board also where one of them fails."""
    try:
        walk.go(only, redo)
    except AbsError:
        with suppress(ConfigError):  # of a board that could not even be read
            keep()
        raise
    keep()


def _tell_steps(*, as_json: bool) -> None:
    """Every step before any is done; no draft is begun."""
    from inteco_abs.commissioning import STEPS

    steps = [
        {"step": number, "name": step.name, "does": step.does, "risk": step.risk}
        for number, step in enumerate(STEPS, 1)
    ]
    if as_json:
        say(json.dumps({"schema_version": 1, "steps": steps}))
        return
    for step in steps:
        say(f"{step['step']} {step['name']}: {step['does']}\n    risk: {step['risk']}")


def _real_profile(board: str) -> str:
    """The mock stands for a board whose wiring nobody has signed yet."""
    from inteco_abs.boards import default_profile, family_of, simulated
    from inteco_abs.config import load_config

    return family_of(load_config().board.kind).profile if simulated(board) else default_profile(board)


def _forgiving(board: str) -> list[str]:
    """A draft made on the mock says so; with no motor to protect, and shared computers, it forgives pauses."""
    from inteco_abs.boards import default_profile, simulated
    from inteco_abs.config import read_profile

    if not simulated(board):
        return []
    guard = read_profile(default_profile(board))["guard"]
    return ["board.simulated=true"] + [
        f"guard.{key}={guard[key]}" for key in ("missed_in_a_row", "bucket_limit", "silence_s")
    ]


def _bench(board: str, draft: ProfileDraft, *, virtual: bool) -> RigAccess:
    from inteco_abs.boards import simulated
    from inteco_abs.commissioning import MockRigAccess, PacedMockRigAccess, RealRigAccess
    from inteco_abs.experiment import by_hand

    if simulated(board):
        return MockRigAccess(draft.config) if virtual else PacedMockRigAccess(draft.config, by_hand)
    return RealRigAccess(board, by_hand)


def _report(walk: Procedure, draft: ProfileDraft, board: str) -> dict[str, Any]:
    from inteco_abs.boards import unconfirmed

    config = draft.config
    return {
        "schema_version": 1,
        "draft": str(draft.file),
        "results": str(draft.results_file),
        "board": board,
        "profile": draft.profile,
        "next": walk.next or None,
        "verified_by": config.board.verified_by,
        "unconfirmed": unconfirmed(config.board),
        "steps": walk.state(),
    }


def _write_report(draft: ProfileDraft, file: Path) -> None:
    from inteco_abs.commissioning.board_report import board_seen
    from inteco_abs.wire.capture import write_capture

    write_capture(file, board_seen(draft))
    say(
        f"{file}: the report; nothing was sent. Look at it before you pass it on: inteco-abs wire show {file}", err=True
    )


def _print_state(walk: Procedure, file: Path) -> None:
    words = ", ".join(f"{one['step']} {one['name']}: {one['outcome']}" for one in walk.state())
    ahead = f"next is {walk.next}" if walk.next else "all is done"
    say(f"{file}: {words}; {ahead}", err=True)
