import io
import re
import threading

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console, Group

from inteco_abs.realtime.screen import Snapshot
from inteco_abs.signals import Phase
from inteco_abs.views.dashboard import HINT, Dashboard, in_one_line, panel

FULL_SPEED = 180.0
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
    late_us=(12.0, 98.0, 301.0, 1234.5),
)
ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
COLOUR = re.compile(r"\x1b\[(?:\d+;)*(?:3[0-8]|4[0-8]|9[0-7]|10[0-7])(?:;\d+)*m")
RED = re.compile(r"\x1b\[(?:\d+;)*31m")
WIDE, NARROW = (60, 80, 120), (20, 40, 59)
TERMINAL = {"force_terminal": True, "color_system": "standard", "legacy_windows": False}

numbers = st.floats(-1e6, 1e6)
duties = st.floats(0.0, 1.0)
late = st.none() | st.floats(0.0, 1e7)
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
)


@pytest.fixture(autouse=True)
def colours(monkeypatch):
    """As on a terminal of a user who has not asked for anything."""
    for name in ("NO_COLOR", "FORCE_COLOR", "COLUMNS", "LINES", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")


def console_of(width, **options):
    return Console(file=io.StringIO(), width=width, height=40, **options)


def text_of(renderable, width, **options):
    console = console_of(width, **options)
    console.print(Group(renderable))  # as it is: texts on their own would be joined, and so wrapped
    return console.file.getvalue()


def shown(width, *snapshots, **options):
    """Everything that a dashboard of that width writes."""
    console = console_of(width, **{**TERMINAL, **options})
    with Dashboard(console, FULL_SPEED) as board:
        for snapshot in snapshots:
            board.show(snapshot)
    return console.file.getvalue()


def lines_of(text):
    return ESCAPE.sub("", text).replace("\r", "\n").splitlines()


class TestPanel:
    def test_every_figure_has_its_label_and_its_unit(self):
        text = text_of(panel(USUAL, FULL_SPEED), 80)
        for label, value in {
            "road speed": "127.6 rad/s",
            "wheel speed": "101.4 rad/s",
            "slip": "0.205",
            "drive duty": "0.00",
            "brake duty": "0.44",
        }.items():
            (line,) = (line for line in text.splitlines() if label in line)
            assert value in line
        assert "6.6 s, 13251 ticks" in text
        assert HINT in text

    def test_lateness_is_told_by_its_quantiles(self):
        text = text_of(panel(USUAL, FULL_SPEED), 80)
        assert "late p50 12, p99 98, p99.9 301, max 1234 us; 0 periods missed" in text

    def test_what_is_not_known_yet_is_a_dash(self):
        early = USUAL._replace(late_us=(None, None, None, 0.0))
        assert "late p50 -, p99 -, p99.9 -, max 0 us" in text_of(panel(early, FULL_SPEED), 80)

    @pytest.mark.parametrize("phase", [Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED])
    def test_the_present_phase_stands_out_among_all_of_them(self, phase):
        text = text_of(panel(USUAL._replace(phase=phase), FULL_SPEED), 80, **TERMINAL)
        standing_out = re.findall(r"\x1b\[1;7m([^\x1b]*)\x1b", text)
        assert standing_out == [phase.name.lower().replace("_", "-")]
        assert "idle > armed > spin-up > braking > stopped" in ESCAPE.sub("", text)

    @pytest.mark.parametrize(("value", "filled"), [(0.0, 0), (90.0, 14), (180.0, 28), (500.0, 28), (-20.0, 0)])
    def test_a_bar_is_filled_by_the_share_of_its_full_scale(self, value, filled):
        plain = text_of(panel(USUAL._replace(road_speed_rad_s=value), FULL_SPEED), 80, **TERMINAL)
        (line,) = (line for line in plain.splitlines() if "road speed" in ESCAPE.sub("", line))
        done = "".join(re.findall(r"\x1b\[(?:38;5;197|91|31|32|35|95)[0-9;]*m([━╸╺]+)", line))
        assert done.count("━") == filled

    @pytest.mark.parametrize("width", WIDE)
    @settings(max_examples=40)
    @given(snapshot=snapshots)
    def test_it_fits_every_terminal_for_which_it_is_made(self, width, snapshot):
        text = text_of(panel(snapshot, FULL_SPEED), width)
        assert max(map(len, text.splitlines())) <= width
        assert len(text.splitlines()) < 20

    @pytest.mark.parametrize("width", WIDE)
    def test_nothing_of_the_usual_is_cut(self, width):
        text = " ".join(re.sub(r"[│╭╮╰╯─\s]+", " ", text_of(panel(USUAL, FULL_SPEED), width)).split())
        for part in ("127.6 rad/s", "101.4 rad/s", "0.205", "0.44", "max 1234 us; 0 periods missed", HINT):
            assert part in text


class TestLine:
    def test_it_names_phase_speed_slip_and_overruns(self):
        assert text_of(in_one_line(USUAL), 80) == f"braking 128 rad/s, slip 0.20, 0 overruns, {HINT}\n"

    @pytest.mark.parametrize("width", NARROW)
    @settings(max_examples=40)
    @given(snapshot=snapshots)
    def test_it_is_one_line_that_fits(self, width, snapshot):
        (line,) = text_of(in_one_line(snapshot), width).splitlines()
        assert len(line) <= width

    def test_what_does_not_fit_is_marked_as_cut(self):
        assert text_of(in_one_line(USUAL), 20).endswith("…\n")


class TestOverruns:
    @pytest.mark.parametrize(
        ("picture", "word"),
        [(in_one_line, "overruns"), (lambda snapshot: panel(snapshot, FULL_SPEED), "periods missed")],
        ids=["line", "panel"],
    )
    def test_they_are_red_if_there_are_any_and_only_then(self, picture, word):
        texts = {
            count: text_of(picture(USUAL._replace(overruns=count)), 120, **TERMINAL, highlight=False)
            for count in (0, 1, 250)
        }
        assert not re.search(rf"\x1b\[(?:\d+;)*31m0 {word}", texts[0])
        for count in (1, 250):
            assert re.search(rf"\x1b\[(?:\d+;)*31m{count} {word}", texts[count])


class TestDashboard:
    @pytest.mark.parametrize("width", WIDE)
    def test_a_wide_terminal_gets_the_panel(self, width):
        text = "\n".join(lines_of(shown(width, USUAL)))
        assert "wheel speed" in text
        assert "late p50" in text

    @pytest.mark.parametrize("width", NARROW)
    def test_a_narrow_terminal_gets_the_line(self, width):
        lines = [line for line in lines_of(shown(width, USUAL)) if line.strip()]
        assert all(line.startswith("braking 128") for line in lines)
        assert lines

    @pytest.mark.parametrize("width", [*WIDE, *NARROW])
    def test_no_line_is_longer_than_the_terminal(self, width):
        snapshots = [USUAL._replace(phase=phase, overruns=10**9) for phase in Phase]
        assert max(map(len, lines_of(shown(width, *snapshots)))) <= width

    @pytest.mark.parametrize("width", [120, 40])
    def test_there_is_colour_on_a_terminal_and_none_with_no_color(self, monkeypatch, width):
        missed = USUAL._replace(overruns=3)
        assert COLOUR.search(shown(width, missed))
        monkeypatch.setenv("NO_COLOR", "1")
        assert not COLOUR.search(shown(width, missed))

    def test_it_starts_no_thread(self):
        before = threading.active_count()
        with Dashboard(console_of(80, **TERMINAL), FULL_SPEED) as board:
            board.show(USUAL)
            assert threading.active_count() == before
        assert threading.active_count() == before

    def test_a_terminal_that_changes_its_width_changes_the_picture(self):
        console = console_of(80, **TERMINAL)
        with Dashboard(console, FULL_SPEED) as board:
            board.show(USUAL)
            before = len(console.file.getvalue())
            console.width = 40
            board.show(USUAL)
        after = "\n".join(lines_of(console.file.getvalue()[before:]))
        assert "wheel speed" not in after
        assert "braking 128 rad/s" in after

    def test_a_snapshot_takes_the_place_of_the_one_before_and_the_last_leaves_nothing(self):
        once, often = (shown(40, *[USUAL] * times) for times in (1, 5))
        assert often.count("braking") > once.count("braking")
        assert often.count("\n") == once.count("\n")
        assert "\x1b[2K" in once.rpartition("braking")[2]  # erases the line

    def test_a_warning_is_red_and_stays(self):
        console = console_of(80, **TERMINAL)
        with Dashboard(console, FULL_SPEED) as board:
            board.show(USUAL)
            board.warn("MOTOR POWER MAY STILL BE ON: [press] the emergency switch")
            board.show(USUAL)
        text = console.file.getvalue()
        assert RED.search(text)
        assert "MOTOR POWER MAY STILL BE ON: [press] the emergency switch" in ESCAPE.sub("", text)

    def test_the_cursor_is_shown_again_whatever_ends_it(self):
        console = console_of(80, **TERMINAL)
        with pytest.raises(KeyboardInterrupt), Dashboard(console, FULL_SPEED) as board:
            interrupted(board)
        text = console.file.getvalue()
        assert text.rfind("\x1b[?25h") > text.rfind("\x1b[?25l") >= 0

    def test_into_a_file_it_writes_no_escapes(self):
        text = shown(80, USUAL, USUAL, force_terminal=False, color_system=None)
        assert "\x1b" not in text


def interrupted(board):
    board.show(USUAL)
    raise KeyboardInterrupt


def test_every_phase_has_a_name():
    for phase in Phase:
        assert phase.name.lower().replace("_", "-") in text_of(in_one_line(USUAL._replace(phase=phase)), 80)
