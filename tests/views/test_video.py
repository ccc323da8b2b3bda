import importlib.util
import math

import av
import numpy as np
import pytest
from PIL import Image

from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.signals import Phase
from inteco_abs.views.video import VideoOptions, check_video, write_video

SMALL = {"height_px": 300, "range_s": (0.0, 0.05)}


def frames_of(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        return (
            stream.codec_context.name,
            stream.average_rate,
            [f.to_ndarray(format="rgb24") for f in container.decode()],
        )


def test_an_mp4_has_the_frames_of_its_part_and_they_move(session, tmp_path):
    calls = []
    options = VideoOptions(**SMALL, speed=0.2, fps=24.0)
    count = write_video(session, tmp_path / "stop.mp4", options, lambda *call: calls.append(call))
    codec, rate, frames = frames_of(tmp_path / "stop.mp4")
    assert (codec, rate) == ("h264", 24)
    assert count == len(frames) == math.floor(0.05 / 0.2 * 24.0) + 1
    assert calls == [(number, count) for number in range(1, count + 1)]
    assert frames[0].shape == (300, 534, 3)
    left, right = (np.abs(frames[-1].astype(int) - frames[0])[:, part] for part in (slice(200), slice(213, None)))
    assert (left.max(), right.max()) > (100, 100)


def test_a_gif_plays_at_the_speed_that_is_asked_for(session, tmp_path):
    write_video(session, tmp_path / "stop.gif", VideoOptions(**SMALL, speed=0.1, fps=30.0))
    with Image.open(tmp_path / "stop.gif") as gif:
        shown_s = gif.info["duration"] * gif.n_frames / 1000.0
        assert gif.info["duration"] == 30
        assert gif.info["loop"] == 0
        assert gif.size == (534, 300)
    assert shown_s == pytest.approx(0.05 / 0.1, abs=0.031)


def test_without_truth_the_estimate_is_shown_and_without_braking_the_whole(session, tmp_path):
    real = session.with_rows(truth=session.truth[:0])
    assert write_video(real, tmp_path / "real.gif", VideoOptions(**SMALL, speed=16.0)) == 1
    ticks = session.ticks[~np.isin(session.ticks["phase"], (Phase.BRAKING, Phase.STOPPED))]
    coasts = session.with_rows(ticks)
    assert write_video(coasts, tmp_path / "coasts.gif", VideoOptions(height_px=240, speed=16.0)) >= 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"speed": 0.0}, r"--speed: 0\.0: must be in 0\.00390625\.\.16 times real time"),
        ({"speed": math.nan}, "--speed"),
        ({"fps": 500.0}, r"--fps: 500\.0: must be in 1\.\.120 frames"),
        ({"height_px": 241}, r"--height: 241: must be an even number in 240\.\.2160"),
        ({"height_px": 10}, "--height"),
        ({"height_px": "720"}, "--height: '720': must be an even number"),
        ({"speed": "x"}, "--speed: 'x': must be in"),
        ({"range_s": 3}, "--range: 3: must be two times"),
        ({"range_s": (1.0, 0.0)}, r"--range: \(1\.0, 0\.0\): must be two times that rise"),
        ({"range_s": (50.0, 60.0)}, r"--range: 50 60: .*\.mcap lasts from"),
        ({"speed": 1 / 256, "fps": 120.0}, r"--range: \d+ frames: must be at most 20000; choose a part"),
    ],
)
def test_what_is_not_possible_is_refused_and_nothing_is_written(session, tmp_path, options, words):
    with pytest.raises(ConfigError, match=words):
        write_video(session, tmp_path / "stop.mp4", VideoOptions(**options))
    assert list(tmp_path.iterdir()) == []


def test_an_mp4_without_its_encoder_says_what_to_install_and_a_gif_needs_none(monkeypatch, tmp_path):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "av" else find_spec(name))
    with pytest.raises(AbsError, match=r"pip install 'inteco-abs\[video\]'; or write a \.gif"):
        check_video(tmp_path / "stop.mp4")
    check_video(tmp_path / "stop.gif")


@pytest.mark.parametrize("name", ["stop.avi", "stop", "stop.MP4"])
def test_another_suffix_is_refused(tmp_path, name):
    with pytest.raises(ConfigError, match=r"--out: .* must end in \.mp4 or \.gif"):
        check_video(tmp_path / name)


def test_the_verb_writes_a_video_and_says_so(verb, session, tmp_path):
    done = verb("video", session.path, "-o", "a.gif", "--range", 0, 0.02, "--speed", 0.1, "--height", 240, "--fps", 10)
    assert (done.code, done.out) == (0, "")
    assert done.err == "video: a.gif, 3 frames\n"
    assert (tmp_path / "a.gif").read_bytes().startswith(b"GIF89a")
    assert verb("video", session.path, "-o", "a.gif").code == 2
