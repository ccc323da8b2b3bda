"""rig.toml -> RigConfig: one visible configuration, every mistake in its values reported at once.

Order of precedence: a `--set` on the command line, then the file, then the profile, then the defaults below. The
result is stored whole in every session.
"""

from __future__ import annotations

import operator
import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from datetime import date, time
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, Literal, NamedTuple

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from firmware_protocol.rtdac_usb2 import TIMER_HZ
from firmware_protocol.rtdac_usb2_bridge import MANUFACTURER
from inteco_abs.errors import ConfigError, ConfigIssue, near_match
from inteco_abs.quantities import number_hint, other_unit, unit_of
from inteco_abs.toml_text import NOT_TOML, in_words, read_toml

DEFAULT_PROFILE: Final = "sim_usb2"
MOCK_NAMES: Final = ("ABSSIM", "ABSIM")
"""Application names of the mock boards on USB, which no real board has."""
_LONGEST_VALUE: Final = 60

Table = dict[str, Any]
Check = Callable[[Mapping[str, Any]], Iterable[ConfigIssue]]
"""Looks at the merged table, wrong values included, and names what the model below cannot know."""


class _Section(BaseModel):
    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


class Evidence(_Section):
    """Why one of the profile's statements about board or wiring is believed."""

    status: Literal["confirmed", "inferred", "unknown"]
    source: str = ""
    """Manual, driver or test that tells it, or what it is inferred from."""


WIRING: Final = (
    "drive_pwm",
    "brake_pwm",
    "pwm_mode",
    "pwm_prescaler",
    "pwm_pins",
    "pwm_functions",
    "numbering_pwm",
    "numbering_pins",
    "timer",
    "frame_map",
    "constants",
    "watchdog_pin",
    "watchdog_contact_pin",
    "road_encoder",
    "wheel_encoder",
    "road_sign",
    "wheel_sign",
    "counts_per_turn",
)
"""What outputs rest on: keys of [board], and `encoders.counts_per_turn`."""
_SIGNED: Final = (
    *WIRING,
    "timer_hz",
    "kind",
    "logic_version",
    "application_names",
    "read_only",
    "simulated",
    "verified_on",
    "verified_logic",
    "evidence",
)
"""What a signature covers."""


class BoardConfig(_Section):
    """Which board is expected and how the rig is wired to it. Comes from a profile."""

    kind: Annotated[str, Field(pattern=r"^[a-z][a-z0-9-]*$")] = "usb2"
    """Board family: usb2 for RT-DAC/USB2, usb for RT-DAC/USB of the first generation, pci for RT-DAC4/PCI, or one of an
    installed package."""
    logic_version: Annotated[int, Field(ge=0, le=0xFFFF)]
    """Version of the FPGA logic that this wiring was checked with."""
    application_names: list[str] = []
    """Names of the logic that may be driven; any other opens read-only. The PCI board tells none."""
    simulated: bool = False
    """Whether the profile was made for the mock: nothing in it was ever seen on a rig, and its guard's limits have no
    ceilings but their ranges."""
    read_only: str = ""
    """Why outputs must stay off whatever the board says; empty: they may be used."""
    verified_by: str = ""
    """Who checked this wiring on the rig: the signature. Without it, a board whose outputs rest on anything that is
    not confirmed opens read-only."""
    verified_on: date | None = None
    """When."""
    verified_logic: Annotated[int, Field(ge=0, le=0xFFFF)] | None = None
    """Version of the logic that the board had then; the signature is good for no other."""
    drive_pwm: Annotated[int, Field(ge=0, le=7)] = 0
    """PWM channel of the drive motor."""
    brake_pwm: Annotated[int, Field(ge=0, le=7)] = 1
    """PWM channel of the brake."""
    pwm_mode: Literal["8-bit", "12-bit"] = "8-bit"
    """Resolution of the PWM: 255 or 4095 steps of a period."""
    pwm_prescaler: Annotated[int, Field(ge=0, le=65535)] = 44
    """44 in 8-bit mode is 3486 Hz, the nearest to the paper's 3.5 kHz."""
    pwm_pins: list[Annotated[int, Field(ge=0, le=25)]] = [2, 5]
    """CN1 pins switched to output; not on the PCI board."""
    pwm_functions: list[Annotated[int, Field(ge=0, le=25)]] | None = None
    """Bits of the pin mode that switch pins to their PWM function; as `pwm_pins` if not given."""
    numbering_pwm: Annotated[int, Field(ge=-1, le=7)] = -1
    """PWM channel that is wired to nothing: its prescaler carries the number of each frame, which the board echoes, so
    that a late or repeated answer is recognised. -1: none is free."""
    numbering_pins: Annotated[list[Annotated[int, Field(ge=0, le=25)]], Field(max_length=8)] = []
    """CN1 pins whose output latch drives nothing, as those of inputs: their latch carries that number as well, where
    neither a PWM channel nor a timer is free. With n pins, answers late by a multiple of 2^n go unnoticed."""
    timer: Annotated[int, Field(ge=-1, le=1)] = -1
    """Timer/counter channel that nothing else uses: it runs free as the clock of the samples, which dates them exactly
    and shows an answer that is older than its request. -1: none; samples are dated when they arrive."""
    timer_hz: Annotated[int, Field(ge=1_000_000, le=100_000_000)] = TIMER_HZ
    """Rate of that timer."""
    frame_map: Literal["generic", "servo", "tras", "rpend", "abs"] = "generic"
    """Which logic's words an RT-DAC/USB2 speaks: the generic one's, or those of a rig. `abs` has what is common to the
    known rigs. What a map does not name is sent back as the board had it. The other boards go by the version."""
    constants: dict[str, Annotated[int, Field(ge=0, le=0xFFFF_FFFF)]] = {}
    """What the board is set to besides the rest of the wiring, in every frame: a field of the SEND frame by its name,
    which the board must echo; the output of a CN1 pin, as `pin21 = 0`; or a whole word, as `w31 = 3` (on the first
    RT-DAC/USB a byte, as `b77 = 1`), which need not be echoed. Not on the PCI board."""
    watchdog_pin: Annotated[int, Field(ge=-1, le=25)] = -1
    """CN1 pin, an output, that changes its level with every good tick: it feeds a one-shot outside of the computer that
    cuts the motors' power (docs/watchdog.md). -1: there is none."""
    watchdog_contact_pin: Annotated[int, Field(ge=-1, le=25)] = -1
    """CN1 pin, an input, that is high while the one-shot's contact is closed; a watchdog is used only with it."""
    road_encoder: Annotated[int, Field(ge=0, le=11)] = 0
    """Encoder channel of the lower wheel, which stands for the road."""
    wheel_encoder: Annotated[int, Field(ge=0, le=11)] = 1
    """Encoder channel of the upper, braked wheel."""
    road_sign: Literal[1, -1] = 1
    """-1 where the road's encoder counts down when the drive turns it."""
    wheel_sign: Literal[1, -1] = 1
    """-1 where the wheel's encoder counts down when the drive turns it."""
    evidence: dict[str, Evidence] = {}
    """Status of each of `WIRING`; what is not named is unknown."""

    def unconfirmed(self, meaningless: Collection[str]) -> list[str]:
        """What outputs rest on and is not confirmed, with its status; `meaningless` is what this board has not."""
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


class UsbConfig(_Section):
    """How an RT-DAC/USB2 is told from other devices. The vendor's software goes by the manufacturer's name alone."""

    vendor_id: Annotated[int, Field(ge=0, le=0xFFFF)] | None = None
    """Any, if not given: UNKNOWN, though probably that of Cypress, the maker of the bridge."""
    product_id: Annotated[int, Field(ge=0, le=0xFFFF)] | None = None
    """Any, if not given: UNKNOWN."""
    manufacturer: Annotated[str, Field(min_length=1)] = MANUFACTURER
    """CONFIRMED: the string that the vendor's software looks for; here upper and lower case are the same."""
    engine: Literal["faster", "one-by-one", "queued"] = "faster"
    """How a tick's three transfers are handed over: queued, or one by one; `faster` queues them unless whole exchanges,
    timed when the board has been opened, are quicker one by one."""


class EncodersConfig(_Section):
    counts_per_turn: Annotated[int, Field(ge=256, le=1_000_000)] = 2048
    """Quadrature counts per turn of both wheels: 2048 in the paper, 4096 on the vendor's rig."""


class LoopConfig(_Section):
    rate_hz: Annotated[float, Field(ge=50.0, le=10_000.0)] = 2000.0
    """Of the loop: exchanges with the board per second."""
    ring_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 0.0
    """Length of the shared memory for ticks in real time; 0: the longest that the experiment can take, up to 60 s."""


_Positive = Annotated[float, Field(gt=0.0, le=1e6)]
_Any = Annotated[float, Field(ge=-1e3, le=1e3)]


class IdentifiedConfig(_Section):
    """A lab's own numbers, as `inteco-abs identify` writes them: in SI units, in place of the published ones."""

    J1: _Positive | None = None
    """Moment of inertia of the braked wheel, kg m2."""
    J2: _Positive | None = None
    """Of the road wheel, kg m2."""
    d1: _Positive | None = None
    """Viscous friction of the braked wheel, N m s."""
    d2: _Positive | None = None
    """Of the road wheel, N m s."""
    M10: _Positive | None = None
    """Static friction of the braked wheel, N m."""
    M20: _Positive | None = None
    """Of the road wheel, N m."""
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
    u0: Annotated[float, Field(ge=0.0, lt=1.0)] | None = None
    """Duty below which that line gives no torque."""
    brake_duties: Annotated[list[Annotated[float, Field(ge=0.0, le=1.0)]], Field(min_length=2)] | None = None
    """Points of the brake's static map, rising; for the observer and `predictive-reaching`."""
    brake_torques_nm: Annotated[list[Annotated[float, Field(ge=0.0, le=100.0)]], Field(min_length=2)] | None = None
    """Torque that the brake settles to at each of them, rising."""
    brake_dead_time_s: Annotated[float, Field(ge=0.0, le=0.2)] | None = None
    """For the observer, which believes no brake outside of 2 to 30 ms."""
    drive_stall_torque_nm: _Positive | None = None
    """Of the drive motor, N m; the guard judges the run-up by it, and no controller uses it."""
    drive_no_load_speed_rad_s: _Positive | None = None
    """Of the drive motor, likewise."""


class ModelConfig(_Section):
    """What the controller believes about the rig."""

    parameters: Literal["mask", "table"] = "mask"
    """Which published set: that of the simulator's mask, or of the manual's tables."""
    identified: IdentifiedConfig = IdentifiedConfig()
    """What a lab has found out about its own rig goes before that."""


class ExperimentConfig(_Section):
    idle_s: Annotated[float, Field(ge=0.01, le=10.0)] = 0.05
    """Time at rest, both wheels watched, before arming; the armed phase lasts as long."""
    drive_duty: Annotated[float, Field(ge=0.2, le=1.0)] = 1.0
    """Of the drive motor while it spins the wheels up."""
    start_speed_rad_s: Annotated[float, Field(ge=10.0, le=240.0)] = 180.0
    """Road wheel speed at which braking begins."""
    stop_speed_rad_s: Annotated[float, Field(gt=0.0, le=10.0)] = 0.5
    """The road wheel counts as stopped when its mean speed over the last 50 ms is below this."""
    hold_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.5
    """Time that the brake is held after the stop."""
    spin_up_timeout_s: Annotated[float, Field(ge=0.1, le=120.0)] = 20.0
    """Time after which a rig that has not reached the start speed is stopped."""
    braking_timeout_s: Annotated[float, Field(ge=0.1, le=120.0)] = 10.0
    """Time after which a rig that still turns is stopped, by taking the brake off."""
    stops: Annotated[int, Field(ge=1, le=1000)] = 1
    """How often all of this is done, one stop after the other, in one session."""

    @property
    def longest_s(self) -> float:
        """The longest that all of it can take before the sequence ends it, s."""
        return self.stops * (2.0 * self.idle_s + self.spin_up_timeout_s + self.braking_timeout_s + self.hold_s)


class EstimatorConfig(_Section):
    name: str = "moving-window"
    """One of `inteco-abs estimators`."""
    window_s: Annotated[float, Field(gt=0.0, le=0.5)] = 0.010
    """Length of the moving window, least time between the edges of edge-time, and T0 of the difference."""
    natural_frequency_rad_s: Annotated[float, Field(gt=0.0, le=2000.0)] = 200.0
    """Of the tracking loop; at most a tenth of the loop's rate."""
    jerk_density: Annotated[float, Field(gt=0.0, le=1e12)] = 3e5
    """Of the Kalman filter's wheel, rad2/s5: less is smoother and slower."""


class ControllerConfig(_Section):
    name: str = "reaching-law"
    """A shipped controller or one of an installed package; a file of your own is named on the command line only, as it
    is code that will run."""
    reference_slip: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.2
    """Slip that the controller shall hold."""
    hold_below_rad_s: Annotated[float, Field(ge=0.0, le=100.0)] = 5.0
    """Below this estimated road speed the last demand is held: the model's terms grow like 1/speed."""
    gains: dict[str, float] = {}
    """The controller's own; defaults where not named."""


class GuardConfig(_Section):
    brake_limit: Annotated[float, Field(gt=0.0, le=1.0)] = 0.7
    """Largest brake duty; the vendor's driver stops at 0.7 for its brake supply's sake."""
    drive_limit: Annotated[float, Field(ge=0.2, le=1.0)] = 1.0
    """Largest drive duty."""
    over_speed_rad_s: Annotated[float, Field(ge=20.0, le=245.0)] = 245.0
    """2344 rpm, the limit on the vendor's screen. A ceiling: configuration can only lower it."""
    missed_in_a_row: Annotated[int, Field(ge=1, le=1000)] = 4
    """Exchanges missed one after the other that end the run."""
    bucket_limit: Annotated[int, Field(ge=3, le=3000)] = 30
    """A missed exchange adds 3, a good one takes 1; at the limit the run ends."""
    silence_s: Annotated[float, Field(ge=0.05, le=2.0)] = 0.05
    """Time without a tick, or five periods if that is longer, after which the guardian takes a loop for hung, kills it
    and makes the board safe."""
    run_up_factor: Annotated[float, Field(ge=1.1, le=10.0)] | None = 1.5
    """How many times slower or faster than the published drive's a run-up may be; around an identified drive
    (model.identified) its square root. It finds a wrong encoders.counts_per_turn, which no other check does. A session
    that does not have it is from before this check, and is replayed without."""


class SessionConfig(_Section):
    """How a run is kept."""

    spill: str = ""
    """Folder on another disk, for a session whose own disk fills up, breaks or vanishes during the run; empty: such a
    session stays in memory, and is to be recovered from there."""


class SimulationConfig(_Section):
    """The rig inside the mock board; not used on a real one."""

    rig: str = ""
    """A drawn virtual rig by population and seed, as "hard:17"; empty: the published one, as the next two keys say."""
    parameters: Literal["mask", "table"] = "mask"
    """Published set of the simulated rig."""
    brake_rate_per_s: Annotated[float, Field(ge=1.0, le=1e6)] = 20.37
    """Rate of the brake actuator's lag."""
    drive_pwm: Annotated[int, Field(ge=0, le=7)] = 0
    """PWM channel that is really wired to the drive, whatever [board] believes; all as the vendor's PCI version."""
    brake_pwm: Annotated[int, Field(ge=0, le=7)] = 1
    """PWM channel that is really wired to the brake."""
    road_encoder: Annotated[int, Field(ge=0, le=7)] = 0
    """Encoder channel that is really on the road wheel."""
    wheel_encoder: Annotated[int, Field(ge=0, le=7)] = 1
    """Encoder channel that is really on the braked wheel."""
    road_sign: Literal[1, -1] = 1
    """-1 where the simulated encoder counts down."""
    wheel_sign: Literal[1, -1] = 1
    """-1 where the simulated encoder counts down."""
    watchdog_pin: Annotated[int, Field(ge=-1, le=25)] = -1
    """CN1 pin that really feeds the one-shot in the emergency chain; -1: there is no one-shot."""
    watchdog_contact_pin: Annotated[int, Field(ge=-1, le=25)] = -1
    """CN1 pin that its contact is really on."""
    watchdog_hold_s: Annotated[float, Field(ge=0.001, le=10.0)] = 0.05
    """Time after the last change of level for which the one-shot holds the motors' power."""
    counts_per_turn: Annotated[int, Field(ge=256, le=1_000_000)] | None = None
    """Of the simulated encoders; not given: what `encoders.counts_per_turn` believes."""


class RigConfig(_Section):
    """Everything a run depends on besides the board itself."""

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
    simulation: SimulationConfig = SimulationConfig()

    @property
    def period_ns(self) -> int:
        """Nominal period of the loop, ns."""
        return round(1e9 / self.loop.rate_hz)

    def to_toml(self) -> str:
        """The effective configuration; `load_config` of it gives an equal RigConfig."""
        return tomli_w.dumps(self.model_dump(exclude_none=True))


def profiles() -> list[str]:
    """Names of the shipped profiles."""
    folder = resources.files("inteco_abs.profiles")
    return sorted(Path(item.name).stem for item in folder.iterdir() if item.name.endswith(".toml"))


def load_config(
    file: Path | None = None,
    settings: Sequence[str] = (),
    checks: Iterable[Check] = (),
    profile: str = DEFAULT_PROFILE,
    follows: Callable[[Table], Table] | None = None,
) -> RigConfig:
    """Configuration from `file` (or only defaults), with `settings` such as `guard.brake_limit=0.7` over it.

    `profile` is the one to begin with if neither names one; `follows` gives what follows from the choices for keys
    that are not set. Raises ConfigError with every mistake found in the file,
    the settings and by `checks`.
    """
    mistakes: list[ConfigIssue] = []
    table = _read(file) if file is not None else {}
    in_file, over = deepcopy(table), _settings_table(settings)
    for setting in settings:
        mistakes.extend(apply_setting(table, setting))
    name = table.setdefault("profile", profile)
    below = _profile(name, mistakes)
    merged = _merge(below, table)
    mistakes.extend(
        ConfigIssue(f"board.evidence.{key}", "evidence stands in a file with its source, not on the command line")
        for key in _section_of(_wiring(over), "evidence")
    )
    _void_signature(below, in_file, merged)
    _void_signature(_merge(below, in_file), over, merged)
    if not _wiring(over).get("verified_by"):
        _void_beyond(_merge(below, in_file) if _wiring(in_file).get("verified_by") else below, merged)
    return _validate(merged if follows is None else _merge(follows(merged), merged), checks, mistakes)


def origins(file: Path | None = None, settings: Sequence[str] = (), profile: str = DEFAULT_PROFILE) -> dict[str, str]:
    """Where the values of `load_config` with these arguments come from, by dotted key; not named: a default."""
    table = _read(file) if file is not None else {}
    over = _settings_table(settings)
    name = _merge(table, over).get("profile", profile)
    found = dict.fromkeys(_leaves(_profile(name, [])), f"profile {name}")
    found |= dict.fromkeys(_leaves(table), str(file))
    return found | dict.fromkeys(_leaves(over), "command line")


def _leaves(table: Table, above: str = "") -> Iterator[str]:
    for key, value in table.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, f"{above}{key}.")
        else:
            yield f"{above}{key}"


def _settings_table(settings: Sequence[str]) -> Table:
    """The settings by themselves; what is wrong with them is told elsewhere."""
    table: Table = {}
    for setting in settings:
        apply_setting(table, setting)
    return table


def profile_text(name: str) -> str:
    """A shipped profile as it was written, comments included."""
    return resources.files("inteco_abs.profiles").joinpath(f"{name}.toml").read_text(encoding="utf-8")


def read_profile(name: str) -> Table:
    """What a shipped profile or a .toml file says, before defaults; raises ConfigError if there is none."""
    mistakes: list[ConfigIssue] = []
    table = _profile(name, mistakes)
    if mistakes:
        raise ConfigError(mistakes)
    return table


def parse_config(text: str, checks: Iterable[Check] = ()) -> RigConfig:
    """Effective configuration as stored in a session, of this version or an earlier one; raises ConfigError."""
    try:
        table = tomllib.loads(text)
    except NOT_TOML as error:
        raise ConfigError([ConfigIssue("config.toml", f"is not TOML: {in_words(error, text)}")]) from error
    guard = table.setdefault("guard", {})
    if isinstance(guard, dict):
        guard.setdefault("run_up_factor", None)  # a session from before the check is replayed as it was run
    return _validate(table, checks, [])


def _validate(table: Table, checks: Iterable[Check], mistakes: list[ConfigIssue]) -> RigConfig:
    config = None
    try:
        config = RigConfig.model_validate(table)
    except ValidationError as error:
        mistakes.extend(_in_words(detail) for detail in error.errors())
    mistakes.extend(_contradictions(table, [mistake.path for mistake in mistakes]))
    for check in checks:
        mistakes.extend(check(table))
    if config is None or mistakes:
        raise ConfigError(mistakes)
    return config


def _read(file: Path) -> Table:
    return read_toml(file, f"inteco-abs config init {file} writes one to begin with")


def apply_setting(table: Table, setting: str) -> list[ConfigIssue]:
    """Put one `key=value` into `table`; the value is TOML, or a bare word. Gives back what is wrong with it."""
    key, equals, text = setting.partition("=")
    path = key.strip().split(".")
    if not equals or not all(path) or "\n" in setting:
        return [ConfigIssue(f"--set {setting}", "must look like guard.brake_limit=0.7")]
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text.strip()
    except NOT_TOML as error:
        return [ConfigIssue(key.strip(), f"is not a value that can be used: {in_words(error, text)}")]
    for part in path[:-1]:
        inner = table.setdefault(part, {})
        if not isinstance(inner, dict):
            return [ConfigIssue(f"--set {setting}", f"{part} is a value, not a section")]
        table = inner
    table[path[-1]] = value
    return []


def _profile(name: object, mistakes: list[ConfigIssue]) -> Table:
    if isinstance(name, str) and name in profiles():
        return tomllib.loads(profile_text(name))
    if isinstance(name, str) and name.endswith(".toml"):
        return read_toml(Path(name), "inteco-abs profiles lists those that ship, inteco-abs probe makes one of a board")
    if not isinstance(name, str):
        return _profile(DEFAULT_PROFILE, mistakes)  # the model below says what is wrong with it
    mistakes.append(
        ConfigIssue("profile", f"{name!r} is not a shipped profile or a .toml file{near_match(name, profiles())}")
    )
    return _profile(DEFAULT_PROFILE, mistakes)


def _merge(below: Table, above: Table) -> Table:
    merged = dict(below)
    for key, value in above.items():
        inner = merged.get(key)
        merged[key] = _merge(inner, value) if isinstance(inner, dict) and isinstance(value, dict) else value
    return merged


def wiring_of(table: Table) -> Table:
    """What a configuration says of `WIRING` and of the logic that it is for, and nothing else."""
    stated = _wiring(table)
    return {key: stated[key] for key in (*WIRING, "logic_version", "application_names") if key in stated}


def _void_signature(below: Table, above: Table, merged: Table) -> None:
    """Who signed what lies `below` has not seen what `above` changes in it, unless that is signed anew.

    A simulated rig may be rewired at will.
    """
    signed, changed = _wiring(below), _wiring(above)
    signer = signed.get("verified_by")
    if not signer or "verified_by" in changed:
        return
    keys = ("simulated",) if signed.get("simulated") is True else _SIGNED
    before = {key: field.default for key, field in BoardConfig.model_fields.items()} | signed
    new = [key for key in keys if key in changed and changed[key] != before.get(key)]
    if new:
        because = f"{signer} signed the profile with another {', '.join(new)}; sign what you have changed"
        merged["board"]["read_only"] = because


def _void_beyond(signed: Table, merged: Table) -> None:
    """Who signed a profile has agreed to its guard's limits, and to anything more careful. A simulated rig has none."""
    board = _section_of(signed, "board")
    beyond = [] if board.get("simulated") is True else laxer_limits(signed, merged)
    if board.get("verified_by") and beyond and not _section_of(merged, "board").get("read_only"):
        because = f"{board['verified_by']} signed the profile with {'; '.join(beyond)}. Lower it, or sign it anew"
        merged["board"]["read_only"] = because


def laxer_limits(than: Table, table: Table) -> list[str]:
    """Limits of the guard that `table` allows more of `than` the other table does, in words.

    Of each limit more is laxer; what a table does not say is the default.
    """
    defaults = GuardConfig().model_dump()
    limits, asked = (defaults | _section_of(one, "guard") for one in (than, table))
    return [
        f"guard.{key} at most {limits[key]:g}, and {asked[key]:g} is asked for"
        for key in defaults
        if isinstance(limits[key], int | float) and isinstance(asked[key], int | float) and asked[key] > limits[key]
    ]


class _Ceiling(NamedTuple):
    """Of a limit of the guard on a real board, whoever signs."""

    seconds: float | None
    """As a time, which the loop's rate makes a number of exchanges of; None: `least` it is."""
    least: float
    """What is allowed at any rate."""
    because: str

    def at(self, rate_hz: float) -> float:
        return max(self.least, 0.0 if self.seconds is None else float(int(self.seconds * rate_hz)))


_REAL_CEILINGS: Final = {
    "missed_in_a_row": _Ceiling(
        0.025, 4, "25 ms, half the shortest silence: a loop without answers ends its run before the guardian has to"
    ),
    "bucket_limit": _Ceiling(0.15, 30, "0.15 s of a link that loses every other exchange"),
    "silence_s": _Ceiling(None, 0.1, "five periods of the slowest loop; meanwhile nobody watches the motors"),
    "run_up_factor": _Ceiling(None, 2.0, "more would let counts per turn pass that are wrong by half"),
}
"""The other limits have their ceilings in the ranges that hold on every board."""


def beyond_ceilings(config: RigConfig) -> Iterator[ConfigIssue]:
    """What a run on a real board is refused for, though it may be run on a simulated one or stand in a session."""
    limits, rate_hz = config.guard, config.loop.rate_hz
    for key, ceiling in _REAL_CEILINGS.items():
        value, most = getattr(limits, key), ceiling.at(rate_hz)
        if value is None or value > most:
            allowed = f"at most {most:g}" + (f" at {rate_hz:g} Hz" if ceiling.seconds is not None else "")
            yield ConfigIssue(f"guard.{key}", f"{value}: on a real board {allowed} ({ceiling.because}); lower it")
    if not config.board.verified_by and not config.board.read_only:
        for beyond in laxer_limits(_shipped_limits(config.board.kind), config.model_dump()):
            key, _, rest = beyond.partition(" ")
            yield ConfigIssue(key, f"{rest}: more takes a signed profile; inteco-abs probe has you sign")


def _shipped_limits(kind: str) -> Table:
    """The most that a shipped profile of a real board of this kind has of each limit of the guard."""
    most: Table = {}
    for table in map(read_profile, profiles()):
        board = table["board"]
        if board.get("kind", BoardConfig.model_fields["kind"].default) == kind and not board.get("simulated"):
            limits = table.get("guard", {})
            most |= {key: max(value, most.get(key, value)) for key, value in limits.items()}
    return {"guard": most}


def bounded_in_time(guard: GuardConfig, rate_hz: float) -> GuardConfig:
    """The same limits at another rate, with those in exchanges within a real board's ceilings there."""
    in_exchanges = [key for key, ceiling in _REAL_CEILINGS.items() if ceiling.seconds is not None]
    return guard.model_copy(
        update={key: min(getattr(guard, key), int(_REAL_CEILINGS[key].at(rate_hz))) for key in in_exchanges}
    )


def _section_of(table: Table, key: str) -> Table:
    section = table.get(key)
    return section if isinstance(section, dict) else {}


def _wiring(table: Table) -> Table:
    """What a configuration says of board and wiring; nothing where the model will say what is wrong with it."""
    board, encoders = table.get("board", {}), table.get("encoders", {})
    if not (isinstance(board, dict) and isinstance(encoders, dict)):
        return {}
    return {**board, **{key: encoders[key] for key in ("counts_per_turn",) if key in encoders}}


class _Pair(NamedTuple):
    """Two values that are each in range and cannot be together."""

    first: str
    second: str
    fits: Callable[[Any, Any], bool]
    must: str


_OF_LIMIT: Final = "must be below, by a tenth that measurement may be off:"
_PAIRS: Final = (
    _Pair("experiment.start_speed_rad_s", "guard.over_speed_rad_s", lambda v, most: v <= 0.9 * most, _OF_LIMIT),
    _Pair("experiment.stop_speed_rad_s", "experiment.start_speed_rad_s", operator.lt, "must be below"),
    _Pair("estimator.window_s", "loop.rate_hz", lambda s, hz: s * hz > 0.999, "must be at least one period of"),
    _Pair("board.brake_pwm", "board.drive_pwm", operator.ne, "must be another PWM channel than"),
    _Pair("board.drive_pwm", "board.numbering_pwm", operator.ne, "must be another PWM channel than"),
    _Pair("board.brake_pwm", "board.numbering_pwm", operator.ne, "must be another PWM channel than"),
    _Pair("board.wheel_encoder", "board.road_encoder", operator.ne, "must be another encoder than"),
    _Pair("simulation.brake_pwm", "simulation.drive_pwm", operator.ne, "must be another PWM channel than"),
    _Pair("simulation.wheel_encoder", "simulation.road_encoder", operator.ne, "must be another encoder than"),
)


def _contradictions(table: Table, wrong: Collection[str]) -> Iterator[ConfigIssue]:
    """Pairs that do not fit; `wrong` are the keys that are mistaken by themselves."""

    def value(path: str) -> Any:
        section, key = path.split(".")
        default = RigConfig.model_fields[section].annotation.model_fields[key].default  # type: ignore[union-attr]  # a section
        return table.get(section, {}).get(key, default)

    board = table.get("board", {})
    evidence = board.get("evidence", {}) if isinstance(board, dict) else {}
    for key in evidence if isinstance(evidence, dict) else ():
        if key not in WIRING:
            yield ConfigIssue(f"board.evidence.{key}", f"nothing rests on {key!r}{near_match(str(key), WIRING)}")
    if isinstance(board, dict) and board.get("verified_by"):
        missing = [key for key in ("verified_on", "verified_logic") if board.get(key) is None]
        if missing:
            wanted = " and ".join(f"board.{key}" for key in missing)
            yield ConfigIssue(
                "board.verified_by", f"a signature needs {wanted} too: the day, and the logic it was made for"
            )
    yield from _brake_map_mistakes(_section_of(_section_of(table, "model"), "identified"))
    for pair in _PAIRS:
        if not {pair.first, pair.second, pair.first.partition(".")[0], pair.second.partition(".")[0]} & set(wrong):
            first, second = value(pair.first), value(pair.second)
            if not pair.fits(first, second):
                yield ConfigIssue(pair.first, f"{first!r}: {pair.must} {pair.second} = {second!r}")


def _brake_map_mistakes(identified: Table) -> Iterator[ConfigIssue]:
    """Points of a map belong together, and rise, so that there is a duty for each torque."""
    keys = ("brake_duties", "brake_torques_nm")
    points = [identified.get(key) for key in keys]
    if points == [None, None]:
        return
    lists = [each if isinstance(each, list) else [] for each in points]
    if len(lists[0]) != len(lists[1]):
        problem = f"{len(lists[0])} values and {len(lists[1])} model.identified.{keys[1]}: each duty needs its torque"
        yield ConfigIssue(f"model.identified.{keys[0]}", problem)
    for key, values in zip(keys, lists, strict=True):
        numbers = [value for value in values if isinstance(value, int | float)]
        if any(following <= value for value, following in pairwise(numbers)):
            yield ConfigIssue(f"model.identified.{key}", f"{_short(values)}: must rise from value to value")


_LIMITS: Final = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
_CEILINGS: Final = {"guard.over_speed_rad_s": "the rig's own limit, which no configuration can raise"}
_NUMBER: Final = re.compile(r"[+-]?[0-9.]+(e[+-]?[0-9]+)?", re.IGNORECASE)
_NUMERIC: Final = ("int_", "float_", "finite_")
"""How pydantic calls its findings about what should be a number."""


def _in_words(detail: Any) -> ConfigIssue:
    """One of pydantic's findings as dotted key, value and what is allowed."""
    location = [part for part in detail["loc"] if part != "[key]"]
    path = ".".join(map(str, location))
    value, kind = detail["input"], detail["type"]
    if kind == "extra_forbidden":
        return ConfigIssue(path, f"unknown key{near_match(str(location[-1]), _known_keys(location[:-1]))}")
    if kind == "missing":
        return ConfigIssue(path, "is missing; a profile normally provides it")
    if kind == "model_type":
        return ConfigIssue(path, f"{_short(value)}: must be a section, as [{path}] with its keys below")
    allowed = limits(location)
    message = detail["msg"].replace("Input should be", "must be")
    wanted = f"must be {allowed}" if allowed else message[0].lower() + message[1:]
    ceiling = f" ({_CEILINGS[path]})" if path in _CEILINGS and kind == "less_than_equal" else ""
    return ConfigIssue(path, f"{_short(value)}: {wanted}{ceiling}{_meant(location, value, kind)}")


def _meant(location: Sequence[Any], value: object, kind: str) -> str:
    """What may have been meant by a value that is not a number, or one in another unit; empty if there is no guess."""
    unit = unit_of(str(location[-1]))
    if isinstance(value, str):
        if not kind.startswith(_NUMERIC):
            return ""
        return "; write it without quotes" if _NUMBER.fullmatch(value) else number_hint(value, unit)
    field = _field_at(location)
    if field is None or field.annotation is not float or isinstance(value, bool) or not isinstance(value, int | float):
        return ""
    low, high = (_bounds(field, *names) for names in (("ge", "gt"), ("le", "lt")))
    return other_unit(value, unit, low[0], high[0]) if low and high else ""


def _short(value: object) -> str:
    """As it stands in the file, cut short."""
    text = {True: "true", False: "false"}[value] if isinstance(value, bool) else repr(value)
    text = value.isoformat() if isinstance(value, date | time) else text
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."


def _model_at(location: Sequence[Any]) -> type[BaseModel] | None:
    model: Any = RigConfig
    for part in location:
        field = model.model_fields.get(part) if isinstance(model, type) and issubclass(model, BaseModel) else None
        model = field.annotation if field is not None else None
    return model if isinstance(model, type) and issubclass(model, BaseModel) else None


def _known_keys(location: Sequence[Any]) -> Iterable[str]:
    model = _model_at(location)
    return model.model_fields if model is not None else ()


def _field_at(location: Sequence[Any]) -> FieldInfo | None:
    model = _model_at(location[:-1])
    return model.model_fields.get(location[-1]) if model is not None and isinstance(location[-1], str) else None


def _bounds(field: FieldInfo, *names: str) -> list[float]:
    """What a field's rules say of some of `_LIMITS`."""
    found = (getattr(rule, name, None) for rule in field.metadata for name in names)
    return [bound for bound in found if bound is not None]


def limits(location: Sequence[Any]) -> str:
    """Type and range of the field at `location`, as in "a number at least 0 and below 1"; empty if not so simple."""
    field = _field_at(location)
    names = {float: "a number", int: "a whole number", str: "text"}
    if field is None or field.annotation not in names:
        return ""
    bounds = [f"{words} {bound:.12g}" for limit, words in _LIMITS.items() for bound in _bounds(field, limit)]
    return " ".join([names[field.annotation], " and ".join(bounds)]).strip()
