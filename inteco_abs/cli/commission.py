"""The verb `inteco-abs commission`: a real board step by step."""

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

from inteco_abs.cli.options import RunOptions, run_options
from inteco_abs.cli.terminal import Terminal, say
from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.posix import require_linux

if TYPE_CHECKING:
    from inteco_abs.commissioning import Procedure, ProfileDraft, RigAccess


def _require_answers() -> None:
    """Raise ConfigError if no answers can come: no terminal, and nothing on standard input."""
    if sys.stdin is not None and (sys.stdin.isatty() or not _ended(sys.stdin)):
        return
    problem = (
        "missing: standard input cannot answer questions; run it on a terminal, or do only steps 1 to 3, which read"
    )
    raise ConfigError.of("--yes-read-only", problem)


def _ended(stream: TextIO) -> bool:
    """Whether the input has ended. A pipe that is still open may be written to later."""
    try:
        ready = select.select([stream], [], [], 0.0)[0]
    except (OSError, ValueError):  # no stream of the system's
        return False
    return bool(ready) and isinstance(stream.buffer, BufferedReader) and not stream.buffer.peek(1)


@click.command()
@run_options("board", "virtual", settings="Override a key of the draft first.")
@click.option(
    "--draft",
    "file",
    default="rig-profile.toml",
    show_default=True,
    type=click.Path(path_type=Path),
    help="Profile to write; the results of the steps are kept beside it.",
)
@click.option("--profile", help="Profile to begin a new draft from; default: the one for the board's kind.")
@click.option("--step", "only", default="", metavar="N|NAME", help="Do only this step.")
@click.option("--redo", default="", metavar="N|NAME", help="Repeat this step, then do the remaining ones.")
@click.option("--yes-read-only", "quiet", is_flag=True, help="Do only steps 1 to 3, which read, without questions.")
@click.option(
    "--send-report",
    "report",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="At the end, write what was read from the board to one anonymous file for others; nothing is sent.",
)
@click.option("--dry-run", is_flag=True, help="Only list the steps and the risk of each; opens no board.")
@click.option("--json", "as_json", is_flag=True, help="Also print one JSON object at the end.")
def commission(
    options: RunOptions,
    file: Path,
    profile: str | None,
    only: str,
    redo: str,
    quiet: bool,
    report: Path | None,
    dry_run: bool,
    as_json: bool,
) -> int:
    """Commission a board step by step and write its profile.

    The steps find out how the rig is wired, in order of rising risk; steps 1 to 4 only read. The same command
    continues where it was left.
    """
    from inteco_abs.boards import check_address, check_kind, simulated
    from inteco_abs.commissioning import Procedure, ProfileDraft, StepContext, find_step
    from inteco_abs.wire import check_target

    board, virtual = options.board, options.virtual
    check_address(board)
    if virtual and not simulated(board):
        raise ConfigError.of("--virtual", f"{board}: a real board runs in real time; omit --virtual")
    for name in (only, redo):
        if name:
            find_step(name)
    if only and redo:
        raise ConfigError.of("--redo", "continues after its step, --step does not: name one of them")
    if dry_run:
        _print_steps(as_json=as_json)
        return 0
    if not virtual:
        require_linux("commissioning", "with a simulated board, add --virtual")
    if not quiet:
        _require_answers()
    if report is not None:
        check_target(report)
    base = profile or _real_profile(board)
    mock_settings = [] if file.exists() else _mock_settings(board)
    draft = ProfileDraft.open(file, board, base, [*mock_settings, *options.settings], given=profile is not None)
    check_kind(board, draft.config)
    procedure = Procedure(StepContext(_rig_access(board, draft, virtual=virtual), draft, Terminal(), quiet))
    _print_state(procedure, file)
    try:
        _go(procedure, only, redo, lambda: None if report is None else _write_report(draft, report))
    finally:
        say(err=True)
        _print_state(procedure, file)
        if as_json:
            say(json.dumps(_report(procedure, draft, board), allow_nan=False))
    return 0


def _go(procedure: Procedure, only: str, redo: str, keep: Callable[[], None]) -> None:
    """Do the steps; write the report also if one of them fails."""
    try:
        procedure.go(only, redo)
    except AbsError:
        with suppress(ConfigError):  # of a board that could not even be read
            keep()
        raise
    keep()


def _print_steps(*, as_json: bool) -> None:
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
    """The mock stands for a board whose wiring is not signed yet."""
    from inteco_abs.boards import default_profile, family_of, simulated
    from inteco_abs.config import load_config

    return family_of(load_config().board.kind).profile if simulated(board) else default_profile(board)


def _mock_settings(board: str) -> list[str]:
    """A draft made on the mock says so, and tolerates pauses of a shared computer, as no motor needs protection."""
    from inteco_abs.boards import default_profile, simulated
    from inteco_abs.config import read_profile

    if not simulated(board):
        return []
    guard = read_profile(default_profile(board))["guard"]
    return ["board.simulated=true"] + [
        f"guard.{key}={guard[key]}" for key in ("missed_in_a_row", "bucket_limit", "silence_s")
    ]


def _rig_access(board: str, draft: ProfileDraft, *, virtual: bool) -> RigAccess:
    from inteco_abs.boards import simulated
    from inteco_abs.commissioning import MockRigAccess, PacedMockRigAccess, RealRigAccess
    from inteco_abs.experiment import manual_control

    if simulated(board):
        return MockRigAccess(draft.config) if virtual else PacedMockRigAccess(draft.config, manual_control)
    return RealRigAccess(board, manual_control)


def _report(procedure: Procedure, draft: ProfileDraft, board: str) -> dict[str, Any]:
    from inteco_abs.boards import unconfirmed

    config = draft.config
    return {
        "schema_version": 1,
        "draft": str(draft.file),
        "results": str(draft.results_file),
        "board": board,
        "profile": draft.profile,
        "next": procedure.next or None,
        "verified_by": config.board.verified_by,
        "unconfirmed": unconfirmed(config.board),
        "steps": procedure.state(),
    }


def _write_report(draft: ProfileDraft, file: Path) -> None:
    from inteco_abs.commissioning import board_seen
    from inteco_abs.wire import write_capture

    write_capture(file, board_seen(draft))
    say(f"{file}: report written, not sent. Look at it before you pass it on: inteco-abs wire show {file}", err=True)


def _print_state(procedure: Procedure, file: Path) -> None:
    states = ", ".join(f"{one['step']} {one['name']}: {one['outcome']}" for one in procedure.state())
    ahead = f"next is {procedure.next}" if procedure.next else "all is done"
    say(f"{file}: {states}; {ahead}", err=True)
