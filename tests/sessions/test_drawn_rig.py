import numpy as np
import pytest

from inteco_abs.config import load_config
from inteco_abs.errors import ConfigError
from inteco_abs.rig import draw, settled_torque
from inteco_abs.sessions import FileWriter, RunEnd, RunHeader, SessionWriter, read_session
from inteco_abs.signals import Reason

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

QUICK = ("experiment.start_speed_rad_s=20.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")
PACED = ("loop.rate_hz=200.0", "experiment.start_speed_rad_s=10.0", "experiment.idle_s=0.01", "experiment.hold_s=0.0")
RIG = "simulation.rig=hard:17"


@pytest.fixture(scope="module")
def drawn(tmp_path_factory, run_at):
    """A completed stop of a drawn rig from 20 rad/s."""
    return run_at(tmp_path_factory.mktemp("drawn") / "stop.mcap", (*QUICK, RIG))


def test_the_same_rig_and_seed_give_the_same_payload(run, drawn):
    again = run(RIG, name="again.mcap")
    assert again.session.payload == drawn.session.payload
    assert again.session.truth.tobytes() == drawn.session.truth.tobytes()
    assert again.stop.card["payload_sha256"] == drawn.stop.card["payload_sha256"]


def test_another_rig_and_another_power_up_give_another_payload(run, drawn, quick):
    others = [run("simulation.rig=hard:18", name="rig.mcap"), run(RIG, name="seed.mcap", seed=2), quick]
    assert len({made.stop.card["payload_sha256"] for made in (drawn, *others)}) == 4


def test_the_session_says_which_rig_it_was(drawn):
    metadata = drawn.session.metadata
    assert drawn.stop.card["rig"] == "hard:17"
    assert metadata["rig"]["drawn"] == "hard:17"
    assert float(metadata["drawn_rig"]["adhesion_scale"]) == draw("hard", 17).adhesion_scale
    assert float(metadata["drawn_rig"]["parameters.J2"]) == draw("hard", 17).parameters.J2


def test_nothing_is_reported_of_the_published_rig(quick):
    assert quick.stop.card["rig"] is None
    assert "drawn" not in quick.session.metadata["rig"]
    assert "drawn_rig" not in quick.session.metadata


def test_the_decisions_replay_bit_for_bit(drawn, replayed):
    assert replayed(drawn.session).differing == 0


def test_command_reaches_the_terminals_one_tick_late_in_255_steps(drawn):
    ticks, truth = drawn.session.ticks, drawn.session.truth
    assert truth["time_ns"][: len(ticks)].tolist() == ticks["time_ns"].tolist()
    steps = np.floor(ticks["brake"][:-1] * 255.0 + 1e-9)
    assert (truth["brake"][1 : len(ticks)] * 255.0).tolist() == pytest.approx(steps.tolist())
    assert len(set(steps)) > 10


def test_the_torque_begins_the_dead_time_of_the_rig_after_the_write(drawn):
    truth, rig = drawn.session.truth, draw("hard", 17)
    written = next(row for row in truth if settled_torque(float(row["brake"]), rig) > 0.0)
    begun = next(row for row in truth if row["brake_torque_nm"] > 0.0)
    late_s = float(begun["time_ns"] - written["time_ns"]) * 1e-9
    assert rig.brake_dead_time_s < late_s <= rig.brake_dead_time_s + 0.0005


# hard:12 jitters by two counts between its first two samples
@pytest.mark.parametrize("name", ["hard:12", "rough:4", "slow:1"])
def test_no_false_trip_of_a_strict_guard(run, name):
    strict = ("guard.missed_in_a_row=4", "guard.bucket_limit=30")
    made = run(f"simulation.rig={name}", *strict, "controller.name=boundary-layer", "estimator.name=kalman", seed=0)
    assert (made.stop.outcome, made.stop.explanation) == ("completed", "no fault")


@pytest.mark.long
def test_a_rig_in_real_time_is_the_same_rig(tmp_path, run_at, replayed):
    made = run_at(tmp_path / "stop.mcap", (*PACED, RIG), virtual=False)
    session = made.session
    assert (made.stop.card["rig"], session.metadata["rig"]["drawn"]) == ("hard:17", "hard:17")
    assert session.metadata["drawn_rig"]["parameters.J2"] == repr(draw("hard", 17).parameters.J2)
    assert replayed(session).differing == 0
    at_rest = session.ticks["road_count"][:3]
    assert np.ptp(at_rest) <= 4
    braking = session.truth["brake_torque_nm"] > 0.0
    assert braking.any()


@pytest.mark.parametrize("virtual", [True, False])
def test_an_unknown_rig_leaves_no_file(tmp_path, run_at, virtual):
    with pytest.raises(ConfigError, match="did you mean hard"):
        run_at(tmp_path / "stop.mcap", (*PACED, "simulation.rig=hrd:1"), virtual=virtual)
    assert not list(tmp_path.iterdir())


def test_what_is_said_of_a_simulated_rig_is_not_said_of_a_real_one(tmp_path):
    config = load_config(settings=[RIG, "profile=usb2_generic_0103", "simulation.counts_per_turn=2048"])
    with FileWriter(tmp_path / "stop.mcap", 0) as recorder:
        scribe = SessionWriter(recorder, config, RunHeader("usb2:", {}, False, {}, [], b""))
        scribe.write_header()
        card = scribe.finish(RunEnd(Reason.NONE, 0)).card
    assert card["rig"] is None
    assert "drawn" not in read_session(tmp_path / "stop.mcap").metadata["rig"]
