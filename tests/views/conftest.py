"""Recorded stops to look at."""

from dataclasses import replace

import pytest
from tracing import untraced

from inteco_abs.config import load_config
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.sessions import read_session

QUICK = ("experiment.start_speed_rad_s=20.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")


def _recorded(folder, name, *settings):
    path = folder / name
    return untraced(run_stop, load_config(settings=(*QUICK, *settings)), Plan(out=path, seed=1)), read_session(path)


@pytest.fixture(scope="session")
def stop(tmp_path_factory):
    """A completed stop and its session."""
    return _recorded(tmp_path_factory.mktemp("stop"), "stop.mcap")


@pytest.fixture(scope="session")
def session(stop):
    return stop[1]


@pytest.fixture(scope="session")
def others(tmp_path_factory):
    """Sessions with other gains, and with another controller."""
    folder = tmp_path_factory.mktemp("others")
    return (
        _recorded(folder, "gains.mcap", "controller.gains.Mk=10.0", "controller.gains.Mq=4.0")[1],
        _recorded(folder, "relay.mcap", 'controller.name="relay"')[1],
    )


@pytest.fixture(scope="session")
def faulty(tmp_path_factory):
    """A session that the guard has ended while it braked."""
    return _recorded(tmp_path_factory.mktemp("faulty"), "faulty.mcap", "experiment.braking_timeout_s=0.1")[1]


@pytest.fixture(scope="session")
def with_facts():
    """A session with other facts in one of its records."""

    def change(session, record, **facts):
        return replace(session, metadata={**session.metadata, record: {**session.metadata.get(record, {}), **facts}})

    return change


@pytest.fixture
def verb(verb, monkeypatch, tmp_path):
    """As everywhere, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return verb
