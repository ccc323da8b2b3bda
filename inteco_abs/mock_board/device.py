"""The device model of a mock board, with the simulated rig on its terminals.

It has echoed settings, PWM outputs, counters, digital pins and timers; front ends translate them to a wire. The
clock is a parameter, so that the same device runs in real and in virtual time.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from itertools import cycle
from typing import Final, Literal, NamedTuple

from firmware_protocol import signed32
from firmware_protocol.pwm import PWM_FULL_WIDTH
from firmware_protocol.rtdac_usb2 import TIMER_HZ
from inteco_abs.config import RigConfig, SimulationConfig
from inteco_abs.mock_board.family import mock_family
from inteco_abs.mock_board.simulated_rig import roads_of_stops, simulated_rig
from inteco_abs.rig import WORD, Encoder, Plant, mixed

_TIMER_RANGE: Final = 1 << 32
MINIMUM_SUPPLY_V: Final = 12.3
MAXIMUM_CELSIUS: Final = 80.0
"""The PCI board's limits on the manual's screens (docs/facts/boards.md#pci-registers-of-the-abs-logic)."""


class Truth(NamedTuple):
    """State of the simulated rig at one instant."""

    time_ns: int
    wheel_speed_rad_s: float
    road_speed_rad_s: float
    slip: float
    brake_torque_nm: float
    drive: float
    """Duty at the drive's terminals from this instant on, 0..1."""
    brake: float
    """Duty at the brake's terminals from this instant on, 0..1."""
    adhesion: float


@dataclass(frozen=True, slots=True)
class Cable:
    """Channels and directions of the rig's plugs on the board; the defaults are those of the vendor's PCI version."""

    drive_pwm: int = 0
    brake_pwm: int = 1
    road_encoder: int = 0
    wheel_encoder: int = 1
    road_sign: int = 1
    """-1: the encoder counts down when driving."""
    wheel_sign: int = 1
    watchdog_pin: int = -1
    """Pin that feeds the one-shot in the power chain; -1 for none."""
    watchdog_contact_pin: int = -1
    watchdog_hold_s: float = 0.05

    @classmethod
    def of(cls, simulation: SimulationConfig) -> Cable:
        """Return the cable that the configuration describes."""
        return cls(**{each.name: getattr(simulation, each.name) for each in fields(cls)})


class PowerInterface(NamedTuple):
    """Measurements of the power interface between the board and the motors."""

    supply_v: float = 24.0
    """Supply voltage; a guess."""
    temperature_celsius: float = 21.0
    """Temperature as on the manual's screens."""
    alarms: int = 0b111
    """All three flags are on in the manual's screens, with no fault and the motor turning (K2)."""

    @property
    def works(self) -> bool:
        """Whether the motors get the board's outputs.

        INFERRED for all boards from the PCI board's limits; those of the power interface itself are unknown.
        """
        return self.supply_v >= MINIMUM_SUPPLY_V and self.temperature_celsius <= MAXIMUM_CELSIUS


class _HandTurn(NamedTuple):
    """A turn of the wheels by hand, at constant speeds."""

    wheel_rad_per_ns: float
    road_rad_per_ns: float
    end_ns: int


class QuadratureCounter:
    """32-bit counter that wraps; its reset bit holds it at zero while set.

    `offset` is its value at power-up; with `sign` -1 it counts down when driving. A noisy encoder gives a different
    reading each time.
    """

    def __init__(self, encoder: Encoder, sign: int, offset: int) -> None:
        self._encoder = encoder
        self._sign = sign
        self._offset = offset
        self._held = False

    def hold(self, held: bool, angle_rad: float) -> None:
        """Set or clear the reset bit with the wheel at `angle_rad`."""
        if held or self._held:
            self._offset = -self._edges(angle_rad)
        self._held = held

    @property
    def free(self) -> bool:
        """Whether its reset bit is clear."""
        return not self._held

    @property
    def sign_and_offset(self) -> tuple[int, int]:
        """What makes the counter's value of the encoder's count."""
        return self._sign, self._offset

    @property
    def encoder(self) -> Encoder:
        """The encoder on this counter."""
        return self._encoder

    def value(self, angle_rad: float, speed_rad_s: float) -> int:
        """Return the count as two's complement, -2^31..2^31-1, with the wheel at `angle_rad` and this speed."""
        return 0 if self._held else signed32(self._edges(angle_rad, speed_rad_s) + self._offset)

    def begin_at(self, value: int, angle_rad: float) -> None:
        """Set the count to `value` with the wheel at `angle_rad`, as after another power-up."""
        self._offset = value - self._edges(angle_rad)

    def _edges(self, angle_rad: float, speed_rad_s: float = 0.0) -> int:
        return self._sign * self._encoder.read(angle_rad, speed_rad_s)


class Terminals(NamedTuple):
    """What is at a device's terminals, for `take_command` and `give_counts`."""

    noise_seed: int
    """Seed of the encoders' noise, and the number of readings so far."""
    readings: int
    drive_full: int
    """Width of duty 1; 0 for a channel that is not connected."""
    brake_full: int
    wheel: QuadratureCounter
    road: QuadratureCounter
    time_ns: int


class Device:
    """A board with the rig on its terminals, at rest, all settings zero, as after power-up.

    `now_ns` is the clock; each access first advances the rig to it. `seed` decides what differs between two power-ups:
    the counts, and the encoders' positions between two edges; for a drawn rig, which has its own positions, the noise
    of their readings (seed 0 gives that of `Encoder`). `observe` receives the rig's true state after every write, with
    the new duties.

    The board's PWM quantizes a duty first, then the drawn rig rounds it down to its own steps: a rig with 255 steps
    keeps an 8-bit width exactly and loses the lowest bits of a 12-bit one.

    Raises ConfigError for an invalid drawn rig.
    """

    def __init__(
        self,
        config: RigConfig,
        now_ns: Callable[[], int],
        seed: int = 0,
        observe: Callable[[Truth], None] | None = None,
        cable: Cable | None = None,
    ) -> None:
        self.settings: dict[str, int] = {}
        self.cable = cable or Cable.of(config.simulation)
        self.kind = config.board.kind
        self.logic_version = config.board.logic_version
        self.frame_map = config.board.frame_map
        self._connected = mock_family(self.kind).connected(config.board)
        generator = random.Random(seed)
        road_edge, road_offset = generator.random(), generator.getrandbits(32)
        wheel_edge, wheel_offset = generator.random(), generator.getrandbits(32)
        road_sign, wheel_sign = self.cable.road_sign, self.cable.wheel_sign
        rig = simulated_rig(config, _seen_from(wheel_sign, wheel_edge), _seen_from(road_sign, road_edge))
        self._rig, self._roads = rig, cycle(roads_of_stops(config, rig))
        self._changes_road, self._on_road = config.simulation.roads is not None, False
        self.plant = Plant(rig, 0.0, 0.0)
        noisy = replace(rig, seed=rig.seed ^ mixed(seed & WORD))  # mixed(0) is 0
        self._road = QuadratureCounter(Encoder(noisy, wheel=False), road_sign, road_offset)
        self._wheel = QuadratureCounter(Encoder(noisy, wheel=True), wheel_sign, wheel_offset)
        self._now_ns = now_ns
        self._time_ns = now_ns()
        self._timer_start_ns = [self._time_ns, self._time_ns]
        self._observe = observe
        self._duties = (0.0, 0.0)
        self._powered = True
        self._watched = self.cable.watchdog_pin >= 0
        self._hold_ns = round(self.cable.watchdog_hold_s * 1e9)
        self._level = 0
        self._opens_ns = -1  # when the one-shot's contact opens; -1 while it is open
        self._hand: _HandTurn | None = None
        self._due_ns = -1  # when `_act` is due; -1: nothing is
        self._act: Callable[[], None] = _nothing

    @property
    def power_interface(self) -> PowerInterface:
        """The present measurements of the power interface."""
        return PowerInterface()

    @property
    def duties(self) -> tuple[float, float]:
        """Duties of drive and brake at the motors' terminals, 0..1."""
        return self._duties

    def terminals(self) -> Terminals | None:
        """Return what is at the terminals while only widths change; None while more happens there, or to the road."""
        wheel, road = self._wheel, self._road
        steady = self._powered and not self._watched and self._hand is None and wheel.free and road.free
        steady = steady and self._due_ns < 0
        if not steady or self._changes_road or wheel.encoder.readings != road.encoder.readings:
            return None
        drive, brake = (self._full_width(channel) for channel in (self.cable.drive_pwm, self.cable.brake_pwm))
        return Terminals(wheel.encoder.seed, wheel.encoder.readings, drive, brake, wheel, road, self._time_ns)

    def resume(self, time_ns: int, readings: int, duties: tuple[float, float], widths: tuple[int, int]) -> None:
        """Go on at `time_ns` with the plant moved there, these widths written, and so many readings of the encoders."""
        cable = self.cable
        self._time_ns, self._duties = time_ns, duties
        self.settings[f"pwm{cable.drive_pwm}_width"], self.settings[f"pwm{cable.brake_pwm}_width"] = widths
        self._wheel.encoder.readings = self._road.encoder.readings = readings

    def power(self, *, on: bool) -> None:
        """Switch the power interface between board and motors, which is on at first."""
        self.catch_up()
        self._powered = on
        self._update_duties()
        self.observe()

    def turn(self, which: Literal["wheel", "road"], turns: float, seconds: float, *, lifted: bool = True) -> None:
        """Begin to turn one wheel by hand at constant speed: `turns`, positive forwards, in `seconds` > 0.

        With the lever lifted the other wheel stays; otherwise it rolls along. Drive and brake act as well.
        """
        self.catch_up()
        rate = 2.0 * math.pi * turns / (seconds * 1e9)
        k = self.plant.parameters
        along = 0.0 if lifted else rate
        wheel, road = (rate, along * k.r1 / k.r2) if which == "wheel" else (along * k.r2 / k.r1, rate)
        self._hand = _HandTurn(wheel, road, self._time_ns + round(seconds * 1e9))

    def write(self, settings: Mapping[str, int]) -> None:
        """Apply settings, named as in the SEND frame, and inform the observer."""
        self.apply(settings)
        self.observe()

    def apply(self, settings: Mapping[str, int]) -> None:
        """Apply settings without informing the observer: others of the same command follow."""
        self.catch_up()
        before = self.settings.get("timer_reset", 0)
        self.settings.update(settings)
        if self._watched:
            self._feed()
        self._hold_counters()
        for i in range(2):
            if (before | self.settings.get("timer_reset", 0)) >> i & 1:
                self._timer_start_ns[i] = self._time_ns
        self._update_duties()

    def write_quickly(self, drive: int, brake: int, pin_output: int) -> None:
        """Apply only the two PWM widths of the rig and the pins' latch."""
        self.catch_up()
        self.settings["pin_output"] = pin_output
        if self._watched:
            self._feed()
        cable = self.cable
        self.settings[f"pwm{cable.drive_pwm}_width"] = drive
        self.settings[f"pwm{cable.brake_pwm}_width"] = brake
        self._update_duties()
        self.observe()

    def observe(self) -> None:
        """Pass the rig's true state to the observer, if there is one."""
        if self._observe is not None:
            self._observe(self.truth())

    def truth(self) -> Truth:
        """Return the rig's true state now."""
        self.catch_up()
        plant = self.plant
        state = plant.wheel_speed, plant.road_speed, plant.slip, plant.brake_torque
        return Truth(self._time_ns, *state, *self._duties, plant.adhesion)

    def counts(self) -> tuple[int, int]:
        """Read both encoders once; return the counts of road and wheel as two's complement."""
        self.catch_up()
        plant = self.plant
        road = self._road.value(plant.road_angle, plant.road_speed)
        return road, self._wheel.value(plant.wheel_angle, plant.wheel_speed)

    def begin_counts(self, road: int, wheel: int) -> None:
        """Set the counters to these values, as after another power-up."""
        self.catch_up()
        self._road.begin_at(road, self.plant.road_angle)
        self._wheel.begin_at(wheel, self.plant.wheel_angle)

    def pins(self) -> int:
        """Return the levels of the digital pins: outputs read back, the one-shot's contact drives its input."""
        levels = self._output_levels()
        return levels | 1 << self.cable.watchdog_contact_pin if self._opens_ns >= 0 else levels

    def _output_levels(self) -> int:
        return self.settings.get("pin_output", 0) & ~self.settings.get("pin_direction", 0)

    def timer(self, i: int) -> int:
        """Return timer/counter `i`: the time since its reset in timer mode, 0 in counter mode, as its input is open."""
        if not self.timer_runs(i):
            return 0
        return (self._time_ns - self._timer_start_ns[i]) * TIMER_HZ // 1_000_000_000 % _TIMER_RANGE

    def timer_runs(self, i: int) -> bool:
        """Return whether timer/counter `i` is in timer mode and not held at zero."""
        get = self.settings.get
        return bool(get("timer_mode", 0) >> i & 1 and not get("timer_reset", 0) >> i & 1)

    @property
    def time_ns(self) -> int:
        """Time up to which the rig has advanced, ns."""
        return self._time_ns

    @property
    def due_ns(self) -> int:
        """When the board's firmware acts by itself, ns; negative if it does not."""
        return self._due_ns

    def act_at(self, time_ns: int, act: Callable[[], None] | None) -> None:
        """Call `act` once when the rig comes to `time_ns`, instead of an earlier one; None: nothing."""
        self._due_ns, self._act = (-1, _nothing) if act is None else (time_ns, act)

    def catch_up(self) -> None:
        """Advance the rig to the present."""
        now = self._now_ns()
        while 0 <= self._due_ns <= now:
            due, act = max(self._due_ns, self._time_ns), self._act
            self._due_ns = -1
            with self._stopped_at(due):
                self.catch_up()
                act()
        if self._time_ns < self._opens_ns < now:
            self._advance(self._opens_ns)
        if 0 <= self._opens_ns < now and self._contact_opens():
            self._opens_ns = -1
            self._update_duties()
            with self._stopped_at(self._time_ns):
                self.observe()
        if now > self._time_ns:
            self._advance(now)

    def _advance(self, until: int) -> None:
        drive, brake = self._motors()
        if self._changes_road:
            self._change_road(drive, brake)
        self.plant.advance(drive, brake, (until - self._time_ns) / 1e9)
        if self._hand is not None:
            self._turn_by_hand(self._hand, until)
        self._time_ns = until

    def _change_road(self, drive: float, brake: float) -> None:
        """Brake on the road of this stop, and drive on the rig's own, on which both wheels spin up."""
        if drive > 0.0:
            if self._on_road:
                self.plant.take_road(self._rig)
            self._on_road = False
        elif brake > 0.0 and not self._on_road:
            self.plant.take_road(next(self._roads))
            self._on_road = True

    def _feed(self) -> None:
        """Restart the one-shot, which closes its contact, if its input level has changed."""
        level = self._output_levels() & 1 << self.cable.watchdog_pin
        if level != self._level:
            self._level, self._opens_ns = level, self._time_ns + self._hold_ns

    def _contact_opens(self) -> bool:
        """Return whether the one-shot's contact opens after its time; a fault may prevent it."""
        return True

    @contextmanager
    def instant(self) -> Iterator[None]:
        """Stop the rig's time inside the context."""
        self.catch_up()
        with self._stopped_at(self._time_ns):
            yield

    @contextmanager
    def _stopped_at(self, time_ns: int) -> Iterator[None]:
        now_ns = self._now_ns
        self._now_ns = lambda: time_ns
        try:
            yield
        finally:
            self._now_ns = now_ns

    def _motors(self) -> tuple[float, float]:
        """Return the duties that reach drive and brake."""
        return self._duties

    def _turn_by_hand(self, hand: _HandTurn, now: int) -> None:
        moved_ns = min(now, hand.end_ns) - self._time_ns
        self.plant.wheel_angle += hand.wheel_rad_per_ns * moved_ns
        self.plant.road_angle += hand.road_rad_per_ns * moved_ns
        if now >= hand.end_ns:
            self._hand = None

    def _update_duties(self) -> None:
        if self._powered and (self._opens_ns >= 0 or not self._watched):
            self._duties = (self._duty(self.cable.drive_pwm), self._duty(self.cable.brake_pwm))
        else:
            self._duties = (0.0, 0.0)

    def _duty(self, channel: int) -> float:
        """Return the duty of a channel, 0..1; 0 if its pin is not an output with PWM function.

        The prescaler sets only the frequency; the motors' inertia averages every frequency in use.
        """
        full = self._full_width(channel)
        return (self.settings.get(f"pwm{channel}_width", 0) & full) / full if full else 0.0

    def _full_width(self, channel: int) -> int:
        """Return the width of duty 1; 0 for a channel that is not connected."""
        connected = self._connected(self.settings, channel)
        return PWM_FULL_WIDTH[self.settings.get(f"pwm{channel}_mode", 0)] if connected else 0

    def _hold_counters(self) -> None:
        reset = self.settings.get("encoder_reset", 0)
        self._road.hold(bool(reset >> self.cable.road_encoder & 1), self.plant.road_angle)
        self._wheel.hold(bool(reset >> self.cable.wheel_encoder & 1), self.plant.wheel_angle)


def _nothing() -> None:
    """Do nothing."""


def _seen_from(sign: int, edge: float) -> float:
    """Return the position between two lines at which an encoder with this `sign` has the same count."""
    return edge if sign > 0 else 1.0 - edge
