"""Writes the session of a run to a `FileWriter`: header, ticks, result card and end."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from inteco_abs.boards import simulated
from inteco_abs.config import RigConfig
from inteco_abs.control import GainChange, changes_not_made, swing_band
from inteco_abs.errors import CaptureError
from inteco_abs.format import TICK, TRUTH
from inteco_abs.quantities import Quantity
from inteco_abs.rig import nominal_parameters
from inteco_abs.sessions.card import RunningCard
from inteco_abs.sessions.content import CONFIG_NAME, CONTROLLER_FILES, CONTROLLER_SOURCE, LAW_NAME
from inteco_abs.sessions.environment import Environment
from inteco_abs.sessions.file_writer import FileWriter
from inteco_abs.sessions.frames import Frames, frame_facts, packed_frames
from inteco_abs.sessions.provenance import controller_facts, shipped_law
from inteco_abs.sessions.rig_numbers import RIG_NAME, rig_numbers
from inteco_abs.signals import EXPLANATIONS, Reason
from inteco_abs.source_files import unpacked

_OUTCOMES: Final = {Reason.NONE: "completed", Reason.OPERATOR_STOP: "interrupted"}
EXIT_CODES: Final = {"fault": 5, "aborted": 5, "interrupted": 130}
"""Exit code by outcome; any other outcome is 0, or `LOSSES`."""
LOSSES: Final = 3
"""Exit code of a completed run with overruns or losses."""
_LIMITS: Final = ("brake_limit", "drive_limit", "over_speed_rad_s")
"""Limits of the guard in the metadata record `rig`."""


@dataclass(frozen=True, slots=True)
class RunHeader:
    """What is known of a run before it begins."""

    board: str
    """Address as the user gave it."""
    identity: Mapping[str, str]
    """What the board reports about itself."""
    virtual: bool
    gains: Mapping[str, float]
    internals: Sequence[Quantity]
    """The controller's values in c0..c3."""
    controller_source: bytes
    """With the files beside it, as `SourceFiles.packed` has them; empty for a shipped controller."""
    declared: Sequence[Quantity] = ()
    """Units and meanings of the gains."""
    facts: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """More metadata: software, host, real-time settings."""
    controller_package: str = ""
    """Name and version of the controller's package; empty without one."""
    profile: bytes = b""
    """Content of the profile's file."""
    environment: Environment = field(default_factory=Environment)


@dataclass(frozen=True, slots=True)
class RunEnd:
    """How a run ended, as its loop reports it."""

    reason: Reason
    written: int
    """Number of ticks that were decided."""
    detail: str = ""
    """The controller's exception or the link's last error, if it is the reason."""
    aborted: str = ""
    """Why the run was aborted; empty if it ended normally."""
    facts: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """More metadata."""
    died: Sequence[str] = ()
    """Processes that died, hung or were killed: of `loop`, `recorder`, `guardian`, `supervisor`."""
    frames: Frames | None = None
    """Raw frames between host and board; None without a recording."""

    @property
    def outcome(self) -> str:
        """`completed`, `interrupted`, `fault` or `aborted`."""
        return "aborted" if self.aborted else _OUTCOMES.get(self.reason, "fault")


@dataclass(frozen=True, slots=True)
class RunResult:
    """How a run ended, for the user."""

    outcome: str
    """`completed`, `interrupted`, `fault` or `aborted`."""
    reason: Reason
    explanation: str
    card: dict[str, Any]
    trouble: str = ""
    """Disk errors and their consequences, or why raw frames are missing; empty without problems."""
    injected: Mapping[str, str] = field(default_factory=dict)
    """How often each injected fault acted."""
    not_made: Sequence[str] = ()
    """Planned changes of gains whose time did not come."""

    @property
    def exit_code(self) -> int:
        """5 safety stop, 130 interrupted, 3 done with overruns, losses or trouble with the session, 0 done."""
        losses = self.trouble or any(self.card[name] for name in ("overruns", "link_errors", "lost_ticks"))
        return EXIT_CODES.get(self.outcome, LOSSES if losses else 0)


class SessionWriter:
    """Writes one run with a new `recorder`; `session` is the file's name for the user."""

    def __init__(self, recorder: FileWriter, config: RigConfig, header: RunHeader, session: Path | None = None) -> None:
        self._recorder = recorder
        self._session = session or recorder.path
        self._config = config
        self.header = header
        self._drawn = config.simulation.rig if simulated(header.board) else ""
        self.card = RunningCard(config)
        """The running result card, which continues from file to file."""
        self.changes: list[GainChange] = []
        """Gains changed so far."""

    def write_header(self) -> None:
        """Write everything that explains the run to the disk, before the first tick."""
        header, config, recorder = self.header, self._config, self._recorder
        parameters = nominal_parameters(config.model)
        for name, facts in header.facts.items():
            recorder.describe(name, facts)
        recorder.describe(
            "rig",
            {
                "board": header.board,
                **header.identity,
                "profile": config.profile,
                "counts_per_turn": str(config.encoders.counts_per_turn),
                "r1_m": repr(parameters.r1),
                "r2_m": repr(parameters.r2),
                "parameters": config.model.parameters,
                **{name: repr(getattr(config.guard, name)) for name in _LIMITS},
                **_sign_off(config),
                "simulated": str(simulated(header.board)).lower(),
                **self._physics(),
                "virtual_time": str(header.virtual).lower(),
            },
        )
        if description := config.description.facts():
            recorder.describe("description", description)
        source = unpacked(header.controller_source).source
        digest = hashlib.sha256(source).hexdigest() if source else ""
        recorder.describe("controller", controller_facts(config, header.gains, digest, header.controller_package))
        recorder.attach(CONFIG_NAME, "application/toml", config.to_toml().encode())
        recorder.attach(RIG_NAME, "application/json", rig_numbers(config, simulated=simulated(header.board)))
        if header.profile:
            recorder.attach("profile.toml", "application/toml", header.profile)
        if law := shipped_law(config):
            recorder.attach(LAW_NAME, "application/zip", law)
        if source:
            recorder.attach(CONTROLLER_SOURCE, "text/x-python", source)
        if source != header.controller_source:
            recorder.attach(CONTROLLER_FILES, "application/zip", header.controller_source)
        self._enclose()
        recorder.supervise(swing_band(config))
        recorder.begin({"reference_slip": config.controller.reference_slip, **header.gains})

    def add_environment(self, found: Environment) -> None:
        """Add the environment, if the header was written without it."""
        self.header = replace(self.header, environment=found)
        self._enclose()

    def add(self, ticks: bytes, truths: bytes) -> None:
        """Add tick records and states of the simulated rig, each back to back."""
        self.remember(ticks, truths)
        self.write(ticks, truths)

    def change(self, changes: Sequence[GainChange]) -> None:
        """Add changes of gains, before the ticks from which on they hold."""
        self.changes += changes
        self._recorder.change(changes)

    def remember(self, ticks: bytes, truths: bytes) -> None:
        """Add rows to the card only."""
        self.card.add(TICK.array(ticks), TRUTH.array(truths))

    def write(self, ticks: bytes, truths: bytes) -> None:
        """Write rows that the card has seen; states come before the ticks that may depend on them."""
        self._recorder.truths(truths)
        self._recorder.ticks(ticks)

    def continued(self, recorder: FileWriter, session: Path) -> SessionWriter:
        """A writer to another file with the same header and card, without rows."""
        other = SessionWriter(recorder, self._config, self.header, session)
        other.write_header()
        other.card = self.card
        other.change(self.changes)
        return other

    def finish(self, end: RunEnd) -> RunResult:
        """Complete the file with the result card and the end of the run."""
        outcome = end.outcome
        parts = [EXPLANATIONS[end.reason]] if end.reason is not Reason.NONE or not end.aborted else []
        explanation = "; ".join([*parts, end.aborted] if end.aborted else parts)
        if end.detail not in explanation:  # the link's error may be in the text already
            explanation += f": {end.detail}"
        missing = "" if end.frames is None else self._enclose_frames(end.frames)
        card = self._card(outcome, end, explanation)
        for name, facts in end.facts.items():
            self._recorder.describe(name, facts)
        last = str(self.card.last_tick) if self.card.ticks and outcome != "completed" else ""
        facts = {"last_tick": last, "died": ", ".join(end.died)}
        self._recorder.describe("session", {name: text for name, text in facts.items() if text})
        self._recorder.finish(outcome, explanation, card)
        not_made = changes_not_made(self._config.experiment.changes, self.changes)
        return RunResult(outcome, end.reason, explanation, card, missing, end.facts.get("injected", {}), not_made)

    def _enclose_frames(self, frames: Frames) -> str:
        """Write the raw frames after all ticks; return why they are missing, or an empty text."""
        try:
            with frames() as (head, records):
                count = self._recorder.frames(frame_facts(head), packed_frames(head, records))
        except CaptureError as error:
            self._recorder.describe("frames", {"missing": str(error)})
            return f"the session does not have all raw frames: {error}"
        self._recorder.describe("frames", {"messages": str(count)})
        return ""

    def _enclose(self) -> None:
        found = self.header.environment
        for file in found.files:
            self._recorder.attach(*file)
        if found.software:
            self._recorder.describe("software", found.software)

    def _physics(self) -> dict[str, str]:
        """The simulated rig in the mock board, and its roads."""
        if not simulated(self.header.board):
            return {}
        simulation = self._config.simulation
        roads = {"roads": ", ".join(simulation.roads)} if simulation.roads else {}
        return (
            {"drawn": self._drawn, **roads} if self._drawn else {"simulated_parameters": simulation.parameters, **roads}
        )

    def _card(self, outcome: str, end: RunEnd, explanation: str) -> dict[str, Any]:
        return {
            "schema_version": 1,
            "session": str(self._session),
            "outcome": outcome,
            "reason": end.reason.name,
            "explanation": explanation,
            "board": self.header.board,
            "rig": self._drawn or None,
            **self.card.card(),
            "ticks": self._recorder.written,
            "lost_ticks": end.written - self._recorder.written,
            "link_errors": self.card.link_errors,
            "payload_sha256": self._recorder.payload_sha256,
        }


def _sign_off(config: RigConfig) -> dict[str, str]:
    """Who signed the profile off, and when; empty without a sign-off."""
    board = config.board
    return {"verified_by": board.verified_by, "verified_on": str(board.verified_on)} if board.verified_by else {}
