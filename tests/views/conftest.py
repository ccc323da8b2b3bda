"""A recorded stop to look at."""

import pytest

from inteco_abs.config import load_config
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.sessions import read_session

QUICK = ("experiment.start_speed_rad_s=20.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")


@pytest.fixture(scope="session")
def stop(tmp_path_factory):
    """A completed stop and its session."""
    path = tmp_path_factory.mktemp("stop") / "stop.mcap"
    outcome = run_stop(load_config(settings=QUICK), Plan(out=path, seed=1))
    return outcome, read_session(path)


@pytest.fixture(scope="session")
def session(stop):
    return stop[1]
