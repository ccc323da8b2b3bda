"""A run on a terminal, through the whole stack: a key stops it as Ctrl-C does, and the terminal is as it was."""

import pytest
from on_terminal import OnTerminal

from inteco_abs.sessions import changes_among, read_session
from inteco_abs.signals import Phase

pytestmark = pytest.mark.untraced
real_time = pytest.mark.xdist_group("real time")

QUICK = ("experiment.start_speed_rad_s=40.0", "experiment.idle_s=0.02", "experiment.hold_s=0.05")


@pytest.fixture
def run(command_path, tmp_path, untraced):
    """Starts a run on a terminal of that size."""
    started = []
    chosen = {"NO_COLOR", "LC_ALL", "LC_CTYPE", "COLUMNS", "LINES"}
    environment = {key: value for key, value in untraced.items() if key not in chosen}

    def start(*arguments, **size):
        sets = [word for setting in QUICK for word in ("--set", setting)]
        started.append(
            OnTerminal(
                [command_path, "run", "--out", tmp_path / "stop.mcap", *sets, *arguments],
                cwd=tmp_path, env=environment | {"TERM": "xterm-256color", "LANG": "C.UTF-8"}, **size,
            )
        )  # fmt: skip
        return started[-1]

    yield start
    for one in started:
        one.close()


@real_time
@pytest.mark.long
def test_q_stops_a_run_in_real_time_safely(run, tmp_path):
    program = run()
    program.until("SPIN-UP")
    assert program.settings != program.at_first
    program.press("q")
    assert program.end() == 130
    assert program.settings == program.at_first
    assert program.unread == 0
    assert "INTERRUPTED" in program.written
    session = read_session(tmp_path / "stop.mcap")
    assert session.metadata["session"]["outcome"] == "interrupted"
    assert session.ticks["drive"].max() > 0.0
    last = session.ticks[-1]
    assert (last["phase"], last["drive"], last["brake"]) == (Phase.FAULT, 0.0, 0.0)
    truth = session.truth[-1]
    assert (truth["drive"], truth["brake"]) == (0.0, 0.0)


@real_time
def test_space_stops_a_run_that_has_not_begun(run, tmp_path):
    program = run()
    program.until("waiting")
    while program.settings == program.at_first:  # drawn first, and then listened to
        assert program.process.poll() is None
    program.press(" ")
    assert program.end() == 130
    assert program.settings == program.at_first
    assert not (tmp_path / "stop.mcap").exists() or not len(read_session(tmp_path / "stop.mcap").ticks)


@real_time
@pytest.mark.long
def test_a_stop_is_shown_from_its_checks_to_its_card(run):
    program = run()
    assert program.end() in {0, 3}
    for text in ("guardian drilled", "after the kill", "wheels at rest", "SPIN-UP", "BRAKING", "DONE", "COMPLETED"):
        assert text in program.written
    assert program.settings == program.at_first


@pytest.mark.parametrize(("options", "shown"), [(("--live", "none"), False), ((), True)])
def test_in_virtual_time_too_unless_switched_off(run, options, shown):
    program = run("--virtual", *options)
    assert program.end() == 0
    assert ("never late" in program.written) == shown
    assert "COMPLETED" in program.written


@pytest.mark.long
def test_a_quiet_run_without_problems_prints_nothing(run):
    program = run("--virtual", "--quiet")
    assert program.end() == 0
    assert not program.written


@pytest.mark.long
def test_a_small_terminal_gets_a_line(run):
    program = run("--virtual", columns=70, rows=20)
    assert program.end() == 0
    assert "rad/s, slip" in program.written
    assert "never late" not in program.written


def test_a_file_gets_neither_colour_nor_pictures(inteco_abs):
    done = inteco_abs("run", "--virtual", *(word for setting in QUICK for word in ("--set", setting)), check=0)
    assert "\x1b" not in done.stderr + done.stdout
    assert "car" not in done.stderr


@real_time
@pytest.mark.long
def test_keys_change_gains_while_a_run_lasts_and_the_session_replays(run, tmp_path, verb):
    program = run("--tune", "--set", "experiment.idle_s=1.0", columns=120)
    program.until("ARMED")
    program.press("\t7.5\r")
    program.until("from tick")
    program.press("9999\r")
    program.until("must be in 0..1000")
    program.press("\x1b[Z\x1b[A")
    assert program.end() in {0, 3}
    changes = changes_among(read_session(tmp_path / "stop.mcap").parameters)
    assert [(each.name, each.value) for each in changes] == [("Mk", 7.5), ("reference_slip", 0.2 + 0.05 * 0.2)]
    assert "none differ" in verb("replay", tmp_path / "stop.mcap").out


@pytest.mark.parametrize(
    ("options", "problem"),
    [(("--virtual",), "virtual time is over before"), (("--live", "line"), "needs the whole display on a terminal")],
)
def test_what_cannot_tune_is_refused_and_nothing_starts(run, tmp_path, options, problem):
    program = run("--tune", *options)
    assert program.end() == 2
    assert problem in program.written
    assert not (tmp_path / "stop.mcap").exists()
