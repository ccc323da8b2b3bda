"""`Board`, the abstract interface of the device layer."""

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
    """Header of a board, and whether it may be driven."""

    logic_version: int
    application_name: str
    """Empty if the board reports none, as the PCI board."""
    synthesis_date: str
    """YYYYMMDD as the board reports it; empty likewise."""
    read_only_because: str
    """Empty if outputs may be used."""

    def facts(self) -> dict[str, str]:
        """Return the header as text, for the session."""
        return {
            "logic_version": f"0x{self.logic_version:04X}",
            "application_name": self.application_name,
            "synthesis_date": self.synthesis_date,
        }

    def __str__(self) -> str:
        name = f" {self.application_name!r}" if self.application_name else ""
        date = f" of {self.synthesis_date}" if self.synthesis_date else ""
        return f"logic 0x{self.logic_version:04X}{name}{date}"


class BoardReading(NamedTuple):
    """One reading of a board, decoded and raw."""

    values: Mapping[str, int | str]
    """Values by field name, as the board reports them: counters without the wiring's sign, and not unwrapped."""
    raw: bytes
    """The frame, or the registers in order."""


class Reading(NamedTuple):
    """A quantity that the board measures besides the wheels' angles, or one of its limits. For display only."""

    name: str
    value: float | None
    """None if the board's numbers give no value."""
    unit: str
    """Unit; `1` for a flag."""
    status: Status
    """How well the register is known; the meaning of the alarm flags is not."""
    meaning: str


class Board(ABC):
    """A board with the rig on it; a context manager.

    Every board guarantees: entering reads before it writes, and writes only to a board that its profile knows and
    trusts; the first write is SAFE; only `exchange` can energise an output; leaving in any way writes SAFE and reads it
    back, or raises UnsafeError.

    `now_ns` is the monotonic clock of the run, `period_ns` the nominal time between exchanges.
    """

    def __init__(self, now_ns: Callable[[], int], period_ns: int) -> None:
        self.link_errors = 0
        """Failed exchanges so far."""
        self.last_error: LinkError | None = None
        self.identity: Identity | None = None
        self.armed = False
        """Whether each exchange after a good one feeds the watchdog, if the wiring has one; nothing else does."""
        self.late_ns = 0
        """How late the newest `report` came, ns; 0 before the first."""
        self.skipped = 0
        """Ticks of the board between the newest `report` and the one before."""
        self._now_ns = now_ns
        self._period_ns = period_ns
        self._tick = 0
        self._ready = False
        self._raw = (0, 0)  # counters of wheel and road at the newest good exchange
        self._newest_ns = 0
        self._start_ns = 0  # of the current exchange
        self._wheel_count = 0
        self._road_count = 0

    engines: tuple[str, ...] = ()
    """Available ways to move an exchange's transfers, the usual one first; empty: no choice."""
    engine: str = ""
    """The engine in use; may be set between two exchanges."""
    hurried: bool = True
    """Whether an exchange gives up after two periods, as a loop needs it; a measurement waits longer."""

    @abstractmethod
    def identify(self) -> Identity:
        """Read the board's header; writes nothing. Raises LinkError if it does not answer in its protocol."""

    @abstractmethod
    def survey(self, names: Collection[str] = ()) -> BoardReading:
        """Read the named fields, or all, of a board that was entered or is only read; writes nothing.

        Raises LinkError if the board does not answer in its protocol, BoardError for an unknown field name.
        """

    def readings(self) -> list[Reading]:
        """Return what the board measures besides counts, and its limits; too slow for a tick. Raises BoardError."""
        return []

    @abstractmethod
    def first_write(self) -> list[PlannedWord]:
        """Return what entering the board would change; reads only, like `survey`.

        Raises BoardError if its settings cannot be kept, LinkError if it does not answer.
        """

    @abstractmethod
    def _prepare_image(self) -> None:
        """Build the output image, all outputs off; reads only. Raises BoardError or LinkError."""

    @abstractmethod
    def _start(self) -> tuple[int, int]:
        """Write the image and check that the board took it; return raw wheel and road counts."""

    @abstractmethod
    def _transfer(self, command: Command) -> tuple[int, int]:
        """Write `command`, read the board; return raw signed 32-bit wheel and road counts. Raises LinkError."""

    def _dated(self, now: int) -> int:
        """Return when the counts of the newest transfer were taken, ns; the transfer ended at `now`."""
        return now

    @abstractmethod
    def _write_safe(self) -> None:
        """Write SAFE and read it back; raises LinkError if the board does not report SAFE."""

    @property
    @abstractmethod
    def safe_image(self) -> bytes:
        """Bytes with which `rescue` makes this board safe from another process; valid once it was entered."""

    @abstractmethod
    def _load_safe_image(self, image: bytes) -> None:
        """Load the `safe_image` of the process that drove the board before; reads nothing."""

    @abstractmethod
    def _close(self) -> None:
        """Close the board."""

    def __enter__(self) -> Self:
        try:
            self.identity = self.identify()
            if not self.identity.read_only_because:
                self._prepare_image()
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
        """Identify and read the board inside the context without entering it, whether it may be driven or not.

        Writes nothing but the channel selection that reading a PCI board takes.
        `require_writable` says whether entering it would allow outputs; `exchange` is refused.
        """
        try:
            self.identity = self.identify()
            yield self
        finally:
            self._close()

    def begin(self) -> None:
        """Begin a run: the next sample is tick 0 and lasts one period; earlier ticks and errors do not count."""
        self._tick = 0
        self.link_errors = 0
        self.last_error = None

    def exchange(self, command: Command) -> Sample:
        """Write `command`, then read the board, once.

        A failed exchange repeats the last counts, with the flag STALE; one that took longer than a period has the flag
        SLOW; the guard limits both. Raises ReadOnlyError for a board that must not be driven, BoardError for
        one that is not open.
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

    def start_pacing(self) -> None:
        """Let the board's tick start the samples from now on, for `answer` and `report`; raises BoardError."""
        raise BoardError("this board has no tick: set loop.pace to computer")

    def answer(self, command: Command) -> None:
        """Send `command`, decided from the newest sample, for the board's next tick; waits for nothing."""
        raise NotImplementedError

    def report(self) -> Sample:
        """Wait for the board's next tick and return its sample, as `exchange` does."""
        raise NotImplementedError

    @property
    def watchdog_closed(self) -> bool | None:
        """Whether the watchdog's contact was closed at the newest good exchange; None if the wiring has no watchdog."""
        return None

    def make_safe(self) -> None:
        """Switch both outputs off and read that back.

        An interruption, Ctrl-C included, is raised only once the outputs are safe. Raises UnsafeError after three
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
            except BaseException as error:  # noqa: BLE001  raised below, once the outputs are off
                interruption = error
            else:
                break
        else:
            raise UnsafeError(f"SAFE could not be confirmed ({failure or interruption}). {STILL_ON}") from failure
        if interruption is not None:
            raise interruption

    def rescue(self, image: bytes) -> None:
        """Make the board of a dead process safe with its `safe_image`, and close it.

        For a board that was not entered; writes before it reads. Raises UnsafeError after three failures.
        """
        try:
            self._load_safe_image(image)
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

    def require_writable(self) -> Identity:
        """Return the identity of a board that may be driven; else raise ReadOnlyError with what the lab has to do."""
        identity = self.identity
        if identity is None or identity.read_only_because:
            because = identity.read_only_because if identity else "it was not identified"
            raise ReadOnlyError(f"the board ({identity}) opens for reading only: {because}")
        return identity

    def _refusal(self) -> BoardError:
        if self.identity is not None and self.identity.read_only_because:
            return ReadOnlyError(f"outputs are off: {self.identity.read_only_because}")
        return BoardError("the board is not open")
