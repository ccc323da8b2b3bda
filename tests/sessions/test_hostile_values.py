"""Sessions of a stranger whose texts hold orders to a terminal, and whose numbers have no end."""

from dataclasses import replace

import numpy as np
import pytest

from inteco_abs.analysis import diff_sessions
from inteco_abs.format.schema import TICK, TRUTH
from inteco_abs.sessions import FileWriter

CLEAR, TITLE, RIGHT_TO_LEFT = "\x1b[2J", "\x1b]0;mine\x07", "\u202e"
NASTY = f"{CLEAR}{TITLE}\x9b31m{RIGHT_TO_LEFT}\r\x08end"
READING = ("replay", "what-if", "info", "validate", "diff", "extract", "list", "play")


@pytest.fixture
def hostile(tmp_path, quick, monkeypatch):
    """A session with such a text in each place that a stranger can choose."""

    def write(name="stranger.mcap", controller=(), config=None, library=False, **facts):
        session, path = quick.session, tmp_path / name
        if library:
            monkeypatch.setattr("inteco_abs.sessions.file_writer.version", lambda _package: NASTY)
        with FileWriter(path, 0) as recorder:
            recorder.describe("controller", {**session.metadata["controller"], **dict(controller)})
            recorder.describe(NASTY, {NASTY: NASTY})
            recorder.attach("config.toml", "application/toml", config or session.attachments["config.toml"])
            recorder.attach(f"a{NASTY}", "text/plain", NASTY.encode())
            recorder.begin({})
            for record, values in facts.items():
                recorder.describe(record, values)
            recorder.ticks(session.payload)
            recorder.finish(NASTY if facts else "completed", NASTY, {**quick.stop.card, "controller": NASTY})
        return path

    return write


VARIANTS = {
    "package": {"controller": {"name": "not-installed", "package": NASTY}},
    "gain": {"controller": {f"gain.{NASTY}": "2.0", f"gain.{NASTY}.hex": "0x1p+1"}},
    "value": {"controller": {"gain.Mk": NASTY, "gain.Mk.hex": NASTY}},
    "config": {"config": f'[controller]\nname = "{CLEAR.encode("unicode_escape").decode()}"'.encode()},
    "newer": {"library": True, "session": {"format_version": "999"}},
}


def orders(text):
    """What a terminal would obey; of white space only line ends and spaces are innocent."""
    return {letter for letter in text if not letter.isprintable() and letter != "\n"}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", READING)
def test_every_verb_escapes_foreign_text_for_the_terminal(verb, hostile, quick, tmp_path, variant, name):
    file = hostile(**VARIANTS[variant])
    words = {
        "what-if": [file, "--set", "controller.gains.Mk=2.5"],
        "info": [file, "--all"],
        "diff": [file, quick.path],
        "extract": [file],
        "list": [tmp_path],
        "play": [file, "--foxglove=0", "--speed=1024"],
    }.get(name, [file])
    done = verb(name, *words)
    assert orders(done.out + done.err) == set()
    assert done.out + done.err


@pytest.mark.parametrize("variant", VARIANTS)
def test_recover_escapes_foreign_text_of_a_damaged_session(verb, hostile, tmp_path, variant):
    file = hostile(**VARIANTS[variant])
    file.write_bytes(file.read_bytes()[:-100])
    done = verb("recover", file, "--out", tmp_path / "again.mcap")
    assert orders(done.out + done.err) == set()


def test_an_extracted_file_is_exact_in_a_pipe_and_escaped_on_a_terminal(verb, hostile, monkeypatch):
    file = hostile()
    assert verb("extract", file, f"a{NASTY}").out == NASTY
    monkeypatch.setattr("inteco_abs.cli.extract.on_terminal", lambda _stream: True)
    shown = verb("extract", file, f"a{NASTY}")
    assert orders(shown.out) == set()
    assert "end" in shown.out


class TestNumbersWithoutEnd:
    """JSON and TOML set no limit to a whole number, and a tick's time has 64 bits."""

    HUGE = 10**4000

    @pytest.fixture
    def with_card(self, tmp_path, quick, monkeypatch):
        monkeypatch.setattr(
            "inteco_abs.sessions.file_writer.pack_result", lambda _card: b""
        )  # ours packs no such number

        def write(name, **values):
            with FileWriter(tmp_path / name, 0) as recorder:
                for record in ("controller", "rig"):
                    recorder.describe(record, quick.session.metadata.get(record, {}))
                config = quick.session.attachments["config.toml"] + f"\n[strange]\nnumber = {self.HUGE}\n".encode()
                recorder.attach("config.toml", "application/toml", config)
                recorder.begin({})
                recorder.ticks(quick.session.payload)
                recorder.finish("completed", "no fault", {**quick.stop.card, **values})
            return tmp_path / name

        return write

    def test_a_card_and_a_setting_of_4000_digits_are_not_an_error_of_the_program(self, verb, with_card, tmp_path):
        huge = dict.fromkeys(("overruns", "stop_time_s", "slip_rms_true"), self.HUGE)
        files = with_card("a.mcap", **huge), with_card("b.mcap", **{**huge, "overruns": 7, "stop_time_s": 1.5})
        for words in (["diff", *files], ["diff", *files, "--rel", "0.5"], ["info", files[0]], ["list", tmp_path]):
            done = verb(*words)
            assert done.code in {0, 4}, done.err
        assert verb("report", files[0], "--out", tmp_path / "report.html").code == 0

    def test_a_setting_that_no_double_holds_differs_from_one_that_it_does(self, quick):
        sessions = [
            replace(quick.session, attachments={"config.toml": f"number = {number}".encode()})
            for number in (self.HUGE, 1, self.HUGE)
        ]
        assert not diff_sessions(sessions[0], sessions[1], ("configuration",), 0.5).equal
        assert diff_sessions(sessions[0], sessions[2], ("configuration",), 0.5).equal

    @pytest.mark.parametrize("of", ["ticks", "truths"])
    @pytest.mark.parametrize("name", ["diff", "report", "info"])
    def test_a_time_that_no_clock_shows_is_damage(self, verb, quick, tmp_path, of, name):
        records = {"ticks": bytearray(quick.session.payload), "truths": bytearray(quick.session.truth.tobytes())}
        rows = np.frombuffer(records[of], (TICK if of == "ticks" else TRUTH).dtype)
        rows["time_ns"] += np.uint64((1 << 64) - (1 << 40))
        path = tmp_path / "late.mcap"
        with FileWriter(path, 0, epoch_ns=0) as recorder:
            recorder.attach("config.toml", "application/toml", quick.session.attachments["config.toml"])
            recorder.begin({})
            recorder.ticks(bytes(records["ticks"]))
            recorder.truths(bytes(records["truths"]))
            recorder.finish("completed", "no fault", quick.stop.card)
        words = {"diff": [path, quick.path], "report": [path, "--out", tmp_path / "report.html"]}.get(name, [path])
        done = verb(name, *words)
        assert done.code == 1
        assert "is damaged: a tick's time is 18446" in done.err
