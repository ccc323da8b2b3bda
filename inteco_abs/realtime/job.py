"""What the processes of a real-time run are told to do."""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Self

from inteco_abs.config import RigConfig, parse_config, trusted_config
from inteco_abs.errors import SessionError
from inteco_abs.realtime.memory import Mailbox, RunMemory

_FILES: Final = ("controller_source", "profile")


@dataclass(frozen=True, slots=True)
class Job:
    """One run, as told by the supervisor to everybody else."""

    out: str
    """Session file to write, absolute."""
    session: str
    """The same as the user named it."""
    board: str
    """Address as the user gave it."""
    address: str
    """Where the processes find that board."""
    seed: int
    session_id: str
    config: RigConfig
    controller_source: bytes
    """Of a controller that does not ship: what a process runs if the configuration names it as file.py:Class."""
    facts: Mapping[str, Mapping[str, str]]
    """Metadata: software and host."""
    wire: str = ""
    """Capture to write, absolute: everything that passes between the loop and the board."""
    frames: bool = False
    """Whether all that goes into the session, too."""
    controller_package: str = ""
    """Name and version of the package that the controller comes from; empty if from none."""
    virtual: bool = False
    """Whether the run has taken no time: its recorder was in the loop's process."""
    profile: bytes = b""
    """The profile as it was written."""
    live_port: int | None = None
    """Where to serve the run to viewers; 0 for any port that is free, None for not at all."""
    faults: tuple[str, ...] = ()
    """What the mock board is to do wrong, as it was typed."""

    def post(self, memory: RunMemory) -> None:
        """Leave it for the others, which trust its configuration. Raises ConfigError for values out of range."""
        files = {name: base64.b64encode(getattr(self, name)).decode() for name in _FILES}
        config = self.config.to_toml()
        parse_config(config)
        memory.post(Mailbox.JOB, asdict(self) | files | {"config": config})

    @classmethod
    def of(cls, memory: RunMemory, config_of: Callable[[str], RigConfig] = trusted_config) -> Self:
        """The job of a run. Who was not started by it hands in `parse_config`, which may raise ConfigError."""
        told: dict[str, Any] | None = memory.note(Mailbox.JOB)
        if told is None:
            raise SessionError(f"{memory.path}: holds no job: the run died before it began; remove it")
        told["config"] = config_of(told["config"])
        return cls(**told | {name: base64.b64decode(told[name]) for name in _FILES})

    @property
    def path(self) -> Path:
        """Session file to write."""
        return Path(self.out)
