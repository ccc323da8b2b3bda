"""Braking as environments of Gymnasium, one at a time or many at once. Needs the extra `gym`.

Importing this module registers `inteco_abs/Braking-v0` for `gymnasium.make` and `gymnasium.make_vec`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from operator import index
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from inteco_abs.config import RigConfig, load_config
from inteco_abs.control import control_check, function_of, make_estimator
from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.interfaces.braking import Clock, Ending, PythonStops, Stops
from inteco_abs.rig import LONGEST_BRAKING_S, POPULATIONS, brake_duty, brake_torque, draw, nominal_parameters
from inteco_abs.sessions import LOCKED_SLIP, LOWEST_RAD_S
from inteco_abs.signals import EXPLANATIONS, Reason

try:
    import gymnasium
    from gymnasium.error import ResetNeeded
    from gymnasium.spaces import Box
    from gymnasium.utils.seeding import np_random
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise AbsError("the environments need Gymnasium: pip install 'inteco-abs[gym]'") from error

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Info = dict[str, Any]

NAME: Final = "inteco_abs/Braking-v0"
FASTEST_RAD_S: Final = 1000.0
"""Bound of an estimated speed: no wheel exceeds 300 rad/s, but the difference of two counts may for a moment."""
_LOCK_PENALTY: Final = 1.0


class Truth(NamedTuple):
    """What a reward may look at: arrays with one number for each environment."""

    time_s: Any
    """Since braking began."""
    wheel_speed_rad_s: Any
    road_speed_rad_s: Any
    slip: Any
    """In 0..1."""
    brake_torque_nm: Any
    """What the brake can hold."""
    brake: Any
    """Duty that the guard has admitted last, in 0..1."""
    reference_slip: Any


Reward = Callable[[Truth], Any]
"""Rewards of an action, one for each environment, from the state that it has led to."""


def slip_reward(truth: Truth) -> Any:
    """Minus the squared slip error, and minus 1 for a locked wheel: slip above 0.9 while the road is above 10 rad/s."""
    slip_error = truth.slip - truth.reference_slip
    locked = (truth.slip > LOCKED_SLIP) & (truth.road_speed_rad_s > LOWEST_RAD_S)
    return -(slip_error * slip_error) - _LOCK_PENALTY * locked


@dataclass(frozen=True, slots=True, kw_only=True)
class BrakingChoices:
    """Arguments of both environments, by name. Raises ValueError for what is out of range, ConfigError for settings."""

    population: str = "hard"
    """Population of the rigs: `nominal`, `hard`, `rough`, `late`, `slow` or `capped`; `hard` by default."""
    config: str | Path | None = None
    """A rig.toml; None: the defaults."""
    settings: Sequence[str] = ()
    """As for `--set`, such as `["estimator.name=kalman"]`."""
    action: Literal["duty", "torque"] = "duty"
    """What an action in 0..1 is: the brake's duty, or a torque as a share of that at full duty (9.03 N m), which the
    straight line of the nominal brake turns into a duty. `duty` by default."""
    ticks_per_action: int = 10
    """Periods of the loop (`loop.rate_hz`) for which an action is held, from 1 to a second of them; 10 by default."""
    run_up_from_rad_s: float | None = None
    """Road speed from which the drive accelerates the wheels, from 0 to `experiment.start_speed_rad_s`; None: from the
    start speed itself, which takes the 20 ms that estimators need."""
    longest_s: float = LONGEST_BRAKING_S
    """Braking for so long truncates a stop: above 0, at most `experiment.braking_timeout_s`; 4 by default."""
    reward: Reward = slip_reward
    """Function of the `Truth` after an action."""

    def load(self) -> RigConfig:
        """The configuration, with which the other choices go together."""
        if self.population not in POPULATIONS:
            raise ValueError(f"population {self.population!r}: must be one of {', '.join(POPULATIONS)}")
        if not callable(self.reward):
            raise TypeError(f"reward = {self.reward!r}: must be a function of a Truth")
        if isinstance(self.settings, str):
            raise ConfigError.of("settings", f"{self.settings!r}: must be a list, as in [{self.settings!r}]")
        if self.action not in {"duty", "torque"}:
            raise ValueError(f"action {self.action!r}: must be 'duty' or 'torque'")
        config = load_config(None if self.config is None else Path(self.config), self.settings, [control_check()])
        most, start = int(config.loop.rate_hz), config.experiment.start_speed_rad_s
        if self.ticks_per_action not in range(1, most + 1):
            raise ValueError(f"ticks_per_action = {self.ticks_per_action!r}: must be a whole number in 1..{most}")
        if self.run_up_from_rad_s is not None and not 0.0 <= self.run_up_from_rad_s <= start:
            raise ValueError(
                f"run_up_from_rad_s = {self.run_up_from_rad_s!r}: must be in 0..{start:g}, the start speed"
            )
        longest = config.experiment.braking_timeout_s
        if not 0.0 < self.longest_s <= longest:
            problem = f"must be above 0, and at most {longest:g}, experiment.braking_timeout_s"
            raise ValueError(f"longest_s = {self.longest_s!r}: {problem}")
        return config


class _Step(NamedTuple):
    """Result of an action, or of a reset, with one entry per environment."""

    observations: Floats
    rewards: Floats
    terminations: Flags
    truncations: Flags
    info: Info


def _spaces() -> tuple[Any, Any]:
    """Spaces of observations and of actions, new ones: each has a generator of its own."""
    low = np.array([-FASTEST_RAD_S, -FASTEST_RAD_S, 0.0, 0.0])
    high = np.array([FASTEST_RAD_S, FASTEST_RAD_S, 1.0, 1.0])
    return Box(low, high, dtype=np.float64), Box(0.0, 1.0, (1,), np.float64)


class _Episodes:
    """Stops of drawn rigs, their observations and rewards: what both environments do."""

    def __init__(self, count: int, choices: BrakingChoices, *, compile_stops: bool) -> None:
        self._config = config = choices.load()
        self._population, self._reward = choices.population, choices.reward
        self._nominal = nominal_parameters(config.model) if choices.action == "torque" else None
        if config.controller.constant_slip is None:
            problem = "an environment has a constant reference: remove it, and set controller.reference_slip"
            raise ConfigError.of(f"controller.{config.controller.reference_key}", problem)
        self._reference = np.full(count, config.controller.reference_slip)
        clock = Clock(config.period_ns, choices.ticks_per_action, round(choices.longest_s * 1e9 / config.period_ns))
        run_up_from = choices.run_up_from_rad_s
        rolling = config.experiment.start_speed_rad_s if run_up_from is None else run_up_from
        self._stops = _stops(config, clock, count, rolling, compile_stops=compile_stops)
        self._rigs: list[str] = [""] * count
        self._begun = np.zeros(count, np.bool_)

    def begin(self, place: int, rig_seed: int) -> None:
        """A new stop, of the rig with this seed. Raises AbsError where its run-up ends without braking."""
        self._stops.begin(place, draw(self._population, rig_seed))
        self._rigs[place] = rig = f"{self._population}:{rig_seed}"
        if self._stops.column("stop", "ending")[place]:
            reason = Reason(self._stops.column("guard", "reason")[place])
            raise AbsError(f"rig {rig} does not reach experiment.start_speed_rad_s: {EXPLANATIONS[reason]}")
        self._begun[place] = True

    def act(self, places: list[int], actions: Floats) -> None:
        """Hold these actions, one for each place, for as long as an action lasts."""
        if not self._begun[places].all():
            raise ResetNeeded("the stop is over, or has not begun: call reset() first")
        self._stops.act(places, [self._duty(action) for action in actions.tolist()])

    def now(self, begun: Sequence[int]) -> _Step:
        """State of all stops, of which those at these places have just begun."""
        truth, endings = self._truth(), self._column("stop", "ending")
        rewards = np.array(self._reward(truth), np.float64)
        if rewards.shape != endings.shape:
            raise ValueError(f"reward of shape {rewards.shape}: must be {endings.shape}, a number per environment")
        rewards[begun] = 0.0
        self._begun[endings != Ending.NOT_YET] = False
        estimates = [self._column("stop", name) for name in ("wheel_speed", "road_speed", "slip")]
        return _Step(
            np.stack([*estimates, truth.brake], axis=1),
            rewards,
            (endings == Ending.STANDING) | (endings == Ending.TRIPPED),
            endings == Ending.OUT_OF_TIME,
            self._info(truth, begun, endings),
        )

    def _duty(self, action: float) -> float:
        k = self._nominal
        return action if k is None else brake_duty(action * brake_torque(1.0, k), k)

    def _truth(self) -> Truth:
        column = self._column
        return Truth(
            (column("stop", "tick") - column("stop", "began")) * (self._config.period_ns * 1e-9),
            column("rig", "wheel_speed"),
            column("rig", "road_speed"),
            column("stop", "true_slip"),
            column("rig", "brake_torque"),
            column("guard", "brake"),
            self._reference.copy(),
        )

    def _info(self, truth: Truth, begun: Sequence[int], endings: NDArray[Any]) -> Info:
        info: Info = truth._asdict() | {f"_{name}": np.ones(len(endings), np.bool_) for name in truth._fields}
        _add(info, "rig", begun, [self._rigs[place] for place in begun])
        ended, reasons = np.flatnonzero(endings), self._column("guard", "reason")
        _add(info, "ended", ended, [_ending(Ending(endings[place]), Reason(reasons[place])) for place in ended])
        return info

    def _column(self, part: str, name: str) -> NDArray[Any]:
        return self._stops.column(part, name).copy()  # the stops go on, what was returned stays


def _stops(config: RigConfig, clock: Clock, count: int, rolling_rad_s: float, *, compile_stops: bool) -> Stops:
    """Compiled where that is wanted and can be."""
    function = function_of(make_estimator(config))
    if not compile_stops or function is None or find_spec("numba") is None:
        return PythonStops(config, clock, count, rolling_rad_s)
    from inteco_abs.interfaces.compiled_braking import CompiledStops  # noqa: PLC0415  numba is heavy, and an extra

    return CompiledStops(config, clock, count, rolling_rad_s, function)


def _ending(ending: Ending, reason: Reason) -> str:
    return reason.name if ending is Ending.TRIPPED else ending.name


def _add(info: Info, name: str, places: Sequence[int] | NDArray[np.int64], values: Sequence[str]) -> None:
    """Values of some environments, beside a mask that says which, as Gymnasium has them."""
    if len(places):
        every = np.full(len(info["slip"]), None, object)
        every[places] = values
        info[name], info[f"_{name}"] = every, np.isin(np.arange(len(every)), places)


class BrakingEnv(gymnasium.Env[Floats, Floats]):
    """A braking stop of a drawn rig, from the start speed to standstill, behind the guard.

    The arguments are those of `BrakingChoices`. An **observation** is what an estimator on the rig knows: wheel speed
    and road speed in rad/s (-1000..1000), slip in 0..1, and the brake duty that the guard admitted last, in 0..1. An
    **action** is a duty or share of torque in 0..1; the guard clamps the duty to `guard.brake_limit`.

    The **reward** of an action is that of the true state after it, by default `slip_reward`; `info` has the same state
    under the names of `Truth`, after a reset the `rig` as POPULATION:SEED, and at the end why it `ended`. A stop
    terminates with the road below 0.5 rad/s (`STANDING`), or when the guard trips (the name of its reason, such as
    `BAD_OUTPUT` for an action that is not a number); it is truncated after `longest_s` of braking (`OUT_OF_TIME`).

    `reset(seed=N)` draws rig N of the population, and later resets draw from the same generator;
    `options={"rig_seed": N}` names a rig.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  as Gymnasium declares it

    def __init__(self, *, render_mode: None = None, **choices: Any) -> None:
        self.render_mode = render_mode
        self._episodes = _Episodes(1, BrakingChoices(**choices), compile_stops=False)
        self.observation_space, self.action_space = _spaces()

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Floats, Info]:
        """Begin the stop of another rig."""
        super().reset(seed=seed)
        self._episodes.begin(0, _rig_seed(seed, _named_rig(options), self.np_random))
        observations, _, _, _, info = self._episodes.now([0])
        return observations[0], _first(info)

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, Info]:
        """Hold an action. Raises ResetNeeded after the end of a stop, ValueError for an action of another shape."""
        self._episodes.act([0], _shaped(action, (1,)))
        observations, rewards, terminations, truncations, info = self._episodes.now([])
        return observations[0], float(rewards[0]), bool(terminations[0]), bool(truncations[0]), _first(info)


class BrakingVectorEnv(VectorEnv[Floats, Floats, NDArray[Any]]):
    """`num_envs` of `BrakingEnv`, compiled where numba (the extra `lab`) is installed, with the same bits.

    `reset(seed=N)` seeds them with N, N + 1 and so on, a list gives each its own; so does a list of rigs in
    `options={"rig_seed": [...]}`. A stop that is over begins again at the next step, as in Gymnasium's own vector
    environments: that step's action is not used, and its reward is 0.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012  same

    def __init__(self, num_envs: int = 1, *, render_mode: None = None, **choices: Any) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs = {num_envs!r}: must be at least 1")
        self.num_envs, self.render_mode = num_envs, render_mode
        self._episodes = _Episodes(num_envs, BrakingChoices(**choices), compile_stops=True)
        self.single_observation_space, self.single_action_space = _spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators = [np_random()[0] for _ in range(num_envs)]
        self._over = np.zeros(num_envs, np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Info | None = None
    ) -> tuple[Floats, Info]:
        """Begin the stops of other rigs."""
        seeds = _one_each("seed", seed, self.num_envs, 1)
        rigs = _one_each("rig_seed", _named_rig(options), self.num_envs, 0)
        for place, (own, rig) in enumerate(zip(seeds, rigs, strict=True)):
            if own is not None:
                self._generators[place] = np_random(own)[0]
            self._episodes.begin(place, _rig_seed(own, rig, self._generators[place]))
        self._over[:] = False
        observations, _, _, _, info = self._episodes.now(range(self.num_envs))
        return observations, info

    def step(self, actions: Floats) -> tuple[Floats, Floats, Flags, Flags, Info]:
        """Hold an action in each; stops that are over begin again."""
        actions = _shaped(actions, (self.num_envs, 1))
        again = np.flatnonzero(self._over).tolist()
        for place in again:
            self._episodes.begin(place, _rig_seed(None, None, self._generators[place]))
        going = np.flatnonzero(~self._over)
        self._episodes.act(going.tolist(), actions[going, 0])
        step = self._episodes.now(again)
        self._over = step.terminations | step.truncations
        return step


def _one_each(name: str, given: int | Sequence[int | None] | None, count: int, step: int) -> list[int | None]:
    """Seeds of as many environments: a list as it is, else a number and those that follow by `step`."""
    if given is None:
        return [None] * count
    if isinstance(given, int | np.integer):
        return [int(given) + i * step for i in range(count)]
    if len(given) != count:
        raise ValueError(f"{name} has {len(given)} entries: must be {count}, one per environment")
    return list(given)


def _named_rig(options: Info | None) -> Any:
    """`rig_seed` of the options of a reset, None without. A misspelt one would silently be another rig."""
    others = [name for name in options or {} if name != "rig_seed"]
    if others:
        raise ValueError(f"options {', '.join(map(repr, others))}: the only option is 'rig_seed'")
    return (options or {}).get("rig_seed")


def _rig_seed(seed: int | None, rig_seed: int | None, generator: np.random.Generator) -> int:
    given = seed if rig_seed is None else rig_seed
    if given is None:
        return int(generator.integers(1 << 32))
    try:
        return index(given)
    except TypeError:
        raise TypeError(f"seed of a rig {given!r}: must be a whole number") from None


def _shaped(actions: Any, shape: tuple[int, ...]) -> Floats:
    found = np.asarray(actions, np.float64)
    if found.shape != shape:
        raise ValueError(f"actions of shape {found.shape}: must be {shape}")
    return found


def _first(info: Info) -> Info:
    """Info of a single environment."""
    values = {name: value[0] for name, value in info.items() if not name.startswith("_") and info[f"_{name}"][0]}
    return {name: value if isinstance(value, str) else float(value) for name, value in values.items()}


gymnasium.register(
    NAME,
    entry_point=f"{__name__}:BrakingEnv",
    vector_entry_point=f"{__name__}:BrakingVectorEnv",
    nondeterministic=False,
)
