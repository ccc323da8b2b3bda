import io
import re
import threading
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console, Group

from inteco_abs.config import load_config
from inteco_abs.realtime.screen import Point, Snapshot, StartCheck
from inteco_abs.signals import Phase
from inteco_abs.views.dashboard import CTRL_C, KEYS, Dashboard, in_one_line

CONFIG = load_config(settings=("guard.brake_limit=0.7",))
USUAL = Snapshot(
    phase=Phase.BRAKING,
    ticks=13_251,
    time_s=6.626,
    wheel_speed_rad_s=101.4,
    road_speed_rad_s=127.6,
    slip=0.2046,
    drive=0.0,
    brake=0.437,
    overruns=0,
    late_us=(12.0, 98.0, 301.0, 434.5),
)
PHASES = (Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED, Phase.DONE)
ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
COLOUR = re.compile(r"\x1b\[(?:\d+;)*(?:3[0-8]|4[0-8]|9[0-7]|10[0-7])(?:;\d+)*m")
RED = re.compile(r"\x1b\[(?:\d+;)*31m")
ROOM, LITTLE = ((80, 24), (109, 30), (110, 36), (200, 60)), ((79, 24), (80, 23), (70, 20), (20, 5))
TERMINAL = {"force_terminal": True, "color_system": "standard", "legacy_windows": False}

numbers = st.floats(-1e6, 1e6)
duties = st.floats(0.0, 1.0)
late = st.none() | st.floats(0.0, 1e7)
points = st.builds(
    Point,
    time_ns=st.integers(1, 10**10),
    wheel_speed_rad_s=numbers,
    road_speed_rad_s=numbers,
    slip=numbers,
    phase=st.sampled_from(Phase).map(int),
)
snapshots = st.builds(
    Snapshot,
    phase=st.sampled_from(Phase),
    ticks=st.integers(1, 2**40),
    time_s=st.floats(0.0, 1e6),
    wheel_speed_rad_s=numbers,
    road_speed_rad_s=numbers,
    slip=numbers,
    drive=duties,
    brake=duties,
    overruns=st.integers(0, 2**40),
    late_us=st.tuples(late, late, late, late),
    recent=st.lists(points, max_size=20).map(lambda some: tuple(sorted(some))),
)


@pytest.fixture(autouse=True)
def colours(monkeypatch):
    """As on a terminal of a user who has not asked for anything."""
    for name in ("NO_COLOR", "FORCE_COLOR", "COLUMNS", "LINES", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")


def console_of(size=(80, 24), **options):
    return Console(file=io.StringIO(), width=size[0], height=size[1], **{**TERMINAL, **options})


def course(*phases, seconds=0.5):
    """Points of those phases, so long each, at 100 Hz."""
    rows = [(phase, step) for phase in phases for step in range(round(seconds * 100))]
    return tuple(
        Point(5_000_000_000 + number * 10_000_000, 130.0 - step, 160.0 - step, 0.18, int(phase))
        for number, (phase, step) in enumerate(rows)
    )


BRAKED = USUAL._replace(recent=course(*PHASES[:4]))


class Shown:
    """A dashboard of that size and what it has written, picture by picture."""

    def __init__(self, size=(80, 24), config=CONFIG, **options):
        ours = {key: options.pop(key) for key in ("virtual", "line", "plain", "playback") if key in options}
        self.console = console_of(size, **options)
        self.board = Dashboard(self.console, config, **ours)

    def after(self, act):
        """What is written while `act` does something with the dashboard."""
        with self.board:
            before = len(self.console.file.getvalue())
            act(self.board)
            return self.console.file.getvalue()[before:]

    def raw(self, *snapshots):
        return self.after(lambda board: [board.show(snapshot) for snapshot in snapshots])

    def picture(self, snapshot):
        """Lines of the picture of a snapshot."""
        return lines_of(self.raw(snapshot))


def lines_of(text):
    return [line.rstrip() for line in ESCAPE.sub("", text).replace("\r", "\n").splitlines() if line.strip()]


def line_with(lines, *words):
    (line,) = (line for line in lines if all(word in line for word in words))
    return line


class TestPlayback:
    def test_it_shows_its_place_its_state_and_its_keys_and_warns_of_no_motor(self):
        def play(board):
            board.describe("of 9.0 s, 2x, paused", "space pauses")
            board.show(BRAKED)

        lines = lines_of(Shown((110, 36), playback=True).after(play))
        assert "reaching-law on moving-window" in line_with(lines, " 6.6 of 9.0 s, 2x, paused ")
        assert line_with(lines, "space pauses").strip() == "space pauses"
        assert not any("emergency" in line for line in lines)

    def test_going_back_begins_new_traces_and_counts_the_stops_before(self):
        shown = Shown((110, 36), load_config(settings=("experiment.stops=5",)), playback=True)

        def play(board):
            board.show(BRAKED)
            board.rewind(3)
            board.show(USUAL._replace(recent=course(Phase.IDLE)))

        lines = lines_of(shown.after(play))
        assert any("stop 1 of 5" in line for line in lines)
        last = max(at for at, line in enumerate(lines) if "reaching-law" in line)
        assert "stop 4 of 5" in lines[last]
        assert not any("slip" in line for line in lines[last + 1 :])

    def test_a_strangers_name_gives_the_terminal_no_orders(self):
        config = replace(CONFIG, controller=replace(CONFIG.controller, name="\x1b[2Jmine"))
        assert "\x1b[2J" not in Shown(config=config, playback=True).raw(BRAKED)


class TestBefore:
    def picture(self, *checks, **options):
        shown = Shown(**options)
        lines = lines_of(shown.after(lambda board: [board.passed(*check) for check in checks]))
        return lines[max(at for at, line in enumerate(lines) if "reaching-law" in line) :]

    def test_passed_steps_are_marked_with_their_evidence(self):
        lines = self.picture((StartCheck.BOARD, "sim:"), (StartCheck.GUARDIAN, "SAFE 12.3 ms after the kill"))
        assert "✓" in line_with(lines, "board opened and identified", "sim:")
        assert "✓" in line_with(lines, "guardian drilled", "SAFE 12.3 ms after the kill")
        assert "waiting" in line_with(lines, "▶ recorder ready")
        assert "·" in line_with(lines, "wheels at rest")

    def test_wheels_are_at_rest_once_the_rig_is_armed(self):
        for phase in Phase:
            lines = Shown().picture(USUAL._replace(phase=phase))
            at_rest = phase not in {Phase.UNKNOWN, Phase.IDLE, Phase.FAULT}
            assert ("✓" in line_with(lines, "wheels at rest")) == at_rest

    def test_in_virtual_time_there_is_no_guardian(self):
        assert not [line for line in self.picture((StartCheck.BOARD,), virtual=True) if "guardian" in line]

    @pytest.mark.parametrize(("speed", "filled"), [(0.0, 0), (90.0, 27), (180.0, 54), (500.0, 54), (-20.0, 0)])
    def test_spinning_up_is_a_bar_with_its_time(self, speed, filled):
        shot = USUAL._replace(phase=Phase.SPIN_UP, road_speed_rad_s=speed, recent=course(*PHASES[:3]))
        lines = Shown().picture(shot)
        assert "0.5 s of at most 20 s" in line_with(lines, "spin-up to the start speed")
        assert line_with(lines, "of 180 rad/s").count("█") == filled

    def test_a_text_from_elsewhere_moves_no_cursor(self):
        assert "\\x1b[2J" in "".join(self.picture((StartCheck.RECORDER, "\x1b[2J.mcap")))


class TestDuring:
    @pytest.mark.parametrize("size", ROOM)
    def test_traces_have_their_legend_with_the_values(self, size):
        lines = Shown(size).picture(BRAKED)
        line_with(lines, "speed [rad/s]", "━━ car  127.6", "╍╍ wheel  101.4")
        line_with(lines, "━━ slip  0.205", "╍╍ reference 0.2")
        assert any("⠀" <= letter <= "⣿" for letter in "".join(lines))

    def test_a_changing_reference_is_that_of_now(self):
        shown = Shown(config=load_config(settings=("controller.reference_formula=0.1 + 0.1*t",)))
        before = BRAKED.recent[-50:]
        now = [point._replace(slip_reference=0.1 + 0.001 * i) for i, point in enumerate(before)]
        line_with(shown.picture(BRAKED._replace(recent=tuple(now))), "reference 0.149")
        line_with(shown.picture(USUAL._replace(phase=Phase.STOPPED)), "reference 0.149")

    def test_plots_are_side_by_side_where_there_is_room(self):
        for width, beside in ((109, False), (110, True)):
            (line,) = (line for line in Shown((width, 36)).picture(BRAKED) if "speed [rad/s]" in line)
            assert ("reference" in line) == beside

    def test_the_time_axis_does_not_move_while_the_traces_grow(self):
        axes = set()
        for count in (151, 160, 200):
            lines = Shown().picture(USUAL._replace(recent=BRAKED.recent[:count]))
            axes.add(tuple(line for line in lines if "└" in line))
        assert len(axes) == 1

    @pytest.mark.parametrize("phase", PHASES)
    def test_the_present_phase_stands_out_by_sign_and_capitals_among_all_of_them(self, phase):
        (line,) = (line for line in Shown().picture(USUAL._replace(phase=phase)) if "armed" in line.lower())
        assert f"▶ {phase.name.replace('_', '-')}" in line
        assert [word.lower() for word in re.findall(r"[A-Za-z-]{4,}", line)] == [
            name.name.lower().replace("_", "-") for name in PHASES
        ]

    def test_phases_that_are_over_have_their_time(self):
        line = line_with(Shown().picture(BRAKED), "armed")
        assert " ".join(line.split()) == "✓ idle ✓ armed ✓ spin-up 0.5 s ▶ BRAKING 0.49 s stopped done"

    def test_a_fault_is_said(self):
        raw = Shown().raw(BRAKED._replace(phase=Phase.FAULT))
        assert "▶ FAULT: outputs off" in ESCAPE.sub("", raw)

    @pytest.mark.parametrize(("duty", "filled"), [(0.0, 0), (0.5, 9), (1.0, 18)])
    def test_duties_are_bars(self, duty, filled):
        lines = Shown().picture(BRAKED._replace(drive=duty, brake=0.0))
        assert line_with(lines, " drive ", " brake ").count("█") == filled

    def test_a_brake_at_its_limit_is_described(self):
        assert "0.44 of 0.7" in line_with(Shown().picture(BRAKED), " drive ", " brake ")
        assert "0.70 limit" in line_with(Shown().picture(BRAKED._replace(brake=0.7)), " drive ", " brake ")

    def test_dashboard_names_which_of_several_stops_it_shows(self):
        config = load_config(settings=("experiment.stops=3",))
        shown = Shown(config=config)
        lines = shown.picture(BRAKED._replace(recent=course(*PHASES, seconds=0.1) + course(Phase.IDLE)))
        line_with(lines, "stop 2 of 3")

    def test_lateness_is_shown_as_quantiles(self):
        line_with(Shown().picture(BRAKED), "late p50 12, p99 98, p99.9 301, max 434 us; 0 periods missed")

    def test_unknown_values_are_shown_as_a_dash(self):
        early = BRAKED._replace(late_us=(None, None, None, 0.0))
        line_with(Shown().picture(early), "late p50 -, p99 -, p99.9 -, max 0 us")

    def test_in_virtual_time_nothing_is_late(self):
        lines = Shown(virtual=True).picture(BRAKED)
        assert "never late" in "".join(lines)
        assert "p99" not in "".join(lines)

    @pytest.mark.parametrize(
        ("changes", "text"),
        [({"overruns": 1}, "1 period missed!"), ({"late_us": (1.0, 1.0, 1.0, 500.4)}, "max 500 us!")],
    )
    def test_only_errors_are_red_and_marked(self, changes, text):
        shown = Shown()
        assert re.search(rf"\x1b\[1;31m{text}", shown.raw(BRAKED._replace(**changes)))
        assert not RED.search(Shown().raw(BRAKED))


class TestEverySize:
    @pytest.mark.parametrize("size", ROOM)
    @pytest.mark.parametrize("plain", [False, True])
    @settings(max_examples=20, deadline=None)
    @given(snapshot=snapshots)
    def test_the_picture_fits_the_terminal(self, size, plain, snapshot):
        board = Dashboard(console_of(size), CONFIG, plain=plain)
        with board:
            board.show(snapshot)
        lines = board.lines()
        assert len(lines) < size[1]
        printed = lines_of(board._console.file.getvalue())
        assert max(map(len, printed)) <= size[0]

    @pytest.mark.parametrize("size", LITTLE)
    def test_a_small_terminal_gets_a_line(self, size):
        lines = Shown(size).picture(BRAKED)
        assert lines
        assert all(line.startswith("braking 128") and len(line) <= size[0] for line in lines)

    def test_whoever_wants_a_line_gets_one(self):
        assert len(Shown((120, 36), line=True).picture(BRAKED)) == 1

    def test_a_resized_terminal_is_cleared_and_redrawn(self):
        shown = Shown((80, 24))

        def resize(board):
            board.show(BRAKED)
            before = len(shown.console.file.getvalue())
            shown.console.size = (70, 20)
            board.show(BRAKED)
            self.after = shown.console.file.getvalue()[before:]

        shown.after(resize)
        assert "\x1b[2J" in self.after
        assert "braking 128 rad/s" in ESCAPE.sub("", self.after)
        assert "late" not in self.after

    def test_a_plain_one_is_ascii_and_distinguishes_curves_by_their_marks(self):
        text = ESCAPE.sub("", Shown((80, 24), plain=True).raw(BRAKED))
        assert text.isascii()
        for mark in ("** car", "o wheel", "** slip", "- reference", "> BRAKING", "x spin-up"):
            assert mark in text

    def test_an_encoding_without_braille_gets_the_plain_one(self):
        file = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
        with Dashboard(Console(file=file, width=80, height=24, **TERMINAL), CONFIG) as board:
            board.show(BRAKED)
        file.flush()
        assert b"** car" in file.buffer.getvalue()


class TestLine:
    def text(self, snapshot, width=80):
        console = Console(file=io.StringIO(), width=width)
        console.print(Group(in_one_line(snapshot, KEYS)))
        return console.file.getvalue()

    def test_it_names_phase_speed_slip_overruns_and_how_to_stop(self):
        assert self.text(USUAL) == f"braking 128 rad/s, slip 0.20, {KEYS}, 0 overruns\n"

    def test_60_columns_have_room_for_how_to_stop(self):
        assert KEYS in self.text(USUAL._replace(phase=Phase.SPIN_UP), 60)

    @pytest.mark.parametrize("width", [20, 40, 59])
    @settings(max_examples=40)
    @given(snapshot=snapshots)
    def test_it_is_one_line_that_fits(self, width, snapshot):
        (line,) = self.text(snapshot, width).splitlines()
        assert len(line) <= width

    def test_text_that_does_not_fit_is_marked_as_cut(self):
        assert self.text(USUAL, 20).endswith("…\n")

    def test_overruns_are_red_if_there_are_any(self):
        assert not RED.search(Shown(line=True).raw(USUAL))
        assert RED.search(Shown(line=True).raw(USUAL._replace(overruns=2)))

    @pytest.mark.parametrize("phase", Phase)
    def test_every_phase_has_a_name(self, phase):
        assert phase.name.lower().replace("_", "-") in self.text(USUAL._replace(phase=phase))

    def test_before_the_first_tick_it_says_what_is_waited_for(self):
        shown = Shown((70, 20))
        assert "starting: guardian drilled?" in shown.after(lambda board: board.passed(StartCheck.BOARD))


class TestDashboard:
    @pytest.mark.parametrize("size", [(120, 36), (80, 24), (70, 20)])
    def test_there_is_colour_on_a_terminal_and_none_with_no_color(self, monkeypatch, size):
        missed = BRAKED._replace(overruns=3)
        assert COLOUR.search(Shown(size).raw(missed))
        monkeypatch.setenv("NO_COLOR", "1")
        assert not COLOUR.search(Shown(size).raw(missed))

    def test_it_starts_no_thread_to_draw(self):
        before = threading.active_count()
        with Dashboard(console_of(), CONFIG) as board:
            board.show(BRAKED)
            assert threading.active_count() == before

    def test_traces_stay_when_it_is_over(self):
        console = console_of()
        with Dashboard(console, CONFIG) as board:
            board.show(BRAKED)
            before = len(console.file.getvalue())
        last = console.file.getvalue()[before:]
        assert "━━ car" in last
        assert "stops safely" not in last  # there is nothing left to stop
        assert "\x1b[2K" not in last.rpartition("car")[2]

    @pytest.mark.parametrize("size", [(80, 24), (70, 20)])
    def test_what_never_braked_leaves_nothing(self, size):
        console = console_of(size)
        with Dashboard(console, CONFIG) as board:
            board.show(USUAL)
        assert "\x1b[2K" in console.file.getvalue().rpartition("rad/s")[2]

    @pytest.mark.parametrize("say", ["warn", "note"])
    def test_what_is_said_stays_above(self, say):
        console = console_of()
        with Dashboard(console, CONFIG) as board:
            board.show(BRAKED)
            getattr(board, say)("MOTOR POWER MAY STILL BE ON: [press] the emergency switch")
            board.show(BRAKED)
        text = console.file.getvalue()
        assert bool(RED.search(text)) == (say == "warn")
        assert "MOTOR POWER MAY STILL BE ON: [press] the emergency switch" in ESCAPE.sub("", text)

    def test_the_cursor_is_shown_again_regardless_of_what_ends_it(self):
        console = console_of()
        with pytest.raises(KeyboardInterrupt), Dashboard(console, CONFIG) as board:
            interrupted(board)
        text = console.file.getvalue()
        assert text.rfind("\x1b[?25h") > text.rfind("\x1b[?25l") >= 0

    def test_without_a_keyboard_only_ctrl_c_is_offered(self):
        def listen(board):
            with board.listening(lambda: None):
                board.show(BRAKED)

        text = Shown().after(listen)
        assert CTRL_C in text
        assert "space" not in text


def interrupted(board):
    board.show(USUAL)
    raise KeyboardInterrupt
