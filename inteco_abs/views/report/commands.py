"""The commands that do a session once more: its decisions, or the whole run."""

from __future__ import annotations

import shlex
from pathlib import PurePath
from typing import Final

from inteco_abs.plugins import FROM_FILE
from inteco_abs.sessions import CONFIG_NAME, Session

_SOURCE: Final = "controller.py"


def replay_commands(session: Session) -> list[str]:
    """Compare the session's decisions bit for bit; none where its configuration is lost."""
    if CONFIG_NAME not in session.attachments or not len(session.ticks):
        return []
    return [*_take_out_controller(session), _line("replay", str(session.path), *_controller(session))]


def repeat_commands(session: Session) -> list[str]:
    """Run the same again; none where configuration or board are lost."""
    rig, software = session.metadata.get("rig", {}), session.metadata.get("software", {})
    board = rig.get("board", "")
    if CONFIG_NAME not in session.attachments or not board:
        return []
    simulated = rig.get("simulated") == "true"
    virtual = ["--virtual"] if rig.get("virtual_time") == "true" else []
    seed = ["--seed", software["seed"]] if simulated and "seed" in software else []
    with_what = ["--config", "rig.toml", *_controller(session)]
    return [
        _line("extract", str(session.path), CONFIG_NAME, "-o", "rig.toml"),
        *_take_out_controller(session),
        _line("run", "--board", board, *virtual, *seed, *with_what, "--out", "again.mcap"),
    ]


def _take_out_controller(session: Session) -> list[str]:
    name = _own_file(session)
    taken = name and _SOURCE in session.attachments
    return [_line("extract", str(session.path), _SOURCE, "-o", name)] if taken else []


def _controller(session: Session) -> list[str]:
    file = _own_file(session)
    if not file:
        return []
    return ["--controller", f"{file}:{_name(session).rpartition(':')[2]}"]


def _own_file(session: Session) -> str:
    """Name of the user's file that the controller came from; empty if it came from none."""
    name = _name(session)
    return PurePath(name.rpartition(":")[0]).name if FROM_FILE in name else ""


def _name(session: Session) -> str:
    return session.metadata.get("controller", {}).get("name", "")


def _line(*words: str) -> str:
    return shlex.join(["inteco-abs", *words])
