"""Golden sessions: recorded runs as regression tests, whose logged decisions a replay must reproduce.

A folder has small copies of sessions, and `golden.toml` with the tolerances and the history of each: date, reason,
hash and software of every version.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import tomli_w

from inteco_abs.analysis.arithmetic import recorded_arithmetic
from inteco_abs.analysis.open_loop import braking_start
from inteco_abs.analysis.replay import Replay, decisions, replay_session, require_known
from inteco_abs.analysis.tolerance import Array, parse_tolerances
from inteco_abs.control import Controller, build_pipeline, control_check
from inteco_abs.errors import ConfigError, ConfigIssue, SessionError, describe_disk, near_match
from inteco_abs.format import TICK, TRUTH, Role
from inteco_abs.sessions import (
    Session,
    ensured_directory,
    file_sha256,
    read_session,
    result_card,
    session_config,
    software_facts,
    write_copy,
)
from inteco_abs.signals import Phase

TABLE_NAME: Final = "golden.toml"
FEWEST_BRAKING_TICKS: Final = 100
"""Fewer test next to nothing."""
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
_KEPT: Final = ("software", "rig", "drawn_rig", "controller")
"""Metadata that a copy keeps; facts about the host are left out."""
_SOFTWARE: Final = ("version", "python", "libc", "git_commit", "git_dirty")
"""Facts about the software that the history keeps."""
_NOT_KEPT: Final = ("argv",)
"""Facts about the software that a copy leaves out, as they name folders."""
_TIMING: Final = tuple(column.name for column in TICK.columns if column.role is Role.TIMING)

ControllerTypes = Mapping[str, type[Controller]]


@dataclass(frozen=True, slots=True)
class Version:
    """One version of a golden session."""

    date: str
    reason: str
    file_sha256: str
    changed_ticks: int
    """Number of ticks that differ from the previous version; 0 for the first."""
    software: dict[str, str]


@dataclass(frozen=True, slots=True)
class Golden:
    """One session of the folder."""

    name: str
    ticks: int
    tolerances: tuple[str, ...]
    """Tolerances, written as for `replay --tol`; empty: every bit must agree."""
    history: tuple[Version, ...]

    @classmethod
    def of(cls, name: str, table: Mapping[str, Any]) -> Self:
        """Return what a table in golden.toml describes. Raises KeyError or TypeError if that is not valid."""
        history = tuple(Version(**version) for version in table["history"])
        if not history:
            raise KeyError("history")
        return cls(name, table["ticks"], tuple(table["tolerances"]), history)


@dataclass(frozen=True, slots=True)
class GoldenResult:
    """Result of the test of one golden session."""

    name: str
    problem: str
    """Why it could not be tested; empty if it was."""
    replay: Replay | None


class GoldenFolder:
    """The golden sessions in `path`. Raises SessionError if its table cannot be read or written."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._goldens = self._read()

    def __iter__(self) -> Iterator[Golden]:
        return iter(self._goldens.values())

    def chosen(self, names: Sequence[str]) -> list[Golden]:
        """Return those with these names, or all. Raises ConfigError for an unknown name, or if the folder is empty."""
        if not self._goldens:
            problem = f"{self.path} has no golden sessions; add one: inteco-abs golden add FILE --reason TEXT"
            raise ConfigError.of("--folder", problem)
        unknown = [name for name in names if name not in self._goldens]
        if unknown:
            raise ConfigError(
                [
                    ConfigIssue("NAMES", f"no {name!r} in {self.path}{near_match(name, self._goldens)}")
                    for name in unknown
                ]
            )
        return [self._goldens[name] for name in dict.fromkeys(names)] if names else list(self._goldens.values())

    def add(
        self,
        session: Session,
        name: str,
        reason: str,
        controllers: ControllerTypes,
        tolerances: Sequence[str] = (),
        until_s: float | None = None,
    ) -> Golden:
        """Keep a copy of `session` as `name`, without the simulation's truth, up to `until_s` after braking began.

        Raises ConfigError for a wrong name or a missing reason; SessionError for a session that was cut, hardly brakes,
        does not replay, or is not fully supported.
        """
        self._check_name(name)
        _require_reason(reason)
        parse_tolerances(tolerances)
        require_known(session)
        payload = _payload_until(session, until_s)
        rows = len(payload) // TICK.size
        _require_a_test(session, TICK.array(payload))
        part = self._part(name)
        with ensured_directory(self.path, "--folder"):
            try:
                _write_copy(session, payload, part)
                found = _replay(read_session(part), controllers, tolerances)
                if found.first is not None:
                    raise SessionError(
                        f"{session.path}: does not replay: {found.differing} ticks differ, first at tick "
                        f"{found.first.tick}: {found.first.field}; look at it with inteco-abs replay first"
                    )
                return self._keep(Golden(name, rows, tuple(tolerances), (_version(reason, part, 0),)), part)
            finally:
                part.unlink(missing_ok=True)

    def test(self, names: Sequence[str], controllers: ControllerTypes) -> list[GoldenResult]:
        """Replay those with these names, or all. Raises ConfigError as `chosen`."""
        return [self._test(golden, controllers) for golden in self.chosen(names)]

    def update(self, name: str, reason: str, controllers: ControllerTypes) -> Golden:
        """Replace the logged decisions by those of this version; the inputs stay.

        Raises ConfigError for an unknown name, a missing reason, or if no tick would change.
        """
        _require_reason(reason)
        (golden,) = self.chosen([name])
        session = self._read_golden(golden)
        with recorded_arithmetic(session):
            pipeline = build_pipeline(session_config(session, (control_check(controllers),)), controllers)
            again = decisions(session, pipeline)
        for column in _TIMING:
            again[column] = session.ticks[column]
        payload = b"".join(map(TICK.pack, again.tolist()))
        rows = np.frombuffer(payload, np.uint8).reshape(-1, TICK.size)
        changed = int((rows != np.frombuffer(session.payload, np.uint8).reshape(rows.shape)).any(axis=1).sum())
        if not changed:
            raise ConfigError.of(name, "replays bit for bit, so there is nothing to update")
        part = self._part(name)
        try:
            _write_copy(session, payload, part)
            version = _version(reason, part, changed)
            return self._keep(Golden(name, golden.ticks, golden.tolerances, (*golden.history, version)), part)
        finally:
            part.unlink(missing_ok=True)

    def file(self, golden: Golden) -> Path:
        """Path of its session."""
        return self.path / f"{golden.name}.mcap"

    def _test(self, golden: Golden, controllers: ControllerTypes) -> GoldenResult:
        try:
            session = self._read_golden(golden)
            return GoldenResult(golden.name, "", _replay(session, controllers, golden.tolerances))
        except (SessionError, ConfigError) as error:
            return GoldenResult(golden.name, str(error), None)

    def _read_golden(self, golden: Golden) -> Session:
        file = self.file(golden)
        session = read_session(file)
        if file_sha256(file) != golden.history[-1].file_sha256:
            raise SessionError(f"{file}: is not the file that {TABLE_NAME} knows; get both from where they agree")
        return session

    def _check_name(self, name: str) -> None:
        problem = ""
        if not _NAME.fullmatch(name):
            problem = f"{name!r}: must be up to 64 letters, digits, - and _, and begin with a letter or digit"
        elif name in self._goldens or (self.path / f"{name}.mcap").exists():
            problem = f"{name!r} exists already, and is never overwritten; choose another, or golden update {name}"
        elif self.path.exists() and not self.path.is_dir():
            problem = f"{self.path} is not a folder"
        if problem:
            raise ConfigError.of("--name", problem)

    def _part(self, name: str) -> Path:
        return self.path / f".{name}.{os.getpid()}.part"

    def _keep(self, golden: Golden, part: Path) -> Golden:
        """Write the file before the table: a table without its file would be worse than the reverse."""
        goldens = {**self._goldens, golden.name: golden}
        tables = {name: _table(each) for name, each in sorted(goldens.items())}
        text = tomli_w.dumps({"schema_version": 1, "golden": tables}, multiline_strings=False)
        table = self.path / TABLE_NAME
        draft = table.with_suffix(f".{os.getpid()}.part")
        try:
            draft.write_text(text, encoding="utf-8", newline="\n")
            part.replace(self.file(golden))
            draft.replace(table)
        except OSError as error:
            with suppress(OSError):
                draft.unlink(missing_ok=True)
            raise SessionError(f"{self.path}: cannot be written: {describe_disk(error)}") from error
        self._goldens = goldens
        return golden

    def _read(self) -> dict[str, Golden]:
        table = self.path / TABLE_NAME
        try:
            data = tomllib.loads(table.read_text(encoding="utf-8"))
            return {name: Golden.of(name, each) for name, each in data["golden"].items()}
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise SessionError(f"{table}: cannot be read: {error.strerror}") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise SessionError(f"{table}: is not a table of golden sessions: {error}") from error


def _table(golden: Golden) -> dict[str, Any]:
    table = asdict(golden)
    del table["name"]
    return {key: list(value) if isinstance(value, tuple) else value for key, value in table.items()}


def _require_reason(reason: str) -> None:
    if not reason.strip():
        raise ConfigError.of("--reason", "is empty; say why, for the history")


def _payload_until(session: Session, until_s: float | None) -> bytes:
    if until_s is None:
        return bytes(session.payload)
    end_ns = np.uint64(braking_start(session)[1] + round((until_s + 1e-9) * 1e9))
    parts = list[bytes]()
    for ticks, _ in session.blocks():
        kept = int(ticks["time_ns"].searchsorted(end_ns))
        parts.append(ticks[:kept].tobytes())
        if kept < len(ticks):
            break
    return b"".join(parts)


def _require_a_test(session: Session, ticks: Array) -> None:
    problem = ""
    braking = ticks[ticks["phase"] == Phase.BRAKING]
    if session.incomplete:
        problem = session.incomplete
    elif len(braking) < FEWEST_BRAKING_TICKS:
        problem = f"{len(braking)} ticks of braking: must be at least {FEWEST_BRAKING_TICKS}"
    elif len(set(braking["brake"].tolist())) < 3:
        problem = "the brake hardly ever changes"
    if problem:
        raise SessionError(f"{session.path}: would prove nothing: {problem}")


def _replay(session: Session, controllers: ControllerTypes, tolerances: Sequence[str]) -> Replay:
    config = session_config(session, (control_check(controllers),))
    with recorded_arithmetic(session):
        return replay_session(session, build_pipeline(config, controllers), parse_tolerances(tolerances))


def _version(reason: str, file: Path, changed: int) -> Version:
    software = {key: value for key, value in software_facts().items() if key in _SOFTWARE}
    return Version(
        datetime.now(UTC).isoformat(timespec="seconds"), reason.strip(), file_sha256(file), changed, software
    )


def _write_copy(session: Session, payload: bytes, path: Path) -> None:
    """Write the session with other ticks, without truth and facts about the host."""
    ticks, truths = TICK.array(payload), TRUTH.array(b"")
    metadata: dict[str, Mapping[str, str]] = {
        name: {key: value for key, value in session.metadata[name].items() if key not in _NOT_KEPT}
        for name in _KEPT
        if name in session.metadata
    }
    card = {**result_card(session_config(session, ()), ticks, truths), "lost_ticks": 0}
    write_copy(session, path, [(ticks, truths)], metadata=metadata, attachments=session.attachments, card=card)
