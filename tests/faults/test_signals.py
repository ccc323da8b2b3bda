"""A signal before any line of ours that `inteco-abs run` executes: outputs off, a whole session or none."""

import random

import pytest

from inteco_abs.experiment.real_time import processes
from inteco_abs.realtime import memory
from inteco_abs.realtime.processes.supervisor import Supervisor
from inteco_abs.sessions import TRUTH
from tests.faults.lines import Counting, Line
from tests.faults.lives import INTERRUPTED, SIGNALS, Lives, strike_each

pytestmark = [
    pytest.mark.untraced,
    # a signal that meets a generator while it is being closed is lost in it, and Python can only report that
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def strike(lives, record_property, names, share):
    found = strike_each(lives, names, share)
    record_property("figures", f"{', '.join(names)}: {found}")
    assert not found.bad, "\n".join(found.bad)


@pytest.mark.long
def test_a_signal_at_any_line_leaves_outputs_off_and_the_session_whole(tmp_path, record_property):
    strike(Lives(tmp_path), record_property, SIGNALS, 0.004)


@pytest.mark.long
@pytest.mark.parametrize(
    ("profile", "name"), [*(("sim_usb2", name) for name in SIGNALS), ("sim_usb", "SIGTERM"), ("sim_pci", "SIGINT")]
)
def test_a_signal_at_one_moment_in_twenty_of_a_run_ends_it_the_same_way(tmp_path, record_property, profile, name):
    strike(Lives(tmp_path, "--set", f"profile={profile}"), record_property, [name], 0.05)


def line_of(function, text):
    code = function.__code__
    (line,) = {each for *_, n in code.co_lines() if n and text in (each := Line(code, n)).text}
    return line


class TestInRealTime:
    """The process that the user started, and hears the signals; the board is another's, which keeps its own record."""

    pytestmark = pytest.mark.xdist_group("real time")
    FILES = (
        "realtime/processes/supervisor.py",
        "realtime/signal_handlers.py",
        "realtime/heartbeat.py",
        "experiment/real_time.py",
    )

    @pytest.fixture
    def strike(self, tmp_path, memories, left_processes):
        """A life with a signal before a line of the supervisor's process, and what was amiss."""

        def live(line, name):
            life = Lives(tmp_path, virtual=False).struck(line, 1, SIGNALS[name])
            truth = memories[-1].truth_reader().newest()
            duties = TRUTH.array(truth)[["drive", "brake"]][0].item() if truth else (0.0, 0.0)
            # the mock board ends by itself with the process that the user started, which is the tests' own here
            left = [words for words in left_processes() if b"inteco_abs.mock_board_process" not in words]
            if any(duties) or left or life.escaped or life.code not in {0, 3, INTERRUPTED}:
                return life, f"{name} before {line}: {duties}, {left}, {life}"
            return life, ""

        return live

    def test_an_interrupt_just_before_the_loop_is_released_is_reported(self, strike):
        life, problem = strike(line_of(Supervisor._start_loop, "apply("), "SIGINT")
        assert not problem
        assert (life.struck, life.code) == (True, INTERRUPTED)

    def test_an_interrupt_before_the_supervisor_works_leaves_no_mock_board(self, strike, left_processes):
        life, problem = strike(line_of(processes.__wrapped__, "yield memory, supervisor"), "SIGINT")
        assert not problem
        assert (life.struck, life.code) == (True, INTERRUPTED)
        assert left_processes() == []
        assert list(memory.FOLDER.iterdir()) == []

    @pytest.mark.long
    @pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of a mock board
    def test_a_signal_before_a_line_of_the_supervisor_leaves_outputs_off(self, strike, tmp_path, record_property):
        counting, draw = Counting(), random.Random(4)
        for tracing in (None, counting):
            Lives(tmp_path, virtual=False).live(tracing)
            (tmp_path / "stop.mcap").unlink()
        lines = [line for line in counting.times if str(line).partition(":")[0] in self.FILES]
        found = [strike(line, draw.choice(["SIGINT", "SIGINT twice"])) for line in draw.sample(lines, 40)]
        delivered, bad = sum(life.struck for life, _ in found), [problem for _, problem in found if problem]
        record_property("figures", f"supervisor: {delivered} signals before {len(lines)} lines, violations: {len(bad)}")
        assert delivered
        assert not bad, "\n".join(bad)
