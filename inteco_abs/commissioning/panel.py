"""The manual panel without its screen: sliders, the hold-to-run key, counts since they were set to zero."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

from firmware_protocol.pwm import PWM_MODES
from inteco_abs.config import RigConfig
from inteco_abs.realtime.processes.manual import HELD_NS
from inteco_abs.signals import EXPLANATIONS, BoardFlags, Command, Reason

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

PHRASE: Final = "the cover is closed, my hand is at the emergency switch"
REQUEST: Final = (
    "The panel can turn the motors, up to the guard's limits, while a key is held. Power stays on for up to half a "
    "second after you release the key. A guardian process watches, but if the computer dies or the cable is pulled, "
    "only the emergency switch stops the motors.\nKeep hair, sleeves and fingers away; close the cover; lower the "
    "balance lever."
)
AGAIN: Final = (
    "Check the rig and repair what is wrong. Then press y to arm again: the board is closed, opened and identified "
    "again, and the guardian is drilled again. Counts and sliders begin at zero, and nothing turns until "
    "you hold the space bar.\nAny other key leaves the outputs off."
)
_RPM: Final = 9.549296585513721
"""rpm per rad/s: 60 / (2 pi)."""

Output = Literal["drive", "brake"]


class WheelState(NamedTuple):
    """Counts and speed of one wheel now."""

    name: str
    counts: int
    """Counts since the zero was set."""
    turns: float
    speed_rad_s: float
    """Mean over the last 0.1 s."""

    @property
    def speed_rpm(self) -> float:
        """Speed in revolutions per minute."""
        return self.speed_rad_s * _RPM


class Pwm(NamedTuple):
    """A PWM channel's settings as the board has them, and as the profile wants them."""

    output: Output
    channel: int
    mode: str
    prescaler: int
    fits: bool
    """Whether they are the profile's."""


class Panel:
    """What the operator has set, and what was last read from the rig.

    Sliders are in whole percent, up to the guard's limits. The key counts as held from its second event on, as a
    terminal repeats it: a tap does nothing, and a terminal does not report the release.
    """

    def __init__(self, config: RigConfig, *, outputs: bool) -> None:
        self.config = config
        self.outputs = outputs
        self.limits: dict[Output, int] = {
            "drive": int(config.guard.drive_limit * 100 + 1e-9),
            "brake": int(config.guard.brake_limit * 100 + 1e-9),
        }
        self.sliders: dict[Output, int] = {"drive": 0, "brake": 0}
        self.admitted = Command.SAFE
        """Last command that the guard admitted."""
        self.reason = Reason.NONE
        """Why the guard switched the outputs off; they return only by arming again."""
        self.flags = BoardFlags.NONE
        """Flags of the newest exchange."""
        self.failed = 0
        """Exchanges that failed or were slow so far."""
        self._pressed_ns = -HELD_NS
        self._held_ns = -HELD_NS
        self._counts = (0, 0)
        self._zero = (0, 0)
        self._speeds = (0.0, 0.0)

    @property
    def tripped(self) -> bool:
        """Whether the guard switched the outputs off, so that they may be armed again."""
        return self.outputs and self.reason is not Reason.NONE

    @property
    def request(self) -> Command:
        """Return the sliders' positions as duties."""
        return Command(self.sliders["drive"] / 100, self.sliders["brake"] / 100)

    def press(self, now_ns: int) -> bool:
        """Take a key event; return whether the key counts as held, so that the request is passed on."""
        repeated = now_ns - self._pressed_ns < HELD_NS
        self._pressed_ns = now_ns
        if repeated and self.outputs:
            self._held_ns = now_ns
        return repeated and self.outputs

    def release(self) -> None:
        """Take the hold-to-run key as released."""
        self._pressed_ns = self._held_ns = -HELD_NS

    def held(self, now_ns: int) -> bool:
        """Whether the key counts as held."""
        return now_ns - self._held_ns < HELD_NS

    def move(self, output: Output, percent: int) -> None:
        """Move a slider by `percent` within its limits; the key counts as released."""
        self.release()
        self.sliders[output] = min(max(self.sliders[output] + percent, 0), self.limits[output])

    def to_zero(self) -> None:
        """Move both sliders to zero."""
        self.release()
        self.sliders = {"drive": 0, "brake": 0}

    def zero_counts(self) -> None:
        """Set the shown counts to zero; the board's own counters go on, as the guard judges by them."""
        self._zero = self._counts

    def see(self, ticks: npt.NDArray[np.void]) -> None:
        """Take the ticks since the last call, oldest first."""
        if not len(ticks):
            return
        last = ticks[-1]
        self._counts = int(last["wheel_count"]), int(last["road_count"])
        self._speeds = float(last["wheel_speed_rad_s"]), float(last["road_speed_rad_s"])
        self.admitted = Command(float(last["drive"]), float(last["brake"]))
        self.reason = Reason(int(last["reason"]))
        self.flags = BoardFlags(int(last["board_flags"]))
        self.failed += int((ticks["board_flags"] != 0).sum())

    @property
    def wheels(self) -> tuple[WheelState, WheelState]:
        """Upper and lower wheel."""
        per_turn = self.config.encoders.counts_per_turn
        upper, lower = (
            WheelState(name, count - zero, (count - zero) / per_turn, speed)
            for name, count, zero, speed in zip(("upper", "lower"), self._counts, self._zero, self._speeds, strict=True)
        )
        return upper, lower

    def pwm(self, look: dict[str, Any]) -> list[Pwm]:
        """PWM settings of both channels in a reading of the whole board; empty if it failed."""
        board, values = self.config.board, look.get("values", {})
        found = []
        channels: tuple[tuple[Output, int], ...] = ("drive", board.drive_pwm), ("brake", board.brake_pwm)
        for output, channel in channels:
            if f"pwm{channel}_mode" in values:
                mode, prescaler = PWM_MODES[values[f"pwm{channel}_mode"]], values[f"pwm{channel}_prescaler"]
                fits = (mode, prescaler) == (board.pwm_mode, board.pwm_prescaler)
                found.append(Pwm(output, channel, mode, prescaler, fits))
        return found

    def state(self, now_ns: int) -> str:
        """One line: whether power is on, or why not."""
        if not self.outputs:
            return "WATCHING: nothing is written to the board; start with --outputs to move the motors"
        if self.reason is not Reason.NONE:
            return f"SWITCHED OFF: {EXPLANATIONS[self.reason]}. r: arm again"
        if self.admitted != Command.SAFE:
            return "POWER IS ON: release the key to switch it off"
        if self.held(now_ns):
            return "OFF: the key is held, but both sliders are at zero"
        return "OFF: hold the space bar to apply the sliders"
