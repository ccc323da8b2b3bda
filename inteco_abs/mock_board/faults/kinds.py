"""The kinds of faults, with their meaning and values."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

_COUNTS: Final = float(1 << 31)


class FaultValue(NamedTuple):
    """The value after a fault's name: a number or a word."""

    unit: str
    low: float = -math.inf
    high: float = math.inf
    default: float | None = None
    """Default value; None: the value is required."""
    words: tuple[str, ...] = ()
    """Allowed words, if the value is a word; a fault keeps its index."""

    @property
    def usage(self) -> str:
        """Notation after the name."""
        typed = "=" + ("|".join(self.words) or (self.unit or f"{self.low:g}..{self.high:g}").upper())
        return typed if self.default is None else f"[{typed}]"

    @property
    def whole(self) -> bool:
        """Whether the value must be an integer."""
        return self.unit in {"bit", "bits", "bytes", "counts"}

    @property
    def allowed(self) -> str:
        """Description of the allowed values."""
        number = "a whole number" if self.whole else "a number"
        return f"{number} in {self.low:.15g}..{self.high:.15g} {self.unit}".rstrip()


class FaultKind(NamedTuple):
    """One kind of fault."""

    meaning: str
    value: FaultValue | None = None
    lasting: bool = False
    """Whether it lasts to the end of the run by default, not for one exchange."""


_BIT: Final = FaultValue("bit", 0, 1 << 14, default=-1)
_SHARE: Final = FaultValue("", 0.0, 1.0)
_NOISE: Final = FaultValue("counts", 1, _COUNTS)
_JUMP: Final = FaultValue("counts", -_COUNTS, _COUNTS)
_TIME: Final = FaultValue("ms", 0.001, 60_000.0)
_STEP: Final = FaultValue("s", -1e9, 1e9)
_SUPPLY: Final = FaultValue("V", 0.0, 30.0)
_HEAT: Final = FaultValue("degC", -40.0, 150.0)
_ALARMS: Final = FaultValue("bits", 1, 7)

ON_THE_WIRE: Final[dict[str, FaultKind]] = {
    "lose": FaultKind("the answer is lost"),
    "lose-command": FaultKind("what the host sends is lost"),
    "late": FaultKind("the exchange takes this much longer", _TIME),
    "overdue": FaultKind("the answer arrives after its request has timed out, before the next one"),
    "twice": FaultKind("the answer arrives twice"),
    "swap": FaultKind("the answer arrives after the next one"),
    "stale": FaultKind("the previous answer arrives again"),
    "corrupt": FaultKind("one bit of the answer flips; without a number, a random one", _BIT),
    "corrupt-command": FaultKind("one bit of what the host sends flips", _BIT),
    "cut": FaultKind("the answer ends after this many bytes", FaultValue("bytes", 0, 2048)),
    "splice": FaultKind(
        "this many bytes of the answer are new, the rest is from the previous one", FaultValue("bytes", 1, 2048)
    ),
    "identity": FaultKind("another board's answer: its header is not the one that was identified", lasting=True),
    "stall": FaultKind("the board does not respond, and holds its outputs", lasting=True),
    "unplug": FaultKind("the cable is unplugged, and the board holds its outputs", lasting=True),
    "reset": FaultKind(
        "the board restarts: counters at zero, outputs as given",
        FaultValue("", default=0.0, words=("zero", "held", "random")),
    ),
    "master": FaultKind("another program repeats the strongest command so far, between ours", lasting=True),
    "pause": FaultKind("the computer stands still for this time, between two exchanges", _TIME),
}
"""Between the host and the board."""

ON_THE_RIG: Final[dict[str, FaultKind]] = {
    **{
        f"{wheel}-{name}": FaultKind(meaning.format(wheel), value, lasting)
        for wheel in ("road", "wheel")
        for name, meaning, value, lasting in (
            ("stuck", "the {} encoder's counter stands still", None, True),
            ("dither", "one of the {} encoder's two channels is dead: its counter alternates", None, True),
            ("reversed", "the {} encoder counts the other way", None, True),
            ("noisy", "each reading of the {} encoder has a random error of up to this many counts", _NOISE, True),
            ("jump", "the {} encoder's counter jumps by this many counts", _JUMP, True),
            ("slips", "the {} encoder loses this share of its counts", _SHARE, True),
        )
    },
    "encoders-swapped": FaultKind("each encoder's plug is in the other's socket", lasting=True),
    "drive-dead": FaultKind("the drive motor gets no power", lasting=True),
    "drive-stuck": FaultKind("the drive motor gets this duty, regardless of the board's output", _SHARE, lasting=True),
    "brake-dead": FaultKind("the brake gets no power", lasting=True),
    "brake-weak": FaultKind("the brake gets this share of its duty", _SHARE, lasting=True),
    "brake-stuck": FaultKind("the brake gets this duty, regardless of the board's output", _SHARE, lasting=True),
    "power-off": FaultKind("the power interface is off, as by the emergency switch", lasting=True),
    "watchdog-stuck": FaultKind("the contact of the one-shot in the emergency chain no longer opens", lasting=True),
    "supply": FaultKind(
        "the motors' supply has this voltage; below 12.3 V the mock gives them no power", _SUPPLY, lasting=True
    ),
    "heat": FaultKind(
        "the power interface is this hot; above 80 degC the mock gives the motors no power", _HEAT, lasting=True
    ),
    "alarm": FaultKind("in the panel: these alarm flags, the sum of 1, 2 and 4, are inverted", _ALARMS, lasting=True),
}
"""Between the board and the wheels."""

PROCESSES: Final = ("loop", "recorder", "guardian", "supervisor")
"""Processes of a real-time run."""
BY_PROCESS: Final[dict[str, FaultKind]] = {
    f"{process}-{name}": FaultKind(meaning.format(process), lasting=lasting)
    for process in PROCESSES
    for name, meaning, lasting in (
        ("killed", "the {}'s process is killed; in real time", False),
        ("frozen", "the {}'s process freezes; in real time", True),
    )
}
CLOCK_STEP: Final = "clock-step"
"""Only in virtual time: all programs share the wall clock of a real computer."""
ON_THE_HOST: Final[dict[str, FaultKind]] = {
    "sleep": FaultKind("the computer sleeps for this time: its clock stops, rig and board continue", _TIME),
    "disk-full": FaultKind("the process that writes the session finds every disk full", lasting=True),
    "file-gone": FaultKind("the session's file is removed while it is being written"),
    CLOCK_STEP: FaultKind("the computer's wall clock jumps by this time; in virtual time", _STEP),
    **BY_PROCESS,
}
"""Kinds of faults in the computer."""

KINDS: Final = {**ON_THE_WIRE, **ON_THE_RIG, **ON_THE_HOST}
