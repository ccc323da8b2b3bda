"""Plays a session into a dashboard, and to viewers of its channels, block by block of the file."""

from __future__ import annotations

import math
import time
from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from contextlib import ExitStack
from queue import Empty, SimpleQueue
from typing import Final

import numpy as np
import numpy.typing as npt

from inteco_abs.config import RigConfig
from inteco_abs.format import LOG_TOPIC, PARAMETERS_TOPIC, RESULT_TOPIC, TICK, TRUTH, Message, pack_result
from inteco_abs.realtime import POINTS_PER_S, Histogram, Point, snapshot_of
from inteco_abs.realtime.foxglove_server import PERIOD_S, FoxgloveServer, PlaybackControl, PlaybackState
from inteco_abs.sessions import (
    Channel,
    Session,
    event_channel,
    gains_of,
    pack_event,
    pack_parameters,
    parameter_channel,
    result_channel,
    row_channel,
    stored_card,
)
from inteco_abs.signals import Phase
from inteco_abs.views.dashboard import Dashboard
from inteco_abs.views.playback import KEYS, Playback

Rows = npt.NDArray[np.void]

_PLAYING, _PAUSED, _ENDED = 0, 1, 3

_DRAWN_S: Final = 0.1
"""Between two pictures."""
_MOST_STEP_S: Final = 10.0
"""Seconds of the session between two looks at the keys: a faster playback is as fast as it goes."""
_BLOCK_S: Final = 2.0
_LONGEST_TRACE_S: Final = 60.0
"""What is read again before the place that a jump leads to, at most: the stop so far."""
_MOST_SENT: Final = 20
"""Rows of a channel in one period: all of them at 2 kHz and real time."""


def session_channels(session: Session) -> list[Channel]:
    """The channels of a session for viewers, with its own units and names."""
    own = [row_channel(TICK), *([row_channel(TRUTH)] if session.truth_count else [])]
    rows = [each._replace(facts={**each.facts, **session.channels.get(each.topic, {})}) for each in own]
    return [*rows, event_channel(), parameter_channel(gains_of(session.channels)), result_channel()]


class Player:
    """Plays `session`, of which `playback` is the place."""

    def __init__(self, session: Session, config: RigConfig, playback: Playback) -> None:
        self._session, self._playback = session, playback
        self._dashboard: Dashboard | None = None
        self._server: FoxgloveServer | None = None
        self._blocks = _Blocks(session)
        self._stops_ns = [entry.unix_ns for entry in session.log if entry.text == f"phase {Phase.IDLE.name}"]
        self._step = max(1, round(config.loop.rate_hz / POINTS_PER_S))
        self._histogram = Histogram()
        self._recent: list[Point] = []
        self._newest: Rows | None = None
        self._next_ns = self._logged = 0
        self._told = False
        self._drawn_s = -math.inf
        self._told_state: tuple[int, float] | None = None
        self._by_viewers = False

    @property
    def controls(self) -> PlaybackControl:
        """What viewers may do."""
        end_ns = self._blocks.zero_ns + round(self._playback.length_s * 1e9)
        return PlaybackControl(self._blocks.zero_ns, end_ns, self._state, self._control)

    def play(self, dashboard: Dashboard | None = None, server: FoxgloveServer | None = None) -> None:
        """Play on `dashboard` and to the viewers of `server` until the end, or until the user leaves.

        At the end it waits for a user with keys, and for viewers that have used their controls. Raises SessionError if
        the file is damaged where it plays.
        """
        self._dashboard, self._server = dashboard, server
        keys, playback = SimpleQueue[bytes](), self._playback
        with ExitStack() as stack:
            can = self._dashboard is not None and stack.enter_context(self._dashboard.keys(keys.put))
            self._send_parameters()
            self._jump()
            before_s = time.monotonic()
            while not playback.left and (can or not playback.at_end or self._controlled):
                self._wait()
                self._press(keys)
                now_s = time.monotonic()
                if playback.jumped:
                    self._jump()
                    now_s = time.monotonic()
                else:
                    playback.advance(now_s - before_s, _MOST_STEP_S)
                before_s = now_s
                self._go_on(can=can)
        if self._server is not None:
            self._server.leave()

    def _control(self, pause: bool, speed: float, seek_ns: int | None) -> None:
        seek_s = None if seek_ns is None else (seek_ns - self._blocks.zero_ns) * 1e-9
        self._playback.control(pause=pause, speed=speed, seek_s=seek_s)
        self._by_viewers = True

    @property
    def _controlled(self) -> bool:
        """Whether viewers control the playback, who may go back from the end."""
        return self._by_viewers and self._server is not None and self._server.viewers > 0

    def _state(self) -> PlaybackState:
        playback = self._playback
        status = _ENDED if playback.at_end else _PAUSED if playback.paused else _PLAYING
        return PlaybackState(status, self._place_ns, playback.speed)

    def _wait(self) -> None:
        if self._server is not None:
            self._server.listen(PERIOD_S)
        else:
            time.sleep(PERIOD_S)

    def _press(self, keys: SimpleQueue[bytes]) -> None:
        while True:
            try:
                self._playback.press(keys.get_nowait())
            except Empty:
                return

    @property
    def _place_ns(self) -> int:
        """UNIX time of the place, or just after the last row, in ns."""
        place_ns = round(self._playback.position_s * 1e9)
        return self._blocks.zero_ns + place_ns + int(self._playback.at_end)

    def _jump(self) -> None:
        """Begin at another place: draw the stop so far, and have viewers go there."""
        self._playback.jumped = False
        place_ns = self._place_ns
        stop = bisect_right(self._stops_ns, place_ns)
        longest_ns = place_ns - round(_LONGEST_TRACE_S * 1e9)
        begin_ns = max(self._stops_ns[stop - 1] if stop else self._blocks.zero_ns, longest_ns)
        self._histogram.clear()
        self._recent.clear()
        self._newest = None
        if self._dashboard is not None:
            self._dashboard.rewind(bisect_left(self._stops_ns, begin_ns))
            for ticks, _ in self._blocks.between(begin_ns, place_ns):
                self._draw_later(ticks)
        if self._server is not None and place_ns < self._next_ns:
            self._server.forget(LOG_TOPIC)
            self._server.forget(RESULT_TOPIC)
            self._logged, self._told = 0, False
        self._next_ns = place_ns
        self._drawn_s = -math.inf
        self._told_state = None

    def _go_on(self, *, can: bool) -> None:
        """Show all up to the present place."""
        place_ns = self._place_ns
        for ticks, truth in self._blocks.between(self._next_ns, place_ns):
            self._draw_later(ticks)
            self._send(TRUTH, truth)
            self._send(TICK, ticks)
        self._next_ns = max(place_ns, self._next_ns)
        if self._server is not None:
            self._send_log(place_ns)
            self._server.tell_time(place_ns)
            status, _, speed = self._state()
            if self._told_state != (status, speed):
                self._server.tell_state(did_seek=self._told_state is None)
                self._told_state = status, speed
        if self._dashboard is not None and time.monotonic() >= self._drawn_s + _DRAWN_S:
            self._drawn_s = time.monotonic()
            self._dashboard.describe(str(self._playback), KEYS if can else "Ctrl-C ends")
            self._draw(self._dashboard)

    def _draw_later(self, ticks: Rows) -> None:
        """Keep what the next picture shows of these ticks."""
        if self._dashboard is None or not len(ticks):
            return
        late_us = ticks["late_us"]
        self._histogram.add(late_us[np.isfinite(late_us)].tolist(), int(ticks["skipped"].sum()))
        drawn = ticks[ticks["tick"] % self._step == 0]
        self._recent += map(Point, *(drawn[name].tolist() for name in Point._fields))
        self._newest = ticks[-1:]

    def _draw(self, dashboard: Dashboard) -> None:
        if self._newest is None:  # nothing before this place
            return
        tick, place_s = self._newest[0], self._playback.position_s
        recent, self._recent = tuple(self._recent), []
        dashboard.show(snapshot_of(tick, int(tick["tick"]) + 1, place_s, self._histogram, recent))

    def _send(self, message: Message, rows: Rows) -> None:
        """Send the newest of these rows, and others evenly before it."""
        if self._server is None or not len(rows):
            return
        times_ns, plain = rows["time_ns"].tolist(), rows.view(f"V{rows.itemsize}")
        for at in range((len(rows) - 1) % -(-len(rows) // _MOST_SENT), len(rows), -(-len(rows) // _MOST_SENT)):
            self._server.send(message.topic, self._session.epoch_ns + times_ns[at], plain[at].tobytes())

    def _send_log(self, until_ns: int) -> None:
        server = self._server
        if server is None:
            return
        log = self._session.log
        while self._logged < len(log) and log[self._logged].unix_ns <= until_ns:
            entry = log[self._logged]
            server.send(LOG_TOPIC, entry.unix_ns, pack_event(*entry), keep=True)
            self._logged += 1
        card = stored_card(self._session.metadata)
        if self._playback.at_end and not self._told and card is not None:
            self._told = True
            server.send(RESULT_TOPIC, until_ns, pack_result({"lateness_us": {}, **card}), keep=True)

    def _send_parameters(self) -> None:
        if self._server is not None:
            for each in self._session.parameters:
                data = pack_parameters(each.values, each.tick)
                self._server.send(PARAMETERS_TOPIC, self._blocks.zero_ns, data, keep=True)


class _Blocks:
    """The rows of a session by UNIX time, of which two seconds are in memory."""

    def __init__(self, session: Session) -> None:
        self._session = session
        first, _ = session.rows.edges()
        self.zero_ns = session.epoch_ns + (int(first["time_ns"][0]) if len(first) else 0)
        """Of the first tick."""
        self._number = -1
        self._rows: tuple[Rows, ...] = ()

    def between(self, begin_ns: int, end_ns: int) -> Iterator[tuple[Rows, Rows]]:
        """Ticks and truth from `begin_ns` to before `end_ns`, block by block."""
        block_ns = round(_BLOCK_S * 1e9)
        for number in range((begin_ns - self.zero_ns) // block_ns, -((self.zero_ns - end_ns) // block_ns)):
            if number >= 0:
                ticks, truth = (self._part(rows, begin_ns, end_ns) for rows in self._block(number))
                yield ticks, truth

    def _block(self, number: int) -> tuple[Rows, ...]:
        if number != self._number:
            part = self._session[number * _BLOCK_S : (number + 1) * _BLOCK_S]
            self._number, self._rows = number, (part.ticks, part.truth)
        return self._rows

    def _part(self, rows: Rows, begin_ns: int, end_ns: int) -> Rows:
        times_ns = rows["time_ns"].astype(np.int64) + self._session.epoch_ns
        there = np.flatnonzero((times_ns >= begin_ns) & (times_ns < end_ns))
        return rows[there[0] : there[-1] + 1] if len(there) else rows[:0]
