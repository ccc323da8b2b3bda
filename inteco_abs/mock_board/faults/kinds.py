"""The kinds of faults, with what they mean and the value that each takes."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

_COUNTS: Final = float(1 << 31)


class FaultValue(NamedTuple):
    """The number after a fault's name, or one of a few words."""

    unit: str
    low: float = -math.inf
    high: float = math.inf
    default: float | None = None
    """None: it must be given."""
    words: tuple[str, ...] = ()
    """If there are any, the value is one of these, and kept as its place among them."""

    @property
    def usage(self) -> str:
        """How it is typed after the name."""
        typed = "=" + ("|".join(self.words) or (self.unit or f"{self.low:g}..{self.high:g}").upper())
        return typed if self.default is None else f"[{typed}]"

    @property
    def whole(self) -> bool:
        """Whether a fraction would mean nothing."""
        return self.unit in {"bit", "bits", "bytes", "counts"}

    @property
    def allowed(self) -> str:
        """What it may be."""
        number = "a whole number" if self.whole else "a number"
        return f"{number} in {self.low:.15g}..{self.high:.15g} {self.unit}".rstrip()


class FaultKind(NamedTuple):
    """One kind of fault."""

    meaning: str
    value: FaultValue | None = None
    lasting: bool = False
    """Whether it lasts for good unless told otherwise; else for one exchange."""


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
    "late": FaultKind("the exchange takes so much longer", _TIME),
    "overdue": FaultKind("the answer comes after its request has timed out, before the next one"),
    "twice": FaultKind("the answer comes twice"),
    "swap": FaultKind("the answer comes after the next one"),
    "stale": FaultKind("the answer is the one before again"),
    "corrupt": FaultKind("one bit of the answer flips; without a number, any", _BIT),
    "corrupt-command": FaultKind("one bit of what the host sends flips", _BIT),
    "cut": FaultKind("the answer ends after so many bytes", FaultValue("bytes", 0, 2048)),
    "splice": FaultKind(
        "so many bytes of the answer are new, the rest is of the one before", FaultValue("bytes", 1, 2048)
    ),
    "identity": FaultKind("another board's answer: its header is not the one that was identified", lasting=True),
    "stall": FaultKind("the board neither hears nor answers, and holds its outputs", lasting=True),
    "unplug": FaultKind("the cable is pulled, and the board holds its outputs", lasting=True),
    "reset": FaultKind(
        "the board starts anew: counters at zero, outputs as told",
        FaultValue("", default=0.0, words=("zero", "held", "random")),
    ),
    "master": FaultKind("another program repeats the strongest command it has heard, between ours", lasting=True),
    "pause": FaultKind("the computer stands still for so long, between two exchanges", _TIME),
}
"""Between the host and the board."""

ON_THE_RIG: Final[dict[str, FaultKind]] = {
    **{
        f"{wheel}-{name}": FaultKind(meaning.format(wheel), value, lasting)
        for wheel in ("road", "wheel")
        for name, meaning, value, lasting in (
            ("stuck", "the {} encoder's counter stands still", None, True),
            ("dither", "one of the {} encoder's two channels is dead: its counter goes to and fro", None, True),
            ("reversed", "the {} encoder counts the other way", None, True),
            ("noisy", "the {} encoder is off by up to so many counts, anew at each reading", _NOISE, True),
            ("jump", "the {} encoder's counter is off by so many counts from now on", _JUMP, True),
            ("slips", "the {} encoder loses this share of its counts", _SHARE, True),
        )
    },
    "encoders-swapped": FaultKind("each encoder's plug is in the other's socket", lasting=True),
    "drive-dead": FaultKind("the drive motor gets nothing", lasting=True),
    "drive-stuck": FaultKind("the drive motor gets this duty, whatever the board puts out", _SHARE, lasting=True),
    "brake-dead": FaultKind("the brake gets nothing", lasting=True),
    "brake-weak": FaultKind("the brake gets this share of its duty", _SHARE, lasting=True),
    "brake-stuck": FaultKind("the brake gets this duty, whatever the board puts out", _SHARE, lasting=True),
    "power-off": FaultKind("the power interface is off, as by the emergency switch", lasting=True),
    "watchdog-stuck": FaultKind(
        "the contact of the one-shot in the emergency chain does not open any more", lasting=True
    ),
    "supply": FaultKind(
        "the motors' supply has so many volts; below 12.3 V they get nothing here", _SUPPLY, lasting=True
    ),
    "heat": FaultKind("the power interface is so hot; above 80 degC the motors get nothing here", _HEAT, lasting=True),
    "alarm": FaultKind("in the panel: these alarm flags, 1, 2 and 4 added up, say the opposite", _ALARMS, lasting=True),
}
"""Between the board and the wheels."""

PROCESSES: Final = ("loop", "recorder", "guardian", "supervisor")
"""Of a run in real time."""
BY_PROCESS: Final[dict[str, FaultKind]] = {
    f"{process}-{name}": FaultKind(meaning.format(process), lasting=lasting)
    for process in PROCESSES
    for name, meaning, lasting in (
        ("killed", "the {}'s process is killed; in real time", False),
        ("frozen", "the {}'s process stands still; in real time", True),
    )
}
CLOCK_STEP: Final = "clock-step"
"""Only in virtual time: the wall clock of a real computer is everybody's."""
ON_THE_HOST: Final[dict[str, FaultKind]] = {
    "sleep": FaultKind("the computer sleeps for so long: its clock stands still, rig and board go on", _TIME),
    "disk-full": FaultKind("whoever writes the session finds no room for it on any disk", lasting=True),
    "file-gone": FaultKind("the session's file is removed while it is being written"),
    CLOCK_STEP: FaultKind("the computer's wall clock jumps by so long; in virtual time", _STEP),
    **BY_PROCESS,
}
"""With the computer."""

KINDS: Final = {**ON_THE_WIRE, **ON_THE_RIG, **ON_THE_HOST}
