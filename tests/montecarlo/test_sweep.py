"""Grids of settings and ranges of draws, as they are named on the command line."""

import errno
import io
import os

import pytest
from matplotlib.figure import Figure
from rich.console import Console

from inteco_abs.control import CONTROLLERS
from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.montecarlo import (
    METRICS,
    MOST_COMBINATIONS,
    InThisProcess,
    SweepFolder,
    SweepPlan,
    combinations,
    parse_draws,
    run_stops,
    split_list,
    work,
)
from inteco_abs.montecarlo.table import figure_of_sweep, render_sweep
from inteco_abs.rig import POPULATIONS, draw, torque_margin
from inteco_abs.views.figure import save_figure

pytestmark = pytest.mark.untraced  # other tests reach these lines, too


def grid(*settings, file=None):
    return combinations(settings, CONTROLLERS, file)


def mistakes(call, *arguments):
    with pytest.raises(ConfigError) as caught:
        call(*arguments)
    return {mistake.path: mistake.problem for mistake in caught.value.mistakes}


@pytest.mark.parametrize("population", POPULATIONS)
def test_a_range_of_draws_includes_its_ends(population):
    draws = parse_draws(f"{population}:100-102")
    assert {*draws.seeds, *draws.left_out} == {100, 101, 102}
    assert draws.rigs == tuple(draw(population, seed) for seed in draws.seeds)
    assert draws.name == f"{population}:100-102"


def test_one_rig_is_named_by_its_seed():
    draws = parse_draws("rough:7")
    assert (draws.rigs, draws.name) == ((draw("rough", 7),), "rough:7")


def test_capped_rigs_that_cannot_hold_the_slip_are_left_out():
    draws = parse_draws("capped:0-30")
    assert draws.left_out
    assert {seed for seed in range(31) if torque_margin(draw("capped", seed)) < 0.5} == set(draws.left_out)
    assert set(draws.seeds) == set(range(31)) - set(draws.left_out)
    weak = draws.left_out[0]
    assert mistakes(parse_draws, f"capped:{weak}") == {
        "--rigs": f"capped:{weak}: none of these rigs can hold slip 0.2 with 0.5 N m to spare"
    }


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("hrad:0-9", "no population 'hrad'; did you mean hard?, or a file as my-lab.toml"),
        ("hard:9-2", "hard:9-2: the range is reversed; write hard:2-9"),
        ("hard", "'hard': must look like hard:0-99, or hard:7 for one rig"),
        ("hard:-3", "'hard:-3': must look like hard:0-99, or hard:7 for one rig"),
        (
            "hard:0-100000000",
            "hard:0-100000000: must be at most 100000000 draws with seeds of at most 18446744073709551615",
        ),
        (
            "hard:18446744073709551616",
            "hard:18446744073709551616: must be at most 100000000 draws with seeds of at most 18446744073709551615",
        ),
    ],
)
def test_draws_that_cannot_be_are_named(text, problem):
    assert mistakes(parse_draws, text) == {"--rigs": problem}


def test_every_value_comes_with_every_other():
    found = grid("controller.gains.Mk=2,5", "controller.gains.Mq=1,4", "estimator.name=kalman,euler")
    assert [one.name for one in found] == [
        f"reaching-law on {estimator}, Mk={Mk}, Mq={Mq}"
        for estimator in ("kalman", "euler")
        for Mk in (2, 5)
        for Mq in (1, 4)
    ]
    assert found[1].config.controller.gains == {"Mk": 2.0, "Mq": 4.0}
    assert found[1].config.estimator.name == "kalman"


def test_what_does_not_vary_is_not_in_the_name():
    (only,) = grid("controller.gains.Mk=5", "controller.reference_slip=0.3")
    assert (only.name, only.config.controller.reference_slip) == ("reaching-law on moving-window", 0.3)


def test_a_key_that_is_given_twice_has_the_values_of_both():
    assert [one.varied for one in grid("controller.gains.Mk=2", "controller.gains.Mk=5, 2")] == [
        {"controller.gains.Mk": "2"},
        {"controller.gains.Mk": "5"},
    ]


def test_a_gain_is_for_the_controllers_that_have_it():
    found = grid("controller.name=reaching-law,pi", "controller.gains.Mk=2,5", "controller.gains.Kp=1")
    assert [(one.name, one.config.controller.gains) for one in found] == [
        ("reaching-law on moving-window, Mk=2", {"Mk": 2.0}),
        ("reaching-law on moving-window, Mk=5", {"Mk": 5.0}),
        ("pi on moving-window", {"Kp": 1.0}),
    ]


def test_a_file_gives_the_settings_outside_the_grid(tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text('[controller]\nname = "pi"\n[controller.gains]\nKi = 9.0\n[estimator]\nname = "euler"\n')
    found = grid("controller.gains.Kp=1,2", file=file)
    assert [one.name for one in found] == ["pi on euler, Kp=1", "pi on euler, Kp=2"]
    assert found[0].config.controller.gains == {"Kp": 1.0, "Ki": 9.0}


def test_the_ideal_estimator_may_be_chosen():
    assert [one.name for one in grid("estimator.name=ideal")] == ["reaching-law on ideal"]


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (
            ["controller.name=pi,reachin-law"],
            {"controller.name": "no controller 'reachin-law'; did you mean reaching-law?"},
        ),
        (["estimator.name=ideel"], {"estimator.name": "no estimator 'ideel'; did you mean ideal?"}),
        (
            ["controller.name=pi,relay", "controller.gains.Mk=2"],
            {"controller.gains.Mk": "unknown gain of relay; known: off_duty, on_duty"},
        ),
        (
            ["controller.gains.Mk=2,5000", "controller.gains.Mq=-1,1"],
            {
                "controller.gains.Mk": "5000: must be a number in 0..1000 1/s "
                "(proportional rate: shortens the reaching phase)",
                "controller.gains.Mq": "-1: must be a number in 0..1000 1/s "
                "(constant rate: rejects model error, as small as possible)",
            },
        ),
        (
            ["controller.gains.Mk=2,,5"],
            {"--set controller.gains.Mk=2,,5": "must look like controller.gains.Mk=2 or ...=2,5,10"},
        ),
        (["nonsense"], {"--set nonsense": "must look like controller.gains.Mk=2 or ...=2,5,10"}),
    ],
)
def test_mistakes_of_the_whole_grid_are_reported_at_once(settings, expected):
    assert mistakes(grid, *settings) == expected


def test_too_many_combinations_are_refused_before_any_is_made():
    settings = [f"controller.gains.{name}={','.join(map(str, range(1, 41)))}" for name in ("Mk", "Mq")]
    assert mistakes(grid, *settings) == {
        "--set": f"1600 combinations: must be at most {MOST_COMBINATIONS}; give fewer values at once"
    }


def test_commas_in_brackets_and_quotes_separate_nothing():
    assert split_list("min(0.3, t),0.2") == ["min(0.3, t)", "0.2"]
    assert split_list("[2, 5],[1,2]") == ["[2, 5]", "[1,2]"]
    assert split_list("\"a,b\",'c,d',e") == ['"a,b"', "'c,d'", "e"]
    assert split_list("{a = [1, 2], b = 3},4") == ["{a = [1, 2], b = 3}", "4"]


def braked(path, configurations, *ranges, run_up=True):
    folder = SweepFolder.make(path, SweepPlan(configurations, list(map(parse_draws, ranges)), run_up=run_up))
    work(folder, InThisProcess())
    return folder.rows()


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    settings = ["experiment.start_speed_rad_s=60", "controller.name=steps,relay", "controller.gains.first=0.3,1.0"]
    return braked(tmp_path_factory.mktemp("sweep"), grid(*settings), "hard:3-4", "rough:5", run_up=False)


def test_every_configuration_brakes_every_range_of_draws(rows):
    names = ["steps on moving-window, first=0.3", "steps on moving-window, first=1.0", "relay on moving-window"]
    expected = [(draws, name) for draws in ("hard:3-4", "rough:5") for name in names]
    assert [(row.draws.name, row.combination.name) for row in rows] == expected
    alone = run_stops([draw("hard", 4)], rows[1].combination.config, run_up_from_rad_s=None)
    assert [rows[1][name][1:].tobytes() for name in METRICS] == [alone[name].tobytes() for name in METRICS]


def test_the_json_of_a_sweep_has_nothing_infinite(rows):
    facts = rows[0].facts()  # a duty in the brake's dead zone
    assert (facts["rigs"], facts["controller"], facts["estimator"]) == ("hard:3-4", "steps", "moving-window")
    assert facts["settings"] == {"controller.gains.first": "0.3"}
    assert (facts["stops"], facts["never_in_band_share"], facts["locked_share"]) == (2, 1.0, 0.0)
    assert facts["metrics"]["slip_rms_true"] == {
        "median": None,
        "p99": None,
        "max": None,
        "worst_seed": 3,
        "median_interval_90": [None, None],
        "p99_interval_90": [None, None],
    }
    locking = rows[1].facts()
    assert locking["locked_share"] == 1.0
    assert 0.0 < locking["metrics"]["stop_time_s"]["median"] <= locking["metrics"]["stop_time_s"]["max"] < 1.0


def test_a_sweep_writes_one_line_per_stop(rows):
    records = [record for row in rows for record in row.records()]
    assert len(records) == 9
    first = records[0]
    assert [first[key] for key in ("population", "seed", "controller", "controller.gains.first", "error")] == [
        "hard",
        3,
        "steps",
        "0.3",
        "",
    ]
    assert first["band_entry_s"] is None


def test_without_run_up_or_with_it_the_start_speed_is_the_configured_one(tmp_path):
    grids = grid("experiment.start_speed_rad_s=12", "controller.name=steps")
    (with_run_up,), (without,) = (
        braked(tmp_path / str(run_up), grids, "nominal:0", run_up=run_up) for run_up in (True, False)
    )
    assert with_run_up.ticks > without.ticks + 100
    assert with_run_up["stop_time_s"][0] == pytest.approx(without["stop_time_s"][0], rel=0.1)


def test_the_table_has_the_best_first_and_fits_a_terminal(rows):
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(render_sweep(rows))
    text = console.export_text()
    first, second = text.split("rough:5: slip RMS of 1 stop each")
    assert "hard:3-4: slip RMS of 2 stops each" in first
    for table, mine in ((first, rows[:3]), (second, rows[3:])):
        slips = {row.combination.config.controller.name: row.summary.spreads["slip_rms_fixed_true"] for row in mine[1:]}
        best, worst = sorted(slips, key=lambda name: slips[name].p99)
        assert 0 < table.index(f"{best} on") < table.rindex(f"{worst} on")
        assert f">{slips[best].median_interval[0]:.4f}".replace("0.", ".") in table
        assert "…" not in table
    assert max(map(len, text.splitlines())) <= 80


def test_figure_shows_the_share_of_each_rms_without_stops_that_have_none(rows, monkeypatch, tmp_path):
    saved = []
    monkeypatch.setattr(Figure, "savefig", lambda self, file, **_: (saved.append(self), file.touch()))
    short = braked(tmp_path / "short", grid("experiment.start_speed_rad_s=12", "controller.name=steps"), "nominal:0")
    save_figure(figure_of_sweep([*rows, *short]), tmp_path / "sweep.png")
    panel, other, last = saved[0].axes
    lines = {line.get_label(): line for line in panel.get_lines()}
    assert panel.get_title() == "hard:3-4"
    assert other.get_title() == "rough:5"
    relay = lines["relay on moving-window"]
    assert list(relay.get_xdata())[1:] == sorted(rows[2]["slip_rms_fixed_true"])
    assert list(relay.get_ydata()) == [0.0, 0.5, 1.0]
    (nothing,) = last.get_lines()
    assert len(nothing.get_xdata()) == 0


def test_a_figure_that_cannot_be_written_is_an_error_and_nothing_is_left(rows, monkeypatch, tmp_path):
    def full(_self, file, **_options):
        file.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Figure, "savefig", full)
    with pytest.raises(AbsError, match=r"sweep\.png: the figure cannot be written: No space left"):
        save_figure(figure_of_sweep(rows), tmp_path / "sweep.png")
    assert not list(tmp_path.iterdir())


def test_in_a_grid_each_controller_has_its_estimator():
    names = [each.name for each in grid("controller.name=predictive-reaching,pi")]
    assert names == ["predictive-reaching on observer", "pi on moving-window"]


def test_an_estimator_that_one_of_the_controllers_cannot_do_with_is_refused():
    for estimator in ("ideal", "kalman"):
        found = mistakes(grid, "controller.name=predictive-reaching,pi", f"estimator.name={estimator}")
        assert found["estimator.name"].startswith(f"'{estimator}': the controller predictive-reaching needs 'observer'")
