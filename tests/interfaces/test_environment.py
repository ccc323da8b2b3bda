"""Braking as environments of Gymnasium."""

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from ensemble_parts import Shell
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

from inteco_abs.config import load_config
from inteco_abs.control import ESTIMATORS, control_check, make_controller, make_estimator
from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.interfaces import braking, environment
from inteco_abs.interfaces.environment import NAME, BrakingEnv, BrakingVectorEnv, Truth
from inteco_abs.montecarlo import run_stops
from inteco_abs.rig import POPULATIONS, draw
from inteco_abs.signals import Estimate

compiles = pytest.mark.xdist_group("compiled")


def stop(env, policy, **reset):
    """Observations, rewards, infos and the end of one stop."""
    observation, info = env.reset(**reset)
    observations, rewards, infos, over = [observation], [], [info], False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        observations.append(observation)
        rewards.append(reward)
        infos.append(info)
        over = terminated or truncated
    return np.array(observations), np.array(rewards), infos, (terminated, truncated)


def duty(value):
    return lambda _: np.array([value])


@pytest.mark.parametrize("choices", [{}, {"action": "torque", "population": "nominal"}])
def test_gymnasiums_own_checker_finds_nothing(choices):
    check_env(gymnasium.make(NAME, **choices).unwrapped)


@pytest.mark.long
@compiles
def test_a_shipped_law_as_agent_brakes_as_it_does_in_a_monte_carlo_run():
    """At one tick per action, bit for bit: with delay, encoder noise, dead time and guard."""
    config = load_config(checks=[control_check()])
    law = make_controller(config)

    def policy(observation):
        wheel, road, slip, _ = observation.tolist()
        return np.array([law.update(Estimate(wheel, road, slip, valid=True), config.period_ns / 1e9).brake])

    env = BrakingEnv(population="rough", ticks_per_action=1, run_up_from_rad_s=178.0)
    observations, _, infos, end = stop(env, policy, seed=3)
    trace = run_stops([draw("rough", 3)], config, run_up_from_rad_s=178.0, traced=[0]).traces[0]
    assert end == (True, False)
    assert infos[0]["rig"] == "rough:3"
    assert infos[-1]["ended"] == "STANDING"
    for name in ("wheel_speed_rad_s", "road_speed_rad_s", "slip", "brake_torque_nm"):
        # the run's first row is the tick at which braking began, before the first decision
        assert [info[name] for info in infos] == getattr(trace, name)[1:].tolist(), name
    assert observations[:-1, 2].tolist() == trace.slip_estimated[1:-1].tolist()
    assert [info["brake"] for info in infos] == trace.brake[:-1].tolist()
    assert observations[:, 3].tolist() == [info["brake"] for info in infos]


def together(envs, actions, **reset):
    observations, info = envs.reset(**reset)
    yield observations, info
    for each in actions:
        observations, *rest, info = envs.step(each)
        yield *rest, observations, info


@pytest.mark.long
@compiles
@pytest.mark.parametrize(
    "choices",
    [
        {"population": "hard", "action": "torque", "longest_s": 0.4},
        pytest.param(
            {"population": "slow", "run_up_from_rad_s": 179.0, "ticks_per_action": 7}, marks=pytest.mark.long, id="slow"
        ),
        *(
            pytest.param(
                {"population": "rough", "settings": [f"estimator.name={name}"], "longest_s": 0.3},
                marks=pytest.mark.long,
                id=name,
            )
            for name in ESTIMATORS
        ),
    ],
)
def test_many_at_once_have_the_bits_of_one_at_a_time_over_restarts_too(choices):
    actions = np.random.default_rng(5).uniform(0.3, 0.8, (120, 3, 1))
    actions[70, 1] = np.nan
    vector = gymnasium.make_vec(NAME, num_envs=3, **choices)
    assert isinstance(vector, BrakingVectorEnv)
    single = SyncVectorEnv([lambda: BrakingEnv(**choices)] * 3)
    ends = set()
    for ours, theirs in zip(together(vector, actions, seed=11), together(single, actions, seed=11), strict=True):
        for mine, other in zip(ours[:-1], theirs[:-1], strict=True):
            assert (mine.dtype, mine.tobytes()) == (other.dtype, other.tobytes())
        assert ours[-1].keys() == theirs[-1].keys()
        for name, values in ours[-1].items():
            assert np.array_equal(values, theirs[-1][name]), name
        ends.update(filter(None, ours[-1].get("ended", ())))
    assert "BAD_OUTPUT" in ends


@pytest.mark.parametrize("population", POPULATIONS)
def test_the_same_seed_is_the_same_stop_and_another_seed_another_rig(population):
    env = BrakingEnv(population=population, longest_s=0.05)
    first, again, other = (stop(env, duty(0.6), seed=seed) for seed in (4, 4, 5))
    assert np.array_equal(first[0], again[0])
    assert first[2] == again[2]
    assert first[2][0]["rig"] == f"{population}:4"
    assert population == "nominal" or not np.array_equal(first[0], other[0])


@pytest.mark.long
@compiles
def test_an_estimator_that_is_a_class_runs_in_python_with_the_same_bits(monkeypatch):
    function = BrakingVectorEnv(2)
    for module in (braking, environment):
        monkeypatch.setattr(module, "make_estimator", lambda config: Shell(make_estimator(config)))
    of_class = BrakingVectorEnv(2)
    for envs in (function, of_class):
        envs.reset(seed=1)
    for _ in range(5):
        ours, theirs = (envs.step(np.full((2, 1), 0.6))[0] for envs in (function, of_class))
        assert ours.tobytes() == theirs.tobytes()


@pytest.fixture
def in_python(monkeypatch):
    """As where numba is not installed: its code would be made first, for nine seconds."""
    monkeypatch.setitem(sys.modules, "numba", None)


@pytest.mark.usefixtures("in_python")
def test_a_rig_may_be_named_and_unnamed_ones_follow_from_the_seed():
    env = BrakingEnv(longest_s=0.05)
    assert env.reset(seed=1, options={"rig_seed": 17})[1]["rig"] == "hard:17"
    after = [env.reset()[1]["rig"] for _ in range(3)]
    assert len(set(after)) == 3
    env.reset(seed=1)
    assert [env.reset()[1]["rig"] for _ in range(3)] == after
    vector = BrakingVectorEnv(2)
    assert vector.reset(options={"rig_seed": [5, 6]})[1]["rig"].tolist() == ["hard:5", "hard:6"]
    assert vector.reset(seed=[8, 2])[1]["rig"].tolist() == ["hard:8", "hard:2"]
    with pytest.raises(ValueError, match="rig_seed has 1 entries: must be 2"):
        vector.reset(options={"rig_seed": [5]})
    with pytest.raises(TypeError, match=r"5\.5: must be a whole number"):
        env.reset(options={"rig_seed": 5.5})
    with pytest.raises(ValueError, match=r"must be in 0\.\."):
        env.reset(options={"rig_seed": -1})
    with pytest.raises(TypeError, match="reward = 3: must be a function of a Truth"):
        gymnasium.make(NAME, reward=3)
    for either in (env, vector):
        with pytest.raises(ValueError, match=r"options 'rig_sed': the only option is 'rig_seed'"):
            either.reset(options={"rig_sed": 17})


@pytest.mark.usefixtures("in_python")
@pytest.mark.parametrize("make", [BrakingEnv, BrakingVectorEnv])
def test_an_action_that_is_not_a_number_ends_the_stop_with_the_guards_reason(make):
    env = make()
    env.reset(seed=1)
    _, _, terminated, truncated, info = env.step(np.full(env.action_space.shape, np.nan))
    assert (terminated, truncated, info["brake"]) == (True, False, 0.0)
    assert np.ravel(info["ended"])[0] == "BAD_OUTPUT"


def test_the_guard_limits_an_action_as_it_does_on_the_rig():
    env = BrakingEnv(population="nominal", settings=["guard.brake_limit=0.7"])
    env.reset(seed=1)
    observation, *_, info = env.step(np.array([7.0]))
    assert observation[3] == info["brake"] == 0.7
    capped = BrakingEnv(population="capped")
    capped.reset(seed=1)
    assert capped.step(np.array([1.0]))[4]["brake"] == 0.7


def test_a_torque_is_a_share_of_that_at_full_duty():
    env = BrakingEnv(population="nominal", action="torque")
    env.reset(seed=1)
    info = env.step(np.array([0.5]))[4]
    assert info["brake_torque_nm"] == pytest.approx(0.5 * (15.24 - 6.21))


def test_a_stop_is_truncated_when_its_time_is_over():
    _, rewards, infos, end = stop(BrakingEnv(longest_s=0.1), duty(0.0), seed=1)
    assert end == (False, True)
    assert infos[-1]["ended"] == "OUT_OF_TIME"
    assert infos[-1]["time_s"] == pytest.approx(0.1, abs=0.006)
    assert len(rewards) == 20


def test_default_reward_is_the_slip_error_and_a_penalty_for_locking():
    _, rewards, infos, _ = stop(BrakingEnv(population="nominal"), duty(0.7), seed=1)
    locked = [info["slip"] > 0.9 and info["road_speed_rad_s"] > 10.0 for info in infos[1:]]
    assert 0 < sum(locked) < len(locked)
    wanted = [-((info["slip"] - 0.2) ** 2) - wheel_locked for info, wheel_locked in zip(infos[1:], locked, strict=True)]
    assert rewards == pytest.approx(wanted)

    def slower(truth: Truth):
        return -truth.road_speed_rad_s

    own = stop(BrakingEnv(population="nominal", reward=slower), duty(0.7), seed=1)
    assert own[1].tolist() == [-info["road_speed_rad_s"] for info in own[2][1:]]


@pytest.mark.usefixtures("in_python")
def test_a_reward_needs_a_number_for_each_environment():
    envs = BrakingVectorEnv(2, reward=lambda truth: -truth.slip[:1])
    with pytest.raises(ValueError, match=r"reward of shape \(1,\): must be \(2,\), a number per environment"):
        envs.reset(seed=1)


def test_the_run_up_is_skipped_or_as_long_as_asked():
    (_, short), (_, long) = (
        BrakingEnv(run_up_from_rad_s=speed).reset(seed=1) for speed in (None, 150.0)
    )  # fmt: skip
    assert short["road_speed_rad_s"] == pytest.approx(180.0, abs=1.5)
    assert long["road_speed_rad_s"] == pytest.approx(180.0, abs=1.5)
    assert short["time_s"] == long["time_s"] == 0.0005
    with pytest.raises(AbsError, match=r"hard:1 does not reach experiment.start_speed_rad_s: the start speed was not"):
        BrakingEnv(settings=["experiment.spin_up_timeout_s=0.5"], run_up_from_rad_s=100.0).reset(seed=1)


def test_a_step_needs_a_stop_that_is_not_over():
    env = BrakingEnv(longest_s=0.01)
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(np.array([0.5]))
    stop(env, duty(0.5), seed=1)
    with pytest.raises(ResetNeeded, match="over"):
        env.step(np.array([0.5]))


@pytest.mark.parametrize(
    ("choices", "message"),
    [
        ({"population": "easy"}, "population 'easy': must be one of nominal, hard"),
        ({"action": "slip"}, "action 'slip': must be 'duty' or 'torque'"),
        ({"ticks_per_action": 0}, r"ticks_per_action = 0: must be a whole number in 1..2000"),
        ({"ticks_per_action": 2.5}, r"ticks_per_action = 2.5: must be a whole number"),
        ({"run_up_from_rad_s": 181.0}, r"run_up_from_rad_s = 181.0: must be in 0..180"),
        ({"longest_s": 11.0}, r"longest_s = 11.0: must be above 0, and at most 10"),
    ],
)
def test_a_wrong_argument_is_refused_with_its_range(choices, message):
    with pytest.raises(ValueError, match=message):
        BrakingEnv(**choices)


def test_a_configuration_comes_from_a_file(tmp_path):
    (tmp_path / "rig.toml").write_text("[controller]\nreference_slip = 0.3\n[experiment]\nstart_speed_rad_s = 100.0\n")
    _, info = BrakingEnv(config=tmp_path / "rig.toml", settings=["controller.reference_slip=0.25"]).reset(seed=1)
    assert info["reference_slip"] == 0.25
    assert info["road_speed_rad_s"] == pytest.approx(100.0, abs=1.5)


def test_a_wrong_setting_is_the_error_of_a_configuration():
    with pytest.raises(ConfigError, match="no estimator 'kalmann'"):
        BrakingEnv(settings=["estimator.name=kalmann"])
    with pytest.raises(ConfigError, match=r"must be a list, as in \['loop\.rate_hz=1000'\]"):
        BrakingEnv(settings="loop.rate_hz=1000")
    with pytest.raises(ValueError, match="at least 1"):
        BrakingVectorEnv(0)


def test_an_action_of_another_shape_is_refused():
    env = BrakingEnv()
    env.reset(seed=1)
    with pytest.raises(ValueError, match=r"actions of shape \(2,\): must be \(1,\)"):
        env.step(np.array([0.1, 0.2]))


def test_without_gymnasium_the_error_names_the_extra():
    code = "import sys; sys.modules['gymnasium'] = None; import inteco_abs.interfaces.environment"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "AbsError: the environments need Gymnasium: pip install 'inteco-abs[gym]'" in done.stderr


@pytest.mark.long
@compiles
def test_without_numba_many_at_once_run_in_python():
    code = (
        "import sys; sys.modules['numba'] = None\n"
        "import gymnasium, numpy\n"
        "envs = gymnasium.make_vec('inteco_abs.interfaces.environment:inteco_abs/Braking-v0', num_envs=2)\n"
        "envs.reset(seed=1)\n"
        "print(envs.step(numpy.full((2, 1), 0.5))[0].tolist())\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    envs = BrakingVectorEnv(2)
    envs.reset(seed=1)
    assert done.stdout.strip() == str(envs.step(np.full((2, 1), 0.5))[0].tolist()), done.stderr
