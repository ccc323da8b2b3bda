import io
import re

import pytest
from rich.console import Console

from inteco_abs.views import render_card

CARD = {
    "session": "stop.mcap",
    "stops": 1,
    "outcome": "completed",
    "controller": "reaching-law",
    "estimator": "moving-window",
    "board": "sim:",
    "rig": None,
    "reference_slip": 0.2,
    "ticks": 16253,
    "overruns": 3,
    "lost_ticks": 0,
    "link_errors": 5,
    "start_speed_rad_s": 180.15,
    "reaching_time_s": 0.3204,
    "band_entry_s": 0.311,
    "stop_time_s": 1.3994,
    "stop_distance_m": 13.176,
    "slip_rms_true": 0.00912,
    "slip_rms_estimated": 0.0099,
    "slip_rms_low_speed_true": 0.00666,
    "slip_rms_fixed_true": 0.01447,
    "lock_fraction": 0.0825,
    "torque_variation_nm_per_s": 186.9,
    "duty_variation_per_s": 12.57,
    "lateness_us": {"p50": 12.2, "p99": 98.6, "p999": 300.0, "max": 1234.4},
    "payload_sha256": "0" * 64,
}
LINES = {
    "start speed": "180.2 rad/s",
    "reaching time": "0.320 s",
    "band entry": "0.311 s",
    "stop time": "1.399 s",
    "stop distance": "13.18 m",
    "slip RMS, true": "0.0091",
    "slip RMS, estimated": "0.0099",
    "slip RMS, 10..60 rad/s": "0.0067",
    "slip RMS, from 0.25 s": "0.0145",
    "wheel locked": "8.2 %",
    "torque variation": "187 N m/s",
    "duty variation": "12.6 /s",
    "ticks, overruns, link errors": "16253, 3, 5",
    "late p50 / p99 / max": "12 / 99 / 1234 us",
}
METRICS = [
    key for key, value in CARD.items() if isinstance(value, float) and key not in {"reference_slip", "lateness_us"}
]
COLOUR = re.compile(r"\x1b\[(?:\d+;)*(?:3[0-8]|4[0-8]|9[0-7]|10[0-7])(?:;\d+)*m")
LONG = "a-folder-with-a-long-name/" * 12 + "stop.mcap"
WORDS = "the road wheel did not stop in time: check the brake's power and the controller's gains; " * 3


def text_of(card, explanation="no fault", width=80, *, before=None, plain=False, **options):
    console = Console(file=io.StringIO(), width=width, **options)
    console.print(render_card(card, explanation, before, plain=plain))
    return console.file.getvalue()


def values_in(text):
    """What stands to the right of every label."""
    found = {}
    for line in text.splitlines():
        inner = line.strip("│ ")
        for label in LINES:
            if inner.startswith(label + "  "):
                found[label] = inner.removeprefix(label).strip()
    return found


def test_every_figure_has_its_line_with_its_unit():
    assert values_in(text_of(CARD)) == LINES


def test_head_says_how_it_ended_and_what_was_run():
    text = text_of(CARD)
    assert "COMPLETED  reaching-law on moving-window, reference slip 0.2" in text
    assert "stop.mcap" in text


def test_head_names_a_drawn_rig_and_no_other():
    assert "reference slip 0.2, rig hard:17" in text_of({**CARD, "rig": "hard:17"})
    assert "rig" not in text_of(CARD)


def test_a_completed_run_needs_no_explanation():
    assert "no fault" not in text_of(CARD)


@pytest.mark.parametrize("outcome", ["fault", "interrupted", "aborted"])
def test_any_other_end_is_explained(outcome):
    text = text_of({**CARD, "outcome": outcome}, "check the brake's power")
    assert outcome.upper() in text
    assert "check the brake's power" in text


def test_a_run_that_never_braked_has_no_lines_of_dashes():
    never = {**CARD, "outcome": "interrupted", "stops": 0, **dict.fromkeys(METRICS)}
    assert list(values_in(text_of(never))) == ["ticks, overruns, link errors", "late p50 / p99 / max"]


@pytest.mark.parametrize("missing", METRICS)
def test_what_was_not_measured_is_a_dash(missing):
    changed = [label for label, value in values_in(text_of({**CARD, missing: None})).items() if value != LINES[label]]
    assert len(changed) == 1
    assert values_in(text_of({**CARD, missing: None}))[changed[0]] == "-"


def test_a_run_without_braking_is_all_dashes():
    nothing = dict.fromkeys(METRICS) | {"lateness_us": dict.fromkeys(("p50", "p99", "p999", "max")), "ticks": 0}
    values = values_in(text_of({**CARD, **nothing}))
    assert values.pop("ticks, overruns, link errors") == "0, 3, 5"
    assert len(values) == len(METRICS)
    assert set(values.values()) == {"-"}


def test_zero_is_a_figure_not_a_dash():
    values = values_in(text_of({**CARD, **dict.fromkeys(METRICS, 0.0)}))
    assert "-" not in values.values()
    assert values["wheel locked"] == "0.0 %"


@pytest.mark.parametrize("width", [80, 100, 200])
@pytest.mark.parametrize(
    "changes",
    [{}, {"session": LONG}, {"outcome": "fault"}, {"outcome": "fault", "session": LONG, "controller": LONG}],
    ids=["usual", "long path", "fault", "everything long"],
)
def test_card_fits_the_terminal(width, changes):
    text = text_of({**CARD, **changes}, WORDS, width)
    assert max(len(line) for line in text.splitlines()) <= width
    assert values_in(text) == LINES


def test_the_usual_card_is_not_as_wide_as_80_columns():
    assert max(len(line) for line in text_of(CARD, width=200).splitlines()) < 80


def test_a_long_explanation_is_wrapped_and_not_cut():
    text = text_of({**CARD, "outcome": "fault"}, WORDS)
    assert " ".join(re.sub(r"[│\s]+", " ", text).split()).count("controller's gains;") == 3


def test_names_are_not_markup():
    text = text_of({**CARD, "controller": "[red]mine.py:Law", "session": "[b]stop.mcap"})
    assert "[red]mine.py:Law" in text
    assert "[b]stop.mcap" in text


@pytest.mark.parametrize("outcome", ["completed", "interrupted", "fault"])
def test_there_is_colour_on_a_terminal_and_none_with_no_color(monkeypatch, outcome):
    terminal = {"force_terminal": True, "color_system": "standard"}
    card = {**CARD, "outcome": outcome}
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert COLOUR.search(text_of(card, **terminal))
    monkeypatch.setenv("NO_COLOR", "1")
    assert not COLOUR.search(text_of(card, **terminal))


def test_outcomes_have_colours_of_their_own(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    codes = {}
    for outcome in ("completed", "interrupted", "fault"):
        text = text_of({**CARD, "outcome": outcome}, force_terminal=True, color_system="standard")
        codes[outcome] = re.search(r"\x1b\[1;(\d+)m" + outcome.upper(), text).group(1)
    assert codes == {"completed": "32", "interrupted": "33", "fault": "31"}


def test_in_a_file_there_are_no_escapes():
    assert "\x1b" not in text_of(CARD)


def test_card_of_a_real_run_can_be_shown(stop):
    values = values_in(text_of(stop[0].card, stop[0].explanation))
    assert values["start speed"] == f"{stop[0].card['start_speed_rad_s']:.1f} rad/s"
    assert values["slip RMS, true"] == "-"  # a stop from 20 rad/s is over before the slip arrives
    assert values["ticks, overruns, link errors"] == f"{stop[0].card['ticks']}, 0, 0"


class TestComparison:
    def changes(self, **earlier):
        text = text_of(CARD, before={**CARD, "session": "before.mcap", **earlier})
        return {label: text.removeprefix(LINES[label]).strip() for label, text in values_in(text).items()}

    def test_less_and_more_are_shown_without_a_verdict(self):
        changes = self.changes(stop_time_s=1.5, slip_rms_true=0.008, lock_fraction=0.1825)
        assert changes["stop time"] == "▼ -0.101"
        assert changes["slip RMS, true"] == "▲ +0.0011"
        assert changes["wheel locked"] == "▼ -10.0"

    def test_what_is_the_same_as_printed_is_equal(self):
        changes = self.changes(stop_time_s=1.39941)
        assert {label for label, change in changes.items() if change == "="} == set(LINES) - {
            "ticks, overruns, link errors",
            "late p50 / p99 / max",
        }

    @pytest.mark.parametrize("missing", METRICS)
    def test_what_was_not_measured_is_not_compared(self, missing):
        assert "" in self.changes(**{missing: None}).values()

    def test_it_says_with_what(self):
        before = {**CARD, "session": "before.mcap"}
        assert "compared with before.mcap: same gains and seed" in text_of(CARD, before=before)
        assert "compared with before.mcap: Mk 2 -> 5" in text_of(CARD, before=before | {"differs": "Mk 2 -> 5"})
        assert "compared" not in text_of(CARD)

    def test_a_plain_one_is_ascii(self):
        before = {**CARD, "session": "before.mcap", "stop_time_s": 1.5, "band_entry_s": 0.2}
        text = re.sub(r"[─│╭╮╰╯]", "", text_of(CARD, before=before, plain=True))  # the frame is the console's
        assert text.isascii()
        assert "v -0.101 " in text
        assert "^ +0.111 " in text

    @pytest.mark.parametrize("width", [44, 60, 80])
    def test_a_narrow_terminal_cuts_no_number(self, width):
        before = {key: 0.0 if key in METRICS else value for key, value in CARD.items()}
        text = text_of(CARD, width=width, before=before)
        assert max(map(len, text.splitlines())) <= width
        assert "…" not in text
        assert all(value in text for value in LINES.values())
        assert "▲ +0.0099" in text
