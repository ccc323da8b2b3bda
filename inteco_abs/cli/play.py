"""The verb `inteco-abs play`."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from inteco_abs.cli.options import LOSSES, SESSION, Finite, shared_option
from inteco_abs.cli.screens import dashboard_of, dashboard_wanted
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import say
from inteco_abs.errors import ConfigError, SessionError
from inteco_abs.views.playback import FASTEST, SLOWEST, Playback

if TYPE_CHECKING:
    from inteco_abs.sessions import Session


@click.command()
@click.argument("file", type=SESSION)
@click.option(
    "--speed",
    type=Finite(SLOWEST, FASTEST),
    default=1.0,
    show_default=True,
    help="Speed, times real time; the fastest ones are as fast as it goes.",
)
@click.option("--from", "from_s", type=Finite(0.0, unit="s"), default=0.0, metavar="SECONDS", help="Begin here.")
@shared_option(
    "live_port", "Serve the session to Lichtblick or Foxglove on this computer; default port: 8765, 0: any free port."
)
@shared_option("live", "Display on the terminal; default: as much as it has room for.")
def play(file: Path, speed: float, from_s: float, live_port: int | None, live: str | None) -> int:
    """Play a session on the terminal and in viewers.

    Keys: space pauses and goes on, the arrows left and right seek by 1 s, comma and dot step by 10 ms, [ and ] halve
    and double the speed, 0 begins again, q ends. Without keys it ends with the session.

    Exit codes: 0 done, 3 the session was cut or is not fully supported, 1 it cannot be used, 2 wrong usage.
    """
    from inteco_abs.realtime.foxglove_server import FoxgloveServer, address, require_foxglove
    from inteco_abs.sessions import open_session, session_config
    from inteco_abs.views.player import Player, session_channels

    shown = dashboard_wanted(live)
    if not shown and live_port is None:
        raise ConfigError.of("--live", "there is no terminal to play on; add --foxglove, or use a terminal")
    if live_port is not None:
        require_foxglove(live_port)
    session = read_whole(file, open_session)
    _require_place(session, from_s)
    config = session_config(session, ())
    player = Player(session, config, Playback(session.duration_s, from_s=from_s, speed=speed))
    with ExitStack() as stack:
        server = None
        if live_port is not None:
            session_id = session.metadata.get("session", {}).get("session_id", "")
            server = FoxgloveServer(live_port, session_id, session_channels(session), playback=player.controls)
            stack.callback(server.close)
            say(f"inteco-abs: open the connection {address(server.port)} in Lichtblick or Foxglove", err=True)
        virtual = session.metadata.get("rig", {}).get("virtual_time") == "true"
        screen = dashboard_of(config, live, virtual=virtual, playback=True) if shown else None
        player.play(stack.enter_context(screen) if screen else None, server)
    return LOSSES if session.incomplete or session.unsupported else 0


def _require_place(session: Session, from_s: float) -> None:
    if not session.tick_count:
        raise SessionError(f"{session.path}: has no ticks")
    if session.duration_s < 0.0:
        problem = f"its last tick is {-session.duration_s:g} s before its first; inteco-abs validate shows where"
        raise SessionError(f"{session.path}: cannot be played: {problem}")
    if from_s > session.duration_s:
        raise ConfigError.of("--from", f"{from_s:g} s: the session has {session.duration_s:g} s; begin within them")
