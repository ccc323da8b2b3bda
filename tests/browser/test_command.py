"""The verb `serve` with what cannot be served, and how it says so."""

import socket
import sys

import pytest


@pytest.fixture
def taken():
    """A port that another program serves."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        yield other.getsockname()[1]


def refused(verb, *arguments):
    done = verb("serve", *arguments)
    assert done.code in {1, 2}
    assert not done.out
    return done.err


def test_a_busy_port_is_named_with_what_to_do(verb, tmp_path, taken):
    said = refused(verb, tmp_path, "--port", taken)
    assert f"port {taken} cannot be served" in said
    assert "name another port" in said
    assert "network" not in said


def test_a_server_for_the_network_warns(verb, tmp_path, taken):
    assert "without encryption" in refused(verb, tmp_path, "--host", "0.0.0.0", "--port", taken)  # noqa: S104  asked for


def test_an_address_of_another_computer_is_refused(verb, tmp_path):
    assert "name an address of this computer" in refused(verb, tmp_path, "--host", "192.0.2.1", "--port", 0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "nowhere: cannot be listed"),
        (["--allow-board", "usb9:"], "usb9:"),
        (["--set", "guard.brake_limt=1"], "did you mean brake_limit?"),
        (["--controller", "nosuch"], "nosuch"),
        (["--config", "nowhere.toml"], "nowhere.toml"),
        (["--port", "70000"], "'70000'"),
    ],
)
def test_what_run_would_refuse_is_refused_before_a_browser_sees_it(verb, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert words in refused(verb, *arguments)


def test_a_missing_extra_is_named(verb, monkeypatch):
    for name in [name for name in sys.modules if name.startswith("inteco_abs.browser")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    assert "pip install 'inteco-abs[serve]'" in refused(verb)
