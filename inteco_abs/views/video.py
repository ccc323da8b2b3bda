"""A stop as a video: the two wheels, and speeds, slip and torque as they become."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from inteco_abs.errors import AbsError, ConfigError, ConfigIssue, describe_disk
from inteco_abs.sessions import Array, Session, atomic_write, check_output, session_config
from inteco_abs.views.comparison import held_spans, labels, start_ns
from inteco_abs.views.figure import BEFORE_S, require_matplotlib
from inteco_abs.views.figure_options import range_issues, within

if TYPE_CHECKING:
    from inteco_abs.views.video_scene import Scene

Progress = Callable[[int, int], None]

FORMATS: Final = (".mp4", ".gif")
SLOWEST: Final = 1 / 256
FASTEST: Final = 16.0
MOST_FPS: Final = 120.0
LEAST_PX: Final = 240
MOST_PX: Final = 2160
_MOST_FRAMES: Final = 20_000
_SHUTTER: Final = 0.5
"""Share of a frame's time over which what turns is blurred, as in films."""
_ROUNDED: Final = 1e-6
"""Of a frame: what lacks at the end by rounding."""
_GIF_TICK_S: Final = 0.01
"""In which a GIF counts how long a frame is shown; players take less than two for ten."""
_GIF_COLOURS: Final = 64
_FPS: Final = {".mp4": 30.0, ".gif": 20.0}
_HEIGHT_PX: Final = {".mp4": 720, ".gif": 400}


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoOptions:
    """Options of a video. Raises ConfigError for a value that it cannot have."""

    speed: float = 0.25
    """Times real time."""
    fps: float | None = None
    """Frames per second; None: 30 in an MP4, 20 in a GIF, whose frames last whole hundredths of a second."""
    range_s: tuple[float, float] | None = None
    """Begin and end, s since braking began; None is from 0.2 s before to the end."""
    height_px: int | None = None
    """Height, even; the width is 16/9 of it. None: 720 in an MP4, 400 in a GIF."""

    def __post_init__(self) -> None:
        issues = list(self._mistakes())
        if issues:
            raise ConfigError(issues)

    def _mistakes(self) -> Iterable[ConfigIssue]:
        if not within(self.speed, SLOWEST, FASTEST):
            yield ConfigIssue("--speed", f"{self.speed!r}: must be in {SLOWEST:g}..{FASTEST:g} times real time")
        if self.fps is not None and not within(self.fps, 1.0, MOST_FPS):
            yield ConfigIssue("--fps", f"{self.fps!r}: must be in 1..{MOST_FPS:g} frames per second")
        height_px = self.height_px
        if height_px is not None and (not within(height_px, LEAST_PX, MOST_PX) or height_px % 2):
            yield ConfigIssue("--height", f"{self.height_px!r}: must be an even number in {LEAST_PX}..{MOST_PX} pixels")
        yield from range_issues(self.range_s)

    def frame_s(self, suffix: str) -> float:
        """How long a frame is shown, s."""
        fps = self.fps or _FPS[suffix]
        return 1.0 / fps if suffix == ".mp4" else max(round(1.0 / fps / _GIF_TICK_S), 2) * _GIF_TICK_S


def check_video(path: Path) -> None:
    """Check that a new video can be written to `path`.

    Raises ConfigError, SessionError if the folder cannot be written to, or AbsError without what the format needs.
    """
    if path.suffix not in FORMATS:
        raise ConfigError.of("--out", f"{path}: must end in {' or '.join(FORMATS)}")
    check_output(path, "--out")
    require_matplotlib()
    if path.suffix == ".mp4" and importlib.util.find_spec("av") is None:
        raise AbsError("MP4 needs PyAV: pip install 'inteco-abs[video]'; or write a .gif")


def write_video(
    session: Session, path: Path, options: VideoOptions | None = None, progress: Progress | None = None
) -> int:
    """Write the braking part of `session` to `path` (.mp4 or .gif), and return the number of frames.

    A session that never brakes is shown whole. `progress` is called with the frames done and all. Raises ConfigError,
    SessionError for a session without ticks or configuration, AbsError if it cannot be written.
    """
    options = options or VideoOptions()
    check_video(path)
    from inteco_abs.views.video_scene import Scene  # noqa: PLC0415  heavy, and an extra

    config = session_config(session, ())
    begin_s, end_s = _range_s(session, options)
    frame_s = options.frame_s(path.suffix)
    count = math.floor((end_s - begin_s) / (options.speed * frame_s) + _ROUNDED) + 1
    if count > _MOST_FRAMES:
        problem = f"{count} frames: must be at most {_MOST_FRAMES}; choose a part with --range, or a higher --speed"
        raise ConfigError.of("--range", problem)
    height_px = options.height_px or _HEIGHT_PX[path.suffix]
    (title,) = labels([session])
    part, words = _part(session, begin_s, end_s), (title, f"{options.speed:g}x")
    scene = Scene(part, start_ns(session), (begin_s, end_s), config, words, height_px)
    pictures = _pictures(scene, begin_s, options.speed * frame_s, count, progress)
    try:
        with atomic_write(path) as new:
            (_write_mp4 if path.suffix == ".mp4" else _write_gif)(new, pictures, frame_s)
    except OSError as error:
        raise AbsError(f"{path}: the video cannot be written: {describe_disk(error)}") from error
    return count


def _range_s(session: Session, options: VideoOptions) -> tuple[float, float]:
    """Begin and end, s since braking began, within the session."""
    spans = session.rows.phases
    if not spans:
        raise AbsError(f"{session.path}: has no ticks; there is nothing to show")
    start = start_ns(session)
    first_s, last_s = (spans[0].first_ns - start) * 1e-9, (spans[-1].last_ns - start) * 1e-9
    held = held_spans(session)
    shown = (-BEFORE_S, (held[-1].last_ns - start) * 1e-9) if held else (first_s, last_s)
    begin_s, end_s = options.range_s or shown
    if begin_s >= last_s or end_s <= first_s:
        problem = f"{begin_s:g} {end_s:g}: {session.path} lasts from {first_s:.3f} to {last_s:.3f} s"
        raise ConfigError.of("--range", problem)
    return max(begin_s, first_s), min(end_s, last_s)


def _part(session: Session, begin_s: float, end_s: float) -> Session:
    """The part of a session that is read."""
    origin_s = (start_ns(session) - session.rows.phases[0].first_ns) * 1e-9
    part: Session = session[max(origin_s + begin_s, 0.0) : origin_s + end_s + BEFORE_S]
    return part


def _pictures(scene: Scene, begin_s: float, step_s: float, count: int, progress: Progress | None) -> Iterator[Array]:
    for number in range(count):
        yield scene.picture(begin_s + number * step_s, _SHUTTER * step_s)
        if progress is not None:
            progress(number + 1, count)


def _write_mp4(part: Path, pictures: Iterator[Array], frame_s: float) -> None:
    """H.264 with the colours of every player."""
    import av  # noqa: PLC0415  an extra

    first = next(pictures)
    with av.open(str(part), "w", format="mp4", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=Fraction(1.0 / frame_s).limit_denominator(1001))
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "20"}
        for picture in chain([first], pictures):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())


def _write_gif(part: Path, pictures: Iterator[Array], frame_s: float) -> None:
    from PIL import Image  # noqa: PLC0415  comes with an extra

    few: Any = {"colors": _GIF_COLOURS, "method": Image.Quantize.FASTOCTREE, "dither": Image.Dither.NONE}
    frames = (Image.fromarray(picture).quantize(**few) for picture in pictures)
    first = next(frames)
    first.save(part, format="GIF", save_all=True, append_images=frames, duration=round(frame_s * 1000.0), loop=0)
