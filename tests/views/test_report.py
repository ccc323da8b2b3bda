"""The page as text: what is in it, what it costs. Its plots are looked at in a browser elsewhere."""

import base64
import importlib.util
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.sessions.content import LogEntry
from inteco_abs.signals import Phase
from inteco_abs.views.report import check_report, report_page, write_report

MOST_BYTES = 2_500_000
EVIL = "</script><script>window.pwned=1</script><img src=x onerror=window.pwned=1>\"'&"
PLOTS = ["speeds", "slip", "torque", "duty", "switching", "timing", "plane", "lateness"]


class Page(HTMLParser):
    """Tags with their attributes, and the text that is read."""

    def __init__(self, page):
        super().__init__()
        self.tags, self._parts, self._silent = [], [], False
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._silent = tag in {"script", "style"}

    def handle_endtag(self, _tag):
        self._silent = False

    def handle_data(self, data):
        if not self._silent:
            self._parts.append(data)

    def of(self, tag):
        return [attrs for name, attrs in self.tags if name == tag]

    @property
    def words(self):
        return " ".join(" ".join(self._parts).split())


def page_of(*sessions):
    return Page(report_page(sessions))


@pytest.fixture
def without_matplotlib(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "matplotlib" else find(name))


@pytest.fixture(scope="module")
def source(session):
    return report_page([session])


@pytest.fixture(scope="module")
def page(source):
    return Page(source)


@pytest.mark.untraced
class TestPage:
    def test_card_gains_and_commands_are_shown(self, page, session, stop):
        for words in (
            "✓ completed",
            f"stop time {stop[0].card['stop_time_s']:.3f} s",
            "Mk 2.0",
            f"inteco-abs replay {session.path}",
            "inteco-abs run --board sim: --virtual --seed 1 --config rig.toml --out again.mcap",
            "Points drawn: every tick.",
        ):
            assert words in page.words

    def test_every_plot_is_there(self, page):
        assert [attrs["id"] for attrs in page.of("figure")] == PLOTS

    def test_every_axis_has_a_unit(self, source):
        axes = re.findall(r'"axis_label":"([^"]*)"', source.replace("\\", ""))
        assert len(axes) == 2 * len(PLOTS)
        ratios = {"slip", "duty", "switching function", "ticks"}
        assert all(axis in ratios or re.search(r" \[(rad/s|N m|us|s)\]$", axis) for axis in axes)

    def test_nothing_is_loaded(self, source, page):
        assert "default-src 'none'" in source
        assert not any("src" in attrs for attrs in page.of("script"))
        assert not page.of("link")
        assert all(attrs["src"].startswith("data:") for attrs in page.of("img"))

    def test_the_picture_for_print_is_an_svg(self, page):
        (image,) = page.of("img")
        assert base64.b64decode(image["src"].partition(",")[2]).startswith(b"<?xml")

    @pytest.mark.long
    def test_ten_seconds_of_noise_fit_into_two_and_a_half_megabytes(self, session):
        random, rows = np.random.default_rng(1), 20_000
        ticks, truth = (table[np.resize(np.arange(len(table)), rows)] for table in (session.ticks, session.truth))
        for table in (ticks, truth):
            table["time_ns"] = np.arange(rows) * 500_000
            for name in (name for name in table.dtype.names if table.dtype[name] == np.float64):
                table[name] = random.uniform(0.0, 2.0, rows)
        ticks["phase"] = np.repeat([Phase.SPIN_UP, Phase.BRAKING, Phase.STOPPED], [12_000, 6_000, 2_000])
        made = report_page([session.with_rows(ticks, truth)])
        assert "the smallest and the largest of each" in made
        assert len(made.encode()) < MOST_BYTES

    @pytest.mark.usefixtures("without_matplotlib")
    def test_nothing_from_a_session_becomes_a_tag_or_a_script_and_no_value_is_too_wild(self, session, with_facts, page):
        evil = session
        for record in ("controller", "session", "software", "rig", EVIL):
            evil = with_facts(evil, record, name=EVIL, outcome=EVIL, reason=EVIL, estimator=EVIL, board=EVIL, argv=EVIL)
        ticks = session.ticks.copy()
        ticks["switching"][-5:], ticks["torque_demand_nm"][-5:], ticks["slip"][-9:] = np.inf, 1e300, np.nan
        evil = replace(evil.with_rows(ticks), path=Path("a" + EVIL.replace("/", "")), log=(LogEntry(0, 4, EVIL),))
        found = page_of(evil, session)
        assert len(found.of("script")) == len(page.of("script"))
        assert all(attrs["nonce"] for attrs in found.of("script"))
        assert not found.of("img")
        assert len(found.of("figure")) == len(PLOTS)
        assert "window.pwned=1" in found.words


@pytest.mark.usefixtures("without_matplotlib")
class TestOddSessions:
    @pytest.mark.long
    def test_one_tick_of_a_real_rig_is_a_page_with_plots(self, session):
        one = page_of(session.with_rows(session.ticks[:1], session.truth[:0]))
        assert "The run ended before braking" in one.words
        assert len(one.of("figure")) == len(PLOTS)
        assert not any("true" in attrs.get("data-lines", "") for attrs in one.of("button"))

    def test_no_tick_is_a_page_without(self, session):
        empty = page_of(session.with_rows(session.ticks[:0], session.truth[:0]))
        assert "The session holds no ticks: there is nothing to draw." in empty.words
        assert not empty.of("figure")

    def test_one_that_says_nothing_can_neither_be_replayed_nor_repeated(self, session):
        bare = replace(session.with_rows(session.ticks[:0], session.truth[:0]), metadata={}, attachments={})
        words = page_of(bare).words
        assert "The decisions cannot be replayed" in words
        assert "The run cannot be repeated" in words


class TestFile:
    def test_an_existing_file_is_never_overwritten(self, session, tmp_path):
        path = tmp_path / "stop.html"
        path.write_text("mine")
        with pytest.raises(ConfigError, match="never overwritten"):
            write_report([session], path)
        assert path.read_text() == "mine"

    @pytest.mark.parametrize("name", ["stop.mcap", "stop", "stop.HTM", "stop.html.gz"])
    def test_another_suffix_is_refused(self, tmp_path, name):
        with pytest.raises(ConfigError, match=r"must end in \.html"):
            check_report(tmp_path / name)

    def test_a_missing_folder_is_refused(self, tmp_path):
        with pytest.raises(ConfigError, match="create it first"):
            check_report(tmp_path / "missing" / "stop.html")

    def test_without_bokeh_it_is_said_what_to_install(self, monkeypatch, tmp_path):
        monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
        with pytest.raises(AbsError, match=r"pip install 'inteco-abs\[report\]'"):
            check_report(tmp_path / "stop.html")

    def test_failed_report_leaves_no_file(self, session, tmp_path):
        with pytest.raises(ConfigError):
            write_report([session, session], tmp_path / "stop.html")
        assert list(tmp_path.iterdir()) == []


class TestVerb:
    @pytest.fixture
    def here(self, session, others, tmp_path):
        for each in (session, others[0]):
            (tmp_path / each.path.name).write_bytes(each.path.read_bytes())
        (tmp_path / "notes.txt").write_text("text")
        return tmp_path

    def test_several_sessions_are_a_comparison(self, verb, here):
        done = verb("report", "stop.mcap", "gains.mcap")
        assert (done.code, done.out, done.err) == (0, "", "report: comparison.html\n")
        words = Page((here / "comparison.html").read_text()).words
        assert "A Mk 2, Mq 1 ✓ completed" in words
        assert "B Mk 10, Mq 4 ✓ completed" in words
        assert verb("report", "stop.mcap", "gains.mcap").code == 2

    def test_a_session_that_was_cut_is_reported_beside_itself_and_with_losses(self, verb, here):
        data = (here / "stop.mcap").read_bytes()
        (here / "cut.mcap").write_bytes(data[: len(data) // 20])
        done = verb("report", "cut.mcap")
        assert done.code == 3
        assert "the file ends early" in done.err
        assert (here / "cut.html").exists()

    @pytest.mark.parametrize("arguments", [("notes.txt", "-o", "x.html"), ("missing.mcap",)])
    def test_what_is_not_a_session_fails_and_leaves_nothing(self, verb, here, arguments):
        assert verb("report", *arguments).code == 1
        assert not list(here.glob("*.html"))

    @pytest.mark.parametrize("arguments", [(), ("stop.mcap", "stop.mcap"), ("stop.mcap", "-o", "stop.pdf")])
    def test_wrong_usage(self, verb, here, arguments):
        assert verb("report", *arguments).code == 2
        assert not list(here.glob("*.html"))
