"""Commands that replay a session or repeat its run."""

from __future__ import annotations

import shlex
from pathlib import PurePath

from inteco_abs.plugins import FROM_FILE
from inteco_abs.sessions import CONFIG_NAME, CONTROLLER_FILES, CONTROLLER_SOURCE, Session


def replay_commands(session: Session) -> list[str]:
    """Commands that replay the session; none without its configuration."""
    if CONFIG_NAME not in session.attachments or not session.tick_count:
        return []
    return [*_extract_controller(session), _line("replay", str(session.path), *_controller(session))]


def repeat_commands(session: Session) -> list[str]:
    """Commands that repeat the run; none without configuration or board."""
    rig, software = session.metadata.get("rig", {}), session.metadata.get("software", {})
    board = rig.get("board", "")
    if CONFIG_NAME not in session.attachments or not board:
        return []
    simulated = rig.get("simulated") == "true"
    virtual = ["--virtual"] if rig.get("virtual_time") == "true" else []
    seed = ["--seed", software["seed"]] if simulated and "seed" in software else []
    options = ["--config", "rig.toml", *_controller(session)]
    return [
        _line("extract", str(session.path), CONFIG_NAME, "-o", "rig.toml"),
        *_extract_controller(session),
        _line("run", "--board", board, *virtual, *seed, *options, "--out", "again.mcap"),
    ]


def _extract_controller(session: Session) -> list[str]:
    name = _own_file(session)
    if name and CONTROLLER_FILES in session.attachments:
        unzip = shlex.join(["python3", "-m", "zipfile", "-e", CONTROLLER_FILES, "."])
        return [_line("extract", str(session.path), CONTROLLER_FILES, "-o", CONTROLLER_FILES), unzip]
    kept = name and CONTROLLER_SOURCE in session.attachments
    return [_line("extract", str(session.path), CONTROLLER_SOURCE, "-o", name)] if kept else []


def _controller(session: Session) -> list[str]:
    file = _own_file(session)
    if not file:
        return []
    return ["--controller", f"{file}:{_name(session).rpartition(':')[2]}"]


def _own_file(session: Session) -> str:
    """Name of the user's file with the controller; empty for other controllers."""
    name = _name(session)
    return PurePath(name.rpartition(":")[0]).name if FROM_FILE in name else ""


def _name(session: Session) -> str:
    return session.metadata.get("controller", {}).get("name", "")


def _line(*words: str) -> str:
    return shlex.join(["inteco-abs", *words])
