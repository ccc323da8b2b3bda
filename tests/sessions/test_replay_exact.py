import signal

import pytest

from inteco_abs.control import CONTROLLERS
from inteco_abs.sessions import read_session
from inteco_abs.signals import BrakeDemand, Phase

BRAKING_TIMEOUT = "experiment.braking_timeout_s=0.1"
EVERY_PAIR = [
    pytest.mark.parametrize("controller", ["reaching-law", "relay"]),
    pytest.mark.parametrize("estimator", ["moving-window", "euler"]),
]


def every_pair(test):
    for mark in EVERY_PAIR:
        test = mark(test)
    return test


def agrees(found, session):
    """Whether a replay reproduced every tick, and there was something to reproduce."""
    braking = int((session.ticks["phase"] == Phase.BRAKING).sum())
    assert braking > 100
    assert len(set(session.ticks["brake"].tolist())) > 1
    return (found.ticks, found.braking_ticks, found.differing, found.first, found.by_field) == (
        len(session.ticks),
        braking,
        0,
        None,
        {},
    )


@every_pair
def test_a_completed_run_replays_bit_for_bit(run, replayed, controller, estimator):
    made = run(f"controller.name={controller}", f"estimator.name={estimator}")
    assert made.stop.outcome == "completed"
    assert agrees(replayed(made.session), made.session)


@pytest.mark.untraced
@every_pair
def test_a_run_that_ended_in_a_fault_replays_bit_for_bit(run, replayed, controller, estimator):
    made = run(f"controller.name={controller}", f"estimator.name={estimator}", BRAKING_TIMEOUT)
    assert made.stop.outcome == "fault"
    assert agrees(replayed(made.session), made.session)


@pytest.mark.untraced
@every_pair
def test_an_interrupted_run_replays_bit_for_bit(run, replayed, at_phase, controller, estimator):
    at_phase(Phase.STOPPED, lambda: signal.raise_signal(signal.SIGINT))
    made = run(f"controller.name={controller}", f"estimator.name={estimator}")
    assert made.stop.outcome == "interrupted"
    assert agrees(replayed(made.session), made.session)


@pytest.mark.untraced
@pytest.mark.parametrize(
    "settings",
    [
        ("model.parameters=table",),
        ("simulation.parameters=table", "simulation.brake_rate_per_s=100.0"),
        ("encoders.counts_per_turn=4096", "loop.rate_hz=1000.0"),
        ("board.road_sign=-1", "guard.brake_limit=0.55"),
        ("controller.gains.Mk=0.1", "controller.gains.Mq=1e-3", "controller.reference_slip=0.1"),
        ("estimator.name=difference", "estimator.window_s=0.005"),
        ("estimator.name=edge-time",),
    ],
    ids=["model", "simulation", "rates", "wiring", "gains", "difference", "edge-time"],
)
def test_the_configuration_in_the_file_is_all_that_a_replay_needs(run, replayed, settings):
    made = run(*settings)
    found = replayed(read_session(made.path))
    assert (found.differing, found.ticks) == (0, made.stop.card["ticks"])


@pytest.mark.parametrize("number", [1, 30, 250])
def test_a_file_that_was_cut_replays_up_to_its_end(chunked, container, altered, replayed, number):
    data = chunked.path.read_bytes()
    first_ticks = [record for record in container.split(data) if record.opcode == 6][1]
    session = read_session(altered(data[: first_ticks.end + number]))
    assert session.incomplete
    found = replayed(session)
    assert (found.ticks, found.differing) == (len(session.ticks), 0)
    assert 0 < found.ticks < chunked.stop.card["ticks"]


def test_a_replay_does_not_depend_on_the_one_before(quick, replayed):
    assert replayed(quick.session) == replayed(quick.session)


class Remembering:
    """Controller with a state of its own that starts counting at its first update."""

    gains = ()
    internals = ("updates",)

    def __init__(self, setup) -> None:
        self._reference = setup.reference_slip
        self._updates = 0

    def update(self, estimate, dt_s):
        self._updates += 1
        if self._updates == 300:
            raise ArithmeticError("enough")
        brake = 0.8 if estimate.slip < self._reference else 0.3
        return BrakeDemand(brake, dt_s, estimate.slip, (float(self._updates), 0.0, 0.0, 0.0))


def test_a_users_controller_with_a_state_replays_up_to_the_error_that_it_raises(run, replayed):
    controllers = {**CONTROLLERS, "remembering": Remembering}
    made = run("controller.name=remembering", controllers=controllers)
    assert "ArithmeticError: enough" in made.stop.explanation
    session = made.session
    assert session.ticks["c0"].max() == 299.0
    assert agrees(replayed(session, controllers), session)
