import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from inteco_abs.errors import ConfigError
from inteco_abs.signals import Phase
from inteco_abs.views.comparison import MOST, labels, require_distinct, since_s, start_ns


def test_one_session_is_named_by_what_it_was_run_with(session):
    assert labels([session]) == ["reaching-law on moving-window"]


def test_gains_are_named_where_only_they_differ(session, others):
    assert labels([session, others[0]]) == ["Mk 2, Mq 1", "Mk 10, Mq 4"]


def test_differing_controllers_are_named_and_gains_only_within_one(session, others):
    assert labels([session, others[1]]) == ["reaching-law", "relay"]
    assert labels([session, *others]) == ["reaching-law, Mk 2, Mq 1", "reaching-law, Mk 10, Mq 4", "relay"]


@pytest.mark.parametrize(
    ("record", "key", "value", "label"),
    [
        ("controller", "estimator", "kalman", "kalman"),
        ("controller", "reference_slip", "0.3", "reference 0.3"),
        ("rig", "drawn", "hard:17", "hard:17"),
        ("software", "seed", "5", "seed 5"),
        ("rig", "simulated", "false", "real rig"),
    ],
)
def test_any_other_difference_is_named(session, with_facts, record, key, value, label):
    other = replace(with_facts(session, record, **{key: value}), path=Path("other.mcap"))
    assert labels([session, other])[1] == label


def test_the_published_rig_is_named_beside_a_drawn_one(session, with_facts):
    assert labels([session, with_facts(session, "rig", drawn="hard:17")]) == ["published rig", "hard:17"]


def test_a_setting_is_named_where_nothing_else_differs(session):
    config = session.attachments["config.toml"].replace(b"brake_limit = 1.0", b"brake_limit = 0.7")
    other = replace(session, path=Path("other.mcap"), attachments={"config.toml": config})
    assert labels([session, other]) == ["guard.brake_limit 1", "guard.brake_limit 0.7"]


def test_files_are_named_where_nothing_differs(session):
    assert labels([session, replace(session, path=Path("again.mcap"))]) == ["stop", "again"]
    paths = Path("a/stop.mcap"), Path("b/stop.mcap")
    assert labels([replace(session, path=path) for path in paths]) == ["a/stop.mcap", "b/stop.mcap"]


def test_a_session_that_says_nothing_has_a_name(session):
    silent = replace(session, metadata={}, attachments={})
    assert labels([silent]) == ["unknown controller on unknown estimator"]
    assert all(labels([silent, session]))


def test_the_same_session_twice_is_refused(session):
    with pytest.raises(ConfigError, match=r"stop\.mcap: is named more than once"):
        require_distinct([session, session])


def test_more_sessions_than_colours_are_refused(session):
    many = [replace(session, path=Path(f"{number}.mcap")) for number in range(MOST + 1)]
    require_distinct(many[:MOST])
    with pytest.raises(ConfigError, match=f"{MOST + 1} sessions: at most {MOST} can be compared"):
        require_distinct(many)


def test_time_counts_from_the_first_tick_of_braking_or_of_all(session):
    ticks = session.ticks
    first = int(np.flatnonzero(ticks["phase"] == Phase.BRAKING)[0])
    assert since_s(ticks, start_ns(session))[first] == 0.0
    before = session.with_rows(ticks[:first])
    assert since_s(before.ticks, start_ns(before))[0] == 0.0


def test_spans_are_the_phases_in_their_order(session):
    found = session.rows.phases
    expected = [Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED, Phase.DONE]
    assert [each.phase for each in found] == expected
    assert found[0].first == 0
    assert found[-1].end == len(session.ticks)
    assert all(a.end == b.first for a, b in itertools.pairwise(found))
    assert session.with_rows(session.ticks[:0]).rows.phases == []
