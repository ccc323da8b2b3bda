"""Sessions of a stranger whose texts hold orders to a terminal."""

import pytest

from inteco_abs.sessions import Recorder

CLEAR, TITLE, RIGHT_TO_LEFT = "\x1b[2J", "\x1b]0;mine\x07", "\u202e"
NASTY = f"{CLEAR}{TITLE}\x9b31m{RIGHT_TO_LEFT}\r\x08end"
READING = ("replay", "what-if", "info", "validate", "diff", "get", "list")


@pytest.fixture
def hostile(tmp_path, quick, monkeypatch):
    """A session with such a text in each place that a stranger can choose."""

    def write(name="stranger.mcap", controller=(), config=None, library=False, **facts):
        session, path = quick.session, tmp_path / name
        if library:
            monkeypatch.setattr("inteco_abs.sessions.recorder.version", lambda _package: NASTY)
        with Recorder(path, 0) as recorder:
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
def test_no_verb_hands_a_strangers_text_to_the_terminal_as_it_is(verb, hostile, quick, tmp_path, variant, name):
    file = hostile(**VARIANTS[variant])
    words = {
        "what-if": [file, "--set", "controller.gains.Mk=2.5"],
        "info": [file, "--all"],
        "diff": [file, quick.path],
        "get": [file],
        "list": [tmp_path],
    }.get(name, [file])
    done = verb(name, *words)
    assert orders(done.out + done.err) == set()
    assert done.out + done.err


@pytest.mark.parametrize("variant", VARIANTS)
def test_nor_does_recover_of_a_damaged_one(verb, hostile, tmp_path, variant):
    file = hostile(**VARIANTS[variant])
    file.write_bytes(file.read_bytes()[:-100])
    done = verb("recover", file, "--out", tmp_path / "again.mcap")
    assert orders(done.out + done.err) == set()


def test_a_file_out_of_a_session_is_exact_in_a_pipe_and_harmless_on_a_terminal(verb, hostile, monkeypatch):
    file = hostile()
    assert verb("get", file, f"a{NASTY}").out == NASTY
    monkeypatch.setattr("inteco_abs.cli.contents.on_terminal", lambda _stream: True)
    shown = verb("get", file, f"a{NASTY}")
    assert orders(shown.out) == set()
    assert "end" in shown.out
