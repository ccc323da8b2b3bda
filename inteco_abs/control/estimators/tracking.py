"""A tracking loop: a model wheel that follows the counted angle through a spring and a damper."""

from __future__ import annotations

from inteco_abs.control.estimators.base import Angles


class TrackingLoop:
    """v += wn^2*e*T, th += (v + 2*zeta*wn*e)*T with e = angle - th: lag 2*zeta/wn, noise falling with wn.

    The loop of resolver and encoder converters; `natural_frequency_rad_s` is wn, the damping zeta is 0.9.
    """

    __slots__ = ("_angle", "_angles", "_damping", "_speed", "_stiffness")

    def __init__(self, counts_per_turn: int, natural_frequency_rad_s: float) -> None:
        self._angles = Angles(counts_per_turn)
        self._stiffness = natural_frequency_rad_s**2
        self._damping = 2.0 * 0.9 * natural_frequency_rad_s
        self._angle = 0.0
        self._speed = 0.0

    def update(self, time_ns: int, count: int) -> float:
        """Speed in rad/s."""
        angle, dt_s = self._angles.update(time_ns, count)
        error = angle - self._angle
        self._speed += self._stiffness * error * dt_s
        self._angle += (self._speed + self._damping * error) * dt_s
        return self._speed
