"""Runs have the same bits on every machine, and sessions replay with the arithmetic that they were recorded with."""

import math
import os
import runpy
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from tracing import untraced

from inteco_abs import elementary
from inteco_abs.analysis import recorded_arithmetic, replay_session
from inteco_abs.control import ESTIMATORS, build_pipeline
from inteco_abs.errors import SessionError
from inteco_abs.plugins.controllers import installed_controllers
from inteco_abs.sessions import read_session, session_config
from inteco_abs.sessions.fingerprint import LIBM_SHA256, PORTABLE_SHA256, arithmetic_facts, other_arithmetic
from inteco_abs.sessions.migration import migrated
from inteco_abs.signals import Phase

TOOL = runpy.run_path(str(Path(__file__).parents[2] / "tools" / "replay_elsewhere"))
WITHOUT_FMA = TOOL["PROCESSORS"]["without FMA and AVX2"]
"""glibc then takes its functions for processors without fused multiplication; other C libraries take no notice."""
OBSERVED = ("controller.name=predictive-reaching", "estimator.name=observer", TOOL["DRAWN"], *TOOL["SHORT"])
OF_THE_C_LIBRARY = """
import math

from inteco_abs.control.controllers import ReachingLaw


class Cosines(ReachingLaw):
    def update(self, estimate, dt_s):
        torque_nm = math.prod(math.cos(k * estimate.slip) for k in range(1, 200))
        return super().update(estimate, dt_s)._replace(torque_nm=torque_nm)
"""
"""Few of its cosines have another last bit without fused multiplication, and a product keeps those."""


@pytest.fixture(scope="module")
def stop(tmp_path_factory):
    """The short stop that calls most of the functions."""
    (path,) = untraced(TOOL["record"], tmp_path_factory.mktemp("portable"), 1)
    return path


@pytest.fixture(scope="module")
def observed(stop):
    return read_session(stop)


@pytest.fixture(scope="module")
def without_fma(stop):
    """What another process without fused multiplication finds in it."""
    return TOOL["replay_all"](sys.executable, [stop], WITHOUT_FMA)


@pytest.fixture(scope="module")
def before_format_5(run_at, tmp_path_factory):
    """The last stop, as format 4 recorded it on this machine."""
    with elementary.arithmetic(elementary.LIBM):
        session = run_at(tmp_path_factory.mktemp("libm") / "stop.mcap", OBSERVED).session
    facts = {**session.metadata["session"], "format_version": "4"}
    return replace(session, metadata=migrated({**session.metadata, "session": facts}))


def differing(session):
    with recorded_arithmetic(session):
        return replay_session(session, build_pipeline(session_config(session, ()))).differing


def payload(session):
    return session.metadata["integrity"]["payload_sha256"]


@pytest.mark.long
@pytest.mark.untraced
def test_all_parts_replay_on_a_processor_without_fused_multiplication(tmp_path):
    stops = TOOL["record"](tmp_path)
    there = TOOL["replay_all"](sys.executable, stops, WITHOUT_FMA)
    laws, estimators = zip(*(path.stem.split("+") for path in stops), strict=True)
    assert set(laws) == set(installed_controllers())
    assert set(estimators) == set(ESTIMATORS)
    assert there["differing"] == dict.fromkeys((path.stem for path in stops), 0)
    assert min(int((read_session(path).ticks["phase"] == Phase.BRAKING).sum()) for path in stops) > 100


@pytest.mark.untraced
def test_a_run_and_its_replay_have_the_same_bits_without_fused_multiplication(stop, without_fma):
    assert without_fma["same_run"]
    assert without_fma["differing"] == {stop.stem: 0}


@pytest.mark.untraced
def test_a_replay_that_differs_names_the_arithmetic_if_that_differs_too(tmp_path, without_fma, verb):
    if without_fma[LIBM_SHA256] == arithmetic_facts()[LIBM_SHA256]:
        pytest.skip("this C library has one set of functions for all processors")
    law, stop = tmp_path / "law.py", tmp_path / "stop.mcap"
    law.write_text(OF_THE_C_LIBRARY)
    settings = [word for setting in TOOL["SHORT"] for word in ("--set", setting)]
    verb("run", "--virtual", "--controller", f"{law}:Cosines", *settings, "--out", stop)
    environment = {**os.environ, "GLIBC_TUNABLES": WITHOUT_FMA}
    command = ["inteco-abs", "replay", stop, "--controller", f"{law}:Cosines"]
    there = subprocess.run(command, env=environment, check=False, capture_output=True, text=True)
    assert there.returncode == 4
    assert "ticks differ, first at tick" in there.stdout
    found = f"the C library computes other bits than where it was recorded: glibc_tunables {WITHOUT_FMA}, was none"
    assert found in there.stdout
    here = verb(*command[1:], "--json").json
    assert (here["differing"], here["arithmetic"]) == (0, {})


def test_a_session_before_format_5_replays_with_the_c_library(before_format_5, observed):
    assert before_format_5.metadata["software"]["arithmetic"] == elementary.LIBM
    assert payload(before_format_5) != payload(observed)
    assert differing(before_format_5) == 0
    assert differing(observed) == 0


def test_the_arithmetic_of_a_session_holds_for_that_session_alone(before_format_5):
    with recorded_arithmetic(before_format_5):
        assert elementary.exp is math.exp
    assert elementary.exp is elementary.ARITHMETICS[elementary.PORTABLE]["exp"]
    software = {**before_format_5.metadata["software"], "arithmetic": elementary.PORTABLE}
    assert differing(replace(before_format_5, metadata={**before_format_5.metadata, "software": software})) > 0


def test_an_arithmetic_of_a_later_program_is_refused(observed):
    session = observed
    later = replace(session, metadata={**session.metadata, "software": {"arithmetic": "decimal"}})
    with pytest.raises(SessionError, match=r"software\.arithmetic is 'decimal': must be one of portable, libm"):
        differing(later)


def test_a_session_keeps_the_fingerprint_of_its_arithmetic(observed):
    software = observed.metadata["software"]
    assert {name: software[name] for name in arithmetic_facts()} == arithmetic_facts()
    assert len(software[LIBM_SHA256]) == len(software[PORTABLE_SHA256]) == 64
    assert other_arithmetic(software) == {}


@pytest.mark.parametrize(
    ("there", "names"),
    [
        ({}, set()),
        ({"libc": "glibc 2.31", "arithmetic.cpu_features": "sse2"}, set()),
        ({LIBM_SHA256: "0" * 64, "libc": "glibc 2.31"}, {LIBM_SHA256, "libc"}),
        ({PORTABLE_SHA256: "0" * 64}, {PORTABLE_SHA256}),
    ],
    ids=["same", "same results", "another C library", "other functions of our own"],
)
def test_arithmetic_differs_if_results_do(there, names):
    found = other_arithmetic({**arithmetic_facts(), **there})
    assert found == {name: {"recorded": there[name], "here": arithmetic_facts()[name]} for name in names}


def test_a_session_without_a_fingerprint_cannot_tell():
    assert other_arithmetic({"libc": "glibc 2.31", "arithmetic": elementary.PORTABLE}) == {}
