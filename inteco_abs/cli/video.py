"""The verb `inteco-abs video`."""

from __future__ import annotations

from pathlib import Path

import click

from inteco_abs.cli.options import FILE, LOSSES, SESSION, Finite, Whole
from inteco_abs.cli.session_files import read_whole
from inteco_abs.cli.terminal import items_progress, say
from inteco_abs.views.video import FASTEST, LEAST_PX, MOST_FPS, MOST_PX, SLOWEST, VideoOptions


@click.command()
@click.argument("file", type=SESSION)
@click.option("--out", "-o", type=FILE, required=True, help="Video to write: .mp4 or .gif.")
@click.option("--speed", type=Finite(SLOWEST, FASTEST), default=0.25, show_default=True, help="Speed, times real time.")
@click.option("--fps", type=Finite(1.0, MOST_FPS), help="Frames per second; default: 30, in a .gif 20.")
@click.option(
    "--range",
    "range_s",
    type=(float, float),
    metavar="FROM TO",
    help="Seconds since braking began; default: from 0.2 s before until the brake is released.",
)
@click.option(
    "--height", type=Whole(LEAST_PX, MOST_PX), metavar="PIXELS", help="Even; default: 720, in a .gif 400. Width: 16/9."
)
def video(
    file: Path, out: Path, speed: float, fps: float | None, range_s: tuple[float, float] | None, height: int | None
) -> int:
    """Animate a stop: both wheels, speeds, slip, torque.

    It needs no display. A .mp4 (H.264) needs the extra `video`, a .gif only `figures`.

    Exit codes: 0 done, 3 the session was cut or is not fully supported, 1 it cannot be shown, 2 wrong usage.
    """
    from inteco_abs.sessions import open_session
    from inteco_abs.views.video import check_video, write_video

    options = VideoOptions(speed=speed, fps=fps, range_s=range_s, height_px=height)
    check_video(out)
    session = read_whole(file, open_session)
    with items_progress("frames", "drawing", "drawing") as progress:
        frames = write_video(session, out, options, progress)
    say(f"video: {out}, {frames} frames", err=True)
    return LOSSES if session.incomplete or session.unsupported else 0
