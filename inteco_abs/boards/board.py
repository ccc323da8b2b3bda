"""Board, the abstract interface of the device layer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Final, NamedTuple, Self

from firmware_protocol import Status, signed32
from inteco_abs.boards.first_write import PlannedWord
from inteco_abs.errors import BoardError, LinkError, ReadOnlyError, UnsafeError
from inteco_abs.signals import BoardFlags, Command, Sample

_GOOD, _SLOW = BoardFlags.NONE, BoardFlags.SLOW
_SAFE_ATTEMPTS: Final = 3
STILL_ON: Final = "MOTOR POWER MAY STILL BE ON: press the emergency switch"


class Identity(NamedTuple):
    """What a board says of itself, and whether it may be driven."""

    logic_version: int
    application_name: str
    """Empty if the board tells none, as the one on the PCI bus."""
    synthesis_date: str
    """YYYYMMDD as the board tells it; empty likewise."""
    read_only_because: str
    """Empty if outputs may be used."""

    def facts(self) -> dict[str, str]:
        """The same as text, for the session."""
        return {
            "logic_version": f"0x{self.logic_version:04X}",
            "application_name": self.application_name,
            "synthesis_date": self.synthesis_date,
        }

    def __str__(self) -> str:
        told = f"logic 0x{self.logic_version:04X}"
        told += f" {self.application_name!r}" if self.application_name else ""
        return f"{told} of {self.synthesis_date}" if self.synthesis_date else told


class BoardReading(NamedTuple):
    """What one reading of a board says, decoded and as it came."""

    values: Mapping[str, int | str]
    """By field name, as the board tells them: counters with no sign or wrap of the wiring's applied."""
    raw: bytes
    """The frame, or the registers one after the other."""


class Reading(NamedTuple):
    """One of the quantities that the board measures besides the wheels' angles, or has as a limit. For show only."""

    name: str
    value: float | None
    """None if the board's numbers make no value."""
    unit: str
    """`1` for a flag."""
    status: Status
    """What is known of the register: the meaning of the alarm flags is not."""
    meaning: str


class Board(ABC):
    """A board with the rig on it; a context manager.

    Every board promises: entering reads before it writes, and writes only to a board that its profile knows and
    trusts; the first thing written is SAFE; `exchange` is the only call that can energise an output; leaving, by
    whatever way, leaves SAFE behind and has read it back, or raises UnsafeError saying that it has not.

    `now_ns` is the monotonic clock of the run, `period_ns` the nominal time between exchanges.
    """

    def __init__(self, now_ns: Callable[[], int], period_ns: int) -> None:
        self.link_errors = 0
        """Exchanges that failed so far."""
        self.last_error: LinkError | None = None
        self.identity: Identity | None = None
        self.armed = False
        """Whether each exchange after a good one feeds the watchdog, if the wiring has one. Nothing else ever does."""
        self._now_ns = now_ns
        self._period_ns = period_ns
        self._tick = 0
        self._ready = False
        self._raw = (0, 0)  # counters of wheel and road at the newest good exchange
        self._newest_ns = 0
        self._start_ns = 0  # of the exchange that goes on
        self._wheel_count = 0
        self._road_count = 0

    engines: tuple[str, ...] = ()
    """Ways to move an exchange's transfers that may be chosen from, the usual one first; empty: no choice."""
    engine: str = ""
    """The one in use; may be set between two exchanges."""
    hurried: bool = True
    """Whether an exchange gives up after a few periods, as a loop needs it; a measurement waits for slow answers."""

    @abstractmethod
    def identify(self) -> Identity:
        """Ask the board what it is; reads only. Raises LinkError if it does not answer in its protocol."""

    @abstractmethod
    def survey(self, names: Collection[str] = ()) -> BoardReading:
        """Read a board that was entered, or is only read, once, trust aside: the named fields, or all; writes nothing.

        Raises LinkError if the board does not answer in its protocol, BoardError if it has no field of such a name.
        """

    def readings(self) -> list[Reading]:
        """What the board measures besides counts, and its limits; takes too long for a tick. Raises BoardError."""
        return []

    @abstractmethod
    def first_write(self) -> list[PlannedWord]:
        """What entering the board would change; reads only, like `survey`.

        Raises BoardError for a board whose settings cannot be taken over, LinkError if it does not answer.
        """

    @abstractmethod
    def _take_over(self) -> None:
        """Build the output image, all outputs off; reads only. Raises BoardError or LinkError."""

    @abstractmethod
    def _start(self) -> tuple[int, int]:
        """Write the image and check that the board took it; raw wheel and road counts."""

    @abstractmethod
    def _transfer(self, command: Command) -> tuple[int, int]:
        """Write `command`, read the board; raw signed 32-bit wheel and road counts. Raises LinkError."""

    def _dated(self, now: int) -> int:
        """When the counts of the newest transfer were taken; `now` is when it was over."""
        return now

    @abstractmethod
    def _write_safe(self) -> None:
        """Write SAFE and read it back; raises LinkError if that is not what the board says it does."""

    @property
    @abstractmethod
    def safe_image(self) -> bytes:
        """What makes this board safe when another process writes it; to be kept once the board has been entered."""

    @abstractmethod
    def _adopt(self, image: bytes) -> None:
        """Take the `safe_image` of the process that drove the board before, without reading anything."""

    @abstractmethod
    def _close(self) -> None:
        """Let go of the board."""

    def __enter__(self) -> Self:
        try:
            self.identity = self.identify()
            if not self.identity.read_only_because:
                self._take_over()
                self._ready = True
                self._raw = self._start()
        except BaseException:
            self.__exit__(None, None, None)  # from the first write on, leaving means SAFE
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self._ready:
                self.make_safe()
        finally:
            self._ready = False
            self._close()

    @contextmanager
    def reading(self) -> Iterator[Self]:
        """Instead of entering it: a board that is identified and read, whoever has signed.

        Nothing is written to it but which of its channels is asked for, where the reading itself takes that (PCI).
        `insist` tells whether entering it would allow outputs; `exchange` is refused. Lets go of the board in the end.
        """
        try:
            self.identity = self.identify()
            yield self
        finally:
            self._close()

    def begin(self) -> None:
        """Begin a run: its first sample is tick 0 and lasts one period, however long ago the newest exchange was.

        What was exchanged before, to time the board, belongs to no run: neither its ticks nor its errors count.
        """
        self._tick = 0
        self.link_errors = 0
        self.last_error = None

    def exchange(self, command: Command) -> Sample:
        """Write `command`, then read the board, once.

        A failed exchange gives a sample that repeats the last counts and carries STALE, one that took longer than a
        period carries SLOW; the guard judges how many are too many. Raises ReadOnlyError on a board whose outputs are
        off, BoardError on one that is not open.
        """
        if not self._ready:
            raise self._refusal()
        start = self._start_ns = self._now_ns()
        try:
            wheel, road = self._transfer(command)
        except LinkError as error:
            self.link_errors += 1
            self.last_error = error
            return self._sample(self._now_ns(), BoardFlags.STALE)
        now = self._now_ns()
        wheel_before, road_before = self._raw
        self._raw = wheel, road
        self._wheel_count += signed32(wheel - wheel_before)
        self._road_count += signed32(road - road_before)
        return self._sample(self._dated(now), _GOOD if now - start <= self._period_ns else _SLOW)

    @property
    def watchdog_closed(self) -> bool | None:
        """Whether the watchdog's contact was closed at the newest good exchange; None if the wiring has no watchdog."""
        return None

    def make_safe(self) -> None:
        """De-energise both outputs and read it back.

        What interrupts it, Ctrl-C included, is raised only once the outputs are safe. Raises UnsafeError after three
        failures, BoardError if the board is not open.
        """
        if not self._ready:
            raise self._refusal()
        failure: LinkError | None = None
        interruption: BaseException | None = None
        for _ in range(_SAFE_ATTEMPTS):
            try:
                self._write_safe()
            except LinkError as error:
                failure = error
            except BaseException as error:  # noqa: BLE001  nothing may keep the outputs on; raised below
                interruption = error
            else:
                break
        else:
            raise UnsafeError(f"SAFE could not be confirmed ({failure or interruption}). {STILL_ON}") from failure
        if interruption is not None:
            raise interruption

    def rescue(self, image: bytes) -> None:
        """Make safe a board whose process is gone, with the `safe_image` that it left, and let go of it.

        For a board that was not entered. The write depends on no read. Raises UnsafeError after three failures.
        """
        try:
            self._adopt(image)
            self._ready = True
            self.make_safe()
        finally:
            self._ready = False
            self._close()

    def _sample(self, time_ns: int, flags: BoardFlags) -> Sample:
        tick, self._tick = self._tick, self._tick + 1
        dt_s = (time_ns - self._newest_ns if tick else self._period_ns) / 1e9
        self._newest_ns = time_ns
        return Sample(tick, time_ns, dt_s, self._wheel_count, self._road_count, flags)

    def insist(self) -> Identity:
        """Identity of a board that may be driven; raises ReadOnlyError saying what the lab has to do."""
        identity = self.identity
        if identity is None or identity.read_only_because:
            because = identity.read_only_because if identity else "it was not identified"
            raise ReadOnlyError(f"the board ({identity}) opens for reading only: {because}")
        return identity

    def _refusal(self) -> BoardError:
        if self.identity is not None and self.identity.read_only_because:
            return ReadOnlyError(f"outputs are off: {self.identity.read_only_because}")
        return BoardError("the board is not open")
