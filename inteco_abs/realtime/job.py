"""The job that the processes of a real-time run share."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Self

from inteco_abs.config import RigConfig, parse_config, trusted_config
from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.realtime.memory import Mailbox, RunMemory

_FILES: Final = ("controller_source", "profile")
_MOST_SOURCE_BYTES: Final = 1_500_000
"""What fits into the note in shared memory, as base64."""


@dataclass(frozen=True, slots=True)
class Job:
    """One run, as the supervisor describes it to the other processes."""

    out: str
    """Session file to write, absolute."""
    session: str
    """Session file as the user named it."""
    board: str
    """Address as the user gave it."""
    address: str
    """Address at which the processes open that board."""
    seed: int
    session_id: str
    config: RigConfig
    controller_source: bytes
    """Source of a controller that the configuration names as file.py:Class; else empty."""
    facts: Mapping[str, Mapping[str, str]]
    """Metadata: software and host."""
    wire: str = ""
    """Capture file for all messages between loop and board, absolute; empty for none."""
    frames: bool = False
    """Whether these messages also go into the session."""
    controller_package: str = ""
    """Name and version of the package that the controller comes from; empty if from none."""
    virtual: bool = False
    """Whether the run was in virtual time, recorded in the loop's process."""
    profile: bytes = b""
    """The profile as it was written."""
    live_port: int | None = None
    """TCP port of the live view; 0 for any free port, None for no view."""
    faults: tuple[str, ...] = ()
    """Faults of the mock board, as they were typed."""

    def post(self, memory: RunMemory) -> None:
        """Check the configuration and post the job in `memory`.

        Raises ConfigError for values out of range, or for a controller with too large files.
        """
        size = len(self.controller_source)
        if size > _MOST_SOURCE_BYTES:
            problem = f"its source and the files beside it that it loads make {size / 1e6:.1f} MB compressed"
            most = f"must be at most {_MOST_SOURCE_BYTES / 1e6:g} MB in real time"
            raise ConfigError.of("controller.name", f"{self.config.controller.name}: {problem}: {most}")
        files = {name: base64.b64encode(getattr(self, name)).decode() for name in _FILES}
        config = self.config.to_toml()
        parse_config(config)
        memory.post(Mailbox.JOB, asdict(self) | files | {"config": config})

    @classmethod
    def of(cls, memory: RunMemory, config_of: Callable[[str], RigConfig] = trusted_config) -> Self:
        """Return the job of the run in `memory`; raises SessionError if there is none.

        Processes of the run trust its configuration; others pass `parse_config`, which may raise ConfigError.
        """
        note: dict[str, Any] | None = memory.note(Mailbox.JOB)
        if note is None:
            raise SessionError(f"{memory.path}: holds no job: the run ended before it began; remove the file")
        note["config"] = config_of(note["config"])
        return cls(**note | {name: base64.b64decode(note[name]) for name in _FILES})

    @property
    def path(self) -> Path:
        """Session file to write."""
        return Path(self.out)
