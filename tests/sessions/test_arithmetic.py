"""Runs have the same bits on every machine, and sessions replay with the arithmetic that they were recorded with."""

import json
import math
import os
import subprocess
from dataclasses import replace

import pytest

from inteco_abs import elementary
from inteco_abs.analysis import recorded_arithmetic, replay_session
from inteco_abs.control import build_pipeline
from inteco_abs.errors import SessionError
from inteco_abs.sessions import read_session, session_config
from inteco_abs.sessions.migration import migrated

OBSERVED = (
    "controller.name=predictive-reaching",
    "estimator.name=observer",
    "simulation.rig=rough:2",
    "experiment.start_speed_rad_s=40",
    "experiment.hold_s=0",
)
OTHER_PROCESSOR = {**os.environ, "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"}
"""glibc then takes its functions for processors without fused multiplication; other C libraries take no notice."""


@pytest.fixture(scope="module")
def observed(run_at, tmp_path_factory):
    """A stop with the functions that use most of the arithmetic."""
    return run_at(tmp_path_factory.mktemp("portable") / "stop.mcap", OBSERVED)


@pytest.fixture(scope="module")
def before_format_5(run_at, tmp_path_factory):
    """The same stop, as format 4 recorded it on this machine."""
    with elementary.arithmetic(elementary.LIBM):
        session = run_at(tmp_path_factory.mktemp("libm") / "stop.mcap", OBSERVED).session
    facts = {**session.metadata["session"], "format_version": "4"}
    return replace(session, metadata=migrated({**session.metadata, "session": facts}))


def differing(session):
    with recorded_arithmetic(session):
        return replay_session(session, build_pipeline(session_config(session, ()))).differing


def payload(session):
    return session.metadata["integrity"]["payload_sha256"]


@pytest.mark.untraced
def test_a_run_has_the_same_bits_on_a_processor_without_fused_multiplication(observed, tmp_path):
    there = tmp_path / "there.mcap"
    settings = [word for setting in OBSERVED for word in ("--set", setting)]
    command = ["inteco-abs", "run", "--virtual", "--seed", "1", *settings, "-q", "--out", there]
    subprocess.run(command, env=OTHER_PROCESSOR, check=True)
    assert payload(read_session(there)) == payload(observed.session)


@pytest.mark.untraced
def test_a_session_replays_on_a_processor_without_fused_multiplication(observed):
    command = ["inteco-abs", "replay", "--json", observed.path]
    done = subprocess.run(command, env=OTHER_PROCESSOR, check=True, capture_output=True)
    assert json.loads(done.stdout)["differing"] == 0


def test_a_session_before_format_5_replays_with_the_c_library(before_format_5, observed):
    assert before_format_5.metadata["software"]["arithmetic"] == elementary.LIBM
    assert payload(before_format_5) != payload(observed.session)
    assert differing(before_format_5) == 0
    assert differing(observed.session) == 0


def test_the_arithmetic_of_a_session_holds_for_that_session_alone(before_format_5):
    with recorded_arithmetic(before_format_5):
        assert elementary.exp is math.exp
    assert elementary.exp is elementary.ARITHMETICS[elementary.PORTABLE]["exp"]
    software = {**before_format_5.metadata["software"], "arithmetic": elementary.PORTABLE}
    assert differing(replace(before_format_5, metadata={**before_format_5.metadata, "software": software})) > 0


def test_an_arithmetic_of_a_later_program_is_refused(observed):
    session = observed.session
    later = replace(session, metadata={**session.metadata, "software": {"arithmetic": "decimal"}})
    with pytest.raises(SessionError, match=r"software\.arithmetic is 'decimal': must be one of portable, libm"):
        differing(later)
