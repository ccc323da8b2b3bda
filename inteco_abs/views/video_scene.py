"""The pictures of a video: wheels on the left, curves on the right; what does not move is drawn once."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyBboxPatch, Wedge

from inteco_abs.config import RigConfig
from inteco_abs.rig import nominal_parameters
from inteco_abs.sessions import Array, Session
from inteco_abs.signals import Phase
from inteco_abs.views.comparison import PALETTE, since_s
from inteco_abs.views.decimation import decimate
from inteco_abs.views.figure import AT_REST_RAD_S, TOP_NM, highest_slip, moving_slip, slip_top

_BLUE, _RED, _GREEN = PALETTE[:3]
_INCHES: Final = (12.8, 7.2)
_POINTS: Final = 1600
_SPARE_PX: Final = 0.01
"""Matplotlib cuts sizes to whole pixels, and rounding must not cost one."""
_SPOKES: Final = 5
_SPOKE_DEG: Final = 9.0
_GREY: Final = "#b8bec6"
_DARK: Final = "#3a3f47"
_KMH_PER_M_S: Final = 3.6


class _Curve(NamedTuple):
    """A line that grows."""

    line: Line2D
    time_s: Array
    values: Array


class _Wheel:
    """A wheel whose spokes turn; one of them is coloured."""

    def __init__(self, panel: Axes, centre: tuple[float, float], radius: float, colour: str, direction: float) -> None:
        panel.add_patch(Circle(centre, radius, facecolor="#eef0f3", edgecolor=_DARK, lw=5.0))
        self.direction = direction
        self.spokes = [
            Wedge(centre, 0.9 * radius, 0.0, 1.0, width=0.72 * radius, lw=0.0, color=_GREY if number else colour)
            for number in range(_SPOKES)
        ]
        for spoke in self.spokes:
            panel.add_patch(spoke)
        hub = Circle(centre, 0.18 * radius, facecolor=_DARK, lw=0.0)
        panel.add_patch(hub)
        self.moving: list[Artist] = [*self.spokes, hub]

    def turn(self, before_rad: float, now_rad: float) -> None:
        """Show the spokes between two angles, the fainter the further they turn while the shutter is open."""
        swept = math.degrees(abs(now_rad - before_rad))
        alpha = max(_SPOKE_DEG / (_SPOKE_DEG + swept), 0.12)
        low = math.degrees(min(self.direction * before_rad, self.direction * now_rad)) % 360.0
        for number, spoke in enumerate(self.spokes):
            begin = 90.0 + low + number * 360.0 / _SPOKES - _SPOKE_DEG / 2.0
            spoke.set_theta1(begin)
            spoke.set_theta2(begin + _SPOKE_DEG + min(swept, 359.0 - _SPOKE_DEG))
            spoke.set_alpha(alpha)


class Scene:
    """Draws the pictures of a session's part in any order."""

    def __init__(
        self, session: Session, start_ns: int, range_s: tuple[float, float], config: RigConfig,
        words: tuple[str, str], height_px: int,
    ) -> None:  # fmt: skip
        title, self._speed = words
        self._ticks, truth = session.ticks, session.truth
        self._time_s = since_s(self._ticks, start_ns)
        self._true = bool(len(truth))
        self._truth, self._truth_s = (truth, since_s(truth, start_ns)) if self._true else (self._ticks, self._time_s)
        self._turn_rad = 2.0 * math.pi / config.encoders.counts_per_turn
        self._road_radius_m = nominal_parameters(config.model).r2
        with rc_context({"font.size": 12.0}):
            dpi = height_px / _INCHES[1]
            width_px = 2 * round(height_px * _INCHES[0] / _INCHES[1] / 2.0)  # H.264 has even widths
            size = (width_px + _SPARE_PX) / dpi, (height_px + _SPARE_PX) / dpi
            self._figure = Figure(size, dpi=dpi, facecolor="white")
            self._canvas = FigureCanvasAgg(self._figure)
            self._moving: list[Artist] = []
            self._wheels(config)
            self._panels(range_s)
            self._figure.text(0.02, 0.955, title, fontsize=15, weight="bold", parse_math=False)
        for artist in self._moving:
            artist.set_animated(True)
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(self._figure.bbox)

    def picture(self, time_s: float, shutter_s: float) -> Array:
        """The picture at a time, s since braking began: an array of height, width and three colours, of bytes.

        What turns is blurred over the last `shutter_s` seconds.
        """
        self._canvas.restore_region(self._still)
        at = min(max(int(np.searchsorted(self._time_s, time_s, side="right")) - 1, 0), len(self._ticks) - 1)
        self._turn(time_s, shutter_s)
        self._say(at, time_s)
        for curve in self._curves:
            shown = int(np.searchsorted(curve.time_s, time_s, side="right"))
            curve.line.set_data(curve.time_s[:shown], curve.values[:shown])
        for cursor in self._cursors:
            cursor.set_xdata([time_s, time_s])
        renderer = self._canvas.get_renderer()
        for artist in self._moving:
            artist.draw(renderer)
        return np.asarray(self._canvas.buffer_rgba())[:, :, :3].copy()

    def _wheels(self, config: RigConfig) -> None:
        model = nominal_parameters(config.model)
        upper, lower, larger = model.r1, model.r2, max(model.r1, model.r2)
        panel = self._figure.add_axes((0.01, 0.08, 0.41, 0.86))
        panel.set_aspect("equal")
        panel.set_axis_off()
        panel.set_xlim(-1.8 * larger, 1.8 * larger)
        panel.set_ylim(-1.06 * lower, lower + 2.06 * upper)
        self._road = _Wheel(panel, (0.0, 0.0), lower, _RED, 1.0)
        self._wheel = _Wheel(panel, (0.0, lower + upper), upper, _BLUE, -1.0)
        self._pad = FancyBboxPatch(
            (-1.26 * upper, lower + 0.75 * upper), 0.18 * upper, 0.5 * upper, boxstyle=f"round,pad={0.02 * upper}",
            facecolor="white", edgecolor=_DARK, lw=1.5,
        )  # fmt: skip
        panel.add_patch(self._pad)
        self._contact = Circle((0.0, lower), 0.05 * lower, facecolor=_RED, lw=0.0)
        panel.add_patch(self._contact)
        looks: dict[str, Any] = {"ha": "left", "va": "center", "fontsize": 12}
        right = 1.1 * larger
        self._words = [
            panel.text(right, lower + upper, "", color=_BLUE, **looks),
            panel.text(right, 0.0, "", color=_RED, **looks),
            panel.text(right, lower, "", color=_DARK, **looks),
            panel.text(-1.32 * upper, lower + upper, "", color=_GREEN, **{**looks, "ha": "right"}),
        ]
        self._clock = self._figure.text(0.02, 0.04, "", fontsize=13, family="monospace")
        self._moving += [*self._wheel.moving, *self._road.moving, self._pad, self._contact, *self._words, self._clock]

    def _panels(self, range_s: tuple[float, float]) -> None:
        speeds, slip, torque = (self._figure.add_axes((0.5, 0.69 - 0.3 * row, 0.47, 0.24)) for row in range(3))
        self._curves: list[_Curve] = []
        self._cursors: list[Line2D] = []
        ticks, truth = self._ticks, self._truth
        self._grow(speeds, ticks, "road_speed_rad_s", "road wheel (car)", color=_RED, lw=2.0)
        self._grow(speeds, ticks, "wheel_speed_rad_s", "braked wheel", color=_BLUE, lw=2.0, ls="--")
        word = "true" if self._true else "estimated"
        self._grow(slip, truth, "slip", word, color=_RED, lw=2.0)
        self._grow(slip, ticks, "slip_reference", "reference", color="black", lw=1.2, ls="--")
        name, said = ("brake_torque_nm", "torque") if self._true else ("torque_demand_nm", "torque, asked")
        self._grow(torque, truth, name, said, color=_RED, lw=2.0)
        speeds.set_ylabel("speed [rad/s]")
        speeds.set_ylim(bottom=0.0)
        slip.set_ylabel("slip")
        slip.set_ylim(0.0, slip_top(map(highest_slip, (truth, ticks))))
        torque.set_ylabel("brake torque [N m]")
        torque.set_ylim(-0.2, TOP_NM)
        torque.set_xlabel("time since braking began [s]")
        for panel in (speeds, slip, torque):
            panel.set_xlim(*range_s)
            panel.tick_params(labelbottom=panel is torque)
            panel.grid(alpha=0.3)
            where: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.0}
            panel.legend(ncols=3, frameon=False, fontsize="small", borderpad=0.2, **where)
            self._cursors.append(panel.axvline(range_s[0], color=_DARK, lw=1.0))
        self._moving += [*(curve.line for curve in self._curves), *self._cursors]

    def _grow(self, panel: Axes, rows: Array, name: str, label: str, **looks: Any) -> None:
        """A curve that is faint from the beginning, and grows."""
        time_s = self._truth_s if rows is self._truth else self._time_s
        values = moving_slip(rows) if name == "slip" else rows[name]
        few = decimate({name: values}, time_s, np.zeros(len(time_s), bool), _POINTS)
        panel.plot(few.time_s, few.columns[name], alpha=0.2, **looks)
        (line,) = panel.plot([], [], label=label, **looks)
        self._curves.append(_Curve(line, few.time_s, few.columns[name]))

    def _turn(self, time_s: float, shutter_s: float) -> None:
        times_s = (time_s - shutter_s, time_s)
        for wheel, name in ((self._wheel, "wheel_count"), (self._road, "road_count")):
            wheel.turn(*(np.interp(times_s, self._time_s, self._ticks[name]) * self._turn_rad).tolist())

    def _say(self, at: int, time_s: float) -> None:
        tick = self._ticks[at]
        true_at = min(max(int(np.searchsorted(self._truth_s, time_s, side="right")) - 1, 0), len(self._truth) - 1)
        true = self._truth[true_at]
        slips = bool(true["road_speed_rad_s"] >= AT_REST_RAD_S)
        slip = float(np.clip(true["slip"], 0.0, 1.0)) if slips else 0.0
        torque_nm = float(true["brake_torque_nm" if self._true else "torque_demand_nm"])
        km_h = float(tick["road_speed_rad_s"]) * self._road_radius_m * _KMH_PER_M_S
        self._pad.set_facecolor(_shade(_GREEN, min(max(torque_nm / TOP_NM, 0.0), 1.0)))
        self._contact.set_alpha(min(max(slip, 0.0), 1.0))
        self._contact.set_radius((0.03 + 0.12 * slip) * self._road_radius_m)
        words = (
            f"{tick['wheel_speed_rad_s']:.0f} rad/s",
            f"{tick['road_speed_rad_s']:.0f} rad/s\n{km_h:.0f} km/h",
            f"slip {slip:.2f}" if slips else "",
            f"brake\n{float(tick['brake']):.0%}\n{max(torque_nm, 0.0):.1f} N m",
        )
        for text, said in zip(self._words, words, strict=True):
            text.set_text(said)
        phase = Phase(int(tick["phase"])).name.lower().replace("_", "-")
        self._clock.set_text(f"t = {time_s:+.3f} s  {self._speed}  {phase}")


def _shade(colour: str, share: float) -> tuple[float, float, float]:
    """The colour, towards white."""
    red, green, blue = (1.0 + (part - 1.0) * share for part in to_rgb(colour))
    return red, green, blue
