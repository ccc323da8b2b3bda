"""Limit cycles of the real loop: brake lag and dead time, sampling, and the estimator's delay and error.

At a frozen road speed, the slip error e about the reference obeys e' = -p*e + g*dM, and the law demands the torque
dM = -(N - p)*e/g, because it inverts the same model. Between both lie the brake's lag, its dead time, the period until
the command is written, the half period for which it is held on average, and the estimator. N is the law's gain; that of
a switching term is its describing function (Khalil, *Nonlinear Systems*, Prentice Hall, 2002, section 7.2), which falls
as the amplitude rises. Where the loop's phase is -180 degrees it bears one gain: a law with more oscillates, with the
amplitude at which the describing function is that gain.

Near the standstill the speed changes faster than the loop can swing; such speeds are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from inteco_abs.config import RigConfig
from inteco_abs.control import BrakingModel, MovingWindow, TwoWheels, gains_in_force, make_estimator
from inteco_abs.errors import ConfigError
from inteco_abs.gain_design.advice import Advice, Case
from inteco_abs.gain_design.bounds import Floats
from inteco_abs.gain_design.gains import Gains
from inteco_abs.rig import RigParameters
from inteco_abs.signals import BoardFlags, Sample

_SPEEDS: Final = 6
_BEFORE_REST_S: Final = 0.25
"""A speed counts as frozen if the wheels need longer than this to stop."""
_OUTPUT_PERIODS: Final = 1.5
"""A command is written a period after its sample, and held for one."""
_SLOPE_STEP: Final = 1e-4
"""Step of slip for a derivative."""
_SLOWEST_RAD_S: Final = 0.1
_FREQUENCIES: Final = 4000
_ROUNDS: Final = 3
"""Rounds that find the frequency, on which the estimator's delay depends."""
_FIRST_DELAY_S: Final = 0.005
_SWING: Final = 0.02
"""Amplitude of the slip that an estimator is shown."""
_SETTLING_S: Final = 0.2
_CYCLES: Final = 4
_HALVINGS: Final = 60
_FILTERS: Final = (MovingWindow, TwoWheels)
"""Estimators that only filter counts."""
_GAIN_MARGIN: Final = 2.0
"""An advised gain is so many times smaller than the one that the loop bears."""
_TO_SPARE: Final = 1.05


class Brake(NamedTuple):
    """Brakes of a set of rigs, in s."""

    least_lag_s: float
    most_lag_s: float
    dead_time_s: float
    """The longest one: less delay bears more gain."""


def identified_brake(config: RigConfig) -> Brake | None:
    """The brake of [model.identified], the slower of rise and release.

    None if its lag is not identified, or for an estimator that models the brake itself.
    """
    own = config.model.identified
    if own.c31 is None or not isinstance(make_estimator(config), _FILTERS):
        return None
    lags_s = (1.0 / own.c31, (own.brake_release_ratio or 1.0) / own.c31)
    dead_time_s = own.brake_dead_time_s or 0.0
    return Brake(min(lags_s), max(lags_s), dead_time_s + max(0.0, own.brake_release_delay_s or 0.0))


class Response(NamedTuple):
    """An estimator's answer to a slip that swings at one frequency."""

    delay_s: float
    gain: float
    error: float
    """Largest remaining error of the slip, by quantisation."""


class Balance(NamedTuple):
    """The loop at one road speed, with the brake and the rig that bear least."""

    road_speed_rad_s: float
    delay_s: float
    """Of dead time, sampling and estimator."""
    estimator_error: float
    """Error of the estimated slip by quantisation."""
    frequency_hz: float
    """Frequency at which the loop oscillates, if it does."""
    most_gain_per_s: float
    """Largest gain that the loop bears."""
    gain_per_s: float
    """Gain of the law near the reference; infinite if it switches there."""
    delay_margin_s: float
    """Further delay that the loop bears; 0 if it oscillates."""
    amplitude: float
    """Amplitude of the slip's limit cycle: 0 without one, infinite if only the brake's limits bound it."""


def balances(config: RigConfig, case: Case, brake: Brake) -> list[Balance]:
    """The loop at several road speeds.

    Raises ConfigError for an estimator that models the brake itself.
    """
    rows = []
    for speed in frozen_speeds(case.nominal, case.reference.slip, (case.speeds[0], case.speeds[-1])).tolist():
        both = [
            _balance(config, case, lag_s, brake.dead_time_s, speed) for lag_s in {brake.least_lag_s, brake.most_lag_s}
        ]
        rows.append(min(both, key=lambda row: row.most_gain_per_s))
    return rows


def _balance(config: RigConfig, case: Case, lag_s: float, dead_time_s: float, speed: float) -> Balance:
    pole = slip_pole(BrakingModel(case.nominal), case.reference.slip, speed)
    fixed_s = dead_time_s + _OUTPUT_PERIODS * case.period_s
    inverted_s = gains_in_force(config)["lag_s"]
    seen = Response(_FIRST_DELAY_S, 1.0, 0.0)
    for _ in range(_ROUNDS):
        loop = _Loop(pole, lag_s, inverted_s, fixed_s + seen.delay_s, seen.gain)
        frequency, borne = loop.critical()
        seen = response(config, case.reference.slip, speed, frequency)
    stronger = 1.0 + float(case.bounds(np.array([speed])).eps_g[0])
    most = borne / stronger + pole
    near = law_gain(case.gains, speed, 0.0)
    margin_s = loop.delay_margin((near - pole) * stronger) if near < most else 0.0
    amplitude = 0.0 if near < most else _amplitude(lambda size: law_gain(case.gains, speed, size), most)
    hz = frequency / (2.0 * math.pi)
    return Balance(speed, loop.delay_s, seen.error, hz, most, near, margin_s, amplitude)


class _Loop(NamedTuple):
    """Everything between the law's demand and the estimate, for a gain of 1."""

    pole: float
    lag_s: float
    inverted_s: float
    delay_s: float
    gain: float

    def frequencies(self) -> Floats:
        return np.linspace(_SLOWEST_RAD_S, 2.0 * math.pi / self.delay_s, _FREQUENCIES)

    def phase(self, w: Floats) -> Floats:
        lag = np.arctan(w * self.lag_s) - np.arctan(w * self.inverted_s)
        phase: Floats = -np.arctan2(w, self.pole) - lag - w * self.delay_s
        return phase

    def size(self, w: Floats) -> Floats:
        lead = np.hypot(1.0, w * self.inverted_s) / np.hypot(1.0, w * self.lag_s)
        return self.gain * lead / np.hypot(w, self.pole)

    def critical(self) -> tuple[float, float]:
        """Frequency in rad/s at which the phase falls to -180 degrees, and the gain that the loop bears there."""
        w = self.frequencies()
        stable = np.nonzero(self.phase(w) > -math.pi)[0]
        if not len(stable):
            return _SLOWEST_RAD_S, 0.0
        at = w[stable[-1:]]
        return float(at[0]), float(1.0 / self.size(at)[0])

    def delay_margin(self, gain: float) -> float:
        """Further delay in s until the loop with this gain oscillates; infinite if its gain never exceeds 1."""
        w = self.frequencies()
        above = np.nonzero(gain * self.size(w) > 1.0)[0]
        if not len(above):
            return math.inf
        at = w[above[-1:]]
        return max(0.0, float((self.phase(at) + math.pi)[0] / at[0]))


def frozen_speeds(nominal: RigParameters, slip: float, speeds: tuple[float, float]) -> Floats:
    """Several road speeds from..to, but for those less than 0.25 s before the standstill."""
    low, high = speeds
    slowest = min(max(low, _deceleration(nominal, slip, low) * _BEFORE_REST_S), high)
    return np.linspace(slowest, high, _SPEEDS)


def _deceleration(nominal: RigParameters, slip: float, speed: float) -> float:
    """Deceleration of the nominal rig's road in rad/s2 while the brake holds a slip, by equation (10)."""
    model = BrakingModel(nominal)
    f, g = model.terms(slip, speed)
    S = model.S(slip)
    by_speed = S * model.c21 / model.ratio * (1.0 - slip) + model.c23
    return -(by_speed * speed + S * model.c22 + model.c24 - model.c25 * S * f / g)


def slip_pole(model: BrakingModel, slip: float, road_speed: float) -> float:
    """Rate p in 1/s at which the slip returns by itself with the brake's torque unchanged; below 0 it runs away."""
    f, g = model.terms(slip, road_speed)
    rates = [
        f_at - g_at * f / g
        for f_at, g_at in (model.terms(slip + step, road_speed) for step in (-_SLOPE_STEP, _SLOPE_STEP))
    ]
    return (rates[0] - rates[1]) / (2.0 * _SLOPE_STEP)


def law_gain(gains: Gains, road_speed: float, amplitude: float) -> float:
    """Describing function of the law in 1/s for a slip error of this amplitude; at 0, its gain near the reference."""
    switching = gains.Mq * max(1.0, gains.v / road_speed)
    if gains.width > 0.0:
        ratio = min(1.0, gains.width / amplitude) if amplitude > 0.0 else 1.0
        share = 2.0 / math.pi * (math.asin(ratio) + ratio * math.sqrt(1.0 - ratio * ratio))
        return gains.Mk + switching / gains.width * share
    if switching == 0.0:
        return gains.Mk
    return gains.Mk + 4.0 * switching / (math.pi * amplitude) if amplitude > 0.0 else math.inf


def _amplitude(gain: Callable[[float], float], most: float) -> float:
    """Where the falling `gain` is `most`; infinite if it is larger for every slip."""
    low, high = 0.0, 1.0
    if gain(high) >= most:
        return math.inf
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if gain(middle) > most else (low, middle)
    return high


def response(config: RigConfig, slip: float, road_speed: float, frequency: float) -> Response:
    """How the configured estimator sees a slip that swings at `frequency` (rad/s), from ideal encoders' counts."""
    estimator = make_estimator(config)
    if not isinstance(estimator, _FILTERS):
        name = config.estimator.name
        raise ConfigError.of(
            "estimator.name", f"{name!r} models the brake itself: --lag needs one that only filters counts"
        )
    ratio, period_s = estimator.k.ratio, config.period_ns * 1e-9
    per_rad = config.encoders.counts_per_turn / (2.0 * math.pi)
    times = np.arange(1, math.ceil((_SETTLING_S + _CYCLES * 2.0 * math.pi / frequency) / period_s)) * period_s
    road = np.floor(per_rad * road_speed * times).astype(int).tolist()
    angles = road_speed / ratio * ((1.0 - slip) * times + _SWING / frequency * np.cos(frequency * times))
    wheel = np.floor(per_rad * angles).astype(int).tolist()
    seen = []
    for tick, (wheel_count, road_count) in enumerate(zip(wheel, road, strict=True), 1):
        seen.append(
            estimator.update(
                Sample(tick, tick * config.period_ns, period_s, wheel_count, road_count, BoardFlags.NONE)
            ).slip
        )
    settled = times >= _SETTLING_S
    t, slips = times[settled], np.array(seen)[settled]
    waves = np.stack([np.sin(frequency * t), np.cos(frequency * t), np.ones_like(t)], axis=1)
    (sine, cosine, mean), *_ = np.linalg.lstsq(waves, slips, rcond=None)
    error = float(np.abs(slips - waves @ [sine, cosine, mean]).max())
    delay_s = math.atan2(-cosine, sine) / frequency
    return Response(delay_s, math.hypot(sine, cosine) / _SWING, error)


def cycle_advice(case: Case, rows: Sequence[Balance]) -> list[Advice]:
    """Whether the loop oscillates, and the boundary layer with which it does not."""
    cycling = [row for row in rows if row.amplitude > 0.0]
    if not cycling:
        return []
    least = min(rows, key=lambda row: row.most_gain_per_s)
    if least.most_gain_per_s <= 0.0:
        found = (
            f"no gain holds the slip at {least.road_speed_rad_s:.0f} rad/s: it runs away faster than the loop answers"
        )
        return [Advice("limit cycle", found, "less lag or dead time, or a higher reference slip")]
    worst = max(cycling, key=lambda row: row.amplitude)
    size = f"by ±{worst.amplitude:.2g}" if math.isfinite(worst.amplitude) else "as far as the brake's limits let it"
    found = (
        f"the slip swings {size}, {worst.frequency_hz:.1f} times a second at {worst.road_speed_rad_s:.0f} rad/s: the "
        f"loop bears a gain of {worst.most_gain_per_s:.3g} 1/s"
    )
    most_mk = least.most_gain_per_s / _GAIN_MARGIN
    if case.gains.Mk >= most_mk:
        return [Advice("limit cycle", found, f"Mk below {most_mk:.2g}, then a boundary layer")]
    width = max(
        case.gains.Mq
        * max(1.0, case.gains.v / row.road_speed_rad_s)
        / (row.most_gain_per_s / _GAIN_MARGIN - case.gains.Mk)
        for row in rows
    )
    return [
        Advice(
            "limit cycle", found, f"the controller boundary-layer with controller.gains.width = {_TO_SPARE * width:.2g}"
        )
    ]
