"""Runs the driver against a capture, and compares what it writes with what was written."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

from firmware_protocol import FrameTable, ProtocolError
from firmware_protocol.pwm import PWM_FULL_WIDTH, PWM_MODES
from inteco_abs.boards import board_behind, family_speaking, protocol_name, protocol_of
from inteco_abs.config import BoardConfig, RigConfig, load_config, profiles
from inteco_abs.errors import BoardError, CaptureError, ConfigError, ConfigIssue
from inteco_abs.signals import BoardFlags, Command
from inteco_abs.wire.capture import Capture, RecordKind
from inteco_abs.wire.playback import CaptureLink, FrameDifference
from inteco_abs.wire.summary import identity_seen


class WireReplay(NamedTuple):
    """Result of a replay."""

    exchanges: int
    failed: int
    differing: int
    """Number of words that differ from the capture."""
    differences: list[FrameDifference]
    ended: str
    """Why it ended before the capture did; empty if it did not."""


def profile_for(capture: Capture) -> str:
    """Return the name of a shipped profile whose board speaks the captured protocol."""
    family = family_speaking(capture.board)
    for name in (family.mock_profile, family.profile, *profiles()):
        wiring = load_config(profile=name).board
        if wiring.kind == family.name and protocol_name(wiring) == capture.board:
            return name
    return family.mock_profile


def replay_wire(capture: Capture, config: RigConfig) -> WireReplay:
    """Enter the captured board, give it the captured duties, leave it, and compare every message.

    No outputs are at stake, so whatever logic the capture shows is driven. Raises CaptureError for a capture without
    frames, ConfigError if the profile is made for another kind of board.
    """
    if protocol_name(config.board) != capture.board:
        problem = f"{protocol_name(config.board)}, the capture is of a {capture.board} board; name another profile"
        raise ConfigError([ConfigIssue("board", problem)])
    protocol = protocol_of(capture.board)
    if not protocol.replays:
        problem = f"{protocol.title}: its messages carry challenges and times, so that no driver repeats them; "
        raise ConfigError([ConfigIssue("board", problem + "inteco-abs replay repeats a session's decisions")])
    numbering = f"pwm{config.board.numbering_pwm}_prescaler" if config.board.numbering_pwm >= 0 else ""
    link = CaptureLink(capture, numbering=numbering)
    trusted = replace(config.board, **_as_signed(capture))
    if not any(_holds_timer(protocol.send, frame, trusted) for frame in _sends(capture)[:1]):
        # recorded by a program without the timer
        trusted = replace(trusted, timer=-1)
    board = board_behind(link, replace(config, board=trusted), link.now_ns)
    done = failed = 0
    ended = ""
    try:
        with board:
            for command in _commands(capture, trusted):
                if command is None:
                    board.make_safe()
                    continue
                failed += BoardFlags.STALE in board.exchange(command).board_flags
                done += 1
    except BoardError as error:
        ended = str(error.__cause__ or error)  # no motor is connected: the warning of UnsafeError does not apply
    return WireReplay(done, failed, link.differing, link.differences, ended)


def _as_signed(capture: Capture) -> dict[str, Any]:
    """Return the profile's keys with a sign-off for the captured board."""
    version, name = identity_seen(capture, protocol_of(capture.board))
    if version is None:
        raise CaptureError(f"{capture.name} holds no READ answer, so its board is not known")
    return {
        "logic_version": version,
        "application_names": [name],
        "read_only": "",
        "verified_by": "the replay: the board is a capture",
        "verified_logic": version,
    }


def _commands(capture: Capture, wiring: BoardConfig) -> Iterator[Command | None]:
    """Yield the duties of the captured SEND frames, None for SAFE, without the first and last, which the driver makes.

    With a timer, a frame that holds it at zero and the next one are SAFE.
    """
    table = protocol_of(capture.board).send
    full = PWM_FULL_WIDTH[PWM_MODES.index(wiring.pwm_mode)]
    names = f"pwm{wiring.drive_pwm}_width", f"pwm{wiring.brake_pwm}_width"
    ours = 1 if wiring.timer < 0 else 2
    held = False
    for frame in _sends(capture)[ours:-ours]:
        before, held = held, _holds_timer(table, frame, wiring)
        if held:
            yield None
        elif not before:
            try:
                values = table.decode_some(frame, names)
            except ProtocolError:
                continue
            drive, brake = (min(1.0, int(values[name]) / full) for name in names)
            yield Command(drive, brake)


def _sends(capture: Capture) -> list[bytes]:
    size = protocol_of(capture.board).send.size
    return [record.data for record in capture.records if record.kind is RecordKind.OUT and len(record.data) == size]


def _holds_timer(table: FrameTable, frame: bytes, wiring: BoardConfig) -> bool:
    """Return whether a captured frame holds the wiring's timer at zero, as the driver does."""
    if wiring.timer < 0 or "timer_reset" not in table.fields:
        return False
    try:
        return bool(int(table.decode_some(frame, ["timer_reset"])["timer_reset"]) >> wiring.timer & 1)
    except ProtocolError:
        return False
