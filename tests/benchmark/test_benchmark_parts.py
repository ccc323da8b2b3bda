"""The benchmark's laws, intervals, comparison and search."""

import math

import pytest

from inteco_abs.benchmark import Law, compared, ranges, read_laws, results_of, shipped_laws, write_laws
from inteco_abs.benchmark.gain_search import Bounds, Budget, search
from inteco_abs.errors import ConfigError
from inteco_abs.montecarlo import InThisProcess, SweepFolder, SweepPlan, parse_draws, work
from inteco_abs.plugins import Controllers

KNOWN = Controllers()
QUICK = Law("stairs", "steps", "moving-window", {"controller.gains.first": 0.6})


def test_every_shipped_law_can_be_made_and_no_two_are_the_same():
    laws = shipped_laws()
    assert len({law.name for law in laws}) == len(laws)
    configs = [law.config(KNOWN) for law in laws]
    assert all(a != b for i, a in enumerate(configs) for b in configs[:i])


def test_laws_are_read_as_they_were_written(tmp_path):
    write_laws(shipped_laws(), tmp_path / "laws.toml")
    assert read_laws(tmp_path / "laws.toml") == shipped_laws()


@pytest.mark.parametrize("text", ["law = 3", "[[law]]\nname = 'a'", "[[law]]\nname='a'\nspeed=1", "not toml", ""])
def test_a_file_without_laws_is_refused(tmp_path, text):
    (tmp_path / "bad.toml").write_text(text)
    with pytest.raises(ConfigError, match="not a file of laws"):
        read_laws(tmp_path / "bad.toml")


def test_the_search_begins_a_decade_around_each_gain_within_its_range():
    law = Law("a", "pi", "kalman", {"controller.gains.Kp": 30.0, "controller.gains.Ki": 0.0})
    found = law.searched(KNOWN)
    assert found["controller.gains.Kp"] == (30.0, 3.0, 100.0)
    assert found["controller.gains.bias"] == (0.6, 0.06, 1.0)
    assert set(found) == {"controller.gains.Kp", "controller.gains.bias", "estimator.jerk_density"}


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """Results of one law on two rigs."""
    folder = tmp_path_factory.mktemp("stops")
    stops = SweepFolder.make(folder, SweepPlan([QUICK.combination(KNOWN)], [parse_draws("hard:700000-700001")]))
    work(stops, InThisProcess())
    return results_of([QUICK], stops.rows()), stops.rows()[0]


def test_figures_are_those_of_the_sweep(found):
    figures, row = found[0]["stairs"]["hard"], found[1]
    slip = row.summary.spreads["slip_rms_fixed_true"]
    assert figures["slip_rms"]["median"] == pytest.approx(slip.median, rel=1e-3)
    assert figures["worst_slip_rms"] == pytest.approx(slip.largest, rel=1e-3)
    assert figures["worst_seed"] == row.seeds[slip.worst]
    low, high = figures["slip_rms"]["median_interval"]
    assert low <= figures["slip_rms"]["median"] <= high
    assert (figures["stops"], figures["draws"]) == (2, "hard:700000-700001")


def _kept(slip=0.1, locked=0, numbers=None):
    row = {"draws": "hard:1-2", "failed": 0, "locked": locked, "never_arrived": 0}
    row["slip_rms"] = {"median": slip, "p99": slip}
    return {"laws": {"a": {"numbers": numbers or {}, "ranges": {"hard": row}}}}


def test_only_what_became_worse_is_reported():
    assert not list(compared(_kept(0.1), _kept(0.1)))
    assert not list(compared(_kept(0.02), _kept(0.1, locked=1)))
    assert next(iter(compared(_kept(0.12), _kept(0.1)))) == "a on hard:1-2: slip RMS, median: 0.12, before 0.1"
    assert len(list(compared(_kept(None), _kept(0.1)))) == 2
    assert list(compared(_kept(0.1, locked=1), _kept(0.1))) == ["a on hard:1-2: locked: 1 stops, before 0"]
    assert "other gains" in next(iter(compared(_kept(0.1, numbers={"k": 1.0}), _kept(0.1))))
    assert not list(compared({"laws": {}}, _kept(0.1)))


def test_ranges_are_the_populations_then_the_single_factors():
    names = [one.population for one in ranges(3, 7, factors=True)]
    assert names[:6] == ["nominal", "hard", "rough", "slow", "capped", "wild"]
    assert len(names) > 50
    assert [one.name for one in ranges(3, 7, factors=False)][:2] == ["nominal:7", "hard:7-9"]


def test_the_search_finds_the_lowest_point_of_a_valley_and_the_same_again():
    bounds = [Bounds(1.0, 0.1, 10.0), Bounds(20.0, 2.0, 200.0)]

    def costs(points):
        return [math.log(a / 3.0) ** 2 + 4.0 * math.log(b / 100.0 * a / 3.0) ** 2 for a, b in points]

    point, best, first = search(bounds, costs, Budget(8, 30, 8, 1))
    assert best < 1e-3 < first
    assert point == pytest.approx([3.0, 100.0], rel=0.05)
    assert search(bounds, costs, Budget(8, 30, 8, 1))[1] == best
