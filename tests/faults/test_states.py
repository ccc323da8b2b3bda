"""The decision path, enumerated: see states.py."""

import pytest

from inteco_abs.signals import Phase
from tests.faults.states import EVENTS, enumerate_states

pytestmark = pytest.mark.untraced


def search(record_property, depth):
    seen, transitions, met = enumerate_states(depth)
    record_property(
        "figures", f"decision path, {depth} ticks around a stop: {len(seen)} states, {transitions} transitions"
    )
    assert set(met) == {(phase, event) for phase in set(Phase) - {Phase.UNKNOWN} for event in EVENTS}


@pytest.mark.long
def test_any_events_within_three_ticks_of_any_moment_keep_the_invariants(record_property):
    search(record_property, 3)


@pytest.mark.long
def test_any_events_within_five_ticks_of_any_moment_keep_the_invariants(record_property):
    search(record_property, 5)
