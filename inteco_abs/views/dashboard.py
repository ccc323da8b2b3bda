"""Live dashboard of a run on a terminal, drawn by the command's process from copies of its ticks.

It is drawn in place, not on the terminal's alternate screen, so that the traces and a controller's prints stay when the
run is over.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import TracebackType
from typing import Final, NamedTuple, Self

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.text import Text

from inteco_abs.config import RigConfig
from inteco_abs.realtime import Snapshot, StartCheck
from inteco_abs.signals import Phase
from inteco_abs.views.keys import pressed_keys, stop_keys
from inteco_abs.views.plot import Curve, PlotAxes, plot
from inteco_abs.views.text_lines import Line, TextLines, apart, length, padded
from inteco_abs.views.trace import RunTrace
from inteco_abs.views.tuning_panel import Tunable, TuningPanel

LEAST: Final = (80, 24)
"""Columns and rows of the smallest terminal for the whole dashboard."""
CTRL_C: Final = "Ctrl-C stops safely"
KEYS: Final = "q or Ctrl-C stops safely"
_SIDE_BY_SIDE: Final = 110
"""Columns from which on the two plots stand side by side."""
_MOST_ROWS: Final = 19
_ROOMY: Final = 30
"""Rows from which on there is room for an empty one."""
_TIMED: Final = {Phase.SPIN_UP: "{:.1f} s", Phase.BRAKING: "{:.2f} s", Phase.STOPPED: "{:.2f} s"}
_STEPS: Final = (Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED, Phase.DONE)
_AT_REST: Final = frozenset({Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED, Phase.DONE})
_ROAD, _WHEEL, _SLIP, _GOOD, _BAD = "cyan", "magenta", "green", "green", "bold red"


class _Signs(NamedTuple):
    """Characters that the dashboard is drawn with."""

    passed: str
    here: str
    open: str
    full: str
    empty: str
    rule: str
    solid: str
    dashed: str


_UNICODE: Final = _Signs("✓", "▶", "·", "█", "░", "─", "━━", "╍╍")
_ASCII: Final = _Signs("x", ">", ".", "#", ".", "-", "", "")


class Dashboard:
    """Shows a run on a terminal in place; in one line on a small terminal or with `line`. A context manager.

    With `playback`, it shows a session that `rewind` and `describe` control; with a `tuner`, keys change gains.
    """

    period_s = 0.1

    def __init__(
        self,
        console: Console,
        config: RigConfig,
        *,
        virtual: bool = False,
        line: bool = False,
        plain: bool = False,
        playback: bool = False,
        tuner: Tunable | None = None,
    ) -> None:
        self._console = console
        self._panel = None if tuner is None else TuningPanel(tuner)
        self._playback = playback
        self._state = "virtual time " if virtual else ""
        self._plain = plain or console.options.ascii_only
        self._config = config
        self._virtual = virtual
        self._only_line = line
        self._trace = RunTrace(config.experiment.start_speed_rad_s)
        self._passed: dict[StartCheck, str] = {}
        self._snapshot: Snapshot | None = None
        self._hint = "" if playback else CTRL_C
        self._size = console.size
        # without a refresh thread: it draws only when it is called
        self._live = Live(console=console, auto_refresh=False)

    def __enter__(self) -> Self:
        self._live.start()
        self._draw()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # a dashboard without traces shows nothing that the result card does not
        self._hint = ""
        self._live.transient = self.in_line or not self._trace.braked()
        if not self._live.transient:
            self._draw()
        self._live.stop()

    @contextmanager
    def listening(self, stop: Callable[[], None]) -> Iterator[None]:
        """Let q and space call `stop`, and other keys change gains, if the program has the keyboard."""
        with stop_keys(stop, _stdin(), self._panel.press if self._panel else None) as can:
            self._hint = KEYS if can else CTRL_C
            yield

    def keys(self, handle: Callable[[bytes], None]) -> AbstractContextManager[bool]:
        """Let keys reach `handle`, if the program has the keyboard; yields whether it has."""
        return pressed_keys(handle, _stdin())

    @property
    def in_line(self) -> bool:
        """Whether only one line is drawn."""
        width, height = self._console.size
        return self._only_line or width < LEAST[0] or height < LEAST[1]

    def passed(self, check: StartCheck, text: str = "") -> None:
        """Tick off a check of the start."""
        self._passed[check] = _printable(text)
        self._draw()

    def show(self, snapshot: Snapshot) -> None:
        """Draw the newest state."""
        self._trace.add(snapshot.recent)
        self._snapshot = snapshot
        if snapshot.phase in _AT_REST:
            self._passed.setdefault(StartCheck.REST, "")
        self._draw()

    def rewind(self, stops: int) -> None:
        """Begin new traces, after so many stops."""
        self._trace = RunTrace(self._config.experiment.start_speed_rad_s)
        self._trace.stop = stops

    def describe(self, state: str, hint: str) -> None:
        """Show the state of a playback beside the time, and its keys below."""
        self._state, self._hint = f"{state} ", hint

    def note(self, text: str) -> None:
        """Print a note above the live part."""
        self._console.print(Text(text, style="yellow"))

    def warn(self, text: str) -> None:
        """Print a warning above the live part."""
        self._console.print(Text(text, style=_BAD))

    def _draw(self) -> None:
        if self._console.size != self._size:  # the terminal has wrapped the old lines: begin on an empty one
            self._size = self._console.size
            self._console.clear()
        self._live.update(self._line() if self.in_line else TextLines(self.lines()), refresh=True)

    def _line(self) -> Text:
        if self._snapshot is not None:
            return in_one_line(self._snapshot, self._hint)
        check = self._awaited()
        return one_line([(f"starting: {check.value}?" if check else "starting", "bold"), (f", {self._hint}", "")])

    def _awaited(self) -> StartCheck | None:
        return next((check for check in self._checks() if check not in self._passed), None)

    def _checks(self) -> list[StartCheck]:
        if self._playback:
            return []
        return [check for check in StartCheck if not (self._virtual and check is StartCheck.GUARDIAN)]

    def lines(self) -> list[Line]:
        """All lines, at most one fewer than the terminal's rows."""
        width, height = self._console.size
        signs = _ASCII if self._plain else _UNICODE
        spare: list[Line] = [[]] if height >= _ROOMY else []
        tuning: list[Line] = [] if self._panel is None or not self._hint else [self._panel.line(width)]
        room = height - 1 - 5 - len(spare) - len(tuning)  # the lines around it
        body = self._plots(width, room) if self._trace.braked() else self._start(width, signs)
        return [
            self._title(width, signs),
            self._phases(signs),
            *spare,
            *body[:room],
            self._duties(width, signs),
            self._timing(),
            *tuning,
            self._end(width, signs),
        ]

    def _title(self, width: int, signs: _Signs) -> Line:
        config, shot = self._config, self._snapshot
        law = _printable(f"{config.controller.name} on {config.estimator.name}")
        name: Line = [(signs.rule * 2, "dim"), (f" {law} ", "bold")]
        if config.experiment.stops > 1:
            name.append((f"stop {max(self._trace.stop, 1)} of {config.experiment.stops} ", ""))
        state = f" {shot.time_s:.1f} s, {shot.ticks} ticks " if shot else " starting "
        if self._playback and shot:
            state = f" {shot.time_s:.1f} "
        right: Line = [(f"{state}{self._state}", ""), (signs.rule * 2, "dim")]
        return [*name, (signs.rule * max(1, width - length(name) - length(right)), "dim"), *right]

    def _phases(self, signs: _Signs) -> Line:
        """Every phase with its duration; the present one stands out by a sign and by capitals."""
        present = self._snapshot.phase if self._snapshot else Phase.UNKNOWN
        line: Line = []
        for phase in _STEPS:
            seconds = self._trace.seconds_in(phase)
            lasted = f" {_TIMED[phase].format(seconds)}" if seconds is not None and phase in _TIMED else ""
            name = f"{named(phase)}{lasted}"
            if phase is present:
                line += [(" ", ""), (f" {signs.here} {named(phase).upper()}{lasted} ", "bold reverse")]
            elif seconds is not None:
                line.append((f"  {signs.passed} {name}", ""))
            elif present is not Phase.FAULT:  # no phase follows a fault
                line.append((f"  {name}", "dim"))
        if present is Phase.FAULT:
            line += [(" ", ""), (f" {signs.here} FAULT: outputs off ", "bold red reverse")]
        return line

    def _start(self, width: int, signs: _Signs) -> list[Line]:
        """Checks of the start, and the speed of the wheels."""
        lines: list[Line] = []
        awaited = self._awaited()
        for check in self._checks():
            text = self._passed.get(check)
            if text is not None:
                lines.append([(f"   {signs.passed} ", _GOOD), (f"{check.value:<28}", ""), (text, "dim")])
            elif check is awaited:
                lines.append([(f"   {signs.here} {check.value:<28}", "bold"), ("waiting", "dim")])
            else:
                lines.append([(f"   {signs.open} {check.value}", "dim")])
        return [*lines, [], *self._spin_up(width, signs), []]

    def _spin_up(self, width: int, signs: _Signs) -> list[Line]:
        seconds, plan = self._trace.seconds_in(Phase.SPIN_UP), self._config.experiment
        if seconds is None or self._snapshot is None:
            return []
        speed = self._snapshot.road_speed_rad_s
        reached = f" {speed:6.1f} of {plan.start_speed_rad_s:g} rad/s"
        meter = bar(speed / plan.start_speed_rad_s, max(10, width - 3 - 3 - len(reached)), signs)
        return [
            [
                ("   spin-up to the start speed", "bold"),
                (f"   {seconds:.1f} s of at most {plan.spin_up_timeout_s:g} s", "dim"),
            ],
            [("   ", ""), *meter, (reached, "bold")],
        ]

    def _plots(self, width: int, room: int) -> list[Line]:
        """Speeds and slip since braking began, side by side if there is room."""
        side_by_side = width >= _SIDE_BY_SIDE
        rows = min(_MOST_ROWS, room - 3 if side_by_side else (room - 4) // 2)
        rows -= 1 - rows % 2  # odd, so that there is a middle row
        each = (width - 2) // 2 if side_by_side else width - 1
        speeds, slip = self._speeds(each, rows), self._slip(each, rows)
        if not side_by_side:
            return [*speeds, *slip]
        return [[*padded(left, each), ("  ", ""), *right] for left, right in zip(speeds, slip, strict=True)] + [[]]

    def _speeds(self, width: int, rows: int) -> list[Line]:
        times, road, wheel, _, _ = self._trace.columns()
        shot = self._shown
        head = [
            (" speed [rad/s]  ", "bold"),
            *self._legend("car", f"{shot.road_speed_rad_s:6.1f}", _ROAD, "*", dashed=False),
            *self._legend("wheel", f"{shot.wheel_speed_rad_s:6.1f}", _WHEEL, "o", dashed=True),
        ]
        curves = [Curve(times, road, _ROAD, "*"), Curve(times, wheel, _WHEEL, "o", dashed=True)]
        axes = PlotAxes(self._trace.span_s(), speed_top(self._config.experiment.start_speed_rad_s))
        return [head, *plot(curves, axes, width, rows, plain=self._plain)]

    def _slip(self, width: int, rows: int) -> list[Line]:
        times, _, _, slip, reference = self._trace.columns()
        axes, constant = PlotAxes(self._trace.span_s(), 1.0), self._config.controller.constant_slip
        if constant is None or np.any(reference[np.isfinite(reference)] != constant):
            known = np.isfinite(reference)  # while braking
            held = Curve(times[known], reference[known], "", "-", dashed=True)
            now = f"{held.values[-1]:.3f}" if len(held.values) else "changing"
        else:
            held = Curve(np.array([0.0, axes.span_s]), np.full(2, constant), "", "-", dashed=True)
            now = f"{constant:g}"
        head = [
            (" slip           ", "bold"),
            *self._legend("slip", f"{self._shown.slip:6.3f}", _SLIP, "*", dashed=False),
            *self._legend("reference", now, "", "-", dashed=True),
        ]
        curves = [Curve(times, slip, _SLIP, "*"), held]
        return [head, *plot(curves, axes, width, rows, plain=self._plain)]

    def _legend(self, name: str, value: str, style: str, mark: str, *, dashed: bool) -> Line:
        signs = _ASCII if self._plain else _UNICODE
        stroke = (signs.dashed if dashed else signs.solid) or mark * (1 if dashed else 2)
        return [(f"{stroke} {name} ", style), (f"{value}   ", "bold")]

    @property
    def _shown(self) -> Snapshot:
        if self._snapshot is None:
            raise ValueError("nothing was shown yet")
        return self._snapshot

    def _duties(self, width: int, signs: _Signs) -> Line:
        shot, guard = self._snapshot, self._config.guard
        size = min(28, (width - 44) // 2)
        line: Line = []
        for name, duty, limit in (
            ("drive", shot.drive if shot else 0.0, guard.drive_limit),
            ("brake", shot.brake if shot else 0.0, guard.brake_limit),
        ):
            at_limit = duty >= limit and limit < 1.0
            text = f" {duty:4.2f} " + ("limit" if at_limit else f"of {limit:g}" if limit < 1.0 else "")
            line += [(f" {name} ", "dim"), *bar(duty, size, signs), (f"{text:<13}", "bold" if at_limit else "")]
        return line

    def _timing(self) -> Line:
        if self._virtual:
            return [(" virtual time: as fast as it goes, never late", "dim")]
        return [(" ", ""), *timing(self._snapshot, self._config.period_ns * 1e-3)]

    def _end(self, width: int, signs: _Signs) -> Line:
        if self._hint:
            warning = "" if self._playback else "only the emergency switch cuts the power "
            return apart([(f" {self._hint}", "bold")], [(warning, "dim")], width)
        return [(signs.rule * width, "dim")]


def in_one_line(snapshot: Snapshot, hint: str) -> Text:
    """Phase, speeds, slip, how to stop, and overruns, shortened to the terminal."""
    return one_line(
        [
            (named(snapshot.phase), "bold"),
            (f" {snapshot.road_speed_rad_s:.0f} rad/s, slip {snapshot.slip:.2f}, ", ""),
            (f"{hint}, " if hint else "", ""),
            (f"{snapshot.overruns} overruns", "red" if snapshot.overruns else ""),
        ]
    )


def one_line(line: Line) -> Text:
    """A line, cut at the terminal's width with three dots."""
    return Text.assemble(*line, no_wrap=True, overflow="ellipsis")


def timing(snapshot: Snapshot | None, period_us: float) -> Line:
    """Lateness so far and periods missed; red and with ! if a tick was a period late or left out."""
    if snapshot is None:
        return [("late -", "dim")]
    p50, p99, p999, greatest = (f"{value:.0f}" if value is not None else "-" for value in snapshot.late_us)
    too_late = (snapshot.late_us[3] or 0.0) > period_us
    missed = snapshot.overruns
    return [
        (f"late p50 {p50}, p99 {p99}, p99.9 {p999}, ", "dim"),
        (f"max {greatest} us{'!' if too_late else ''}", _BAD if too_late else "dim"),
        ("; ", "dim"),
        (f"{missed} {'period' if missed == 1 else 'periods'} missed{'!' if missed else ''}", _BAD if missed else "dim"),
    ]


def bar(share: float, size: int, signs: _Signs) -> Line:
    """A share in 0..1 as a bar of `size` cells."""
    full = round(min(max(share, 0.0), 1.0) * size) if math.isfinite(share) else 0
    return [(signs.full * full, "bold"), (signs.empty * (size - full), "dim")]


def speed_top(start_speed_rad_s: float) -> float:
    """Upper end of the speed axis, rad/s: 5 % above the start speed, in steps of 20 rad/s."""
    return 20.0 * math.ceil(1.05 * start_speed_rad_s / 20.0)


def named(phase: Phase) -> str:
    """A phase in lower case, as `spin-up`."""
    return phase.name.lower().replace("_", "-")


def _printable(text: str) -> str:
    """The text without what a terminal obeys."""
    return text if text.isprintable() else ascii(text)[1:-1]


def _stdin() -> int:
    """File descriptor of standard input; -1 if it has none."""
    try:
        return sys.stdin.fileno()
    except (OSError, ValueError, AttributeError):  # closed, or a notebook's
        return -1
