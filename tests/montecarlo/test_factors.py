"""One factor at a time: the ranges of draws, their table and figure."""

import io
import re

import pytest
from rich.console import Console

from inteco_abs.control import CONTROLLERS
from inteco_abs.errors import ConfigError
from inteco_abs.montecarlo import (
    InThisProcess,
    SampleSet,
    SweepFolder,
    SweepPlan,
    combinations,
    one_at_a_time,
    parse_draws,
    work,
)
from inteco_abs.montecarlo.table import figure_of_sweep, render_sweep
from inteco_abs.rig import draw
from inteco_abs.views.figure import save_figure

pytestmark = pytest.mark.untraced  # other tests reach these lines, too

RANGES = list(one_at_a_time(parse_draws("hard:3-4")))


def test_the_population_itself_comes_first_and_every_other_range_differs_from_it():
    assert RANGES[0] == SampleSet("hard", 3, 4)
    assert len({each.population for each in RANGES}) == len(RANGES) > 40
    assert all(each.rigs != RANGES[0].rigs for each in RANGES[1:])


def test_a_level_is_that_of_its_name():
    named = {each.population: each for each in RANGES}
    assert [rig.brake_dead_time_s for rig in named["hard-brake_dead_time_s-0.035"].rigs] == [0.035, 0.035]
    small = named["hard-r1-x0.96"].rigs[0]
    assert small.parameters.r1 == 0.96 * draw("hard", 3).parameters.r1


def test_names_are_of_files_and_come_back_from_a_description():
    assert all(re.fullmatch(r"[\w.-]+", each.population) for each in RANGES)
    plan = SweepPlan(combinations([], CONTROLLERS), RANGES)
    assert [each.name for each in SweepPlan.from_json(plan.to_json(), "x", "--work").draws] == [e.name for e in RANGES]


def test_ones_own_population_has_no_numbers_to_be_changed(tmp_path):
    (tmp_path / "lab.toml").write_text("[rig]\nsupply_sag = 0.1\n")
    with pytest.raises(ConfigError, match="--factors: lab:1: needs a shipped population"):
        list(one_at_a_time(parse_draws(f"{tmp_path / 'lab.toml'}:1")))


@pytest.mark.long
def test_many_ranges_have_one_table_and_one_figure(tmp_path):
    grid = combinations(["experiment.start_speed_rad_s=12", "controller.name=steps,relay"], CONTROLLERS)
    draws = [SampleSet(each.population, 3, 3, each.text) for each in RANGES[:9]]
    folder = SweepFolder.make(tmp_path / "sweep", SweepPlan(grid, draws, run_up=False))
    work(folder, InThisProcess())
    console = Console(file=io.StringIO(), width=100)
    console.print(render_sweep(folder.rows()))
    text = console.file.getvalue()
    assert text.count("slip RMS from 0.25 s on") == 2
    assert all(text.count(each.name) == 2 for each in draws)
    save_figure(figure_of_sweep(folder.rows()), tmp_path / "factors.svg")
    assert (tmp_path / "factors.svg").read_text().count("hard-brake_dead_time_s") == 4
