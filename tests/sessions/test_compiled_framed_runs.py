"""Runs through frames, with faults of link and rig, are decided by machine code with the same bits."""

import pytest

from inteco_abs.analysis.compiled_replay import CompiledReplay
from inteco_abs.control import build_pipeline, control_check
from inteco_abs.format import Role
from inteco_abs.mock_board import parse_faults
from inteco_abs.sessions import TICK, session_config
from inteco_abs.signals import BoardFlags, Reason

pytestmark = [pytest.mark.untraced, pytest.mark.long]

NO_TRIP = (
    "lose@brake+20ms", "late=0.7@brake+50ms/#3", "stale@drive+100ms", "corrupt@brake+30ms", "twice@brake+10ms",
    "pause=2@brake+40ms", "wheel-noisy=2@drive+10ms", "brake-weak=0.8@brake+10ms", "master@brake+10ms/#2",
)  # fmt: skip
"""Faults after which both stops may go on to their end; those of a wheel or the brake change what is estimated."""
TRIPS = (
    "lose@brake+20ms/400ms", "road-stuck@drive+50ms", "road-jump=5000@brake+20ms", "road-reversed@drive+300ms",
    "wheel-stuck@drive+50ms", "drive-dead@drive+0ms", "brake-stuck=0.6@start+1ms", "encoders-swapped@brake+20ms",
    "brake-dead@brake+0ms", "power-off@drive+100ms", "drive-stuck=1@start+0ms", "sleep=500@brake+20ms",
)  # fmt: skip


@pytest.mark.parametrize(
    ("controller", "estimator"),
    [("reaching-law", "moving-window"), ("boundary-layer", "kalman"), ("predictive-reaching", "observer")],
)
def test_framed_runs_with_faults_of_link_and_rig_are_decided_the_same(run, controller, estimator):
    flags, reasons, stops = set(), set(), set()
    for number, fault in enumerate(["", *NO_TRIP, *TRIPS]):
        settings = (f"controller.name={controller}", f"estimator.name={estimator}", "experiment.stops=2")
        rig = f'simulation.rig="{("hard", "rough", "slow")[number % 3]}:{number}"'
        faults = parse_faults([fault] if fault else [])
        session = run(*settings, rig, name=f"{number}.mcap", faults=faults).session
        pipeline = build_pipeline(session_config(session, (control_check(),)))
        found = CompiledReplay(pipeline, may_compile=True).decide(session.ticks)
        assert found is not None, fault
        for column in TICK.columns:
            if column.role is not Role.TIMING:
                assert found[column.name].tobytes() == session.ticks[column.name].tobytes(), (fault, column.name)
        flags |= set(session.ticks["board_flags"].tolist())
        reasons |= set(session.ticks["reason"].tolist())
        stops.add(int((session.ticks["phase"][1:] < session.ticks["phase"][:-1]).sum()))
    assert flags >= {BoardFlags.NONE, BoardFlags.STALE}
    assert reasons >= {Reason.NONE, Reason.MISSED_EXCHANGES, Reason.ROAD_ENCODER_FROZEN, Reason.COUNT_JUMP}
    assert stops == {0, 1}, "some runs ended in the first of two stops"
