import io
import re

import pytest
from rich.console import Console

from inteco_abs.host.checks import CheckResult, Rating
from inteco_abs.views.findings import render_findings, render_histogram

FINDINGS = [
    CheckResult("clock source", Rating.GREEN, "tsc"),
    CheckResult("board", Rating.AMBER, "no [red]board[/red]", "plug it in"),
    CheckResult(
        "loop settings", Rating.RED, "refused: scheduler, memory", "scheduler: raise rtprio\nmemory: raise memlock"
    ),
]


def text_of(renderable, width=80, **options):
    console = Console(file=io.StringIO(), width=width, **options)
    console.print(renderable)
    return console.file.getvalue()


def lines_of(renderable, **options):
    return [line.strip() for line in text_of(renderable, **options).splitlines() if line.strip()]


def test_every_finding_has_its_verdict_as_text_and_its_fix_below():
    assert lines_of(render_findings(FINDINGS)) == [
        "clock source   green  tsc",
        "board          amber  no [red]board[/red]",
        "-> plug it in",
        "loop settings  red    refused: scheduler, memory",
        "-> scheduler: raise rtprio",
        "-> memory: raise memlock",
        "red  1 green, 1 amber, 1 red",
    ]


@pytest.mark.parametrize(
    ("count", "last"), [(1, "green  1 green, 0 amber, 0 red"), (2, "amber  1 green, 1 amber, 0 red")]
)
def test_the_last_line_is_the_worst_verdict(count, last):
    assert lines_of(render_findings(FINDINGS[:count]))[-1] == last


def test_verdicts_have_colours_of_their_own_and_none_in_a_file(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    text = text_of(render_findings(FINDINGS), force_terminal=True, color_system="standard")
    assert {word: re.search(rf"\x1b\[1;(\d+)m{word}", text).group(1) for word in Rating} == {
        "green": "32",
        "amber": "33",
        "red": "31",
    }
    assert "\x1b" not in text_of(render_findings(FINDINGS))


def test_long_commands_are_wrapped_and_not_cut():
    command = "echo on | sudo tee /sys/" + "a-long-folder/" * 20 + "control"
    text = text_of(render_findings([CheckResult("board", Rating.AMBER, "x", command)]))
    assert max(map(len, text.splitlines())) <= 80
    assert re.sub(r"\s+", "", command) in re.sub(r"\s+", "", text)


def test_a_histogram_counts_by_twentieths_of_the_period_and_shows_the_rare_ones():
    times_us = [210.0] * 1000 + [249.9] * 500 + [275.0] + [5000.0]
    assert [line.split() for line in lines_of(render_histogram(times_us, 500.0))] == [
        ["from", "200", "us", "1000", "#" * 40],
        ["from", "225", "us", "500", "#" * 20],
        ["from", "275", "us", "1", "#"],
        ["from", "1000", "us", "1", "#"],
    ]


def test_bars_beyond_the_period_are_red(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    options = {"force_terminal": True, "color_system": "standard"}
    assert "\x1b[32m#" in text_of(render_histogram([499.0], 500.0), **options)
    assert "\x1b[31m#" in text_of(render_histogram([500.0], 500.0), **options)


def test_nothing_measured_is_not_a_histogram():
    assert text_of(render_histogram([], 500.0)).strip() == ""
