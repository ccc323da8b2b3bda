"""One wheel between brakings, and the errors of its encoder's disc once and twice per turn."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from inteco_abs import elementary
from inteco_abs.control.estimators.angles import CountState

Row = list[float]

ANY_SPEED_SD: Final = 200.0
_ACCELERATION_SD: Final = 50.0
"""Standard deviations before the first count, in rad/s and rad/s2: any speed and acceleration of the rig."""
_WAVE_SD_COUNTS: Final = 0.6
"""Standard deviation before the first count: a disc is about half a count off centre."""
_JERK_DENSITY: Final = 1e3
"""White jerk in rad2/s5 of a wheel that is driven or coasts."""
_UNLEARNT: Final = 400.0
"""Samples for which the error twice per turn counts as zero: its amplitude is a fraction of a count."""
_LEARNING_RAD_S: Final = 60.0
"""Speed above which a turn is short enough to separate the disc from the motion."""


@dataclass(frozen=True, slots=True)
class DiscConstants:
    """Noise of a disc's count."""

    noise: float
    """Variance, rad2."""
    wave: float
    """Variance of each component of the disc's error before the first count, rad2."""
    jitter: float
    """Variance of the time between stamp and counts, s2."""
    learns_second: bool
    """Whether the error twice per turn is learnt."""


def disc_constants(
    count_rad: float, noise_rad: float, jitter: float = 0.0, *, learns_second: bool = False
) -> DiscConstants:
    """Return the constants for counts of `count_rad`, with noise of standard deviation `noise_rad` and a `jitter`."""
    noise, wave = elementary.raised(noise_rad, 2), elementary.raised(_WAVE_SD_COUNTS * count_rad, 2)
    return DiscConstants(noise, wave, jitter, learns_second)


@dataclass(slots=True)
class DiscState(CountState):
    """Kalman filter of angle, speed and acceleration, and of the error that a disc off centre adds to the angle.

    z = th + c*cos(z) + s*sin(z) + noise, th''' white; the noise is that of a count. Once c and s are learnt, the error
    is known in any later braking as well.
    """

    angle: float = 0.0
    """Angle without the disc's error, rad."""
    speed: float = 0.0
    """Speed, rad/s."""
    acceleration: float = 0.0
    cosine: float = 0.0
    sine: float = 0.0
    P: list[list[float]] = field(default_factory=lambda: [[0.0] * 5 for _ in range(5)])
    """Covariances of these five."""
    cosine_2: float = 0.0
    """Components of the error twice per turn, rad."""
    sine_2: float = 0.0
    learnt: float = 0.0
    """Samples that these are learnt from."""


def rolling_wheel(k: DiscConstants) -> DiscState:
    """Return the state before the first count."""
    s = DiscState()
    s.P[3][3] = s.P[4][4] = k.wave
    restart(k, s, 0.0, 0.0, ANY_SPEED_SD)
    return s


def restart(k: DiscConstants, s: DiscState, angle: float, speed: float, deviation: float) -> None:
    """Restart at `angle` in rad and `speed` with its `deviation` in rad/s; what was learnt of the disc is kept."""
    s.angle, s.speed, s.acceleration = straight(s, angle), speed, 0.0
    P = s.P
    for i in range(3):
        for j in range(5):
            P[i][j] = P[j][i] = 0.0
    P[0][0], P[1][1], P[2][2] = k.noise, elementary.raised(deviation, 2), elementary.raised(_ACCELERATION_SD, 2)


def straight(s: DiscState, angle: float) -> float:
    """The wheel's angle, from the disc's `angle`, in rad."""
    sine, cosine = elementary.sin_cos(angle)
    first = angle - s.cosine * cosine - s.sine * sine
    return first - s.cosine_2 * (cosine * cosine - sine * sine) - s.sine_2 * (2.0 * sine * cosine)


def follow(k: DiscConstants, s: DiscState, angle: float, dt_s: float) -> None:
    """Advance by `dt_s`, and correct by the disc's `angle` in rad."""
    P = s.P
    p0, p1, p2, p3, p4 = P[0], P[1], P[2], P[3], P[4]
    if dt_s > 0.0:
        _predict(s, p0, p1, p2, p3, p4, dt_s)
    cosine = sine = 0.0
    if s.speed > _LEARNING_RAD_S:
        sine, cosine = elementary.sin_cos(angle)
        if k.learns_second:
            angle = _without_second(s, angle, sine, cosine)
    e0 = p0[0] + cosine * p0[3] + sine * p0[4]
    e1 = p1[0] + cosine * p1[3] + sine * p1[4]
    e2 = p2[0] + cosine * p2[3] + sine * p2[4]
    e3 = p3[0] + cosine * p3[3] + sine * p3[4]
    e4 = p4[0] + cosine * p4[3] + sine * p4[4]
    variance = e0 + cosine * e3 + sine * e4 + (k.noise + k.jitter * s.speed * s.speed)
    error = (angle - s.angle - cosine * s.cosine - sine * s.sine) / variance
    s.angle += e0 * error
    s.speed += e1 * error
    s.acceleration += e2 * error
    s.cosine += e3 * error
    s.sine += e4 * error
    for row, e in ((p0, e0), (p1, e1), (p2, e2), (p3, e3), (p4, e4)):
        gain = e / variance
        row[0] -= gain * e0
        row[1] -= gain * e1
        row[2] -= gain * e2
        row[3] -= gain * e3
        row[4] -= gain * e4


def follow_braked(k: DiscConstants, s: DiscState, angle: float, dt_s: float) -> None:
    """As `follow`, with the disc's errors as they are: what the brake does would pass for one."""
    cosine, sine, cosine_2, sine_2, learnt = s.cosine, s.sine, s.cosine_2, s.sine_2, s.learnt
    follow(k, s, angle, dt_s)
    s.cosine, s.sine, s.cosine_2, s.sine_2, s.learnt = cosine, sine, cosine_2, sine_2, learnt


def _without_second(s: DiscState, angle: float, sine: float, cosine: float) -> float:
    """Learn the error twice per turn from what the filter, too slow for it, does not follow; the angle without it.

    The mean of the deviation times cos(2*angle) is half of the cosine's component.
    """
    cosine_2, sine_2 = cosine * cosine - sine * sine, 2.0 * sine * cosine
    angle -= s.cosine_2 * cosine_2 + s.sine_2 * sine_2
    deviation = angle - s.angle - cosine * s.cosine - sine * s.sine
    s.learnt += 1.0
    gain = 2.0 / (_UNLEARNT + s.learnt)
    s.cosine_2 += gain * deviation * cosine_2
    s.sine_2 += gain * deviation * sine_2
    return angle


def _predict(s: DiscState, p0: Row, p1: Row, p2: Row, p3: Row, p4: Row, T: float) -> None:
    half = 0.5 * T * T
    v, a = s.speed, s.acceleration
    s.angle = s.angle + v * T + a * half
    s.speed = v + a * T
    for row in (p0, p1, p2, p3, p4):
        speed, acceleration = row[1], row[2]
        row[0] = row[0] + T * speed + half * acceleration
        row[1] = speed + T * acceleration
    for j in range(5):
        speed, acceleration = p1[j], p2[j]
        p0[j] = p0[j] + T * speed + half * acceleration
        p1[j] = speed + T * acceleration
    p2[2] += _JERK_DENSITY * T
