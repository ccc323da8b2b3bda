"""Plan of a run, its checks before anything is opened, and the job for its processes."""

from __future__ import annotations

import sys
import uuid
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Final

from inteco_abs.boards import check_address, check_kind, check_limits, check_pace, simulated
from inteco_abs.config import RigConfig
from inteco_abs.control import CONTROLLERS, Controller
from inteco_abs.errors import ConfigError
from inteco_abs.mock_board import BY_PROCESS, CLOCK_STEP, Fault, drawn_facts, require_possible
from inteco_abs.posix import needs_linux, require_linux
from inteco_abs.realtime import Job
from inteco_abs.realtime.foxglove_server import require_foxglove
from inteco_abs.sessions import check_spill, host_facts, profile_source, software_facts
from inteco_abs.signals import Phase
from inteco_abs.wire import check_recordable, check_target

REAL_TIME: Final = "real time"
"""Needs Linux."""
_SPARE_S: Final = 2.0
_LONGEST_RING_S: Final = 60.0
"""The ring has the latest ticks, the file older ones: a disk may stall for this time. A run without recorder ends in
a second. Every process of the run maps the whole ring: 38 MB at 2 kHz."""
_SHORTEST_RING_S: Final = 4.0
"""Long enough for the recorder to be found dead and the run to end before the ring is full."""

RunProgress = Callable[[Phase, int], None]
"""Called with phase and number of ticks between slices of a virtual run."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A run, besides its configuration."""

    out: Path
    board: str = "sim:"
    virtual: bool = True
    seed: int = 0
    controllers: Mapping[str, type[Controller]] = field(default_factory=lambda: CONTROLLERS)
    controller_source: bytes = b""
    """Source of a user's controller, with the files beside it; the session keeps it, another process runs it."""
    wire: Path | None = None
    """Capture to write, with all messages between host and board."""
    frames: bool = False
    """Whether the session also keeps these messages."""
    controller_package: str = ""
    """Name and version of the installed package with the controller; empty without one."""
    live_port: int | None = None
    """Port that serves a real-time run to viewers on this computer; 0: any free port, None: not served."""
    faults: tuple[Fault, ...] = ()
    """Faults to inject into the mock board."""


def run_checks(config: RigConfig, plan: Plan) -> Iterator[Callable[[], object]]:
    """Checks before anything is opened, besides that of the session's path; each raises AbsError if it fails."""
    yield partial(check_address, plan.board)
    yield partial(check_kind, plan.board, config)
    yield partial(check_limits, plan.board, config)
    yield partial(check_pace, config)
    yield partial(_check_time, config, plan)
    if config.loop.compiled and not plan.virtual:
        yield partial(_check_compiled, config)
    if plan.faults:
        yield partial(_check_faults, config, plan)
    if plan.live_port is not None:
        yield partial(_check_live, plan.live_port, virtual=plan.virtual)
    yield partial(check_spill, config)
    if plan.frames:
        yield partial(check_recordable, "--frames", config)
    if plan.wire is not None:
        yield partial(check_target, plan.wire)


def _check_time(config: RigConfig, plan: Plan) -> None:
    """Raise AbsError if the run is not possible in the requested virtual or real time."""
    if not plan.virtual:
        require_linux(REAL_TIME, "use --virtual")
        _require_origin(config, plan)
    elif not simulated(plan.board):
        raise ConfigError.of("--virtual", f"{plan.board} is a real board, which runs in real time; omit --virtual")


def _check_compiled(config: RigConfig) -> None:
    """Raise AbsError unless the loop could decide in machine code: it has that of the package's own parts alone."""
    if config.controller.name not in CONTROLLERS:
        problem = f"true: {config.controller.name} runs in a process of its own, in Python; set it to false"
        raise ConfigError.of("loop.compiled", problem)
    import_module("inteco_abs.kept_loop")  # needs numba


def _check_faults(config: RigConfig, plan: Plan) -> None:
    require_mock_board(plan.board)
    if plan.virtual:
        impossible = dict.fromkeys(BY_PROCESS, "a run in virtual time has no such process; omit --virtual")
    else:
        impossible = {CLOCK_STEP: "the computer's real clock is not changed; add --virtual"}
    if not sys.platform.startswith("linux"):
        impossible["disk-full"] = needs_linux("a limit to another program's files")
    if sys.platform == "win32":
        impossible["file-gone"] = "Windows removes no file that is open"
    impossible["alarm"] = "a run does not read such flags; inteco-abs panel --inject shows them"
    require_possible(plan.faults, config.board.kind, impossible)


def require_mock_board(board: str) -> None:
    if not simulated(board):
        raise ConfigError.of("--inject", f"{board} is a real board; faults can be injected into sim: only")


def _require_origin(config: RigConfig, plan: Plan) -> None:
    if config.controller.name in CONTROLLERS:
        return
    if not (plan.controller_source or plan.controller_package):
        problem = (
            f"{config.controller.name!r}: in real time a controller must come from a file, as file.py:Class, "
            "or from an installed package"
        )
        raise ConfigError.of("controller.name", problem)


def _check_live(port: int, *, virtual: bool) -> None:
    if virtual:
        problem = "a run in virtual time ends too soon to be viewed; omit one of the two"
        raise ConfigError.of("--foxglove", f"{problem}, or open the session file in the viewer")
    require_foxglove(port)


def job_of(config: RigConfig, plan: Plan, facts: Mapping[str, Mapping[str, str]] = MappingProxyType({})) -> Job:
    return Job(
        out=str(plan.out.absolute()),
        session=str(plan.out),
        board=plan.board,
        address=plan.board,
        seed=plan.seed,
        session_id=str(uuid.uuid4()),
        config=config,
        controller_source=plan.controller_source,
        controller_package=plan.controller_package,
        facts={**facts_of(config, plan), **facts},
        wire=str(plan.wire.absolute()) if plan.wire else "",
        frames=plan.frames,
        profile=profile_source(config.profile),
        live_port=plan.live_port,
        faults=tuple(map(str, plan.faults)),
    )


def facts_of(config: RigConfig, plan: Plan) -> dict[str, dict[str, str]]:
    facts = {"software": {**software_facts(), "seed": str(plan.seed)}, "host": host_facts()}
    drawn = drawn_facts(config) if simulated(plan.board) else {}
    return {**facts, "drawn_rig": drawn} if drawn else facts


def ring_ticks(config: RigConfig) -> int:
    """Size of the ring in ticks: by `loop.ring_s`, or the longest possible run, up to a minute."""
    whole_s = min(config.experiment.longest_s + _SPARE_S, _LONGEST_RING_S)
    seconds = max(config.loop.ring_s, _SHORTEST_RING_S) if config.loop.ring_s else whole_s
    return round(seconds * config.loop.rate_hz)
