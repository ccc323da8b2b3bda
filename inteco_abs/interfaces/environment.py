"""Braking as environments of Gymnasium, one at a time or many at once. Needs the extra `gym`.

Importing this module registers `inteco_abs/Braking-v0` for `gymnasium.make` and `gymnasium.make_vec`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from inteco_abs.config import RigConfig, load_config
from inteco_abs.control import control_check, function_of, make_estimator
from inteco_abs.errors import AbsError
from inteco_abs.interfaces.braking import Clock, Ending, PythonStops, Stops
from inteco_abs.rig import POPULATIONS, brake_duty, brake_torque, draw, nominal_parameters
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
LONGEST_S: Final = 4.0
"""No rig of any population that is braked at all takes half as long."""
LOCK_PENALTY: Final = 1.0
_LOCKED_SLIP: Final = 0.9
"""As for the metric `lock_fraction`, also above this speed only:"""
_LOCK_ABOVE_RAD_S: Final = 10.0


class Truth(NamedTuple):
    """What a reward may look at: numbers of one environment, or arrays with one number for each."""

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
"""Reward of an action, from the state that it has led to: a number, or an array of them where the truth has arrays."""


def slip_reward(truth: Truth) -> Any:
    """Minus the squared slip error, and minus LOCK_PENALTY for a slip above 0.9 while the road is above 10 rad/s."""
    slip_error = truth.slip - truth.reference_slip
    locked = (truth.slip > _LOCKED_SLIP) & (truth.road_speed_rad_s > _LOCK_ABOVE_RAD_S)
    return -(slip_error * slip_error) - LOCK_PENALTY * locked


class _Step(NamedTuple):
    """Result of an action, or of a reset, with one entry per environment."""

    observations: Floats
    rewards: Floats
    terminations: Flags
    truncations: Flags
    info: Info


def _spaces() -> tuple[Any, Any]:
    """Of observations and of actions, new ones: each has a generator of its own."""
    low = np.array([-FASTEST_RAD_S, -FASTEST_RAD_S, 0.0, 0.0])
    high = np.array([FASTEST_RAD_S, FASTEST_RAD_S, 1.0, 1.0])
    return Box(low, high, dtype=np.float64), Box(0.0, 1.0, (1,), np.float64)


class _Episodes:
    """Stops of drawn rigs, their observations and rewards: what both environments do."""

    def __init__(
        self,
        count: int,
        *,
        population: str = "hard",
        config: str | Path | None = None,
        settings: Sequence[str] = (),
        action: Literal["duty", "torque"] = "duty",
        ticks_per_action: int = 10,
        run_up_from_rad_s: float | None = None,
        longest_s: float = LONGEST_S,
        reward: Reward = slip_reward,
        compile_stops: bool,
    ) -> None:
        self._config = load_config(None if config is None else Path(config), settings, [control_check()])
        _check(self._config, population, action, ticks_per_action, run_up_from_rad_s, longest_s)
        self._population, self._reward = population, reward
        self._nominal = nominal_parameters(self._config.model) if action == "torque" else None
        start = self._config.experiment.start_speed_rad_s
        longest = round(longest_s * 1e9 / self._config.period_ns)
        clock = Clock(self._config.period_ns, ticks_per_action, longest)
        rolling = start if run_up_from_rad_s is None else run_up_from_rad_s
        self._stops = _stops(self._config, clock, count, rolling, compile_stops=compile_stops)
        self._rigs: list[str] = [""] * count
        self._begun = np.zeros(count, np.bool_)

    def begin(self, place: int, rig_seed: int) -> None:
        """A new stop, of the rig with this seed. Raises AbsError where its run-up ends without braking."""
        self._stops.begin(place, draw(self._population, rig_seed))
        self._rigs[place] = f"{self._population}:{rig_seed}"
        if self._stops.column("stop", "ending")[place]:
            reason = Reason(self._stops.column("guard", "reason")[place])
            raise AbsError(
                f"rig {self._rigs[place]} does not reach experiment.start_speed_rad_s: {EXPLANATIONS[reason]}"
            )
        self._begun[place] = True

    def act(self, places: list[int], actions: Floats) -> None:
        """Hold these actions, one for each place, for as long as an action lasts."""
        if not self._begun[places].all():
            raise ResetNeeded("the stop is over, or has not begun: call reset() first")
        self._stops.act(places, [self._duty(action) for action in actions.tolist()])

    def _duty(self, action: float) -> float:
        k = self._nominal
        return action if k is None else brake_duty(action * brake_torque(1.0, k), k)

    def now(self, begun: Sequence[int]) -> _Step:
        """State of all stops, of which those at these places have just begun."""
        column = self._column
        duties, endings = column("guard", "brake"), column("stop", "ending")
        estimates = [column("stop", name) for name in ("wheel_speed", "road_speed", "slip")]
        truth = Truth(
            (column("stop", "tick") - column("stop", "began")) * (self._config.period_ns * 1e-9),
            column("rig", "wheel_speed"),
            column("rig", "road_speed"),
            column("stop", "true_slip"),
            column("rig", "brake_torque"),
            duties,
            np.full(len(duties), self._config.controller.reference_slip),
        )
        rewards = np.array(self._reward(truth), np.float64)
        rewards[begun] = 0.0
        ended = np.flatnonzero(endings)
        self._begun[ended] = False
        info: Info = truth._asdict() | {f"_{name}": np.ones(len(duties), np.bool_) for name in truth._fields}
        _add(info, "rig", begun, [self._rigs[place] for place in begun])
        reasons = column("guard", "reason")
        _add(info, "ended", ended, [_ending(Ending(endings[place]), Reason(reasons[place])) for place in ended])
        return _Step(
            np.stack([*estimates, duties], axis=1),
            rewards,
            (endings == Ending.STANDING) | (endings == Ending.TRIPPED),
            endings == Ending.OUT_OF_TIME,
            info,
        )

    def _column(self, part: str, name: str) -> NDArray[Any]:
        return self._stops.column(part, name).copy()  # the stops go on, what was returned stays


def _check(
    config: RigConfig,
    population: str,
    action: str,
    ticks_per_action: int,
    run_up_from_rad_s: float | None,
    longest_s: float,
) -> None:
    start = config.experiment.start_speed_rad_s
    if population not in POPULATIONS:
        raise ValueError(f"population {population!r}: must be one of {', '.join(POPULATIONS)}")
    if action not in {"duty", "torque"}:
        raise ValueError(f"action {action!r}: must be 'duty' or 'torque'")
    if not 1 <= ticks_per_action <= config.loop.rate_hz:
        raise ValueError(f"ticks_per_action = {ticks_per_action!r}: must be in 1..{config.loop.rate_hz:g}, one second")
    if run_up_from_rad_s is not None and not 0.0 <= run_up_from_rad_s <= start:
        raise ValueError(
            f"run_up_from_rad_s = {run_up_from_rad_s!r}: must be in 0..{start:g}, experiment.start_speed_rad_s"
        )
    if not 0.0 < longest_s <= config.experiment.braking_timeout_s:
        limit = config.experiment.braking_timeout_s
        raise ValueError(f"longest_s = {longest_s!r}: must be above 0, and at most {limit:g}, braking_timeout_s")


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

    An **observation** is what an estimator on the rig knows: wheel speed and road speed in rad/s (-1000..1000), slip
    in 0..1, and the brake duty that the guard admitted last, in 0..1. An **action** is in 0..1: a duty of the brake, or
    with `action="torque"` a torque as a share of that at full duty, which the nominal brake's straight line turns into
    a duty. It is held for `ticks_per_action` periods of the loop (`loop.rate_hz`); the guard clamps it to
    `guard.brake_limit`.

    The **reward** of an action is that of the true state after it, by default `slip_reward`; `info` has the same state
    under the names of `Truth`, after a reset the `rig` as POPULATION:SEED, and at the end why it `ended`. A stop
    terminates with the road below 0.5 rad/s (`STANDING`), or when the guard trips (the name of its reason, such as
    `BAD_OUTPUT` for an action that is not a number); it is truncated after `longest_s` of braking (`OUT_OF_TIME`).

    `reset(seed=N)` draws rig N of the `population`, and later resets draw from the same generator;
    `options={"rig_seed": N}` names a rig. The drive accelerates the wheels from `run_up_from_rad_s` to
    `experiment.start_speed_rad_s`; None: from that speed itself, which takes the 20 ms that estimators need. `config`
    is a rig.toml, and `settings` are as for `--set`, such as `estimator.name=kalman`. Raises ConfigError for these, and
    ValueError for other arguments.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  as Gymnasium declares it

    def __init__(self, *, render_mode: None = None, **choices: Any) -> None:
        self.render_mode = render_mode
        self._episodes = _Episodes(1, compile_stops=False, **choices)
        self.observation_space, self.action_space = _spaces()

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Floats, Info]:
        """Begin the stop of another rig."""
        super().reset(seed=seed)
        self._episodes.begin(0, _rig_seed(seed, (options or {}).get("rig_seed"), self.np_random))
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
        self._episodes = _Episodes(num_envs, compile_stops=True, **choices)
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
        rigs = _one_each("rig_seed", (options or {}).get("rig_seed"), self.num_envs, 0)
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


def _rig_seed(seed: int | None, rig_seed: int | None, generator: np.random.Generator) -> int:
    if rig_seed is not None:
        return int(rig_seed)
    return int(generator.integers(1 << 32)) if seed is None else int(seed)


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
