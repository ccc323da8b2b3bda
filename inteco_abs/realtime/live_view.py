"""Serves a run to Lichtblick and Foxglove while it lasts, from a thread of the recorder's process.

It reads the rings a hundred times a second and takes nothing out of them, so the recording stays whole. Viewers get the
newest tick and state of the simulated rig each time, all events, the parameters, the result; and, when they call
`/abs/burst`, every tick of the last milliseconds.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import Any, Final

from inteco_abs.boards import simulated
from inteco_abs.control import swing_band
from inteco_abs.format import LOG_TOPIC, PARAMETERS_TOPIC, RESULT_TOPIC, TICK, TRUTH, pack_result
from inteco_abs.quantities import quantities
from inteco_abs.realtime.foxglove_server import PERIOD_S, Answer, FoxgloveServer, Service
from inteco_abs.realtime.gain_changes import ChangeTable
from inteco_abs.realtime.job import Job
from inteco_abs.realtime.memory import Field, Mailbox, RunMemory
from inteco_abs.sessions import (
    WARNING,
    StateEvents,
    event_channel,
    pack_change,
    pack_event,
    pack_parameters,
    parameter_channel,
    result_channel,
    row_channel,
)

BURST_TOPIC: Final = "/abs/burst"
"""Name of the service, and topic of its ticks."""
MOST_BURST_MS: Final = 2000
_SPARE: Final = 0.125
"""Share of the ring that the loop may fill while a burst is read."""
_BURST: Final = {
    "type": "object",
    "required": ["ms"],
    "properties": {"ms": {"type": "number", "exclusiveMinimum": 0, "maximum": MOST_BURST_MS}},
}
_SENT: Final = {
    "type": "object",
    "properties": {name: {"type": "integer"} for name in ("ticks", "first_tick", "last_tick")},
}


class LiveView:
    """What the recorder shows viewers that is not in the rings; `epoch_ns` as in the run's memory."""

    def __init__(self, epoch_ns: int) -> None:
        self._epoch_ns = epoch_ns
        self.shown: SimpleQueue[tuple[str, int, bytes]] = SimpleQueue()
        """Topic, UNIX time in ns and message."""

    def warn(self, text: str, time_ns: int | None = None) -> None:
        """Show a warning as an event, as of a monotonic time in ns, or of now."""
        stamp_ns = self._epoch_ns + (time.monotonic_ns() if time_ns is None else time_ns)
        self.shown.put((LOG_TOPIC, stamp_ns, pack_event(stamp_ns, WARNING, text)))

    def finish(self, card: Mapping[str, Any]) -> None:
        """Show the result card."""
        self.shown.put((RESULT_TOPIC, self._epoch_ns + time.monotonic_ns(), pack_result(card)))


@contextmanager
def live_view(memory: RunMemory, job: Job) -> Iterator[LiveView]:
    """Serve the run in `memory` inside the context if its job asks for it; LIVE_PORT then holds the port.

    Raises AbsError if the port is taken. A later failure ends the view only.
    """
    view = LiveView(memory.words[Field.EPOCH_NS])
    if job.live_port is None:
        yield view
        return
    server = _RunServer(memory, job, job.live_port, view)
    memory.words[Field.LIVE_PORT] = server.port
    try:
        yield view
    finally:
        server.close()


class _RunServer:
    """Serves the run from a thread of its own."""

    def __init__(self, memory: RunMemory, job: Job, port: int, view: LiveView) -> None:
        self._memory, self._job, self._view = memory, job, view
        self._ticks, self._truths = memory.tick_reader(), memory.truth_reader()
        self._epoch_ns: int = memory.words[Field.EPOCH_NS]
        self._next = self._next_truth = 0
        self._newest = b""
        self._described = False
        self._events = StateEvents(swing_band(job.config))
        channels = [
            row_channel(TICK),
            row_channel(TICK)._replace(topic=BURST_TOPIC),
            *([row_channel(TRUTH)] if simulated(job.board) else []),
            event_channel(),
            parameter_channel(),
            result_channel(),
        ]
        burst = Service(BURST_TOPIC, _BURST, _SENT, self._burst)
        self._server = FoxgloveServer(port, job.session_id, channels, [burst])
        self.port = self._server.port
        self._changes: ChangeTable | None = None
        self._shown_changes = 0
        self._over = Event()
        self._thread = Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Send the last tick, and stop."""
        self._over.set()
        self._thread.join()

    def _serve(self) -> None:
        try:
            while not self._over.is_set():
                self._server.listen(PERIOD_S)
                self._show()
            self._show()
            self._server.leave()
        except Exception as error:  # noqa: BLE001  a viewer must not end the recording
            print(f"inteco-abs: the live view has ended, and the run continues: {error}", file=sys.stderr)  # noqa: T201
        finally:
            self._server.close()

    def _show(self) -> None:
        """Send what is new: the newest tick and state, and all else."""
        if not self._described:
            self._describe()
        records, self._next = self._ticks.look(self._next)
        if records:
            self._show_events(records)
            self._show_changes(records)
            self._newest = records[-TICK.size :]
            self._server.send(TICK.topic, self._time_of(self._newest), self._newest)
        if self._newest and self._truths.written != self._next_truth:  # the file has no states from before the ticks
            self._next_truth, state = self._truths.written, self._truths.newest()
            if state is not None:
                ((time_ns,),) = TRUTH.values(state, ("time_ns",))
                self._server.send(TRUTH.topic, self._epoch_ns + time_ns, state)
        while True:
            try:
                message = self._view.shown.get_nowait()
            except Empty:
                return
            self._server.send(*message, keep=True)

    def _describe(self) -> None:
        """Send the gains, and the names of the controller's internal values, once they are known."""
        header = self._memory.note(Mailbox.HEADER)
        if header is None:
            return
        self._described = True
        for topic in (TICK.topic, BURST_TOPIC):
            self._server.describe(row_channel(TICK, quantities(header["internals"]))._replace(topic=topic))
        self._server.describe(parameter_channel(quantities(header["declared"])))
        self._changes = ChangeTable(self._memory, (each[0] for each in header["declared"]))
        gains = {"reference_slip": self._job.config.controller.reference_slip, **header["gains"]}
        now_ns = self._epoch_ns + time.monotonic_ns()
        self._server.send(PARAMETERS_TOPIC, now_ns, pack_parameters(gains), keep=True)

    def _show_changes(self, records: bytes) -> None:
        """Send the changes of gains up to the newest of these ticks, at the time of their tick."""
        rows = TICK.array(records)
        for change in self._changes.changes(self._shown_changes) if self._changes is not None else ():
            if change.tick > rows["tick"][-1]:
                return  # its tick comes
            self._shown_changes += 1
            stamp_ns = self._epoch_ns + int(rows["time_ns"][rows["tick"].searchsorted(change.tick)])
            data = pack_parameters({change.name: change.value}, change.tick)
            self._server.send(PARAMETERS_TOPIC, stamp_ns, data, keep=True)
            self._server.send(LOG_TOPIC, stamp_ns, pack_change(stamp_ns, change), keep=True)

    def _show_events(self, records: bytes) -> None:
        rows = TICK.array(records)
        for index, entries in self._events.among(rows):
            stamp_ns = self._epoch_ns + int(rows["time_ns"][index])
            for level, text in entries:
                self._server.send(LOG_TOPIC, stamp_ns, pack_event(stamp_ns, level, text), keep=True)

    def _time_of(self, record: bytes) -> int:
        ((time_ns,),) = TICK.values(record, ("time_ns",))
        return self._epoch_ns + int(time_ns)

    def _burst(self, request: Mapping[str, Any]) -> Answer:
        """Every tick of the last `ms` ms, copied now. Raises ValueError if memory does not hold them."""
        ms, rate_hz, written = request.get("ms"), self._job.config.loop.rate_hz, self._ticks.written
        if not isinstance(ms, int | float) or isinstance(ms, bool) or not 0 < ms <= MOST_BURST_MS:
            raise ValueError(f"ms is {ms!r}: must be a number above 0, at most {MOST_BURST_MS}")

        def whole_ms(ticks: int) -> int:
            return math.floor(ticks * 1e3 / rate_hz)

        number = math.ceil(ms * rate_hz / 1e3)
        if number > written:
            raise ValueError(f"ms is {ms}: the run has {whole_ms(written)} ms of ticks so far; ask for fewer")
        held = written - self._ticks.held_from(_SPARE)
        if number > held:
            raise ValueError(f"ms is {ms}: memory holds the last {whole_ms(held)} ms; ask for fewer")
        records, _ = self._ticks.look(written - number, number)
        rows = TICK.array(records)
        if len(rows) != number:
            raise ValueError(f"ms is {ms}: the loop overwrote ticks meanwhile; ask for fewer")
        packed = (records[at : at + TICK.size] for at in range(0, len(records), TICK.size))
        messages = ((self._time_of(record), record) for record in packed)
        numbers = {"first_tick": int(rows["tick"][0]), "last_tick": int(rows["tick"][-1])}
        return Answer(BURST_TOPIC, messages, {"ticks": number, **numbers})
