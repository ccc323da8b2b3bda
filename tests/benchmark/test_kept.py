"""No law becomes worse unnoticed: one stop of each in Python, beside the slip RMS that is kept in kept.json.

Each commit judges a quarter of the laws by default, the long check all.

Where a law has become worse on purpose, its new number, which the failure shows, replaces the kept one.
"""

import json
from pathlib import Path

import pytest

from inteco_abs.benchmark import shipped_laws, time_decisions
from inteco_abs.montecarlo import parse_draws
from inteco_abs.plugins import Controllers
from tests.commit import drawn_by_the_commit

KEPT = json.loads(Path(__file__).with_name("kept.json").read_text())
KNOWN = Controllers()
RIGS = parse_draws("hard:700000").rigs
WORSE = 1.1
"""Ratio of two slip RMS: one rig's varies more than a population's."""
LAWS = {law.name: law for law in shipped_laws()}
TODAY = drawn_by_the_commit(8)
JUDGED = [
    name if number % 8 == TODAY else pytest.param(name, marks=pytest.mark.long) for number, name in enumerate(LAWS)
]


def test_every_law_has_a_kept_figure():
    assert set(KEPT) == set(LAWS)


@pytest.mark.parametrize("name", JUDGED)
def test_no_law_is_worse_than_its_kept_figure(name):
    found = float(time_decisions(LAWS[name].config(KNOWN), RIGS, KNOWN).stops["slip_rms_fixed_true"][0])
    assert found <= WORSE * KEPT[name] + 1e-4, f"{name}: {found:.3g}"
