"""The sections of rig.toml: every key with its type, range, default and meaning.

The module is cheap to import for the processes of a run; `validation` checks TOML by the same declarations.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, field, fields
from datetime import date
from functools import cache
from types import NoneType
from typing import Annotated, Any, ClassVar, Final, Literal, TypeGuard, cast, get_args, get_origin, get_type_hints

from annotated_types import Interval, MaxLen, MinLen

from firmware_protocol.rtdac_usb2 import TIMER_HZ
from firmware_protocol.rtdac_usb2_bridge import MANUFACTURER
from inteco_abs.quantities import unit_of

DEFAULT_PROFILE: Final = "sim_usb2"
MOCK_NAMES: Final = ("ABSSIM", "ABSIM", "OPENSIM")
"""Names that the mock boards report, and no real board has."""

Table = dict[str, Any]
PwmMode = Literal["8-bit", "12-bit"]


class Section:
    """A section of rig.toml. Change a value with `dataclasses.replace`, which does not check it."""

    __slots__ = ()
    __pydantic_config__: ClassVar = {"extra": "forbid", "strict": True, "allow_inf_nan": False}

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        """Let pydantic accept a table for a section; its values are checked strictly."""
        return handler(source) | {"strict": False}

    def as_table(self) -> Table:
        """Keys and values as in TOML, which has no None: keys without a value are left out."""
        table: Table = asdict(self, dict_factory=_given)  # type: ignore[call-overload]  # every section is a dataclass
        return table


def _given(pairs: list[tuple[str, Any]]) -> Table:
    return {key: value for key, value in pairs if value is not None}


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence(Section):
    """Status and source of a profile's statement about board or wiring."""

    status: Literal["confirmed", "inferred", "unknown"]
    source: str = ""
    """Manual, driver or test that states it, or what it is inferred from."""


WIRING: Final = (
    "drive_pwm", "brake_pwm", "pwm_mode", "pwm_prescaler", "pwm_pins", "pwm_functions", "numbering_pwm",
    "numbering_pins", "timer", "frame_map", "constants", "watchdog_pin", "watchdog_contact_pin", "road_encoder",
    "wheel_encoder", "road_sign", "wheel_sign", "counts_per_turn",
)  # fmt: skip
"""Keys that outputs depend on: of [board], and `encoders.counts_per_turn`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardConfig(Section):
    """The board and how the rig is wired to it. Comes from a profile."""

    kind: str = "usb2"
    """Board family: usb2 for RT-DAC/USB2, usb for RT-DAC/USB of the first generation, pci for RT-DAC4/PCI, open for the
    open board, or one of an installed package."""
    logic_version: Annotated[int, Interval(ge=0, le=0xFFFF)]
    """Version of the FPGA logic that this wiring was checked with."""
    application_names: list[str] = field(default_factory=list)
    """Names of the logic that may be driven; any other opens read-only. The PCI board reports none."""
    simulated: bool = False
    """Whether the profile is for the mock: nothing in it was checked on a rig, and its guard's limits have no ceilings
    but their ranges."""
    read_only: str = ""
    """Why outputs must always stay off; empty: they may be used."""
    verified_by: str = ""
    """Who checked this wiring on the rig: the sign-off. Without it, a board opens read-only if its outputs depend on
    anything that is not confirmed."""
    verified_on: date | None = None
    """Day of the sign-off."""
    verified_logic: Annotated[int, Interval(ge=0, le=0xFFFF)] | None = None
    """Version of the logic that the board had then; the sign-off holds for no other."""
    drive_pwm: Annotated[int, Interval(ge=0, le=7)] = 0
    """PWM channel of the drive motor."""
    brake_pwm: Annotated[int, Interval(ge=0, le=7)] = 1
    """PWM channel of the brake."""
    pwm_mode: PwmMode = "8-bit"
    """Resolution of the PWM: 255 or 4095 steps of a period."""
    pwm_prescaler: Annotated[int, Interval(ge=0, le=65535)] = 44
    """44 in 8-bit mode is 3486 Hz, the nearest to the paper's 3.5 kHz."""
    pwm_pins: list[Annotated[int, Interval(ge=0, le=25)]] = field(default_factory=lambda: [2, 5])
    """CN1 pins switched to output; not on the PCI board."""
    pwm_functions: list[Annotated[int, Interval(ge=0, le=25)]] | None = None
    """Bits of the pin mode that switch pins to their PWM function; as `pwm_pins` if not given."""
    numbering_pwm: Annotated[int, Interval(ge=-1, le=7)] = -1
    """PWM channel that is wired to nothing: its prescaler carries the number of each frame, which the board echoes, so
    that a late or repeated answer is recognised. -1: none is free."""
    numbering_pins: Annotated[list[Annotated[int, Interval(ge=0, le=25)]], MaxLen(8)] = field(default_factory=list)
    """CN1 pins whose output latch drives nothing, as those of inputs: their latch carries that number as well, where
    neither a PWM channel nor a timer is free. With n pins, answers late by a multiple of 2^n go unnoticed."""
    timer: Annotated[int, Interval(ge=-1, le=1)] = -1
    """Timer/counter channel that nothing else uses: it runs free as the clock of the samples, which dates them exactly
    and shows an answer that is older than its request. -1: none; samples are dated when they arrive."""
    timer_hz: Annotated[int, Interval(ge=1_000_000, le=100_000_000)] = TIMER_HZ
    """Rate of that timer."""
    frame_map: Literal["generic", "servo", "tras", "rpend", "abs"] = "generic"
    """Frame map of an RT-DAC/USB2's logic: the generic one, or that of a rig. `abs` has what the known rigs have in
    common. Words that a map does not name are sent back as the board had them. Other boards go by the version."""
    constants: dict[str, Annotated[int, Interval(ge=0, le=0xFFFF_FFFF)]] = field(default_factory=dict)
    """Further values that are sent in every frame: a field of the SEND frame by its name,
    which the board must echo; the output of a CN1 pin, as `pin21 = 0`; or a whole word, as `w31 = 3` (on the first
    RT-DAC/USB a byte, as `b77 = 1`), which need not be echoed. Not on the PCI board."""
    watchdog_pin: Annotated[int, Interval(ge=-1, le=25)] = -1
    """CN1 pin, an output, that changes its level with every good tick: it feeds a one-shot outside of the computer that
    cuts the motors' power (docs/watchdog.md). -1: there is none."""
    watchdog_contact_pin: Annotated[int, Interval(ge=-1, le=25)] = -1
    """CN1 pin, an input, that is high while the one-shot's contact is closed; a watchdog is used only with it."""
    watchdog_ms: Annotated[int, Interval(ge=2, le=100)] = 20
    """Open board: it switches its outputs off by itself when no command has come for this long, and for four
    periods of the loop: 40 ms in the panel, whose loop is slower."""
    stop_pins: list[Annotated[int, Interval(ge=0, le=15)]] = field(default_factory=list)
    """Open board: inputs that must be high while outputs are on, such as a second contact of the emergency switch."""
    baud: Annotated[int, Interval(ge=9600, le=12_000_000)] = 1_000_000
    """Open board: rate of its serial line, bit/s; a board with USB of its own ignores it."""
    road_encoder: Annotated[int, Interval(ge=0, le=11)] = 0
    """Encoder channel of the lower wheel, which stands for the road."""
    wheel_encoder: Annotated[int, Interval(ge=0, le=11)] = 1
    """Encoder channel of the upper, braked wheel."""
    road_sign: Literal[1, -1] = 1
    """-1 where the road's encoder counts down when the drive turns it."""
    wheel_sign: Literal[1, -1] = 1
    """-1 where the wheel's encoder counts down when the drive turns it."""
    evidence: dict[str, Evidence] = field(default_factory=dict)
    """Status of each of `WIRING`; a key that is missing is unknown."""

    def unconfirmed(self, meaningless: Collection[str]) -> list[str]:
        """Keys that outputs depend on and that are not confirmed, with status; without those `meaningless` here."""
        relied_on = [key for key in self._relied_on() if key not in meaningless]
        statuses = {key: self.evidence[key].status if key in self.evidence else "unknown" for key in relied_on}
        return [f"{key} ({status})" for key, status in statuses.items() if status != "confirmed"]

    def _relied_on(self) -> Iterator[str]:
        unused = {"pwm_functions"} if self.pwm_functions is None else set()
        if self.numbering_pwm < 0:
            unused.add("numbering_pwm")
        unused |= {key for key in ("timer", "watchdog_pin", "watchdog_contact_pin") if getattr(self, key) < 0}
        unused |= {key for key in ("numbering_pins", "constants") if not getattr(self, key)}
        return (key for key in WIRING if key not in unused)


@dataclass(frozen=True, slots=True, kw_only=True)
class UsbConfig(Section):
    """How an RT-DAC/USB2 is found. The vendor's software goes by the manufacturer's name alone."""

    vendor_id: Annotated[int, Interval(ge=0, le=0xFFFF)] | None = None
    """Any, if not given: UNKNOWN, though probably that of Cypress, the maker of the bridge."""
    product_id: Annotated[int, Interval(ge=0, le=0xFFFF)] | None = None
    """Any, if not given: UNKNOWN."""
    manufacturer: Annotated[str, MinLen(1)] = MANUFACTURER
    """CONFIRMED: the string that the vendor's software looks for; here upper and lower case are the same."""
    engine: Literal["faster", "one-by-one", "queued"] = "faster"
    """How a tick's three transfers are handed over: queued, or one by one; `faster` queues them unless whole exchanges,
    timed when the board has been opened, are quicker one by one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EncodersConfig(Section):
    counts_per_turn: Annotated[int, Interval(ge=256, le=1_000_000)] = 2048
    """Quadrature counts per turn of both wheels: 2048 in the paper, 4096 on the vendor's rig."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopConfig(Section):
    rate_hz: Annotated[float, Interval(ge=50.0, le=10_000.0)] = 2000.0
    """Rate of the loop: exchanges with the board per second."""
    pace: Literal["computer", "board"] = "computer"
    """Whose clock starts the ticks: the computer's, or the board's, on boards that have a tick (the open board)."""
    compiled: bool = False
    """Whether the loop decides in machine code, which is made once in up to 12 s and has the bits of Python."""
    ring_s: Annotated[float, Interval(ge=0.0, le=3600.0)] = 0.0
    """Length of the shared memory for ticks in real time; 0: the longest that the experiment can take, up to 60 s."""


_Positive = Annotated[float, Interval(gt=0.0, le=1e6)]
_Any = Annotated[float, Interval(ge=-1e3, le=1e3)]


@dataclass(frozen=True, slots=True, kw_only=True)
class IdentifiedConfig(Section):
    """A lab's own parameters in SI units, as written by `inteco-abs identify`, instead of the published ones."""

    r1: _Positive | None = None
    """Radius of the upper wheel, the braked one, m."""
    r2: _Positive | None = None
    """Radius of the lower wheel, the road, m."""
    L: _Positive | None = None
    """Distance from the contact to the lever's axis, m."""
    phi_rad: Annotated[float, Interval(gt=0.0, lt=1.5708)] | None = None
    """Angle between the contact normal and the lever, rad."""
    J1: _Positive | None = None
    """Moment of inertia of the braked wheel, kg m2."""
    J2: _Positive | None = None
    """Moment of inertia of the road wheel, kg m2."""
    d1: _Positive | None = None
    """Viscous friction of the braked wheel, N m s."""
    d2: _Positive | None = None
    """Viscous friction of the road wheel, N m s."""
    M10: _Positive | None = None
    """Static friction of the braked wheel, N m."""
    M20: _Positive | None = None
    """Static friction of the road wheel, N m."""
    Mg: _Positive | None = None
    """Torque of gravity and shock absorber on the lever, N m."""
    w1: _Any | None = None
    """Friction curve (8), linear term."""
    w2: _Any | None = None
    """Its quadratic term."""
    w3: _Any | None = None
    """Its cubic term."""
    w4: _Any | None = None
    """Its saturating term, height."""
    a: _Positive | None = None
    """Position of that term."""
    p: _Positive | None = None
    """Exponent of that term."""
    c31: _Positive | None = None
    """Rate of the brake's lag, 1/s."""
    b1: _Positive | None = None
    """Brake's static map as a straight line, N m per unit duty."""
    b2: _Any | None = None
    """Offset of that line, N m."""
    u0: Annotated[float, Interval(ge=0.0, lt=1.0)] | None = None
    """Duty below which that line gives no torque."""
    brake_duties: Annotated[list[Annotated[float, Interval(ge=0.0, le=1.0)]], MinLen(2)] | None = None
    """Points of the brake's static map, rising; for the observer and `predictive-reaching`."""
    brake_torques_nm: Annotated[list[Annotated[float, Interval(ge=0.0, le=100.0)]], MinLen(2)] | None = None
    """Torque that the brake settles to at each of them, rising."""
    brake_dead_time_s: Annotated[float, Interval(ge=0.0, le=0.2)] | None = None
    """Dead time of the brake, for the observer, which limits it to 2 to 30 ms; `adaptive-observer` to 2 ms to
    its `longest_dead_time_s`."""
    brake_release_ratio: Annotated[float, Interval(ge=0.3, le=4.0)] | None = None
    """Lag of the brake in releasing over that in rising, for the observers and `design`."""
    brake_release_delay_s: Annotated[float, Interval(ge=-0.2, le=0.2)] | None = None
    """How much longer the dead time of a release is than that of a rise, s; for `design`."""
    brake_fade_per_kj: Annotated[float, Interval(ge=0.0, le=5.0)] | None = None
    """Fade with heat: after E kJ of work the torque is 1 / (1 + fade * E) of the cold brake's; for `design`."""
    drive_stall_torque_nm: _Positive | None = None
    """Stall torque of the drive motor, N m; the guard judges the run-up by it, and no controller uses it."""
    drive_no_load_speed_rad_s: _Positive | None = None
    """No-load speed of the drive motor, rad/s; used like its stall torque."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelConfig(Section):
    """The controller's model of the rig."""

    parameters: Literal["mask", "table"] = "mask"
    """Published set of parameters: of the simulator's mask, or of the manual's tables."""
    identified: IdentifiedConfig = IdentifiedConfig()
    """A lab's own parameters, which replace the published ones."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExperimentConfig(Section):
    idle_s: Annotated[float, Interval(ge=0.01, le=10.0)] = 0.05
    """Time at rest, both wheels watched, before arming; the armed phase lasts as long."""
    drive_duty: Annotated[float, Interval(ge=0.2, le=1.0)] = 1.0
    """Duty of the drive motor while it spins the wheels up."""
    start_speed_rad_s: Annotated[float, Interval(ge=10.0, le=240.0)] = 180.0
    """Road wheel speed at which braking begins."""
    stop_speed_rad_s: Annotated[float, Interval(gt=0.0, le=10.0)] = 0.5
    """The road wheel counts as stopped when its mean speed over the last 50 ms is below this."""
    hold_s: Annotated[float, Interval(ge=0.0, le=10.0)] = 0.5
    """Time that the brake is held after the stop."""
    spin_up_timeout_s: Annotated[float, Interval(ge=0.1, le=120.0)] = 20.0
    """Time after which a rig that has not reached the start speed is stopped."""
    braking_timeout_s: Annotated[float, Interval(ge=0.1, le=120.0)] = 10.0
    """Time after which a rig that still turns is stopped, by taking the brake off."""
    stops: Annotated[int, Interval(ge=1, le=1000)] = 1
    """Number of stops, one after the other, in one session."""
    changes: Annotated[list[Annotated[str, MaxLen(100)]], MaxLen(100)] | None = None
    """Gains, and the reference slip, to change while the run lasts, as NAME=VALUE@WHEN: `Mk=5@brake+200ms` counts from
    the beginning of the first braking, `reference_slip=0.3@brake2` from that of the second one, `Mk=5@3.5s` from the
    first tick; `#400` is a number of ticks. Not in sweeps."""

    @property
    def longest_s(self) -> float:
        """Longest possible duration of all stops, s."""
        return self.stops * (2.0 * self.idle_s + self.spin_up_timeout_s + self.braking_timeout_s + self.hold_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class EstimatorConfig(Section):
    name: str = "moving-window"
    """One of `inteco-abs estimators`."""
    window_s: Annotated[float, Interval(gt=0.0, le=0.5)] = 0.010
    """Length of the moving window, least time between the edges of edge-time, and T0 of the difference."""
    natural_frequency_rad_s: Annotated[float, Interval(gt=0.0, le=2000.0)] = 200.0
    """Natural frequency of the tracking loop; at most a tenth of the loop's rate."""
    jerk_density: Annotated[float, Interval(gt=0.0, le=1e12)] = 3e5
    """Density of the white jerk that the Kalman filter assumes, rad2/s5: less is smoother and slower."""
    longest_dead_time_s: Annotated[float, Interval(ge=0.01, le=0.2)] = 0.2
    """Longest dead time of the brake that `adaptive-observer` takes for possible."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerConfig(Section):
    name: str = "reaching-law"
    """A shipped controller or one of an installed package; a file of your own is named on the command line only, as it
    is code that will run."""
    reference_slip: Annotated[float, Interval(gt=0.0, lt=1.0)] = 0.2
    """Slip that the controller holds, unless `reference_points` or `reference_formula` are given."""
    reference_points: Annotated[list[Annotated[float, Interval(gt=0.0, lt=1.0)]], MinLen(2), MaxLen(1000)] | None = None
    """Slips to hold in turn, linear between them, at the values of one of the two following keys."""
    reference_at_s: Annotated[list[Annotated[float, Interval(ge=0.0, le=60.0)]], MinLen(2), MaxLen(1000)] | None = None
    """Times since braking began; rising, the same one twice is a step."""
    reference_at_rad_s: (
        Annotated[list[Annotated[float, Interval(ge=0.0, le=245.0)]], MinLen(2), MaxLen(1000)] | None
    ) = None
    """Estimated road speeds; rising, the same one twice is a step."""
    reference_formula: str | None = None
    """Slip to hold, as a formula of `t`, the time since braking began in s, and `speed`, the estimated road speed in
    rad/s: `0.2 + 0.05*sin(2*pi*t/0.4)`. Numbers, pi, + - * /, sin, cos, exp, min, max and step(x, x0)."""
    reference_search: bool = False
    """Search the slip at which the road slows most, from `reference_slip` on, and hold it."""
    hold_below_rad_s: Annotated[float, Interval(ge=0.0, le=100.0)] = 5.0
    """Below this estimated road speed the last demand is held: the model's terms grow like 1/speed."""
    gains: dict[str, float] = field(default_factory=dict)
    """The controller's own; defaults where not named."""

    @property
    def constant_slip(self) -> float | None:
        """The reference slip where it is constant, else None."""
        return self.reference_slip if self.reference_key == "reference_slip" else None

    @property
    def reference_key(self) -> str:
        """The key that gives the slip to hold."""
        if self.reference_search:
            return "reference_search"
        if self.reference_formula is not None:
            return "reference_formula"
        return "reference_slip" if self.reference_points is None else "reference_points"

    @property
    def reference_text(self) -> str:
        """The reference slip for people: the constant, its range and what it is over, or the formula."""
        if self.reference_search:
            return f"searched from {self.reference_slip:g}"
        if self.reference_formula is not None:
            return self.reference_formula
        if self.reference_points is None:
            return f"{self.reference_slip:g}"
        over = "time" if self.reference_at_s is not None else "speed"
        return f"{min(self.reference_points):g}..{max(self.reference_points):g} over {over}"


@dataclass(frozen=True, slots=True, kw_only=True)
class GuardConfig(Section):
    brake_limit: Annotated[float, Interval(gt=0.0, le=1.0)] = 0.7
    """Largest brake duty; the vendor's driver stops at 0.7 for its brake supply's sake."""
    drive_limit: Annotated[float, Interval(ge=0.2, le=1.0)] = 1.0
    """Largest drive duty."""
    over_speed_rad_s: Annotated[float, Interval(ge=20.0, le=245.0)] = 245.0
    """2344 rpm, the limit on the vendor's screen. A ceiling: configuration can only lower it."""
    missed_in_a_row: Annotated[int, Interval(ge=1, le=1000)] = 4
    """Exchanges missed one after the other that end the run."""
    bucket_limit: Annotated[int, Interval(ge=3, le=3000)] = 30
    """A missed exchange adds 3, a good one takes 1; at the limit the run ends."""
    silence_s: Annotated[float, Interval(ge=0.05, le=2.0)] = 0.05
    """Time without a tick, or five periods if that is longer, after which the guardian takes a loop for hung, kills it
    and makes the board safe."""
    run_up_factor: Annotated[float, Interval(ge=1.1, le=10.0)] | None = 1.5
    """How many times slower or faster than the published drive's a run-up may be; around an identified drive
    (model.identified) its square root. It finds a wrong encoders.counts_per_turn, which no other check does. A session
    that does not have it is from before this check, and is replayed without."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionConfig(Section):
    """How a run is stored."""

    spill: str = ""
    """Folder on another disk, for a session whose disk fills up or fails during the run; empty: such a session stays in
    memory, from where you recover it."""


_Words = Annotated[str, MinLen(1), MaxLen(2000)]


@dataclass(frozen=True, slots=True, kw_only=True)
class DescriptionConfig(Section):
    """What a run was for, and whose it is; the session keeps it, and `inteco-abs annotate` changes it afterwards."""

    purpose: _Words | None = None
    """Why the run was made."""
    note: _Words | None = None
    """Anything that a reader should know of it."""
    tags: Annotated[list[Annotated[str, MinLen(1), MaxLen(64)]], MaxLen(32)] | None = None
    """Words by which it is found."""
    operator: _Words | None = None
    """Name of who ran it."""
    orcid: Annotated[str, MaxLen(19)] | None = None
    """The operator's ORCID iD, as 0000-0002-1825-0097."""
    institution: _Words | None = None
    """Name of the laboratory."""
    licence: _Words | None = None
    """Licence of the data, best by its SPDX name, as CC-BY-4.0."""

    def facts(self) -> dict[str, str]:
        """Keys and values as metadata of a session: tags as JSON, keys without a value left out."""
        return {key: value if isinstance(value, str) else json.dumps(value) for key, value in self.as_table().items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationConfig(Section):
    """The rig inside the mock board; not used on a real one."""

    rig: str = ""
    """A drawn virtual rig by population and seed, as "hard:17"; empty: the published one, as the keys below say."""
    population: str = ""
    """Text of that population, in TOML, where it is not a shipped one; `--rig my-lab.toml:17` fills in both."""
    parameters: Literal["mask", "table"] = "mask"
    """Published set of the simulated rig."""
    roads: Annotated[list[Annotated[str, MaxLen(100)]], MinLen(1), MaxLen(1000)] | None = None
    """Road of each stop in turn, from the first again after the last: `own`, the rig's, or dry-asphalt, dry-concrete,
    wet-asphalt, wet-cobblestone, snow or ice; `own*0.6` has a factor on the adhesion, `own>ice@300ms` and
    `ice>*2@0.3s` change it that long after the brake came on. It lies there from the first brake command of a stop
    to the drive's next run-up, which is on the rig's own."""
    brake_rate_per_s: Annotated[float, Interval(ge=1.0, le=1e6)] = 20.37
    """Rate of the brake actuator's lag."""
    drive_pwm: Annotated[int, Interval(ge=0, le=7)] = 0
    """PWM channel of the simulated drive, which may differ from [board]; defaults as in the vendor's PCI version."""
    brake_pwm: Annotated[int, Interval(ge=0, le=7)] = 1
    """PWM channel that is really wired to the brake."""
    road_encoder: Annotated[int, Interval(ge=0, le=7)] = 0
    """Encoder channel that is really on the road wheel."""
    wheel_encoder: Annotated[int, Interval(ge=0, le=7)] = 1
    """Encoder channel that is really on the braked wheel."""
    road_sign: Literal[1, -1] = 1
    """-1 where the simulated encoder counts down."""
    wheel_sign: Literal[1, -1] = 1
    """-1 where the simulated encoder counts down."""
    watchdog_pin: Annotated[int, Interval(ge=-1, le=25)] = -1
    """CN1 pin that really feeds the one-shot in the emergency chain; -1: there is no one-shot."""
    watchdog_contact_pin: Annotated[int, Interval(ge=-1, le=25)] = -1
    """CN1 pin that its contact is really on."""
    watchdog_hold_s: Annotated[float, Interval(ge=0.001, le=10.0)] = 0.05
    """Time after the last change of level for which the one-shot holds the motors' power."""
    counts_per_turn: Annotated[int, Interval(ge=256, le=1_000_000)] | None = None
    """Counts per turn of the simulated encoders; not given: `encoders.counts_per_turn`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RigConfig(Section):
    """The complete configuration of a run."""

    profile: str = DEFAULT_PROFILE
    """A shipped profile, or a .toml file of the lab's own: which board, how it is wired, its limits."""
    board: BoardConfig
    usb: UsbConfig = UsbConfig()
    encoders: EncodersConfig = EncodersConfig()
    loop: LoopConfig = LoopConfig()
    model: ModelConfig = ModelConfig()
    experiment: ExperimentConfig = ExperimentConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    controller: ControllerConfig = ControllerConfig()
    guard: GuardConfig = GuardConfig()
    session: SessionConfig = SessionConfig()
    description: DescriptionConfig = DescriptionConfig()
    simulation: SimulationConfig = SimulationConfig()

    @property
    def period_ns(self) -> int:
        """Nominal period of the loop, ns."""
        return round(1e9 / self.loop.rate_hz)

    def to_toml(self) -> str:
        """The effective configuration; `parse_config` of it gives an equal RigConfig."""
        import tomli_w  # noqa: PLC0415 - most processes write none

        return tomli_w.dumps(self.as_table())


def section_of(table: Mapping[str, Any], key: str) -> Table:
    """The section `key` of a table that was not checked; empty if there is none."""
    section = table.get(key)
    return section if isinstance(section, dict) else {}


def key_types(section: type[Section]) -> Mapping[str, Any]:
    """Type of each key of a section, with its range."""
    hints = _type_hints(cast(Any, section))  # mypy takes a protocol's class for unhashable
    return {key.name: hints[key.name] for key in _fields(section)}


@cache
def _type_hints(section: type[Any]) -> Mapping[str, Any]:
    return get_type_hints(section, include_extras=True)


def defaults(section: type[Section]) -> Table:
    """Default of each key of a section that has one."""
    found: Table = {}
    for key in _fields(section):
        if key.default is not MISSING:
            found[key.name] = key.default
        elif key.default_factory is not MISSING:
            found[key.name] = key.default_factory()
    return found


def section_at(location: Sequence[Any]) -> type[Section] | None:
    """The section at a path of keys from the top; None if there is none."""
    found = type_at(location)
    return found if _is_section(found) else None


def type_at(location: Sequence[Any]) -> Any:
    """Type of what is at a path of keys from the top, with its range; None if there is no such key."""
    if not location:
        return RigConfig
    above = _required(type_at(location[:-1]))
    if _is_section(above):
        return key_types(above).get(location[-1])
    return get_args(bare(above))[-1] if get_origin(bare(above)) in _HOLDING else None


def bare(key_type: Any) -> Any:
    """A key's type without its range."""
    return key_type.__origin__ if get_origin(key_type) is Annotated else key_type


def bounds(key_type: Any, *names: str) -> list[float]:
    """Limits of a key's range, of those named: ge, gt, le, lt; min_length and max_length of a list."""
    rules = key_type.__metadata__ if get_origin(key_type) is Annotated else ()
    found = (getattr(rule, name, None) for rule in rules for name in names)
    return [bound for bound in found if bound is not None]


def limits(location: Sequence[Any]) -> str:
    """Type, range and unit of the value at `location`, as in "a number above 0 and at most 0.5 s"."""
    found = _described(_required(type_at(location)))
    unit = unit_of(str(location[-1]))
    return f"{found} {unit}" if unit and found[-1].isdigit() else found


def _described(key_type: Any) -> str:
    kind, values = bare(key_type), get_args(bare(key_type))
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(f'"{one}"' if isinstance(one, str) else str(one) for one in values)
    if _is_section(kind):
        return "a section"
    ranges = [f"{words} {bound:.12g}" for rule, words in _LIMITS.items() for bound in bounds(key_type, rule)]
    if get_origin(kind) in _HOLDING:
        number = " and ".join([*ranges, "values"]).replace(" and values", " values")
        return f"{_HOLDING[get_origin(kind)]} of {number}, each {_described(values[-1])}"
    return " ".join([_NAMES[kind], " and ".join(ranges)]).strip()


def _required(key_type: Any) -> Any:
    """Type of an optional key's value, or the type itself."""
    types = get_args(key_type)
    return next(one for one in types if one is not NoneType) if NoneType in types else key_type


_NAMES: Final[dict[Any, str]] = {
    float: "a number",
    int: "a whole number",
    str: "text",
    bool: "true or false",
    date: "a date such as 2026-01-31",
}
_HOLDING: Final[dict[Any, str]] = {list: "a list", dict: "a table"}
_LIMITS: Final = {
    "ge": "at least",
    "gt": "above",
    "le": "at most",
    "lt": "below",
    "min_length": "at least",
    "max_length": "at most",
}


def _fields(section: type[Section]) -> tuple[Any, ...]:
    return fields(section)  # type: ignore[arg-type]  # every section is a dataclass


def _is_section(found: Any) -> TypeGuard[type[Section]]:
    return isinstance(found, type) and issubclass(found, Section)
